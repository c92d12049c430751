"""Hermite–Simpson direct collocation with q, q̇, q̈ at nodes and midpoints as unknowns (J. T. Betts, "Practical Methods for
Optimal Control", 2010, ch. 4, in separated form).

On an interval of length h between nodes 0 and 1 with midpoint m, the acceleration is linear, and the defects are

    a_m = (a₀ + a₁) / 2
    v_m = (v₀ + v₁) / 2 + h (a₀ − a₁) / 8           v₁ = v₀ + h (a₀ + 4 a_m + a₁) / 6
    q_m = (q₀ + q₁) / 2 + h (v₀ − v₁) / 8           q₁ = q₀ + h (v₀ + 4 v_m + v₁) / 6

The mean in the first line matters: with a free midpoint acceleration, motions appear that meet the limits at nodes and
midpoints and break them between. So q is a cubic on each interval, and limits on its Bernstein coefficients hold for all t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from energyopt.parameterizations.bspline import graded_breaks
from energyopt.parameterizations.space import MotionSpace, Rows, Unknowns
from energyopt.parameterizations.trajectory import PolynomialTrajectory, Trajectory, gauss_on_spans
from energyopt.problem_values import whole

_DEFECTS = (  # entries (point: 0 start, 1 middle, 2 end; derivative order; power of h; factor), one defect a line
    ((1, 2, 0, 1.0), (0, 2, 0, -0.5), (2, 2, 0, -0.5)),
    ((1, 1, 0, 1.0), (0, 1, 0, -0.5), (2, 1, 0, -0.5), (0, 2, 1, -0.125), (2, 2, 1, 0.125)),
    ((2, 1, 0, 1.0), (0, 1, 0, -1.0), (0, 2, 1, -1 / 6), (1, 2, 1, -4 / 6), (2, 2, 1, -1 / 6)),
    ((1, 0, 0, 1.0), (0, 0, 0, -0.5), (2, 0, 0, -0.5), (0, 1, 1, -0.125), (2, 1, 1, 0.125)),
    ((2, 0, 0, 1.0), (0, 0, 0, -1.0), (0, 1, 1, -1 / 6), (1, 1, 1, -4 / 6), (2, 1, 1, -1 / 6)),
)
_BERNSTEIN = {  # rows whose interval bounds the derivative of this order between the nodes
    0: (((0, 0, 0, 1.0),), ((0, 0, 0, 1.0), (0, 1, 1, 1 / 3)), ((2, 0, 0, 1.0), (2, 1, 1, -1 / 3)), ((2, 0, 0, 1.0),)),
    1: (((0, 1, 0, 1.0),), ((0, 1, 0, 1.0), (0, 2, 1, 0.5)), ((2, 1, 0, 1.0),)),
    2: (((0, 2, 0, 1.0),), ((2, 2, 0, 1.0),)),
    3: (((2, 2, -1, 1.0), (0, 2, -1, -1.0)),),
}


@dataclass(frozen=True)
class HermiteSimpson:
    """Direct collocation with states as unknowns.

    Attributes:
        intervals: number of intervals, ever shorter towards both ends (see `graded_breaks`).
    """

    intervals: int = 40

    def __post_init__(self):
        # three have no more freedom than the six boundary conditions take
        object.__setattr__(self, "intervals", whole("HermiteSimpson intervals", self.intervals, 4, 500))

    def space(self, duration: float, nodes: int | None = None) -> HermiteSimpsonSpace:
        """The motions. ``nodes``: Gauss nodes of the quadrature in each interval; Simpson's rule by default."""
        return HermiteSimpsonSpace(graded_breaks(duration, self.intervals), nodes)


class HermiteSimpsonSpace(MotionSpace):
    """Coefficient 3 k + o is the derivative of order o at point k; points 0, 2, 4 … are nodes, 1, 3 … midpoints."""

    everywhere = True

    def __init__(self, breaks: np.ndarray, nodes: int | None = None):
        self.breaks, self.nodes = np.asarray(breaks, float), nodes
        self.duration = float(self.breaks[-1])
        self.points = np.sort(np.concatenate([self.breaks, 0.5 * (self.breaks[1:] + self.breaks[:-1])]))
        self.size = 3 * len(self.points)

    def basis(self, t, orders=3):
        """From q, v, a at the interval's start and a at its end: q + v τ + a τ²/2 + (a₁ − a) τ³/6h."""
        t = np.clip(np.asarray(t, float), 0.0, self.duration)
        interval = np.clip(np.searchsorted(self.breaks, t, side="right") - 1, 0, len(self.breaks) - 2)
        h, u = np.diff(self.breaks)[interval], t - self.breaks[interval]
        first = 6 * interval[:, None]
        columns = np.concatenate([first, first + 1, first + 2, first + 8], axis=1)
        values = np.zeros((len(t), max(orders, 4), 4))
        values[:, 0] = np.stack([np.ones_like(u), u, u**2 / 2 - u**3 / (6 * h), u**3 / (6 * h)], axis=1)
        values[:, 1, 1:] = np.stack([np.ones_like(u), u - u**2 / (2 * h), u**2 / (2 * h)], axis=1)
        values[:, 2, 2:] = np.stack([1 - u / h, u / h], axis=1)
        values[:, 3, 2:] = np.stack([-1 / h, 1 / h], axis=1)
        return columns, values[:, :orders]

    def quadrature(self):
        """Simpson's rule: h/6, 4h/6, h/6 on each interval; or Gauss nodes, on the cubic."""
        if self.nodes:
            return gauss_on_spans(self.breaks, self.nodes)
        h, weights = np.diff(self.breaks), np.zeros(len(self.points))
        weights[:-1:2] += h / 6
        weights[2::2] += h / 6
        weights[1::2] = 4 * h / 6
        return self.points, weights

    def quadrature_basis(self):
        """The unknowns of each point themselves (padded to four columns, as `basis` has), or the cubic at the Gauss nodes."""
        if self.nodes:
            return self.basis(self.quadrature()[0])
        count = len(self.points)
        columns = 3 * np.arange(count)[:, None] + np.array([0, 1, 2, 2])
        values = np.zeros((count, 3, 4))
        values[:, range(3), range(3)] = 1.0
        return columns, values

    def unknowns(self, start, goal):
        nv = len(start.velocity)
        offset, block = np.zeros((self.size, nv)), np.arange(-3, self.size - 3)
        block[:3] = block[-3:] = -1
        offset[:3] = start.position, start.velocity, start.acceleration
        offset[-2:] = goal.velocity, goal.acceleration
        if goal.position is not None:
            offset[-3] = goal.position
            return Unknowns(block, offset, self.size - 6)
        block[-3] = self.size - 6
        return Unknowns(block, offset, self.size - 5, goal=self.size - 6)

    def closed_unknowns(self, position):
        offset, block = np.zeros((self.size, len(position))), np.arange(-1, self.size - 1)
        block[-3:], offset[[0, -3]] = (-1, block[1], block[2]), position
        return Unknowns(block, offset, self.size - 4)

    def bounding_rows(self, order):
        return self._rows(_BERNSTEIN[order])

    def defects(self):
        return self._rows(_DEFECTS)

    def trajectory(self, coefficients):
        c = coefficients.reshape(len(self.points), 3, -1)[::2]
        q, v, a = c[:, 0], c[:, 1], c[:, 2]
        h = np.diff(self.breaks)[:, None]
        pieces = np.stack([q[:-1], v[:-1], a[:-1] / 2, np.diff(a, axis=0) / (6 * h)], axis=1)
        return PolynomialTrajectory(self.breaks, pieces)

    def interpolate(self, trajectory: Trajectory):
        stretch = trajectory.duration / self.duration
        times = self.points * stretch
        states = [trajectory(times, order) * stretch**order for order in range(3)]
        return np.stack(states, axis=1).reshape(self.size, trajectory.nv)

    def stretched(self, duration: float) -> HermiteSimpsonSpace:
        breaks = self.breaks * (duration / self.duration)
        breaks[-1] = duration
        return HermiteSimpsonSpace(breaks, self.nodes)

    def _rows(self, pattern: tuple) -> Rows:
        """The rows of a pattern, for every interval."""
        h, count = np.diff(self.breaks), len(self.breaks) - 1
        first, index, columns, values = 6 * np.arange(count), [], [], []
        for r, row in enumerate(pattern):
            for point, order, power, factor in row:
                index.append(np.arange(count) * len(pattern) + r)
                columns.append(first + 3 * point + order)
                values.append(factor * h**power)
        return Rows(count * len(pattern), np.concatenate(index), np.concatenate(columns), np.concatenate(values))
