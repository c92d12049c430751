"""HalfSpace: everything behind a plane, {y : n·y ≤ b}; φ(y) = n·y − b."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from energyopt.errors import GeometryError
from energyopt.geometry.shapes.shape import Distances, Shape
from energyopt.geometry.values import LARGEST, ROUNDING, pose_matrix, vector


@dataclass(frozen=True, eq=False)
class HalfSpace(Shape):
    """All points on the far side of a plane: a floor, a wall, a ceiling. Its distance is linear, smooth everywhere.

    Attributes:
        normal: points out of the solid, towards the free side; any length, stored as a unit vector; shape (3,).
        offset: of the plane along the unit normal [m]: the solid is {y : normal·y ≤ offset}.
        pose: 4×4, ``pin.SE3``, xyz, or `Moving`; the origin by default.
        name: for reports.

    Raises:
        GeometryError: a value is malformed.
    """

    normal: ArrayLike
    offset: float = 0.0
    pose: Any = None
    name: str = ""

    kind: ClassVar[str] = "half-space"

    def __post_init__(self):
        normal = vector("half-space: normal", self.normal, (3,))
        length = np.linalg.norm(normal)
        if not 1e-9 < length < 1e9:
            raise GeometryError(f"half-space: normal is {normal.tolist()}; expected a direction, not zero")
        if abs(length - 1.0) > ROUNDING:
            normal = normal / length
        normal.flags.writeable = False
        offset = float(vector("half-space: offset", self.offset, ()))
        if abs(offset) > LARGEST:
            raise GeometryError(f"half-space: offset is {offset:g}; expected metres, at most {LARGEST:g}")
        self._set(normal=normal, offset=offset)

    @property
    def bounding_radius(self) -> float:
        return np.inf

    def speed_bound(self) -> float:
        """Infinite where the plane turns: its far points move as fast as one likes."""
        if not self.moves:
            return 0.0
        speed = self.pose.speed_bound(0.0)
        return speed if self.pose.speed_bound(1.0) == speed else np.inf

    def local_distance(self, y: np.ndarray) -> np.ndarray:
        return y @ self.normal - self.offset

    def local_derivatives(self, y: np.ndarray) -> Distances:
        gradient = np.broadcast_to(self.normal, (len(y), 3)).copy()
        return self.local_distance(y), gradient, np.zeros((len(y), 3, 3))

    def enclosing_points(self) -> np.ndarray:
        raise GeometryError("half-space: is unbounded; expected a shape of finite size, such as a box")

    def coal_geometry(self):
        import coal

        return coal.Halfspace(np.array(self.normal), self.offset)


def workspace_walls(size: ArrayLike, pose: Any = None, name: str = "workspace") -> tuple[HalfSpace, ...]:
    """The six half-spaces around a box that a robot has to stay inside of.

    Args:
        size: full inner edge lengths of the box [m], shape (3,).
        pose: of the box's centre: 4×4, ``pin.SE3`` or xyz.
        name: the walls are called ``name +x``, ``name -x`` and so on.

    Raises:
        GeometryError: a value is malformed.
    """
    size = vector(f"{name}: size", size, (3,))
    if not np.all((size > 0) & (size <= LARGEST)):
        raise GeometryError(f"{name}: size is {size.tolist()}; expected three positive edge lengths [m], at most {LARGEST:g}")
    pose = pose_matrix(f"{name}: pose", pose)
    inward = [(axis, sign) for axis in range(3) for sign in (-1.0, 1.0)]
    return tuple(
        HalfSpace(sign * np.eye(3)[axis], -0.5 * size[axis], pose, f"{name} {'-' if sign > 0 else '+'}{'xyz'[axis]}")
        for axis, sign in inward
    )
