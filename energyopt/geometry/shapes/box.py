"""Box: with q = |y| − size/2, φ(y) = |max(q, 0)| outside and the largest qᵢ inside."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from energyopt.errors import GeometryError
from energyopt.geometry.shapes.round import corner_derivatives, corner_distance
from energyopt.geometry.shapes.shape import Distances, Shape
from energyopt.geometry.values import LARGEST, vector
from energyopt.robots.messages import as_numbers


@dataclass(frozen=True, eq=False)
class Box(Shape):
    """A cuboid centred at its origin.

    Outside φ is C¹ (its curvature jumps where the nearest feature changes between face, edge and corner); inside it has kinks
    on the planes from which two faces are equally far. There the first of the axes counts, on its positive side at y = 0.

    Attributes:
        size: full edge lengths [m], shape (3,), or one number for a cube.
        pose: 4×4, ``pin.SE3``, xyz, or `Moving`; the origin by default.
        name: for reports.

    Raises:
        GeometryError: a value is malformed.
    """

    size: ArrayLike
    pose: Any = None
    name: str = ""

    kind: ClassVar[str] = "box"

    def __post_init__(self):
        size = as_numbers(self.size)
        size = self.size if size is None or size.ndim else np.full(3, size)
        size = vector("box: size", size, (3,))
        if not np.all((size > 0) & (size <= LARGEST)):
            raise GeometryError(f"box: size is {size.tolist()}; expected three positive edge lengths [m], at most {LARGEST:g}")
        self._set(size=size)

    @property
    def bounding_radius(self) -> float:
        return 0.5 * float(np.linalg.norm(self.size))

    def local_distance(self, y: np.ndarray) -> np.ndarray:
        return corner_distance(np.abs(y) - 0.5 * self.size)

    def local_derivatives(self, y: np.ndarray) -> Distances:
        sign = np.where(y < 0, -1.0, 1.0)
        distance, gradient, curvature = corner_derivatives(np.abs(y) - 0.5 * self.size)
        return distance, sign * gradient, curvature * sign[:, :, None] * sign[:, None, :]

    def enclosing_points(self) -> np.ndarray:
        return 0.5 * self.size * np.array(list(product((-1.0, 1.0), repeat=3)))

    def coal_geometry(self):
        import coal

        return coal.Box(*self.size)
