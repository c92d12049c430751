"""Cylinder: with ρ = √(y₁² + y₂²) and q = (ρ − r, |y₃| − l/2), φ(y) = |max(q, 0)| outside and the larger qᵢ inside.

With f(q) its derivatives in q, u the radial unit vector and e = sign(y₃) e₃ the axial one,
∂φ/∂y = f₁ u + f₂ e and ∂²φ/∂y² = f₁₁ uuᵀ + f₁₂ (ueᵀ + euᵀ) + f₂₂ eeᵀ + (f₁/ρ)(I − uuᵀ − eeᵀ).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from energyopt.geometry.shapes.round import circle_points, corner_derivatives, corner_distance, norm_derivatives
from energyopt.geometry.shapes.shape import Distances, Shape
from energyopt.geometry.values import positive


@dataclass(frozen=True, eq=False)
class Cylinder(Shape):
    """A solid cylinder along its z axis, centred at its origin, with flat ends.

    Outside φ is C¹; inside it has kinks on its axis (there +y is chosen, if the wall is nearest), on the middle plane, and
    where wall and end are equally far (there the wall is chosen).

    Attributes:
        radius: [m].
        length: full length [m].
        pose: 4×4, ``pin.SE3``, xyz, or `Moving`; the origin by default.
        name: for reports.

    Raises:
        GeometryError: a value is malformed.
    """

    radius: float
    length: float
    pose: Any = None
    name: str = ""

    kind: ClassVar[str] = "cylinder"

    def __post_init__(self):
        self._set(radius=positive("cylinder: radius", self.radius), length=positive("cylinder: length", self.length))

    @property
    def bounding_radius(self) -> float:
        return float(np.hypot(self.radius, 0.5 * self.length))

    def local_distance(self, y: np.ndarray) -> np.ndarray:
        return corner_distance(self._excess(np.linalg.norm(y[:, :2], axis=1), y))

    def local_derivatives(self, y: np.ndarray) -> Distances:
        rho, radial, turn = norm_derivatives(y[:, :2])
        distance, f, ff = corner_derivatives(self._excess(rho, y))
        sign = np.where(y[:, 2] < 0, -1.0, 1.0)
        gradient = np.empty((len(y), 3))
        gradient[:, :2], gradient[:, 2] = f[:, :1] * radial, f[:, 1] * sign
        curvature = np.empty((len(y), 3, 3))
        curvature[:, :2, :2] = ff[:, :1, :1] * radial[:, :, None] * radial[:, None, :] + f[:, :1, None] * turn
        curvature[:, :2, 2] = curvature[:, 2, :2] = (ff[:, 0, 1] * sign)[:, None] * radial
        curvature[:, 2, 2] = ff[:, 1, 1]
        return distance, gradient, curvature

    def enclosing_points(self) -> np.ndarray:
        ring = circle_points(self.radius)
        ends = [np.column_stack([ring, np.full(len(ring), z)]) for z in (-0.5 * self.length, 0.5 * self.length)]
        return np.concatenate(ends)

    def coal_geometry(self):
        import coal

        return coal.Cylinder(self.radius, self.length)

    def _excess(self, rho: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.stack([rho - self.radius, np.abs(y[:, 2]) - 0.5 * self.length], axis=1)
