"""Capsule: φ(y) = |y − c| − r, with c the nearest point of the axis segment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from energyopt.geometry.shapes.round import ball_points, norm_derivatives
from energyopt.geometry.shapes.shape import Distances, Shape
from energyopt.geometry.values import positive


@dataclass(frozen=True, eq=False)
class Capsule(Shape):
    """A cylinder along its z axis, centred, closed by two half balls.

    On the axis, deepest inside, the chosen gradient is +y, at its ends +z, and the second derivative zero.

    Attributes:
        radius: of cylinder and half balls [m].
        length: of the axis between the centres of the half balls [m]; from tip to tip it is ``length + 2 radius``.
        pose: 4×4, ``pin.SE3``, xyz, or `Moving`; the origin by default.
        name: for reports.

    Raises:
        GeometryError: a value is malformed.
    """

    radius: float
    length: float
    pose: Any = None
    name: str = ""

    kind: ClassVar[str] = "capsule"

    def __post_init__(self):
        self._set(radius=positive("capsule: radius", self.radius), length=positive("capsule: length", self.length))

    @property
    def bounding_radius(self) -> float:
        return self.radius + 0.5 * self.length

    def local_distance(self, y: np.ndarray) -> np.ndarray:
        return np.linalg.norm(self._from_axis(y), axis=1) - self.radius

    def local_derivatives(self, y: np.ndarray) -> Distances:
        away = self._from_axis(y)
        length, gradient, curvature = norm_derivatives(away)
        beside = np.abs(y[:, 2]) < 0.5 * self.length
        on_axis = beside & (length == 0)
        gradient[on_axis] = (0.0, 1.0, 0.0)
        # Beside the segment the distance does not change along it.
        curvature[beside, 2, :] = curvature[beside, :, 2] = 0.0
        return length - self.radius, gradient, curvature

    def enclosing_points(self) -> np.ndarray:
        ball, end = ball_points(self.radius), np.array([0.0, 0.0, 0.5 * self.length])
        return np.concatenate([ball[ball[:, 2] >= -1e-12] + end, ball[ball[:, 2] <= 1e-12] - end])

    def coal_geometry(self):
        import coal

        return coal.Capsule(self.radius, self.length)

    def _from_axis(self, y: np.ndarray) -> np.ndarray:
        away = y.copy()
        away[:, 2] -= np.clip(y[:, 2], -0.5 * self.length, 0.5 * self.length)
        return away
