"""Paths made shorter, and resampled.

Random shortcuts (R. Geraerts and M. H. Overmars, "Creating High-quality Paths for Motion Planning", IJRR 26, 2007, §3): two
random places on the path are joined by the straight way where that is free. Then every corner is pulled towards the middle of
its neighbours as far as the ways stay free, and corners that are not needed any more are left out. No step makes the path
longer, and every way of the result has been found free.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from energyopt.pathfinding.free_space import FreeSpace

PULLS = (1.0, 0.5, 0.25)
"""How far a corner is pulled, tried in this order: all the way, half, a quarter."""
WORTH = 1e-3
"""A change has to make the path shorter by this share."""


@dataclass(frozen=True)
class Effort:
    """How long to go on: ``shortcuts`` tried, ``rounds`` of corner pulling, and ``until`` a time of `time.monotonic`."""

    shortcuts: int = 60
    rounds: int = 4
    until: float = np.inf


def shorten(free: FreeSpace, path: np.ndarray, rng: np.random.Generator, effort: Effort | None = None) -> np.ndarray:
    """A path with the same ends, not longer, free where ``path`` was free; shape (K', nv).

    Args:
        free: the robot among obstacles.
        path: configurations joined by straight ways [rad], shape (K, nv).
        rng: source of the shortcuts.
        effort: when to stop.
    """
    effort = effort or Effort()
    deadline = effort.until
    path = np.array(path, dtype=float)
    for _ in range(effort.shortcuts):
        if len(path) == 2 or time.monotonic() > deadline:
            break
        path = _shortcut(free, path, rng)
    for _ in range(effort.rounds):
        before = length(path)
        path = _without_needless_corners(free, path)
        path = _pulled(free, path, deadline)
        if len(path) == 2 or time.monotonic() > deadline or length(path) > (1 - WORTH) * before:
            break
    return path


def length(path: np.ndarray) -> float:
    """Of a path (K, nv) [rad]."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def resampled(path: np.ndarray, spacing: float) -> np.ndarray:
    """The same path with points at most ``spacing`` [rad] apart, all corners kept; shape (K', nv)."""
    parts = [path[:1]]
    for a, b in zip(path[:-1], path[1:], strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / spacing)))
        parts.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
        parts[-1][-1] = b
    return np.concatenate(parts)


def _shortcut(free: FreeSpace, path: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Join two random places by the straight way, if that is free and worth it."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    first, last = np.sort(rng.uniform(0.0, along[-1], 2))
    i, j = np.searchsorted(along, (first, last), side="right") - 1
    i, j = min(i, len(path) - 2), min(j, len(path) - 2)
    if i == j:
        return path
    a, b = (path[k] + (x - along[k]) / (along[k + 1] - along[k]) * (path[k + 1] - path[k]) for k, x in ((i, first), (j, last)))
    if np.linalg.norm(b - a) > last - first - WORTH * along[-1]:
        return path
    # What is left of the cut ways is asked as well: their samples are others than those of the whole ways.
    if not all(free.free_way(*way) for way in ((a, b), (path[i], a), (b, path[j + 1]))):
        return path
    return _without_doubles(np.concatenate([path[: i + 1], [a, b], path[j + 1 :]]))


def _without_needless_corners(free: FreeSpace, path: np.ndarray) -> np.ndarray:
    k = 1
    while k < len(path) - 1:
        if free.free_way(path[k - 1], path[k + 1]):
            path = np.delete(path, k, axis=0)
        else:
            k += 1
    return path


def _pulled(free: FreeSpace, path: np.ndarray, deadline: float) -> np.ndarray:
    for k in range(1, len(path) - 1):
        if time.monotonic() > deadline:
            break
        before, at, after = path[k - 1 : k + 2]
        for share in PULLS:
            new = at + share * (0.5 * (before + after) - at)
            if free.free_way(before, new) and free.free_way(new, after) and free.free(new)[0]:
                path[k] = new
                break
    return path


def _without_doubles(path: np.ndarray) -> np.ndarray:
    """Without points that repeat the one before; the last one stays."""
    apart = np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-9
    return path[np.append(True, apart)] if apart[-1] else np.append(path[:-1][np.append(True, apart[:-1])], path[-1:], axis=0)
