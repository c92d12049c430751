"""B-splines: q(t) = Σ_j B_j(t) c_j with clamped knots (C. de Boor, "A Practical Guide to Splines", 1978, ch. IX–XI).

The first three coefficients are determined by position, velocity and acceleration at t = 0, the last three by those at T,
so no boundary condition is left to the solver. The derivative is a spline one degree lower with the coefficients

    c'_j = p (c_{j+1} − c_j) / (t_{j+p+1} − t_{j+1}),

and a spline lies inside the convex hull of its coefficients: bounds put on them hold for all t.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_banded

from energyopt.errors import ProblemError
from energyopt.parameterizations.space import BoundaryState, MotionSpace, Rows, Unknowns
from energyopt.parameterizations.trajectory import SplineTrajectory, Trajectory, gauss_on_spans
from energyopt.problem_values import numbers, real, shown, whole

MOST_CONTROL_POINTS = 2000


@dataclass(frozen=True)
class BSpline:
    """Splines of degree 3, 4 or 5 (the default way to describe a motion).

    Attributes:
        degree: 3 has torque kinks at the knots, 4 and 5 have none.
        control_points: coefficients a joint on even knots; None chooses by the duration.
        accuracy: refine the knots until the estimated relative error of J is below this; None keeps the knots.
        knots: breakpoints [s] from 0 to T to start from, in place of even ones.
    """

    degree: int = 3
    control_points: int | None = None
    accuracy: float | None = 0.01
    knots: tuple[float, ...] | None = None

    def __post_init__(self):
        put = lambda key, value: object.__setattr__(self, key, value)
        put("degree", whole("BSpline degree", self.degree, 3, 5, "3, 4 or 5"))
        if self.control_points is not None:
            least, most = self.degree + 4, MOST_CONTROL_POINTS
            expected = f"{least} to {most} for degree {self.degree} (a whole number), or None"
            put("control_points", whole("BSpline control_points", self.control_points, least, most, expected))
        if self.accuracy is not None:
            expected = "a relative error between 0 and 1, or None"
            put("accuracy", real("BSpline accuracy", self.accuracy, lambda x: 0 < x < 1, expected))
        if self.knots is not None and self.control_points is not None:
            raise ProblemError("BSpline has both knots and control_points: expected one of them")
        if self.knots is not None:
            put("knots", _breakpoints(self.knots))

    def space(self, duration: float, nodes: int | None = None) -> SplineSpace:
        """The splines to start with. ``nodes``: of the quadrature in each span; by default the degree."""
        if self.knots is not None:
            breaks = np.array(self.knots)
            if abs(breaks[-1] - duration) > 1e-9 * duration:
                raise ProblemError(f"BSpline knots end at {breaks[-1]:g} s: expected the duration {duration:g} s")
            breaks[-1] = duration
            return SplineSpace(breaks, self.degree, nodes)
        spans = (self.control_points or self.default_control_points(duration)) - self.degree
        return SplineSpace(graded_breaks(duration, spans), self.degree, nodes)

    def default_control_points(self, duration: float) -> int:
        """One span for 0.25 s at most, between 14 and 40 spans; `accuracy` refines from there."""
        return self.degree + int(np.clip(np.ceil(duration / 0.25), 14, 40))


def _breakpoints(given: Sequence[float]) -> tuple[float, ...]:
    """The ``knots`` of a `BSpline` as numbers; that they end at the duration is seen later."""
    expected = f"increasing times [s] from 0 to the duration, 5 to {MOST_CONTROL_POINTS}"
    breaks = numbers("BSpline knots", given, expected)
    rising = breaks.ndim == 1 and 5 <= len(breaks) <= MOST_CONTROL_POINTS and breaks[0] == 0 and np.all(np.diff(breaks) > 0)
    if not rising or not np.isfinite(breaks).all():
        raise ProblemError(f"BSpline knots is {shown(given)}: expected {expected}")
    return tuple(breaks.tolist())


def graded_breaks(duration: float, spans: int, ratio: float = 0.25) -> np.ndarray:
    """Breakpoints (spans + 1,) [s], even but for up to three ever shorter spans towards both ends.

    The optimum starts and ends with a finite acceleration; a motion that has to start and end with none pays for the
    time it takes to get there. On even knots this costs 10–70 % of J, more than all other errors together.
    """
    depth = int(np.clip((spans - 6) // 3, 0, 3))
    even = spans - 2 * depth
    edge = ratio ** np.arange(depth, 0, -1)
    breaks = duration / even * np.concatenate([[0.0], edge, np.arange(1.0, even), even - edge[::-1], [even]])
    breaks[-1] = duration
    return breaks


class SplineSpace(MotionSpace):
    """Splines of one degree on given breakpoints."""

    everywhere = True

    def __init__(self, breaks: np.ndarray, degree: int, nodes: int | None = None):
        self.breaks = np.asarray(breaks, float)
        self.degree, self.nodes = degree, nodes or degree
        self.duration = float(self.breaks[-1])
        self.knots = np.concatenate([np.full(degree, self.breaks[0]), self.breaks, np.full(degree, self.breaks[-1])])
        self.size = len(self.knots) - degree - 1

    def basis(self, t, orders=3):
        t = np.clip(np.asarray(t, float), 0.0, self.duration)
        span = np.clip(np.searchsorted(self.breaks, t, side="right") - 1, 0, len(self.breaks) - 2)
        columns = span[:, None] + np.arange(self.degree + 1)
        values = np.zeros((len(t), orders, self.degree + 1))
        for order in range(min(orders, self.degree + 1)):
            local = self._lower_splines(t, span, self.degree - order)
            for k in range(order, 0, -1):
                slope = local * self._slope(k)[span[:, None] + np.arange(local.shape[1])]
                local = _difference(slope, slope)
            values[:, order] = local
        return columns, values

    def quadrature(self):
        return gauss_on_spans(self.breaks, self.nodes)

    def unknowns(self, start, goal):
        nv = len(start.velocity)
        offset, block = np.zeros((self.size, nv)), np.full(self.size, -1)
        offset[:3] = self._end_coefficients(0, start)
        offset[-3:] = self._end_coefficients(1, goal)
        block[3:-3] = np.arange(self.size - 6)
        if goal.position is not None:
            return Unknowns(block, offset, self.size - 6)
        block[-3:] = self.size - 6
        return Unknowns(block, offset, self.size - 5, goal=self.size - 6)

    def closed_unknowns(self, position):
        offset, block = np.zeros((self.size, len(position))), np.arange(-1, self.size - 1)
        block[-1], offset[[0, -1]] = -1, position
        return Unknowns(block, offset, self.size - 2)

    def closing_rows(self):
        """Velocity and acceleration at the end less those at the start."""
        columns, values = self.basis(np.array([0.0, self.duration]))
        both, change = columns.reshape(1, -1), np.concatenate([-values[0], values[1]], axis=1)
        return Rows.stacked([Rows.banded(both, change[order : order + 1]) for order in (1, 2)])

    def bounding_rows(self, order):
        values = np.ones((self.size, 1))
        for k in range(1, order + 1):
            slope = self._slope(k)[:, None]
            values = slope * _difference(values[1:], values[:-1])
        return Rows.banded(np.arange(len(values))[:, None] + np.arange(order + 1), values)

    def trajectory(self, coefficients):
        return SplineTrajectory(self.knots, coefficients, self.degree)

    def interpolate(self, trajectory: Trajectory):
        """Interpolation at the Greville abscissae; reproduces every spline of this space."""
        if isinstance(trajectory, SplineTrajectory) and self._contains(trajectory):
            return trajectory.spline.c.copy()
        times = self.greville
        columns, values = self.basis(times, 1)
        # By the Schoenberg–Whitney conditions each diagonal entry is positive, and columns are at most degree − 1 apart from it.
        width, row = self.degree - 1, np.arange(self.size)[:, None]
        there = np.abs(row - columns) <= width
        matrix = np.zeros((2 * width + 1, self.size))
        matrix[(width + row - columns)[there], columns[there]] = values[:, 0][there]
        return solve_banded((width, width), matrix, trajectory(times * (trajectory.duration / self.duration)))

    def _contains(self, spline: SplineTrajectory) -> bool:
        """Whether a spline has these knots, in its own duration."""
        knots, share = spline.spline.t, self.duration / spline.duration
        same = spline.degree == self.degree and len(knots) == len(self.knots)
        return same and bool(np.allclose(knots * share, self.knots, rtol=0.0, atol=1e-13 * self.duration))

    @cached_property
    def greville(self) -> np.ndarray:
        """Where each coefficient acts: the means of its p inner knots [s], (size,)."""
        p, knots = self.degree, self.knots
        means = sum(knots[k : k + self.size] for k in range(1, p + 1)) / p
        return means.clip(0.0, self.duration)

    def stretched(self, duration: float) -> SplineSpace:
        breaks = self.breaks * (duration / self.duration)
        breaks[-1] = duration
        return SplineSpace(breaks, self.degree, self.nodes)

    def refined(self, times: np.ndarray) -> SplineSpace:
        """The space with further knots; it contains this one."""
        return SplineSpace(np.union1d(self.breaks, times), self.degree, self.nodes)

    def _lower_splines(self, t: np.ndarray, span: np.ndarray, degree: int) -> np.ndarray:
        """The degree + 1 splines of a lower degree that do not vanish at each time (Cox–de Boor recursion)."""
        knots = self.knots[self.degree - degree : len(self.knots) - self.degree + degree]
        base, local = span + degree, np.ones((len(t), 1))
        for k in range(1, degree + 1):
            right = knots[base[:, None] + np.arange(1, k + 1)]
            left = knots[base[:, None] + np.arange(1 - k, 1)]
            share = local / (right - left)
            local = _difference(share * (t[:, None] - left), share * (t[:, None] - right))
        return local

    def _slope(self, order: int) -> np.ndarray:
        """p / (t_{j+p+1} − t_{j+1}) of the splines whose derivative has this order."""
        p, knots = self.degree - order + 1, self.knots[order:-order]
        return p / (knots[p:] - knots[:-p])

    def _end_coefficients(self, end: int, state: BoundaryState) -> np.ndarray:
        """The three outer coefficients (3, nv) that give a state; with an unknown position, what to add to it.

        At a clamped end v = s₁ (c₁ − c₀) and a = s₂ (s₁' (c₂ − c₁) − v), the slopes s being those of `_slope`.
        """
        position = np.zeros_like(state.velocity) if state.position is None else state.position
        first, second = self._slope(1), self._slope(2)
        if end == 0:
            near = position + state.velocity / first[0]
            return np.stack([position, near, near + (state.velocity + state.acceleration / second[0]) / first[1]])
        near = position - state.velocity / first[-1]
        return np.stack([near - (state.velocity - state.acceleration / second[-1]) / first[-2], near, position])


def _difference(shifted: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """``shifted`` moved one column to the right minus ``kept``: (N, k) → (N, k + 1)."""
    result = np.zeros((len(kept), kept.shape[1] + 1))
    result[:, 1:] = shifted
    result[:, :-1] -= kept
    return result
