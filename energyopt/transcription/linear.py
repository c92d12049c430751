"""The linear part of a transcribed problem: bounds, defects and timed waypoints as rows in the unknowns x.

A row of a motion space, Σ_j A_rj c_j ∈ [low, high], holds for every joint alike; with c = offset + x[block] it becomes one
row in x for each joint. A row that touches a single unknown is a bound on it; one that touches none is left to the check.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array, vstack

from energyopt.parameterizations.space import MotionSpace, Unknowns
from energyopt.problem import Problem
from energyopt.robots.model import Limits


KINEMATIC_BACKOFF = 1e-7
"""Rows stay inside their limit by this share, so that the solver's own tolerance does not break it."""


@dataclass(frozen=True, eq=False)
class SampleRow:
    """A derivative bounded at further times (where a check found it outside)."""

    order: int
    times: np.ndarray


@dataclass(frozen=True, eq=False)
class LinearRows:
    """lower ≤ A x + offset ≤ upper, and bounds on x itself.

    Attributes:
        matrix: (R, n) compressed by row; offset, lower, upper: (R,).
        x_lower, x_upper: (n,).
    """

    matrix: csr_array
    offset: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    x_lower: np.ndarray
    x_upper: np.ndarray


def limits_of_order(limits: Limits, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper limits (nv,) of the derivative of an order: 0 position … 3 jerk."""
    if order == 0:
        return limits.lower, limits.upper
    bound = (limits.velocity, limits.acceleration, limits.jerk)[order - 1]
    return -bound, bound


def linear_rows(problem: Problem, space: MotionSpace, unknowns: Unknowns, samples: tuple[SampleRow, ...] = ()) -> LinearRows:
    """All linear constraints of a problem in one motion space."""
    nv = problem.robot.nv
    groups = []
    for order in range(4):
        low, high = limits_of_order(problem.limits, order)
        low, high = _backed_off(low, 1.0), _backed_off(high, -1.0)
        if np.any(np.isfinite(low) | np.isfinite(high)):
            extra = [space.rows_at(row.times, order) for row in samples if row.order == order]
            rows = vstack([space.bounding_rows(order), *extra], format="csr")
            groups.append((rows, np.tile(low, (rows.shape[0], 1)), np.tile(high, (rows.shape[0], 1))))
    defects = space.defects()
    if defects.shape[0]:
        groups.append((defects, *(np.zeros((defects.shape[0], nv)),) * 2))
    timed = [w for w in problem.waypoints if w.time is not None]
    if timed:
        positions = np.array([w.position for w in timed])
        groups.append((space.rows_at(np.array([w.time for w in timed]), 0), positions, positions))
    return _in_unknowns(groups, unknowns, nv)


def _backed_off(bound: np.ndarray, sign: float) -> np.ndarray:
    return np.where(np.isfinite(bound), bound + sign * KINEMATIC_BACKOFF * np.abs(np.where(np.isfinite(bound), bound, 0.0)), bound)


def _in_unknowns(groups: list, unknowns: Unknowns, nv: int) -> LinearRows:
    """Rows in coefficients (shared by the joints) → rows and bounds in x."""
    rows = vstack([g[0] for g in groups], format="csr")
    low, high = np.concatenate([g[1] for g in groups]), np.concatenate([g[2] for g in groups])
    constant = rows @ unknowns.offset
    known = unknowns.block >= 0
    selection = csr_array(
        (np.ones(known.sum()), (np.flatnonzero(known), unknowns.block[known])), shape=(len(known), unknowns.count)
    )
    blocks = csr_array(rows @ selection)
    blocks.data[np.abs(blocks.data) < 1e-12 * max(1.0, np.abs(blocks.data).max(initial=0.0))] = 0.0
    blocks.eliminate_zeros()
    touched = np.diff(blocks.indptr)
    x_lower, x_upper = _simple_bounds(blocks, touched == 1, low - constant, high - constant, unknowns.count, nv)
    return _general_rows(blocks, touched > 1, low, high, constant, x_lower, x_upper)


def _simple_bounds(blocks: csr_array, single: np.ndarray, low, high, count: int, nv: int):
    x_lower, x_upper = np.full((count, nv), -np.inf), np.full((count, nv), np.inf)
    at = np.flatnonzero(single)
    block, factor = blocks.indices[blocks.indptr[at]], blocks.data[blocks.indptr[at]][:, None]
    one, other = low[at] / factor, high[at] / factor
    np.maximum.at(x_lower, block, np.minimum(one, other))
    np.minimum.at(x_upper, block, np.maximum(one, other))
    return x_lower.ravel(), x_upper.ravel()


def _general_rows(blocks, several, low, high, constant, x_lower, x_upper) -> LinearRows:
    nv = low.shape[1]
    at = np.flatnonzero(several)
    kept = blocks[at]
    scale = 1.0 / np.maximum.reduceat(np.abs(kept.data), kept.indptr[:-1]) if len(at) else np.zeros(0)
    bounded = np.isfinite(low[at]) | np.isfinite(high[at])
    number = np.cumsum(bounded.ravel()).reshape(bounded.shape) - 1
    coo = kept.tocoo()
    row, column, value = (np.repeat(a, nv).reshape(-1, nv) for a in (coo.coords[0], coo.coords[1], coo.data * scale[coo.coords[0]]))
    joint = np.broadcast_to(np.arange(nv), row.shape)
    used = bounded[row, joint]
    matrix = coo_array(
        (value[used], (number[row, joint][used], (column * nv + joint)[used])), shape=(int(bounded.sum()), x_lower.size)
    )
    pick = lambda a: (a[at] * scale[:, None])[bounded]  # noqa: E731
    return LinearRows(csr_array(matrix), pick(constant), pick(low), pick(high), x_lower, x_upper)
