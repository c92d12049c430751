"""A path with corners as a smooth curve near it.

The curve is a cubic B-spline whose coefficients lie on the path, each at its Greville abscissa taken as a length along it.
Where the path is straight, so is the curve, with unit speed (splines reproduce linear functions); at a corner it stays inside
the hull of four neighbouring coefficients, and is the rounder the farther those are apart. Where a corner cut so is not free,
coefficients are put closer together. Samples say where, at little cost; what they pass is then proved free in between by
conservative advancement (`geometry.advancement`), as a finished motion is, unless obstacles move.
"""

from __future__ import annotations

import numpy as np

from energyopt.errors import ProblemError
from energyopt.geometry.advancement import Advancement
from energyopt.parameterizations.excursions import excursions
from energyopt.parameterizations.trajectory import SplineTrajectory
from energyopt.pathfinding.free_space import FreeSpace
from energyopt.pathfinding.shortening import length

SPANS = 12
"""Spans of the curve to begin with."""
ROUNDS = 6
"""Times that spans in the way are halved: corners are then cut by a 64th of what they were."""
PER_SPAN = 6
"""Places at which a span is asked whether it is free."""
PROVED = 1e-4
"""Distances are decided to this [m], and with no margin at least this is kept."""
ITEMS = 100_000
"""Intervals and pairs of bodies looked at, at most, to prove a curve free."""


def rounded(path: np.ndarray, free: FreeSpace | None = None, keep: float | None = None) -> SplineTrajectory:
    """A curve q(s), 0 ≤ s ≤ length, near a path (K, nv) [rad]; twice continuously differentiable, |q'| = 1 where it is straight.

    Args:
        path: configurations joined by straight ways.
        free: keeps the curve free as far as halving its spans can; None takes the first curve.
        keep: distance that is proved to be kept everywhere [m]; the margin of ``free`` by default, which samples keep.

    Raises:
        ProblemError: the path has fewer than two points, or no length.
    """
    path = np.asarray(path, dtype=float)
    if path.ndim != 2 or len(path) < 2 or not np.all(np.isfinite(path)) or length(path) == 0:
        raise ProblemError(f"path of shape {path.shape}: expected at least two different configurations, one a row")
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    path, steps = path[np.append(True, steps > 0)], steps[steps > 0]
    along = np.append(0.0, np.cumsum(steps))
    breaks = np.linspace(0.0, along[-1], SPANS + 1)
    for _ in range(ROUNDS):
        curve = _curve(path, along, breaks)
        blocked = _blocked_spans(curve, free, free.margin if keep is None else keep) if free is not None else np.zeros(0, int)
        if not len(blocked):
            break
        # A span depends on four coefficients, which depend on the three knots to either side.
        near = np.unique(np.clip(blocked[:, None] + np.arange(-2, 3), 0, len(breaks) - 2))
        breaks = np.union1d(breaks, 0.5 * (breaks[near] + breaks[near + 1]))
    return curve


def _curve(path: np.ndarray, along: np.ndarray, breaks: np.ndarray) -> SplineTrajectory:
    knots = np.concatenate([breaks[:1].repeat(3), breaks, breaks[-1:].repeat(3)])
    greville = np.array([knots[j + 1 : j + 4].mean() for j in range(len(knots) - 4)])
    coefficients = np.stack([np.interp(greville, along, column) for column in path.T], axis=1)
    coefficients[[0, -1]] = path[[0, -1]]
    return SplineTrajectory(knots, coefficients, 3)


def _blocked_spans(curve: SplineTrajectory, free: FreeSpace, keep: float) -> np.ndarray:
    """Numbers of the spans that are not free at samples; where all are, of those that are not proved to be."""
    s = curve.sample_times(PER_SPAN)[1:-1]
    hits = s[~free.free(curve(s))]
    if not len(hits) and free.clock is None and free.scene.pairs:
        hits = _too_close(curve, free, max(keep, PROVED))
    return np.unique(np.clip(np.searchsorted(curve.breaks, hits, side="right") - 1, 0, len(curve.breaks) - 2))


def _too_close(curve: SplineTrajectory, free: FreeSpace, required: float) -> np.ndarray:
    """Places, at least one of every stretch, at which something is closer than required [m], or may be."""
    search = Advancement(free.scene, curve, lambda s, half: excursions(curve, s, half), required, PROVED)
    sweep = search.run(curve.breaks, ITEMS)
    return np.append(sweep.time[sweep.distance < required - 0.5 * PROVED], sweep.open_time)
