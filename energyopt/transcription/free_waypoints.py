"""Waypoints at times that the solver chooses."""

from __future__ import annotations

import numpy as np

from energyopt.parameterizations.space import MotionSpace, Unknowns
from energyopt.problem import Waypoint
from energyopt.transcription.extras import Priceless


class FreeWaypoints(Priceless):
    """Waypoints whose times are unknowns: q(t_w) − q_w = 0, in the order listed, a least gap apart.

    A waypoint with a fixed time only bounds the times of its neighbours. Unknown times are scaled by the duration.
    """

    GAP = 1e-3
    """Least time between waypoints, as a share of the duration."""

    def __init__(self, waypoints: tuple[Waypoint, ...], space: MotionSpace, unknowns: Unknowns, first: int):
        self._space, self._unknowns, self._first = space, unknowns, first
        self._free = [k for k, w in enumerate(waypoints) if w.time is None]
        self._positions = np.array([waypoints[k].position for k in self._free])
        self._fixed = [None if w.time is None else w.time / space.duration for w in waypoints]
        self.variables, self._nv = len(self._free), self._positions.shape[1]
        times = [0.0, *(1.0 if t is None else t for t in self._fixed), 1.0]
        self.lower = np.array([max(t for t in [0.0, *self._fixed[:k]] if t is not None) + self.GAP for k in self._free])
        self.upper = np.array([min(t for t in times[k + 1 :]) - self.GAP for k in self._free])
        self._ordered = [k for k in range(self.variables - 1) if self._free[k + 1] == self._free[k] + 1]
        equalities, order = self.variables * self._nv, len(self._ordered)
        self.row_lower = np.concatenate([np.zeros(equalities), np.full(order, self.GAP)])
        self.row_upper = np.concatenate([np.zeros(equalities), np.full(order, np.inf)])

    def guess(self, coefficients):
        """Times at which the motion comes nearest, in order."""
        trajectory = self._space.trajectory(coefficients)
        s = np.linspace(0.0, 1.0, 201)
        q, result, latest = trajectory(s * self._space.duration), [], 0.0
        for position, low, high in zip(self._positions, self.lower, self.upper, strict=True):
            inside = (s >= max(low, latest + self.GAP)) & (s <= high)
            nearest = s[inside][np.argmin(np.linalg.norm(q[inside] - position, axis=1))] if inside.any() else 0.5 * (low + high)
            result.append(nearest)
            latest = nearest
        return np.array(result)

    def jacobian_pattern(self):
        nv, count = self._nv, self._unknowns.count
        rows, columns = [], []
        for w in range(self.variables):
            row = w * nv + np.arange(nv)
            rows += [np.repeat(row, count), row]
            columns += [(np.arange(count) * nv + np.arange(nv)[:, None]).ravel(), np.full(nv, self._first + w)]
        for r, k in enumerate(self._ordered):
            rows.append(np.full(2, self.variables * nv + r))
            columns.append(self._first + np.array([k, k + 1]))
        return np.concatenate(rows), np.concatenate(columns)

    def hessian_pattern(self):
        size = self._unknowns.count * self._nv
        rows = [np.concatenate([np.arange(size), [self._first + w]]) for w in range(self.variables)]
        columns = [np.full(size + 1, self._first + w) for w in range(self.variables)]
        return np.concatenate(rows), np.concatenate(columns)

    def evaluate(self, x):
        times, values, jacobian = x[self._first : self._first + self.variables], [], []
        for s, position in zip(times, self._positions, strict=True):
            state, shares = self._state(s, x)
            values.append(state[0] - position)
            jacobian += [np.tile(shares[0], self._nv), state[1] * self._space.duration]
        for k in self._ordered:
            values.append([times[k + 1] - times[k]])
            jacobian.append(np.array([-1.0, 1.0]))
        return np.concatenate(values), np.concatenate(jacobian)

    def curvature(self, x, sigma, multipliers):
        times, T, result = x[self._first : self._first + self.variables], self._space.duration, []
        for w, s in enumerate(times):
            state, shares = self._state(s, x)
            mu = multipliers[w * self._nv : (w + 1) * self._nv]
            result += [np.outer(shares[1] * T, mu).ravel(), [T**2 * mu @ state[2]]]
        return np.concatenate(result)

    def _state(self, s: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position, velocity, acceleration (3, nv) at t = sT, and the share of each block in them (3, count)."""
        u = self._unknowns
        columns, values = self._space.basis(np.array([s * self._space.duration]))
        blocks = u.block[columns[0]]
        known = blocks >= 0
        shares = np.zeros((3, u.count))
        np.add.at(shares.T, blocks[known], values[0].T[known])
        state = values[0] @ u.offset[columns[0]] + shares @ x[: u.count * self._nv].reshape(u.count, self._nv)
        return state, shares
