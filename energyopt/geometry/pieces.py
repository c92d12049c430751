"""A triangle mesh as few convex pieces.

A collision library and a simulator want convex bodies, and the hull of a bent link fills its bend. So a mesh is cut by a plane
across one of its principal axes wherever that saves enough volume: the hulls of the two halves together are then at least 15 %
smaller than the hull of the whole. The pieces contain every triangle, since each triangle is cut with its mesh.

Hulls of finely tessellated parts have thousands of corners and no use for them. Above 300, a hull is replaced by one around
it: corners are added, always the one farthest out of each face, until none is more than 0.5 mm outside, and then the corners
are moved out by as much as it takes.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

SAVING = 0.15
"""Share of the hull's volume that a cut has to save."""
SMALLEST_SAVING = 5e-5
"""Volume that a cut has to save [m³]: a cube of 37 mm. The hollows of small parts are not worth a body more."""
MAX_DEPTH = 3
"""Cuts in a row: at most eight pieces."""
CUTS = (0.25, 0.4, 0.5, 0.6, 0.75)
"""Where cuts are tried, as shares of the extent along an axis."""
THINNEST = 1e-3
"""Pieces must be at least this thick [m]: thinner ones make poor bodies."""
SAMPLED_TRIANGLES = 600
"""Cuts are chosen by looking at so many of the mesh's triangles, and made with all of them."""
MANY_CORNERS = 300
SIMPLIFIED = 5e-4
"""How far outside a hull its corners may be when it is simplified [m], before it is widened."""


def convex_pieces(vertices: np.ndarray, triangles: np.ndarray) -> list[np.ndarray]:
    """Corner points [m] of convex pieces that contain the mesh, each of shape (K, 3).

    Args:
        vertices: [m], shape (V, 3); triangles: indices, shape (F, 3).

    Returns:
        the pieces; where no cut saves much, one: the corners of the mesh's hull.
    """
    return _split(vertices[triangles], MAX_DEPTH)


def _split(corners: np.ndarray, depth: int) -> list[np.ndarray]:
    points = np.unique(corners.reshape(-1, 3), axis=0)
    hull = _hull(points)
    if hull is None:
        return [points]
    cut = _best_cut(corners[:: -(-len(corners) // SAMPLED_TRIANGLES)], points[hull.vertices]) if depth else None
    if cut is None:
        return [_simplified(points[hull.vertices])]
    axis, offset = cut
    halves = (_clip(corners, axis, offset), _clip(corners, -axis, -offset))
    return [piece for half in halves for piece in _split(half, depth - 1)]


def _best_cut(corners: np.ndarray, outline: np.ndarray) -> tuple[np.ndarray, float] | None:
    """The plane axis·x = offset whose two halves have the least volume, if that saves enough."""
    volume = _volume(corners)
    least, best = min((1.0 - SAVING) * volume, volume - SMALLEST_SAVING), None
    for axis in np.linalg.svd(outline - outline.mean(axis=0), full_matrices=False)[2]:
        low, high = (outline @ axis).min(), (outline @ axis).max()
        for offset in low + np.array(CUTS) * (high - low):
            halves = _volume(_clip(corners, axis, offset)) + _volume(_clip(corners, -axis, -offset))
            if halves < least:
                least, best = halves, (axis, float(offset))
    return best


def _simplified(points: np.ndarray) -> np.ndarray:
    """Corners of a hull around the hull of ``points``, with fewer corners where there are many."""
    if len(points) <= MANY_CORNERS:
        return points
    axes = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]) - 1.0
    chosen = np.unique((points @ axes.T).argmax(axis=0))
    while True:
        hull = ConvexHull(points[chosen])
        height = points @ hull.equations[:, :3].T + hull.equations[:, 3]
        farthest = height.argmax(axis=0)
        farthest = np.unique(farthest[height.max(axis=0) > SIMPLIFIED])
        if len(farthest) == 0:
            return _moved_out(points[chosen], hull, points)
        chosen = np.union1d(chosen, farthest)


def _moved_out(corners: np.ndarray, hull: ConvexHull, points: np.ndarray) -> np.ndarray:
    """The corners of a hull, each moved along the mean of its faces' normals until all ``points`` are inside."""
    normals = np.zeros_like(corners)
    for k in range(3):
        np.add.at(normals, hull.simplices[:, k], hull.equations[:, :3])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    step = 0.1 * SIMPLIFIED
    moved = corners
    while np.any(_height(moved, points) > 0):
        moved = corners + step * normals
        step *= 1.2
    return moved[ConvexHull(moved).vertices]


def _height(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How far points are outside the hull of corners [m]; negative inside."""
    planes = ConvexHull(corners).equations
    return (points @ planes[:, :3].T + planes[:, 3]).max(axis=1)


def _clip(corners: np.ndarray, axis: np.ndarray, offset: float) -> np.ndarray:
    """The parts of triangles (F, 3, 3) where axis·x ≤ offset, as triangles."""
    height = corners @ axis - offset
    below = height <= 0
    count = below.sum(axis=1)
    kept = [corners[count == 3]]
    for lone_below in (True, False):
        rows = np.flatnonzero(count == (1 if lone_below else 2))
        first = (below[rows] == lone_below).argmax(axis=1)
        order = (first[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(corners[rows], order[:, :, None], axis=1), 1, 0)
        ha, hb, hc = np.moveaxis(np.take_along_axis(height[rows], order, axis=1), 1, 0)[..., None]
        ab, ac = a + ha / (ha - hb) * (b - a), a + ha / (ha - hc) * (c - a)
        kept += [np.stack(t, axis=1) for t in (((a, ab, ac),) if lone_below else ((ab, b, c), (ab, c, ac)))]
    return np.concatenate(kept)


def _volume(corners: np.ndarray) -> float:
    """Of the hull; infinite where it is too thin to be a piece."""
    hull = _hull(corners.reshape(-1, 3))
    if hull is None:
        return np.inf
    spans = hull.points[hull.vertices] @ hull.equations[:, :3].T
    return hull.volume if np.ptp(spans, axis=0).min() > THINNEST else np.inf


def _hull(points: np.ndarray) -> ConvexHull | None:
    try:
        return ConvexHull(points) if len(points) > 3 else None
    except (QhullError, ValueError):
        return None
