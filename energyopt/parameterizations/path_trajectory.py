"""A path passed at a pace: q(t) = p(s(t)), the exact composition of a path p(s), 0 ≤ s ≤ L, and a monotone time law s(t).

The derivatives follow from the formula of Faà di Bruno (e.g. L. Comtet, "Advanced Combinatorics", 1974, sec. 3.4),

    q⁽ⁿ⁾ = Σ_k p⁽ᵏ⁾(s) B_{n,k}(ṡ, s̈, …),     B_{n,k} = Σ_i C(n − 1, i − 1) s⁽ⁱ⁾ B_{n−i,k−1},     B_{0,0} = 1,

up to the jerk q⃛ = p'''ṡ³ + 3 p''ṡ s̈ + p's⃛ and two orders more, which serve to find where it is extreme.
"""

from __future__ import annotations

from math import comb

import numpy as np

from energyopt.parameterizations.trajectory import Trajectory

HIGHEST_ORDER = 5
HALVINGS = 60
"""Bisections that bring the time at which a break of the path is passed to the last digit."""
SAME_TIME = 1e-9
"""Share of the duration within which two breaks are one."""


class PathTrajectory(Trajectory):
    """A path and the time law by which it is passed."""

    kind = "path"

    def __init__(self, path: Trajectory, law: Trajectory):
        """``path`` is any motion, its time read as the place s; ``law`` is s(t) as a motion of one joint, which never goes back.

        Raises:
            ValueError: the law leaves the path or runs backwards.
        """
        self.path, self.law = path, law
        self.duration, self.nv = law.duration, path.nv
        places = law(law.sample_times(8))[:, 0]
        slack = 1e-9 * path.duration
        if places.min() < -slack or places.max() > path.duration + slack:
            raise ValueError(
                f"the time law goes from {places.min():.6g} to {places.max():.6g}, the path from 0 to {path.duration:.6g}"
            )
        if np.any(np.diff(places) < -slack):
            raise ValueError("the time law runs backwards")
        self.breaks = self._all_breaks()

    @property
    def highest_order(self) -> int:
        return HIGHEST_ORDER

    def stretched(self, duration: float) -> PathTrajectory:
        return PathTrajectory(self.path, self.law.stretched(duration))

    def to_arrays(self) -> dict[str, np.ndarray]:
        arrays = {}
        for name, part in (("path", self.path), ("law", self.law)):
            arrays[f"{name}.kind"] = np.frombuffer(part.kind.encode(), dtype=np.uint8)
            arrays |= {f"{name}.{key}": value for key, value in part.to_arrays().items()}
        return arrays

    def places(self, t: np.ndarray) -> np.ndarray:
        """s at the times ``t`` (N,), shape (N,)."""
        return np.clip(self.law._evaluate(np.asarray(t, float), 0)[:, 0], 0.0, self.path.duration)

    def _evaluate(self, t: np.ndarray, order: int) -> np.ndarray:
        s = self.places(t)
        if order == 0:
            return self.path._evaluate(s, 0)
        rates = [None] + [self.law._evaluate(t, k)[:, 0] for k in range(1, order + 1)]
        return sum(self.path._evaluate(s, k) * _bell(order, k, rates)[:, None] for k in range(1, order + 1))

    def _all_breaks(self) -> np.ndarray:
        """Breaks of the law, and the times at which it passes breaks of the path."""
        marks = self.path.breaks[1:-1]
        low, high = np.zeros(len(marks)), np.full(len(marks), self.duration)
        for _ in range(HALVINGS if len(marks) else 0):
            middle = 0.5 * (low + high)
            before = self.law._evaluate(middle, 0)[:, 0] < marks
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        own = np.asarray(self.law.breaks, float)
        apart = np.abs(high[:, None] - own).min(axis=1, initial=np.inf) > SAME_TIME * self.duration
        return np.union1d(own, high[apart])


def _bell(n: int, k: int, x: list) -> np.ndarray | float:
    """B_{n,k} of x[1], x[2] …"""
    if k == 0:
        return 1.0 if n == 0 else 0.0
    return sum(comb(n - 1, i - 1) * x[i] * _bell(n - i, k - 1, x) for i in range(1, n - k + 2))
