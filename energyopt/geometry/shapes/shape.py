"""Shape: what every obstacle is: a solid with a pose and a signed distance.

The signed distance of a point p to a solid is positive outside, zero on the surface and negative inside, where it is minus
the distance to the surface. With the pose R, x (of time, where the shape moves) it is d(p, t) = φ(y), y = Rᵀ(p − x), φ
being the distance in the shape's own axes. From g = ∂φ/∂y and H = ∂²φ/∂y²:

    ∂d/∂p = R g       ∂²d/∂p² = R H Rᵀ       ∂d/∂t = g·ẏ       ∂²d/∂p∂t = R H ẏ + Ṙ g       ∂²d/∂t² = ẏᵀHẏ + g·ÿ
    ẏ = Ṙᵀ(p − x) − Rᵀẋ                      ÿ = R̈ᵀ(p − x) − 2 Ṙᵀẋ − Rᵀẍ

|∂d/∂p| = 1 everywhere. For a convex solid d is convex and, outside, once continuously differentiable (its gradient is
Lipschitz with constant 1/d); second derivatives exist except where the nearest feature changes (face, edge, corner).
Inside, the gradient jumps on the medial axis, where several surface points are nearest; there one of them is chosen
(each shape says which) and the second derivative is that of the chosen branch, or zero where it is unbounded.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from energyopt.errors import GeometryError
from energyopt.geometry.moving import Moving, PoseDerivatives
from energyopt.geometry.values import label, pose_matrix

if TYPE_CHECKING:
    import coal

Distances = tuple[np.ndarray, np.ndarray, np.ndarray]
"""d (N,), gradient (N, 3) and second derivative (N, 3, 3)."""


class Shape(ABC):
    """Base of all shapes. A new one is a frozen dataclass with ``pose`` and ``name`` that implements the abstract methods.

    Attributes:
        pose: base_T_shape as a 4×4 matrix, or a `Moving`.
        name: for reports.
        kind: the word for the shape in problem files and messages.
    """

    kind: ClassVar[str]
    pose: np.ndarray | Moving
    name: str

    @abstractmethod
    def local_distance(self, y: np.ndarray) -> np.ndarray:
        """φ [m], shape (N,), of points ``y`` [m], shape (N, 3), in the shape's axes."""

    @abstractmethod
    def local_derivatives(self, y: np.ndarray) -> Distances:
        """φ (N,), its gradient (N, 3) and second derivative [1/m] (N, 3, 3), of points in the shape's axes."""

    @property
    @abstractmethod
    def bounding_radius(self) -> float:
        """Radius [m] of a ball about the shape's origin that contains it; infinite for unbounded shapes."""

    @abstractmethod
    def enclosing_points(self) -> np.ndarray:
        """Points [m], shape (K, 3), in the shape's axes, whose convex hull contains it closely.

        Raises:
            GeometryError: the shape is unbounded.
        """

    @abstractmethod
    def coal_geometry(self) -> coal.CollisionGeometry:
        """The same solid for the collision library, in the shape's axes."""

    @property
    def moves(self) -> bool:
        return isinstance(self.pose, Moving)

    def pose_at(self, t: ArrayLike = 0.0) -> np.ndarray:
        """base_T_shape at times ``t`` [s]: shape (4, 4) for one time, (N, 4, 4) for several."""
        t = np.asarray(t, dtype=float)
        if not self.moves:
            return np.broadcast_to(self.pose, (*t.shape, 4, 4)).copy()
        rotation, position = self.pose.at(t)
        matrix = np.zeros((len(position), 4, 4))
        matrix[:, :3, :3], matrix[:, :3, 3], matrix[:, 3, 3] = rotation, position, 1.0
        return matrix if t.ndim else matrix[0]

    def speed_bound(self) -> float:
        """Upper bound [m/s], over all times, of the speed of any of its points."""
        return self.pose.speed_bound(self.bounding_radius) if self.moves else 0.0

    def distance(self, points: ArrayLike, t: ArrayLike = 0.0) -> np.ndarray:
        """Signed distance [m], shape (N,), of ``points`` [m], shape (N, 3), at one time or one time a point [s]."""
        points = point_rows(points)
        rotation, position = self._placement(t)
        return self.local_distance(_to_local(points - position, rotation))

    def signed_distance(self, points: ArrayLike, t: ArrayLike = 0.0) -> Distances:
        """Signed distance and its derivatives with respect to the point.

        Args:
            points: [m], shape (N, 3).
            t: one time, or one a point, shape (N,) [s]; matters only to a shape that moves.

        Returns:
            d [m], shape (N,); gradient, shape (N, 3), of norm 1; second derivative [1/m], shape (N, 3, 3).

        Raises:
            GeometryError: points have another shape.
        """
        points = point_rows(points)
        rotation, position = self._placement(t)
        d, g, h = self.local_derivatives(_to_local(points - position, rotation))
        return d, _to_world(g, rotation), rotation @ h @ np.swapaxes(rotation, -1, -2)

    def signed_distance_in_time(self, points: ArrayLike, t: ArrayLike) -> Distances:
        """Signed distance and its derivatives with respect to (point, time).

        Args:
            points: [m], shape (N, 3); t: times [s], shape (N,).

        Returns:
            d, shape (N,); gradient (∂d/∂p, ∂d/∂t), shape (N, 4); second derivative, shape (N, 4, 4).
        """
        points = point_rows(points)
        t = np.broadcast_to(np.asarray(t, dtype=float), len(points))
        m = self.pose.derivatives(t) if self.moves else _at_rest(self.pose, len(points))
        away = points - m.position
        d, g, h = self.local_derivatives(_to_local(away, m.rotation))
        rate = _to_local(away, m.rotation_rate) - _to_local(m.velocity, m.rotation)
        second = _to_local(away, m.rotation_acceleration) - 2 * _to_local(m.velocity, m.rotation_rate)
        second -= _to_local(m.acceleration, m.rotation)
        bent = (h @ rate[:, :, None])[:, :, 0]
        gradient, curvature = np.empty((len(d), 4)), np.empty((len(d), 4, 4))
        gradient[:, :3], gradient[:, 3] = _to_world(g, m.rotation), np.sum(g * rate, axis=1)
        curvature[:, :3, :3] = m.rotation @ h @ m.rotation.transpose(0, 2, 1)
        curvature[:, :3, 3] = curvature[:, 3, :3] = _to_world(bent, m.rotation) + _to_world(g, m.rotation_rate)
        curvature[:, 3, 3] = np.sum(rate * bent, axis=1) + np.sum(g * second, axis=1)
        return d, gradient, curvature

    def _placement(self, t: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        if not self.moves:
            return self.pose[:3, :3], self.pose[:3, 3]
        rotation, position = self.pose.at(t)
        return (rotation[0], position[0]) if len(position) == 1 else (rotation, position)

    def _set(self, **values) -> None:
        """Store checked values in a frozen dataclass, with its pose and name checked as well."""
        pose = self.pose if isinstance(self.pose, Moving) else pose_matrix(f"{self.kind}: pose", self.pose)
        for key, value in {**values, "pose": pose, "name": label(f"{self.kind}: name", self.name)}.items():
            object.__setattr__(self, key, value)


def point_rows(points: ArrayLike) -> np.ndarray:
    """Points as float rows, shape (N, 3).

    Raises:
        GeometryError: another shape.
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise GeometryError(f"points have the shape {points.shape}; expected rows xyz, (N, 3)")
    return points


def _to_local(vectors: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Rᵀ v, row by row."""
    return vectors @ rotation if rotation.ndim == 2 else np.einsum("nji,nj->ni", rotation, vectors)


def _to_world(vectors: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """R v, row by row."""
    return vectors @ rotation.T if rotation.ndim == 2 else np.einsum("nij,nj->ni", rotation, vectors)


def _at_rest(pose: np.ndarray, count: int) -> PoseDerivatives:
    rotation, position = np.broadcast_to(pose[:3, :3], (count, 3, 3)), np.broadcast_to(pose[:3, 3], (count, 3))
    still, none = np.zeros((count, 3, 3)), np.zeros((count, 3))
    return PoseDerivatives(rotation, position, still, none, still, none)
