"""Clearance in the program: penalties on samples of the motion, and rows where a pair would come too close.

With q_k = Σ_j B_j(t_k) c_j the configuration at instant k, a function φ of q_k has in the unknowns x (blocks of nv)

    ∂φ/∂x_A = β_A(k) ∂φ/∂q        ∂²φ/∂x_A∂x_B = β_A(k) β_B(k) ∂²φ/∂q²        β_A(k) = Σ_{j in block A} B_j(t_k),

so that sums over instants are products of matrices: Σ_k β_A β_B H_k for each two blocks that meet in an instant.
The penalty is Σ_k ω_k E(q_k) ≈ ∫ E dt, E being hinge and potential (see `collision`); rows are d(q_k) ≥ bound.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array

from energyopt.avoidance import RESERVE, Avoidance
from energyopt.clearance_checks import exact_distances, motion_clearance
from energyopt.collision import Hinge
from energyopt.parameterizations.space import MotionSpace, Unknowns
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.transcription.extras import ThetaTerms
from energyopt.transcription.penalty import travel_times

CHECK_STEP, CHECKS = 0.005, (200, 1200)
"""Distance [m] a sphere moves from one sample of the check to the next, and bounds of their number."""
EXCESS = 0.5 * RESERVE
"""Missing distance [m] that calls for rows: half of the reserve, the other half covers the time between the samples."""
NEAR = 2e-3
"""Spheres that keep less than this beyond what is asked of them [m] get a row as well where one beside them calls for it."""
AROUND = np.linspace(-0.02, 0.02, 9)
"""Instants around a contact that get rows too, in shares of the duration."""
PUSH = 1.2
"""Share of the missing distance that is asked for."""
FEW = 2
STRIDE = 6
"""Rows a pair of links gets at one instant, and every which sample of a stretch is such an instant."""


TICK = 2e-6
"""Seconds by which obstacles that move are moved on to see how distances change."""

Bounds = dict[tuple[float, int, int], float]
"""Least distances [m] by (time, a, b), pairs as in `collision`."""


class ClearanceTerms:
    """Penalty and rows of one program; see `transcription.extras.ExtraRows`."""

    variables = 0

    def __init__(
        self,
        avoidance: Avoidance,
        space: MotionSpace,
        unknowns: Unknowns,
        rows: Bounds,
        hinge: Hinge,
        samples: tuple[np.ndarray, np.ndarray],
    ):
        """``rows``: bounds by (time, a, b); ``samples``: times and weights of the penalty."""
        self._avoidance, self._unknowns = avoidance, unknowns
        keys = sorted(rows)
        row_times = np.array([t for t, *_ in keys])
        self._weight = self._planned_weight = samples[1]
        self._bent_last, self._theta, self._turned = True, 0.0, None
        instants, self._row_sample = np.unique(row_times, return_inverse=True)
        self._pairs = np.array([pair for _, *pair in keys], np.int64).reshape(-1, 2)
        none = np.zeros(0)
        self.lower = self.upper = none
        self.row_lower = np.array([rows[key] for key in keys])
        self.row_upper = np.full(len(keys), np.inf)
        self._template, self._times = replace(avoidance.scene, hinge=hinge), (samples[0], instants)
        self._moves = any(obstacle.moves for obstacle in avoidance.scene.obstacles)
        self._penalised, self._bounded = self._prepared()
        self._nv = avoidance.arm.nv
        self._lay_out(space, np.concatenate([samples[0], instants]))

    @property
    def priced(self) -> bool:
        """Whether there is a penalty at all."""
        return bool(len(self._weight))

    def guess(self, coefficients):
        return np.zeros(0)

    def jacobian_pattern(self):
        rows, columns = np.repeat(self._entry_row, self._nv), self._entry_block[:, None] * self._nv + np.arange(self._nv)
        return rows, columns.ravel()

    def hessian_pattern(self):
        i, j = np.indices((self._nv, self._nv))
        i, j = self._meet[:, :1, None] * self._nv + i, self._meet[:, 1:, None] * self._nv + j
        return i[self._kept], j[self._kept]

    def stretch(self, theta):
        self._weight = self._planned_weight * np.exp(theta)
        if self._moves and theta != self._theta:
            self._theta = theta
            self._penalised, self._bounded = self._prepared()

    def in_theta(self, x, sigma, multipliers):
        """With ω and t growing as e^θ, and f_t from differences in time of what is exact in q (see `_drift`):
        dE/dθ = E + Σωtf_t, ∂²E/∂θ∂x = ∇E + Σωt∇f_t, d²E/dθ² = E + Σω(3tf_t + t²f_tt); rows likewise without ω."""
        own, nothing = self.objective(), np.zeros(self._unknowns.count * self._nv)
        crossed = nothing if not self.priced else sigma * self.gradient()
        if not self._moves:
            return ThetaTerms(own, 0.0, crossed, sigma * own)
        (f_t, f_tt, slope_t), (d_t, d_tt, row_t) = self._drift()
        late, instants = (times * np.exp(self._theta) for times in self._times)
        rows = instants[self._row_sample] * d_t
        bent = sigma * (own + self._weight @ (3.0 * late * f_t + late**2 * f_tt))
        bent += float(multipliers @ (rows + instants[self._row_sample] ** 2 * d_tt))
        if self.priced:
            crossed = crossed + sigma * (self._gather @ ((self._weight * late)[:, None] * slope_t)).ravel()
        shares = (multipliers * instants[self._row_sample])[self._entry_row, None] * self._entry_share[:, None]
        crossed = crossed.reshape(-1, self._nv).copy()
        np.add.at(crossed, self._entry_block, shares * row_t[self._entry_row])
        return ThetaTerms(own + float(self._weight @ (late * f_t)), rows, crossed.ravel(), float(bent))

    def _prepared(self, ahead: float = 0.0):
        """Kernels at the instants of penalty and rows, seconds ``ahead``."""
        scenes = (self._template.at(np.exp(self._theta) * times + ahead) for times in self._times)
        return tuple(map(self._avoidance.kernels.prepare, scenes))

    def _drift(self):
        """Of penalty and rows: first and second derivative in time and the first of the gradient, the arm standing still."""
        if self._turned is None:
            before, now, after = (self._at_time(ahead) for ahead in (-TICK, 0.0, TICK))
            self._turned = [
                ((late - early) / (2 * TICK), (late - 2 * mid + early) / TICK**2, (late_slope - early_slope) / (2 * TICK))
                for (early, early_slope), (mid, _), (late, late_slope) in zip(before, now, after, strict=True)
            ]
        return self._turned

    def _at_time(self, ahead: float):
        """Penalty at each instant and distance of each row, with their derivatives in q, where obstacles are ``ahead``."""
        penalised, bounded = self._prepared(ahead)
        count, nothing = len(self._weight), (np.zeros(0), np.zeros((0, self._nv)))
        penalty = rows = nothing
        if count:
            energy, slope, _ = penalised(self._q[:count]).penalty()
            penalty = energy.sum(axis=1), slope
        if len(self._pairs):
            rows = bounded(self._q[count:]).pairs(self._row_sample, self._pairs)
        return penalty, rows

    def evaluate(self, x):
        count, penalised = self._unknowns.count, len(self._weight)
        self._turned = None
        self._q = q = self._offset + self._spread @ x[: count * self._nv].reshape(count, self._nv)
        if penalised:
            self._placed = self._penalised(q[:penalised])
            self._penalty = self._placed.penalty(derivatives=self._bent_last)
            self._bent_last = False
        if not len(self._pairs):
            return np.zeros(0), np.zeros(0)
        self._placed_rows = self._bounded(q[penalised:])
        distance, gradient = self._placed_rows.pairs(self._row_sample, self._pairs)
        return distance, (self._entry_share[:, None] * gradient[self._entry_row]).ravel()

    def objective(self):
        return float(self._weight @ self._penalty[0].sum(axis=1)) if self.priced else 0.0

    def gradient(self):
        if not self.priced:
            return None
        return (self._gather @ (self._weight[:, None] * self._bent()[1])).ravel()

    def curvature(self, x, sigma, multipliers):
        nv, parts = self._nv, []
        if self.priced:
            parts.append(sigma * self._weight[:, None] * self._bent()[2].reshape(-1, nv * nv))
        if len(self._pairs):
            parts.append(self._placed_rows.bends(self._row_sample, self._pairs, multipliers).reshape(-1, nv * nv))
        blocks = (self._products @ np.concatenate(parts)).reshape(-1, nv, nv)
        return blocks[self._kept]

    def _bent(self):
        """Penalty with derivatives, which line searches do not ask for."""
        self._bent_last = True  # the next point is likely to be accepted as well
        if self._penalty[1] is None:
            self._penalty = self._placed.penalty()
        return self._penalty

    def _lay_out(self, space: MotionSpace, times: np.ndarray) -> None:
        """Shares β (count, K), their products by pairs of blocks, and the entries of the rows."""
        u, nv = self._unknowns, self._nv
        share, self._offset = np.zeros((u.count, len(times))), np.zeros((len(times), nv))
        if len(times):
            columns, values = space.basis(times, 1)
            block, values = u.block[columns], values[:, 0]
            self._offset = np.einsum("kl,kli->ki", values, u.offset[columns])
            sample, place = np.nonzero(block >= 0)
            np.add.at(share, (block[sample, place], sample), values[sample, place])
        # Each instant touches few blocks: sparse products, which also leave the threads of dense ones alone.
        self._spread, self._gather = csr_array(share.T), csr_array(share[:, : len(self._weight)])
        there = csr_array(share != 0).astype(float)
        first, second = np.nonzero(np.triu((there @ there.T).toarray()))
        self._meet = np.stack([first, second], axis=1)
        self._products = csr_array(share[first] * share[second])
        upper = np.triu(np.ones((nv, nv), bool))
        self._kept = np.where((first == second)[:, None, None], upper, True)
        own = share[:, len(self._weight) + self._row_sample].T if len(self._pairs) else np.zeros((0, u.count))
        self._entry_row, self._entry_block = np.nonzero(own)
        self._entry_share = own[self._entry_row, self._entry_block]


def close_pairs(avoidance: Avoidance, trajectory: Trajectory, slack: float = 0.0) -> Bounds:
    """Rows at the deepest instants of every stretch where a pair of links, or a link and an obstacle, is too close.

    Args:
        slack: pairs also count as too close if they keep less than this [m] beyond what is asked.
    """
    times = travel_times(avoidance, trajectory, CHECK_STEP, CHECKS)
    placed = avoidance.kernels.place(avoidance.scene.at(times), trajectory(times))
    least, pair = placed.least(NEAR + slack)
    limit = slack - EXCESS
    picks = [(k, *pair[k, c]) for c in np.flatnonzero((least < limit).any(axis=0)) for k in _instants(least[:, c], limit)]
    found = np.array([pick for pick in picks if pick[1] >= 0], np.int64).reshape(-1, 3)
    if not len(found):
        return {}
    sample, pairs, counts = _with_neighbours(avoidance, found)
    bound = required_of(avoidance, pairs)
    kept = _nearest_few(placed.pairs(sample, pairs)[0] - bound, np.repeat(np.arange(len(found)), counts), NEAR + slack)
    kept = zip(sample[kept], pairs[kept], bound[kept], strict=True)
    return {(float(times[k]), int(a), int(b)): float(d) for k, (a, b), d in kept}


def touching_pairs(avoidance: Avoidance, problem: Problem, trajectory: Trajectory) -> Bounds:
    """Rows where the exact check fails although the spheres keep what is asked of them: less was asked than the clearance.

    At and around each instant the exact distance misses, all overlapping spheres of the two links are asked for what is missing
    more than they have.
    """
    rows: Bounds = {}
    for instant in motion_clearance(problem, trajectory).violations:
        names = (instant.first, instant.second)
        pairs, margin = _pairs_of_names(avoidance, *names), RESERVE if instant.second in avoidance.arm.links else avoidance.margin
        times = np.clip(instant.time + trajectory.duration * AROUND, 0.0, trajectory.duration)
        missing = margin - exact_distances(problem, trajectory, times, names)
        times, missing = times[missing > 0], missing[missing > 0]
        if not len(times) or not len(pairs):
            continue
        placed = avoidance.kernels.place(avoidance.scene.at(times), trajectory(times))
        sample, every = np.repeat(np.arange(len(times)), len(pairs)), np.tile(pairs, (len(times), 1))
        distance = placed.pairs(sample, every)[0]
        bound = np.minimum(distance + PUSH * missing[sample], margin)
        for r in np.flatnonzero(distance < margin):
            rows[float(times[sample[r]]), int(every[r, 0]), int(every[r, 1])] = float(bound[r])
    return rows


def _pairs_of_names(avoidance: Avoidance, first: str, second: str) -> np.ndarray:
    """All pairs of spheres of a link and an obstacle, or of two links, by name; shape (R, 2)."""
    arm, names = avoidance.arm, avoidance.names
    on = lambda link: np.arange(arm.link_start[link], arm.link_start[link + 1])
    if first not in arm.links:
        return np.empty((0, 2), np.int64)
    a = on(arm.links.index(first))
    if second in arm.links:
        b = -1 - on(arm.links.index(second))
    else:
        b = np.array([k for k, name in enumerate(names) if name == second], np.int64)
    return np.stack(np.meshgrid(a, b, indexing="ij"), axis=-1).reshape(-1, 2)


def required_of(avoidance: Avoidance, pairs: np.ndarray) -> np.ndarray:
    """The distance asked of each pair (R, 2) of spheres [m]."""
    a, b = pairs.T
    own = b < 0
    bound = np.empty(len(pairs))
    bound[own] = avoidance.scene.required_self[a[own], -1 - b[own]]
    bound[~own] = avoidance.scene.required[a[~own], b[~own]]
    return bound


def _instants(excess: np.ndarray, limit: float) -> np.ndarray:
    """Indices that cover every stretch below a limit: its local minima, and every few samples of it."""
    below = np.flatnonzero(excess < limit)
    padded = np.concatenate([[np.inf], excess, [np.inf]])
    minima = below[(excess[below] <= padded[below]) & (excess[below] <= padded[below + 2])]
    inner = below[(below > 0) & (below < len(excess) - 1)]
    return np.unique(np.concatenate([minima, inner[::STRIDE]]))


def _with_neighbours(avoidance: Avoidance, found: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The other spheres of the same links at the same instants as well: samples (R,), pairs (R, 2), and how many for each."""
    arm, start = avoidance.arm, avoidance.arm.link_start
    samples, pairs = [], []
    for k, a, b in found:
        link = arm.link_of(a)
        first = np.arange(start[link], start[link + 1])
        second = np.array([b])
        if b < 0:
            link = arm.link_of(-1 - b)
            second = -1 - np.arange(start[link], start[link + 1])
        pairs.append(np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1).reshape(-1, 2))
        samples.append(np.full(len(pairs[-1]), k))
    return np.concatenate(samples), np.concatenate(pairs), np.array([len(part) for part in pairs])


def _nearest_few(excess: np.ndarray, group: np.ndarray, near: float) -> np.ndarray:
    """Which pairs get a row: of each group (R,) the FEW of least excess (R,), as far as they keep less than ``near``."""
    order = np.lexsort((excess, group))
    first = np.searchsorted(group[order], group[order])
    kept = np.zeros(len(excess), bool)
    kept[order] = (np.arange(len(order)) - first < FEW) & (excess[order] < near)
    return kept
