"""Time laws with finitely many numbers: s(t) = L Σ_j B_j(t/T) c_j, cubic splines on even spans.

Where the acceleration has to rise from zero at once, which an optimum wants to, two ever shorter spans stand at each end.

The derivative of a spline lies in the hull of its differences c_{j+1} − c_j: where none is negative, ṡ ≥ 0 for all t. A law
that begins at rest has c₀ = c₁ = 0, without acceleration c₂ = 0 too; at the goal likewise with 1 in place of 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline as ScipySpline

from energyopt.parameterizations.trajectory import SplineTrajectory, Trajectory, gauss_on_spans

DEGREE = 3
EDGE = np.array([1.0 / 16.0, 1.0 / 4.0])
"""Where the first even span is divided at a quick end."""


@dataclass(frozen=True)
class Ends:
    """How a law begins and ends.

    Attributes:
        speeds: ṡ at start and goal [1/s]; None leaves it free, where the path stands still anyway.
        smooth: whether s̈ vanishes there too.
    """

    speeds: tuple[float | None, float | None] = (0.0, 0.0)
    smooth: bool = True

    def fixed(self, end: int) -> int:
        """How many coefficients this end determines: the place, at rest the speed, and then the acceleration."""
        return 1 if self.speeds[end] != 0.0 else 2 + self.smooth


@dataclass(frozen=True, eq=False)
class LawSpace:
    """The splines of a law.

    Attributes:
        spans: number of even spans. length: L of the path.
        quick: whether the first and the last of them are divided.
    """

    spans: int
    length: float
    quick: tuple[bool, bool] = (True, True)

    @cached_property
    def knots(self) -> np.ndarray:
        """In σ = t/T, from 0 to 1, the ends repeated."""
        breaks = self.breaks
        return np.concatenate([breaks[:1].repeat(DEGREE), breaks, breaks[-1:].repeat(DEGREE)])

    @cached_property
    def breaks(self) -> np.ndarray:
        even = np.arange(self.spans + 1.0)
        edges = [EDGE if self.quick[0] else [], self.spans - EDGE if self.quick[1] else []]
        return np.sort(np.concatenate([even, *edges])) / self.spans

    @property
    def size(self) -> int:
        return len(self.breaks) - 1 + DEGREE

    def quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes σ and weights, three a span."""
        return gauss_on_spans(self.breaks, DEGREE)

    def local_basis(self, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The splines that do not vanish at σ (K,): indices (K, 4), and L times their derivatives of order 0 to 3, (K, 4, 4)."""
        span = np.clip(np.searchsorted(self.breaks, sigma, side="right") - 1, 0, len(self.breaks) - 2)
        index = span[:, None] + np.arange(DEGREE + 1)
        every = ScipySpline(self.knots, np.eye(self.size), DEGREE)
        values = [every.derivative(k)(sigma) if k else every(sigma) for k in range(DEGREE + 1)]
        rows = np.arange(len(sigma))[:, None]
        return index, self.length * np.stack([value[rows, index] for value in values], axis=1)

    def law(self, coefficients: np.ndarray, duration: float) -> SplineTrajectory:
        """s(t) as a motion of one joint; differences that are negative by rounding become zero."""
        rising = np.maximum.accumulate(np.clip(coefficients, 0.0, 1.0))
        rising[-1] = 1.0
        law = SplineTrajectory(self.knots, self.length * rising[:, None], DEGREE)
        return law.stretched(duration)

    def guess(self, law: Trajectory) -> np.ndarray:
        """Coefficients of a law near a given one, monotone as that is: its places at the Greville abscissae."""
        greville = np.array([self.knots[j + 1 : j + DEGREE + 1].mean() for j in range(self.size)])
        return np.clip(law(greville * law.duration)[:, 0] / self.length, 0.0, 1.0)
