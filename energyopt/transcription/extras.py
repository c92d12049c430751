"""Constraints that are not linear in the unknowns and not torques: a Cartesian goal, waypoints at times to be chosen, clearance.

Each is one class with further unknowns (maybe none), rows, and exact first and second derivatives; `ExtendedEvaluator`
puts them beside the rows of the main program. A new constraint of this kind is one more class.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import casadi as ca
import numpy as np
from scipy.sparse import csr_array

from energyopt.costs import CostTerm, Samples
from energyopt.parameterizations.space import MotionSpace, Unknowns
from energyopt.problem import FramePose, Problem, Waypoint
from energyopt.robots.model import RobotModel


class ExtraRows(Protocol):
    """Rows between ``row_lower`` and ``row_upper``, maybe with further unknowns and a share of the objective."""

    variables: int
    lower: np.ndarray
    upper: np.ndarray
    row_lower: np.ndarray
    row_upper: np.ndarray

    def guess(self, coefficients: np.ndarray) -> np.ndarray: ...

    def jacobian_pattern(self) -> tuple[np.ndarray, np.ndarray]: ...

    def hessian_pattern(self) -> tuple[np.ndarray, np.ndarray]: ...

    def evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...

    def objective(self) -> float: ...

    def gradient(self) -> np.ndarray | None:
        """Of the objective, with respect to the unknowns of the motion; None where it has none."""

    def curvature(self, x: np.ndarray, sigma: float, multipliers: np.ndarray) -> np.ndarray: ...

    def stretch(self, theta: float) -> None:
        """Before an evaluation: the motion takes exp(theta) times as long as its space says."""

    def in_theta(self, x: np.ndarray, sigma: float, multipliers: np.ndarray) -> ThetaTerms:
        """Derivatives that involve theta, at the point evaluated last; see `stretch`."""


@dataclass(frozen=True, eq=False)
class ThetaTerms:
    """What an extra has to do with theta.

    Attributes:
        slope: of its objective; rows: of its rows; crossed: ∂²L/∂θ∂x, as long as the part of x it touches; bent: ∂²L/∂θ².
    """

    slope: float = 0.0
    rows: np.ndarray | float = 0.0
    crossed: np.ndarray = field(default_factory=lambda: np.zeros(0))
    bent: float = 0.0


class _Priceless:
    """No share of the objective, and nothing to do with the duration: times count as shares of it."""

    def stretch(self, theta: float) -> None:
        pass

    def in_theta(self, x: np.ndarray, sigma: float, multipliers: np.ndarray) -> ThetaTerms:
        return ThetaTerms()

    def objective(self) -> float:
        return 0.0

    def gradient(self) -> None:
        return None


def extra_rows(problem: Problem, space: MotionSpace, unknowns: Unknowns) -> list[ExtraRows]:
    """The extra constraints a problem needs in a motion space, but for clearance, which depends on the motion so far."""
    nv, extras = problem.robot.nv, []
    if isinstance(problem.goal, FramePose):
        extras.append(FrameGoal(problem.robot, problem.goal, unknowns.goal * nv))
    if any(w.time is None for w in problem.waypoints):
        extras.append(FreeWaypoints(problem.waypoints, space, unknowns, unknowns.count * nv))
    return extras


class FrameGoal(_Priceless):
    """The frame of a `FramePose` stands where it should: p(q) − p* = 0 and, where asked, ½ (R*ᵀR − RᵀR*)^∨ = 0.

    The second is sin θ times the axis of the remaining rotation; it also vanishes at θ = π, which seeds avoid and the
    check of the result excludes.
    """

    variables = 0

    def __init__(self, robot: RobotModel, goal: FramePose, first: int):
        q = ca.SX.sym("q", robot.nv)
        R, p = robot.frame_placement(goal.frame)(q)
        residual = p - ca.DM(goal.position)
        if goal.rotation is not None:
            turn = ca.DM(goal.rotation).T @ R
            residual = ca.vertcat(residual, 0.5 * ca.inv_skew(turn - turn.T))
        multipliers = ca.SX.sym("multipliers", residual.numel())
        curvature = ca.densify(ca.triu(ca.hessian(ca.dot(multipliers, residual), q)[0]))
        self._columns = first + np.arange(robot.nv)
        self._rows = residual.numel()
        self._values = ca.Function("goal", [q], [residual, ca.densify(ca.jacobian(residual, q))])
        self._curvature = ca.Function("goal_curvature", [q, multipliers], [curvature])
        self._upper = np.triu_indices(robot.nv)
        self.lower = self.upper = np.zeros(0)
        self.row_lower = self.row_upper = np.zeros(self._rows)

    def guess(self, coefficients):
        return np.zeros(0)

    def jacobian_pattern(self):
        rows, columns = np.indices((self._rows, len(self._columns)))
        return rows.ravel(), self._columns[columns.ravel()]

    def hessian_pattern(self):
        i, j = self._upper
        return self._columns[i], self._columns[j]

    def evaluate(self, x):
        residual, jacobian = self._values(x[self._columns])
        return np.array(residual).ravel(), np.array(jacobian).ravel()

    def curvature(self, x, sigma, multipliers):
        return np.array(self._curvature(x[self._columns], multipliers))[self._upper]


class FreeWaypoints(_Priceless):
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


class JerkCost(_Priceless):
    """The share of a cost term in the third derivative of the motion: Σ_k ω_k φ(d³q/dt³(t_k)).

    In the unknowns the jerk is linear; on a motion e^θ times as long it is e^{−3θ} of what the space says.
    """

    variables = 0

    def __init__(self, term: CostTerm, space: MotionSpace, unknowns: Unknowns, parts: np.ndarray):
        """``parts``: offsets by what they come from, (3, size, nv); see `stretch.offset_parts`."""
        times, self._weight = space.quadrature()
        columns, values = space.basis(times, 4)
        values, blocks = values[:, 3], unknowns.block[columns]
        sample, place = np.nonzero(blocks >= 0)
        share = csr_array((values[sample, place], (sample, blocks[sample, place])), shape=(len(times), unknowns.count))
        self._term, self._share, self._nv, self._theta = term, share, parts.shape[2], 0.0
        self._parts = np.einsum("kl,pkli->pki", values, parts[:, columns])
        there = csr_array(abs(share)).T @ abs(share)
        self._first, self._second = np.nonzero(np.triu(there.toarray()))
        dense = share.toarray().T
        self._products = csr_array(dense[self._first] * dense[self._second])
        self.lower = self.upper = self.row_lower = self.row_upper = np.zeros(0)

    def guess(self, coefficients):
        return np.zeros(0)

    def jacobian_pattern(self):
        return np.zeros(0, int), np.zeros(0, int)

    def hessian_pattern(self):
        joints = np.arange(self._nv)
        rows, columns = ((blocks[:, None] * self._nv + joints).ravel() for blocks in (self._first, self._second))
        return rows, columns

    def stretch(self, theta):
        self._theta = theta

    def evaluate(self, x):
        free = self._share @ x[: self._share.shape[1] * self._nv].reshape(-1, self._nv)
        scale = [np.exp((k - 3) * self._theta) for k in range(3)]
        self._own = scale[0] * free
        self._ends = [s * part for s, part in zip(scale, self._parts, strict=True)]
        nothing = np.zeros_like(free)
        jerk = self._own + sum(self._ends)
        self._found = self._term.integrand(Samples(nothing, nothing, nothing, jerk, nothing), 2)
        self._omega = self._term.weight * self._weight * np.exp(self._theta)
        return np.zeros(0), np.zeros(0)

    def objective(self):
        return float(self._omega @ self._found.value)

    def gradient(self):
        return self._gathered(self._found.jerk)

    def curvature(self, x, sigma, multipliers):
        scale = sigma * np.exp(-6.0 * self._theta)
        return (self._products @ (scale * self._omega[:, None] * self._found.jerk_jerk)).ravel()

    def in_theta(self, x, sigma, multipliers):
        speed = -3.0 * self._own + sum((k - 3) * end for k, end in enumerate(self._ends))
        change = 9.0 * self._own + sum((k - 3) ** 2 * end for k, end in enumerate(self._ends))
        first, second = self._found.jerk, self._found.jerk_jerk
        slope = self.objective() + float(self._omega @ (first * speed).sum(axis=1))
        bent = float(self._omega @ (second * speed**2 + first * change + 2.0 * first * speed).sum(axis=1)) + self.objective()
        return ThetaTerms(slope, 0.0, sigma * self._gathered(second * speed - 2.0 * first), sigma * bent)

    def _gathered(self, values: np.ndarray) -> np.ndarray:
        return (self._share.T @ (np.exp(-3.0 * self._theta) * self._omega[:, None] * values)).ravel()


class TimePrice(_Priceless):
    """The share of the cost that only grows with the duration: price · T."""

    variables = 0

    def __init__(self, price: float, space: MotionSpace):
        self._planned = self._value = price * space.duration
        self.lower = self.upper = self.row_lower = self.row_upper = np.zeros(0)

    def guess(self, coefficients):
        return np.zeros(0)

    def jacobian_pattern(self):
        return np.zeros(0, int), np.zeros(0, int)

    hessian_pattern = jacobian_pattern

    def stretch(self, theta):
        self._value = self._planned * np.exp(theta)

    def in_theta(self, x, sigma, multipliers):
        return ThetaTerms(self._value, 0.0, np.zeros(0), sigma * self._value)

    def evaluate(self, x):
        return np.zeros(0), np.zeros(0)

    def objective(self):
        return self._value

    def curvature(self, x, sigma, multipliers):
        return np.zeros(0)


class ExtendedEvaluator:
    """A program's evaluator with extra rows and unknowns behind its own."""

    def __init__(self, base, size: int, rows: int, base_patterns: tuple, extras: list[ExtraRows]):
        self._base, self._size, self._rows, self.extras = base, size, rows, extras
        self._counts = [len(extra.row_lower) for extra in extras]
        total = size + sum(extra.variables for extra in extras)
        first = rows + np.cumsum([0, *self._counts])
        jacobians = [extra.jacobian_pattern() for extra in extras]
        (jac_start, jac_row), (hess_start, hess_row) = base_patterns
        parts = [(jac_row, _columns(jac_start))] + [(r + f, c) for (r, c), f in zip(jacobians, first, strict=False)]
        self.jacobian_pattern, self._jac_place = _merged(parts, int(first[-1]), total)
        parts = [(hess_row, _columns(hess_start)), *(extra.hessian_pattern() for extra in extras)]
        self.hessian_pattern, self._hess_place = _merged(parts, total, total)
        self._jac_base, self._hess_base = np.zeros(len(jac_row)), np.zeros(len(hess_row))

    def move(self, x):
        self._x = x
        self._base.move(x[: self._size])
        self._values = [extra.evaluate(x) for extra in self.extras]

    def objective(self):
        return self._base.objective() + sum(extra.objective() for extra in self.extras)

    def constraints(self, x, out):
        own = np.empty(self._rows)
        self._base.constraints(x[: self._size], own)
        out[:] = np.concatenate([own, *(v for v, _ in self._values)])

    def gradient(self, out):
        own = np.empty(self._size)
        self._base.gradient(own)
        out[: self._size], out[self._size :] = own, 0.0
        for extra in self.extras:
            slope = extra.gradient()
            if slope is not None:
                out[: len(slope)] += slope

    def jacobian(self, out):
        self._base.jacobian(self._jac_base)
        values = np.concatenate([self._jac_base, *(j for _, j in self._values)])
        out[:] = np.bincount(self._jac_place, values, minlength=len(out))

    def hessian(self, sigma, multipliers, out):
        self._base.hessian(sigma, multipliers[: self._rows].copy(), self._hess_base)
        parts, first = [self._hess_base], self._rows
        for extra, count in zip(self.extras, self._counts, strict=True):
            parts.append(extra.curvature(self._x, sigma, multipliers[first : first + count]))
            first += count
        out[:] = np.bincount(self._hess_place, np.concatenate(parts), minlength=len(out))


def _columns(start: np.ndarray) -> np.ndarray:
    return np.repeat(np.arange(len(start) - 1), np.diff(start))


def _merged(parts: list, rows: int, columns: int) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """One compressed-column pattern of several, and the place in it of each of their entries."""
    row, column = (np.concatenate([np.asarray(part[k], np.int64) for part in parts]) for k in (0, 1))
    keys, place = np.unique(column * rows + row, return_inverse=True)
    return (np.searchsorted(keys, np.arange(columns + 1, dtype=np.int64) * rows), keys % rows), place
