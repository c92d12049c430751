"""The repulsive potential of an artificial potential field.

With clearance d between a sphere of the robot and an obstacle (O. Khatib, "Real-Time Obstacle Avoidance for Manipulators
and Mobile Robots", Int. J. Robotics Research 5(1), 1986, eqs. 16–17):

    U(d) = ½ k (1/d − 1/d_safe)²            for d ≤ d_safe, and 0 beyond
    F = −∇U = k (1/d − 1/d_safe) (1/d²) ∇d

U grows without bound at contact and has no meaning in penetration, where a planner's first guess may well be. Below d_min
it continues by its own quadratic Taylor polynomial, U(d_min) + U′(d_min) (d − d_min) + ½ U″(d_min) (d − d_min)², which is
finite, convex, falls with d for all d < d_min, and makes U twice continuously differentiable there. At d_safe it is as in
the literature: U and U′ are continuous and zero, U″ steps from k/d_safe⁴ to 0.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from energyopt.errors import GeometryError
from energyopt.geometry.shapes import Shape
from energyopt.geometry.shapes.shape import point_rows
from energyopt.geometry.values import positive, vector

MINIMUM_SHARE = 0.1
"""d_min as a share of d_safe, where it is not given."""


@dataclass(frozen=True, eq=False)
class RepulsivePotential:
    """U(d) with its derivatives.

    Attributes:
        gain: k; U has its unit times 1/m².
        safe_distance: d_safe [m], beyond which nothing is felt.
        minimum_distance: d_min [m], below which U is its own quadratic Taylor polynomial; a tenth of d_safe by default.

    Raises:
        GeometryError: a value is not positive, or d_min is not below d_safe.
    """

    gain: float
    safe_distance: float
    minimum_distance: float | None = None

    def __post_init__(self):
        put = lambda key, value: object.__setattr__(self, key, value)
        gain = float(vector("potential: gain", self.gain, ()))
        if not gain > 0:
            raise GeometryError(f"potential: gain is {gain:g}; expected a positive number (a negative one attracts)")
        put("gain", gain)
        put("safe_distance", positive("potential: safe_distance", self.safe_distance))
        given = MINIMUM_SHARE * self.safe_distance if self.minimum_distance is None else self.minimum_distance
        put("minimum_distance", positive("potential: minimum_distance", given))
        low, high = self.minimum_distance, self.safe_distance
        if low >= high:
            raise GeometryError(f"potential: minimum_distance is {low:g} m; expected below safe_distance, {high:g} m")

    def energy(self, d: ArrayLike) -> np.ndarray:
        """U at clearances ``d`` [m], any shape."""
        return self.derivatives(d)[0]

    def derivatives(self, d: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """U, U′ = dU/dd and U″ at clearances ``d`` [m], each of the shape of ``d``."""
        d = np.asarray(d, dtype=float)
        felt = np.clip(d, self.minimum_distance, self.safe_distance)
        gap = 1.0 / felt - 1.0 / self.safe_distance
        first, second = -self.gain * gap / felt**2, self.gain * (1.0 + 2.0 * felt * gap) / felt**4
        below = np.minimum(d - self.minimum_distance, 0.0)
        energy = 0.5 * self.gain * gap**2 + first * below + 0.5 * second * below**2
        inside = d <= self.safe_distance
        return energy, (first + second * below) * inside, second * inside

    def force(self, points: ArrayLike, shapes: Iterable[Shape], t: ArrayLike = 0.0, radius: ArrayLike = 0.0) -> np.ndarray:
        """The force field −∇U, summed over shapes.

        Args:
            points: [m], shape (N, 3); shapes: the obstacles.
            t: one time, or one a point [s]; radius: of balls about the points, one or one a point [m].

        Returns:
            F, shape (N, 3); it points away from what is near.
        """
        points = point_rows(points)
        total = np.zeros_like(points)
        for shape in shapes:
            d, gradient, _ = shape.signed_distance(points, t)
            total -= self.derivatives(d - radius)[1][:, None] * gradient
        return total

    def field_energy(self, points: ArrayLike, shapes: Iterable[Shape], t: ArrayLike = 0.0, radius: ArrayLike = 0.0) -> np.ndarray:
        """U summed over shapes, shape (N,); arguments as of `force`."""
        points = point_rows(points)
        return sum((self.energy(shape.distance(points, t) - radius) for shape in shapes), np.zeros(len(points)))
