"""The linear part of a transcribed problem: bounds, defects and timed waypoints as rows in the unknowns x.

A row of a motion space, Σ_j A_rj c_j ∈ [low, high], holds for every joint alike; with c = offset + x[block] it becomes one
row in x for each joint. A row that touches a single unknown is a bound on it; one that touches none is left to the check.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from energyopt.parameterizations.space import MotionSpace, Rows, Unknowns
from energyopt.problem import Problem
from energyopt.robots.model import Limits

TOLERATED = 1e-8
"""What the solver may violate a row by, in the unit the row is scaled to."""
FORGIVEN = 1e-7
"""What a motion may exceed a limit by, in the limit's unit and as a share of the interval between two limits."""
MOST_BACKOFF = 3e-3
"""Rows that the solver may violate by more than that are moved inside, by this share of their interval at most."""
LARGEST_COEFFICIENT = 1e4
"""Rows are in units of the width of their interval, but coefficients are no larger than this: beyond it, sums of them would be
rounded by more than the solver tolerates."""


@dataclass(frozen=True, eq=False)
class SampleRow:
    """A derivative bounded at further times, each for some joints (where a check found it outside).

    Attributes:
        order: of the derivative; times: (N,); joints: (N, nv), true where the bound is needed.
        inside: by how much it is kept from its limits.
    """

    order: int
    times: np.ndarray
    joints: np.ndarray
    inside: float = 0.0

    def bounds(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper ones (N, nv), from limits (nv,)."""
        return np.where(self.joints, low + self.inside, -np.inf), np.where(self.joints, high - self.inside, np.inf)


@dataclass(frozen=True, eq=False)
class LinearRows:
    """lower ≤ A x + offset ≤ upper, and bounds on x itself.

    Attributes:
        start, column, value: A compressed by row, (R + 1,), (E,), (E,).
        offset, lower, upper: (R,).
        x_lower, x_upper: (n,).
        order: (R,) of the derivative a row bounds; parts: (3, R), what position, velocity and acceleration at the ends contribute
            to the offset, where the duration is free; else None.
    """

    start: np.ndarray
    column: np.ndarray
    value: np.ndarray
    offset: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    x_lower: np.ndarray
    x_upper: np.ndarray
    order: np.ndarray
    parts: np.ndarray | None = None

    @cached_property
    def row(self) -> np.ndarray:
        """Row of each entry."""
        return np.repeat(np.arange(len(self.lower)), np.diff(self.start))

    def evaluate(self, x: np.ndarray) -> np.ndarray:
        """A x + offset, (R,)."""
        return self.offset + np.bincount(self.row, self.value * x[self.column], minlength=len(self.lower))


def limits_of_order(limits: Limits, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper limits (nv,) of the derivative of an order: 0 position … 3 jerk."""
    if order == 0:
        return limits.lower, limits.upper
    bound = (limits.velocity, limits.acceleration, limits.jerk)[order - 1]
    return -bound, bound


def linear_rows(
    problem: Problem,
    space: MotionSpace,
    unknowns: Unknowns,
    samples: tuple[SampleRow, ...] = (),
    parts: np.ndarray | None = None,
) -> LinearRows:
    """All linear constraints of a problem in one motion space.

    Args:
        parts: offsets of the unknowns, (3, size, nv), by what they come from, where the duration is free: rows of derivatives
            change with it and must not become bounds on x.
    """
    nv, groups = problem.robot.nv, []
    for order in range(4):
        low, high = limits_of_order(problem.limits, order)
        if np.any(np.isfinite(low) | np.isfinite(high)):
            rows = space.bounding_rows(order)
            groups.append((rows, np.tile(low, (rows.count, 1)), np.tile(high, (rows.count, 1)), order))
            for sample in (s for s in samples if s.order == order):
                groups.append((space.rows_at(sample.times, order), *sample.bounds(low, high), order))
    defects = space.defects()
    groups.append((defects, *(np.zeros((defects.count, nv)),) * 2, 0))
    if problem.periodic:
        closing = space.closing_rows()
        groups.append((closing, *(np.zeros((closing.count, nv)),) * 2, 0))
    timed = [w for w in problem.waypoints if w.time is not None]
    if timed:
        positions = np.array([w.position for w in timed])
        groups.append((space.rows_at(np.array([w.time for w in timed]), 0), positions, positions, 0))
    rows = Rows.stacked([g[0] for g in groups])
    low, high = (np.concatenate([g[k] for g in groups]) for k in (1, 2))
    order = np.concatenate([np.full(g[0].count, g[3]) for g in groups])
    return _in_unknowns(rows, unknowns, low, high, order, parts)


def _in_unknowns(rows: Rows, unknowns: Unknowns, low, high, order, parts) -> LinearRows:
    """Rows in coefficients (shared by the joints) → rows and bounds in x; ``low`` and ``high`` are (R, nv)."""
    count = max(unknowns.count, 1)
    constant = rows @ unknowns.offset
    block = unknowns.block[rows.column]
    known = block >= 0
    key, place = np.unique(rows.row[known] * count + block[known], return_inverse=True)
    value = np.bincount(place, rows.value[known], minlength=len(key))
    row, block = np.divmod(key, count)
    # Entries that cancel are dropped, judged row by row: those of a jerk on short spans are 1e13 times those of a position.
    kept = np.abs(value) > 1e-12 * _largest(rows.row, rows.value, rows.count)[row]
    row, block, value = row[kept], block[kept], value[kept]
    touched = np.bincount(row, minlength=rows.count) == 1
    if parts is not None:
        parts = np.array([rows @ part for part in parts])
        touched &= (order == 0) & ~np.any(parts[1:], axis=(0, 2))
    single = touched[row]
    bounds = _simple_bounds(row[single], block[single], value[single], low - constant, high - constant, unknowns.count)
    several = ~single
    return _general_rows(row[several], block[several], value[several], (low, high, constant), bounds, order, parts)


def _simple_bounds(row, block, value, low, high, count: int) -> tuple[np.ndarray, np.ndarray]:
    nv = low.shape[1]
    x_lower, x_upper = np.full((count, nv), -np.inf), np.full((count, nv), np.inf)
    one, other = low[row] / value[:, None], high[row] / value[:, None]
    np.maximum.at(x_lower, block, np.minimum(one, other))
    np.minimum.at(x_upper, block, np.maximum(one, other))
    return x_lower.ravel(), x_upper.ravel()


def _general_rows(row, block, value, sides, bounds, order, parts) -> LinearRows:
    """One row a joint with a finite limit.

    The third difference that bounds a jerk on a short span may vary by 1e-10 rad only, so what the solver tolerates must be a
    share of the row's own interval [low, high]: rows are scaled to intervals of width one, but to largest coefficients not
    below one and not above `LARGEST_COEFFICIENT`.
    """
    low, high, constant = sides
    count, nv = low.shape
    largest = _largest(row, value, count)
    bounded = (largest > 0)[:, None] & (np.isfinite(low) | np.isfinite(high))
    scale = _row_scale(largest, high - low)
    number = np.cumsum(bounded.ravel()).reshape(count, nv) - 1
    used = bounded[row].ravel()
    new_row = number[row].ravel()[used]
    new_column = (block[:, None] * nv + np.arange(nv)).ravel()[used]
    new_value = (value[:, None] * scale[row]).ravel()[used]
    sorting = np.argsort(new_row, kind="stable")
    start = np.searchsorted(new_row[sorting], np.arange(int(bounded.sum()) + 1))
    pick = lambda side: (side * scale)[bounded]
    backoff = _backoff(pick(high) - pick(low), scale[bounded])
    return LinearRows(
        start,
        new_column[sorting],
        new_value[sorting],
        pick(constant),
        pick(low) + backoff,
        pick(high) - backoff,
        *bounds,
        order=np.broadcast_to(order[:, None], bounded.shape)[bounded],
        parts=None if parts is None else np.array([pick(part) for part in parts]),
    )


def _row_scale(largest: np.ndarray, width: np.ndarray) -> np.ndarray:
    """What to multiply each row by, (R, nv), from its largest coefficient (R,) and the width of its interval (R, nv)."""
    unit = 1.0 / np.where(largest > 0, largest, 1.0)[:, None]
    with np.errstate(divide="ignore"):
        return unit * np.clip(1.0 / (width * unit), 1.0, np.where(width > 0, LARGEST_COEFFICIENT, 1.0))


def _backoff(width: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """How far rows are moved inside their intervals of the given (scaled) widths, (R,)."""
    backoff = np.clip(TOLERATED - FORGIVEN * np.minimum(width, scale), 0.0, MOST_BACKOFF * width)
    return np.where(np.isfinite(width), backoff, TOLERATED)


def _largest(row: np.ndarray, value: np.ndarray, count: int) -> np.ndarray:
    """Magnitude of the largest entry of each row, (count,)."""
    largest = np.zeros(count)
    np.maximum.at(largest, row, np.abs(value))
    return largest
