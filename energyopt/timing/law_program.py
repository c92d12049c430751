"""The energy-optimal time law on a path as a nonlinear program, with exact first and second derivatives.

    minimise over c (and θ = log T)   J = ∫₀ᵀ (Σ w τ² + Σ λ q̇²) dt,   s(t) = L Σ_j B_j(t/T) c_j,
    c_{j+1} ≥ c_j,   |q̇| ≤ V,  |q̈| ≤ A,  |q⃛| ≤ J,  |τ| ≤ τ_max at samples,

by Gauss quadrature. At every sample all depends on z = (s, ṡ, s̈, s⃛) alone (see `profile`), and z on four coefficients and θ:
z_k = e^{−kθ} L Σ B_j⁽ᵏ⁾ c_j, so ∂z_k/∂θ = −k z_k. In ṡ² as a function of s the problem is convex but for viscous friction and a
given duration (D. Verscheure, B. Demeulenaere, J. Swevers, J. De Schutter, M. Diehl, "Time-Optimal Path Tracking for Robots: A
Convex Optimization Approach", IEEE TAC 54, 2009); as s(t) it is smooth at rest, too, and the motion can wait.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from energyopt.timing.law_space import DEGREE, Ends, LawSpace
from energyopt.timing.profile import PathProfile, Quantity

ORDERS = np.arange(4.0)
RATES = "rates"
"""Kind of the rows on ṡ and s̈ themselves, which hold at ends that are no rest."""


@dataclass(frozen=True, eq=False)
class SampleRows:
    """Rows lower ≤ (quantity of one joint at one sample) · scale ≤ upper.

    Attributes:
        sigma: where, t/T; kind: name of the quantity; joint: index (for `RATES` the order); each of shape (R,).
        scale, lower, upper: (R,).
    """

    sigma: np.ndarray
    kind: np.ndarray
    joint: np.ndarray
    scale: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @staticmethod
    def joined(parts: list[SampleRows]) -> SampleRows:
        names = ("sigma", "kind", "joint", "scale", "lower", "upper")
        return SampleRows(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def end_rows(ends: Ends, length: float) -> SampleRows:
    """The speeds of ends that are no rest, and their vanishing accelerations."""
    rows = []
    for sigma, speed in zip((0.0, 1.0), ends.speeds, strict=True):
        if speed:
            rows.append((sigma, 1, speed))
            rows += [(sigma, 2, 0.0)] if ends.smooth else []
    sigma, order, value = np.array(rows, float).reshape(-1, 3).T
    kind = np.full(len(sigma), RATES, dtype="<U12")
    return SampleRows(sigma, kind, order.astype(int), np.full(len(sigma), 1.0 / length), value / length, value / length)


class LawProgram:
    """The program as `solvers.solve` takes it; it is its own evaluator."""

    linear_only = False

    def __init__(
        self,
        profile: PathProfile,
        space: LawSpace,
        ends: Ends,
        weights: tuple[np.ndarray, np.ndarray],
        durations: tuple[float, float],
        rows: SampleRows,
    ):
        """``weights`` are w and λ, (nv,) each; ``durations`` the shortest and longest T [s], the same where it is given."""
        self.profile, self.space, self.weights, self.samples = profile, space, weights, rows
        self.free = durations[0] < durations[1]
        known, count = np.array([ends.fixed(0), ends.fixed(1)]), space.size
        self.block = np.full(count, -1)
        self.block[known[0] : count - known[1]] = np.arange(count - known.sum())
        self.offset = np.where(np.arange(count) >= count - known[1], 1.0, 0.0)
        self.coefficient_count = int(count - known.sum())
        self._set_bounds(durations)
        self._set_nodes()
        self._set_patterns()
        self.evaluator = self

    @property
    def size(self) -> int:
        return len(self.lower)

    @property
    def rows(self) -> int:
        return len(self.row_lower)

    def unknowns(self, coefficients: np.ndarray, duration: float) -> np.ndarray:
        """x from the coefficients (n,) and T."""
        inside = coefficients[self.block >= 0]
        x = np.append(inside, np.log(duration)) if self.free else inside
        return np.clip(x, self.lower, self.upper)

    def coefficients(self, x: np.ndarray) -> np.ndarray:
        return self.offset + np.append(x[: self.coefficient_count], 0.0)[self.block]

    def duration(self, x: np.ndarray) -> float:
        return float(np.exp(x[-1])) if self.free else self._duration

    # The evaluator.

    def move(self, x: np.ndarray) -> None:
        self._T = self.duration(x)
        c = self.coefficients(x)[self._index]
        self._Z = self._basis * self._T ** -ORDERS[:, None]
        self._z = np.einsum("kop,kp->ko", self._Z, c)
        self._q = self.profile.at(self._z, self._kinds)
        self._q[RATES] = Quantity(self._z, np.broadcast_to(np.eye(4), (len(self._z), 4, 4)), np.zeros((len(self._z), 4, 4, 4)))
        tau, speed = (self._q[kind].value[: self._cost_nodes] for kind in ("torque", "velocity"))
        self._density = self._T * self._weight * (tau**2 @ self.weights[0] + speed**2 @ self.weights[1])

    def objective(self) -> float:
        return float(self._density.sum())

    def gradient(self, out: np.ndarray) -> None:
        slope = self._cost_slope()
        local = np.einsum("ko,kop->kp", slope, self._Z[: self._cost_nodes])
        total = np.bincount(self._own[: self._cost_nodes].ravel(), local.ravel(), minlength=self.coefficient_count + 1)
        out[: self.coefficient_count] = total[:-1]
        if self.free:
            out[-1] = self._density.sum() - np.sum(slope * ORDERS * self._z[: self._cost_nodes])

    def constraints(self, x: np.ndarray, out: np.ndarray) -> None:
        c, count = self.coefficients(x), len(self._differences)
        out[:count] = np.diff(c)[self._differences]
        for kind, (rows, node, joint) in self._groups.items():
            out[count + rows] = self._q[kind].value[node, joint] * self.samples.scale[rows]

    def jacobian(self, out: np.ndarray) -> None:
        entries = np.zeros((len(self.samples.sigma), DEGREE + 1 + self.free))
        for kind, (rows, node, joint) in self._groups.items():
            slope = self._q[kind].slope[node, joint] * self.samples.scale[rows, None]
            entries[rows, : DEGREE + 1] = np.einsum("ro,rop->rp", slope, self._Z[node])
            if self.free:
                entries[rows, -1] = -np.sum(slope * ORDERS * self._z[node], axis=1)
        out[:] = np.concatenate([self._linear_entries, entries.ravel()[self._row_entries]])[self._jacobian_order]

    def hessian(self, sigma: float, multipliers: np.ndarray, out: np.ndarray) -> None:
        slope, curvature = np.zeros((len(self._z), 4)), np.zeros((len(self._z), 4, 4))
        K = self._cost_nodes
        slope[:K], curvature[:K] = sigma * self._cost_slope(), sigma * self._cost_curvature()
        own = slope[:K].copy()
        for kind, (rows, node, joint) in self._groups.items():
            weight = multipliers[len(self._differences) + rows] * self.samples.scale[rows]
            np.add.at(slope, node, weight[:, None] * self._q[kind].slope[node, joint])
            np.add.at(curvature, node, weight[:, None, None] * self._q[kind].curvature[node, joint])
        P = DEGREE + 1 + self.free
        local = np.zeros((len(self._z), P, P))
        bent = curvature @ self._Z
        local[:, : DEGREE + 1, : DEGREE + 1] = np.swapaxes(self._Z, 1, 2) @ bent
        if self.free:
            drift = -ORDERS * self._z
            mixed = np.einsum("kop,ko->kp", bent, drift) - np.einsum("ko,o,kop->kp", slope, ORDERS, self._Z)
            mixed[:K] += np.einsum("ko,kop->kp", own, self._Z[:K])
            local[:, :-1, -1] = local[:, -1, :-1] = mixed
            twice = np.einsum("ko,kop,kp->k", drift, curvature, drift) + np.sum(slope * ORDERS**2 * self._z, axis=1)
            twice[:K] += sigma * self._density + 2 * np.sum(own * drift[:K], axis=1)
            local[:, -1, -1] = twice
        out[:] = np.bincount(self._targets, local.ravel(), minlength=len(out) + 1)[:-1]

    def _cost_slope(self) -> np.ndarray:
        """∂(integrand · weight · T)/∂z at the nodes of the cost, (K, 4)."""
        K, total = self._cost_nodes, 0.0
        for kind, weight in zip(("torque", "velocity"), self.weights, strict=True):
            q = self._q[kind]
            total = total + np.einsum("ki,kio->ko", 2 * weight * q.value[:K], q.slope[:K])
        return self._T * self._weight[:, None] * total

    def _cost_curvature(self) -> np.ndarray:
        K, total = self._cost_nodes, 0.0
        for kind, weight in zip(("torque", "velocity"), self.weights, strict=True):
            q = self._q[kind]
            scaled = np.swapaxes(q.slope[:K], 1, 2) * (2 * weight)
            total = total + scaled @ q.slope[:K] + np.einsum("ki,kiop->kop", 2 * weight * q.value[:K], q.curvature[:K])
        return self._T * self._weight[:, None, None] * total

    # What does not change.

    def _set_bounds(self, durations: tuple[float, float]) -> None:
        n = self.coefficient_count
        self._duration = durations[0]
        theta = [np.log(durations)] if self.free else []
        self.lower = np.concatenate([np.zeros(n), *(t[:1] for t in theta)])
        self.upper = np.concatenate([np.ones(n), *(t[1:] for t in theta)])
        # Differences of two known coefficients say nothing.
        self._differences = np.flatnonzero((self.block[1:] >= 0) | (self.block[:-1] >= 0))
        m = len(self._differences)
        self.row_lower = np.concatenate([np.zeros(m), self.samples.lower])
        self.row_upper = np.concatenate([np.full(m, np.inf), self.samples.upper])

    def _set_nodes(self) -> None:
        sigma, self._weight = self.space.quadrature()
        self._cost_nodes = len(sigma)
        places, node = np.unique(self.samples.sigma, return_inverse=True)
        self._index, self._basis = self.space.local_basis(np.concatenate([sigma, places]))
        self._own = self.block[self._index]
        self._own[self._own < 0] = self.coefficient_count  # one past the last: thrown away
        self._groups = {}
        for kind in np.unique(self.samples.kind):
            rows = np.flatnonzero(self.samples.kind == kind)
            self._groups[str(kind)] = (rows, self._cost_nodes + node[rows], self.samples.joint[rows])
        self._node = self._cost_nodes + node
        self._kinds = tuple({"torque", "velocity", *self._groups} - {RATES})

    def _set_patterns(self) -> None:
        self._set_jacobian_pattern()
        self._set_hessian_pattern()

    @cached_property
    def _columns(self) -> np.ndarray:
        """Unknowns of every node, (K, 4) or with θ (K, 5); known coefficients have the number of unknowns in their place."""
        own = np.where(self._own == self.coefficient_count, self.size, self._own)
        theta = np.full((len(own), 1), self.size - 1)
        return np.concatenate([own, theta], axis=1) if self.free else own

    def _set_jacobian_pattern(self) -> None:
        m = len(self._differences)
        row, column, value = [], [], []
        for sign, shift in ((-1.0, 0), (1.0, 1)):
            block = self.block[self._differences + shift]
            row.append(np.flatnonzero(block >= 0))
            column.append(block[block >= 0])
            value.append(np.full(np.sum(block >= 0), sign))
        self._linear_entries = np.concatenate(value)
        columns = self._columns[self._node].ravel()
        self._row_entries = np.flatnonzero(columns < self.size)
        rows = np.repeat(m + np.arange(len(self._node)), self._columns.shape[1])
        row, column = np.concatenate([*row, rows[self._row_entries]]), np.concatenate([*column, columns[self._row_entries]])
        self._jacobian_order = np.lexsort((row, column))
        self.jacobian_pattern = _pattern(row[self._jacobian_order], column[self._jacobian_order], self.size)

    def _set_hessian_pattern(self) -> None:
        n = self.size
        first = np.repeat(self._columns[:, :, None], self._columns.shape[1], axis=2)
        second = np.swapaxes(first, 1, 2)
        use = (first <= second) & (second < n)
        key = np.where(use, second * n + first, -1)
        present = np.unique(key[use])
        self._targets = np.where(use, np.searchsorted(present, key), len(present)).ravel()
        self.hessian_pattern = _pattern(present % n, present // n, n)


def _pattern(row: np.ndarray, column: np.ndarray, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Column starts and rows, of entries sorted by column."""
    return np.searchsorted(column, np.arange(columns + 1)), row
