"""Parts that round and edged shapes share: derivatives of a norm, of the distance to a corner, and polyhedra about a ball."""

from __future__ import annotations

from functools import cache

import numpy as np

TINY = 1e-12
"""Lengths [m] below this have no direction."""


def norm_derivatives(y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """|y| (N,), its gradient u = y/|y| (N, n), and second derivative (I − uuᵀ)/|y| (N, n, n).

    At y = 0 the gradient is the last axis and the second derivative, which is unbounded there, zero.
    """
    length = np.linalg.norm(y, axis=1)
    somewhere = length > TINY
    safe = np.where(somewhere, length, 1.0)
    unit = y / safe[:, None]
    unit[~somewhere] = np.eye(y.shape[1])[-1]
    curvature = (np.eye(y.shape[1]) - unit[:, :, None] * unit[:, None, :]) / safe[:, None, None]
    curvature[~somewhere] = 0.0
    return length, unit, curvature


def corner_distance(q: np.ndarray) -> np.ndarray:
    """Signed distance f(q) of points to the corner region {q ≤ 0}: |max(q, 0)| outside, the largest qᵢ inside."""
    return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)


def corner_derivatives(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """f (N,), its gradient (N, n) and second derivative (N, n, n), as of `corner_distance`.

    Inside, the nearest face counts; where several are equally near, the first.
    """
    above = np.maximum(q, 0.0)
    distance, gradient, curvature = norm_derivatives(above)
    inside = distance <= TINY
    gradient[inside] = np.eye(q.shape[1])[q[inside].argmax(axis=1)]
    active = (above > 0).astype(float)
    curvature *= active[:, :, None] * active[:, None, :]
    return np.where(inside, q.max(axis=1), distance), gradient, curvature


@cache
def _unit_ball_points(rings: int) -> np.ndarray:
    """Points whose convex hull contains the unit ball: even rings of latitude, scaled until every face lies outside."""
    from scipy.spatial import ConvexHull

    rows = [np.array([[0, 0, 1.0], [0, 0, -1.0]])]
    for k in range(1, rings):
        polar = np.pi * k / rings
        count = max(6, round(2 * rings * np.sin(polar)))
        angle = 2 * np.pi * (np.arange(count) + 0.5 * (k % 2)) / count
        ring = [np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.full(count, np.cos(polar))]
        rows.append(np.stack(ring, axis=1))
    points = np.concatenate(rows)
    points /= np.min(-ConvexHull(points).equations[:, 3])
    points.flags.writeable = False
    return points


def ball_points(radius: float) -> np.ndarray:
    """Points whose convex hull contains the ball of a radius and stays within 2 % of it; shape (K, 3)."""
    return radius * _unit_ball_points(16)


def circle_points(radius: float, count: int = 32) -> np.ndarray:
    """Corners of the regular polygon drawn around a circle; shape (count, 2)."""
    angle = 2 * np.pi * np.arange(count) / count
    return radius / np.cos(np.pi / count) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
