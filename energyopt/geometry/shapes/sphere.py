"""Sphere: φ(y) = |y| − r."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from energyopt.geometry.shapes.round import ball_points, norm_derivatives
from energyopt.geometry.shapes.shape import Distances, Shape
from energyopt.geometry.values import positive


@dataclass(frozen=True, eq=False)
class Sphere(Shape):
    """A ball about its origin. At the very centre the chosen gradient is +z and the second derivative zero.

    Attributes:
        radius: [m].
        pose: 4×4, ``pin.SE3``, xyz, or `Moving`; the origin by default.
        name: for reports.

    Raises:
        GeometryError: a value is malformed.
    """

    radius: float
    pose: Any = None
    name: str = ""

    kind: ClassVar[str] = "sphere"

    def __post_init__(self):
        self._set(radius=positive("sphere: radius", self.radius))

    @property
    def bounding_radius(self) -> float:
        return self.radius

    def local_distance(self, y: np.ndarray) -> np.ndarray:
        return np.linalg.norm(y, axis=1) - self.radius

    def local_derivatives(self, y: np.ndarray) -> Distances:
        length, gradient, curvature = norm_derivatives(y)
        return length - self.radius, gradient, curvature

    def enclosing_points(self) -> np.ndarray:
        return ball_points(self.radius)

    def coal_geometry(self):
        import coal

        return coal.Sphere(self.radius)
