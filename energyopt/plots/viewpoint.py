"""Where to look from at a scene, and how it fills the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from mpl_toolkits.mplot3d.proj3d import proj_transform

from energyopt.geometry.shapes import Shape

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

ELEVATIONS = (22.0, 32.0)
AZIMUTHS = range(-170, 180, 20)
"""Directions that are tried [degrees]."""
AHEAD = np.linspace(0.03, 1.2, 24)
"""Distances [m] from a point towards the eye at which something may be in the way."""
FILLED = (0.04, 0.14, 0.96, 0.90)
"""Left, lower, right and upper edge of the scene, as shares of the figure."""


@dataclass(frozen=True)
class Viewpoint:
    """Elevation and azimuth [degrees], and the direction to the eye, shape (3,)."""

    elevation: float
    azimuth: float
    eye: np.ndarray


def viewpoint(way: np.ndarray, times: np.ndarray, solids: Sequence[Shape], middle: np.ndarray) -> Viewpoint:
    """The direction from which a way is least hidden, most spread out, and in front of the rest.

    Args:
        way: points [m], shape (N, 3), passed at ``times`` [s], shape (N,).
        solids: what may hide it.
        middle: of the whole scene [m], shape (3,).
    """
    views = [_view(elevation, azimuth) for elevation, azimuth in product(ELEVATIONS, AZIMUTHS)]
    return max(views, key=lambda view: _merit(view.eye, way, times, solids, middle))


def _view(elevation: float, azimuth: float) -> Viewpoint:
    e, a = np.radians(elevation), np.radians(azimuth)
    return Viewpoint(elevation, float(azimuth), np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]))


def _merit(eye: np.ndarray, way: np.ndarray, times: np.ndarray, solids: Sequence[Shape], middle: np.ndarray) -> float:
    points, instants = way[::16], np.repeat(times[::16], len(AHEAD))
    rays = points[:, None] + AHEAD[:, None] * eye
    hidden = np.zeros(rays.shape[:2], bool)
    for shape in solids:
        hidden |= (shape.distance(rays.reshape(-1, 3), instants) < 0).reshape(hidden.shape)
    flat = way - (way @ eye)[:, None] * eye
    spread = np.sqrt(np.linalg.svd(flat - flat.mean(axis=0), compute_uv=False)[:2].prod() / len(flat))
    return float(spread - hidden.any(axis=1).mean() - 0.1 * ((middle - way.mean(axis=0)) @ eye))


def fill_page(ax: Axes3D, points: np.ndarray) -> None:
    """Scale and move the panel so that the points, shape (N, 3), fill the figure."""
    size, shape = ax.figure.bbox.size, np.ptp([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()], axis=1)
    left, lower, right, upper = FILLED
    low, high = _on_page(ax, points)
    zoom = float(np.min(np.array([right - left, upper - lower]) * size / (high - low)))
    ax.set_box_aspect(shape, zoom=zoom)
    low, high = _on_page(ax, points)
    shift = np.array([left + right, lower + upper]) / 2 - (low + high) / 2 / size
    place = ax.get_position(original=True)
    ax.set_position((place.x0 + shift[0], place.y0 + shift[1], place.width, place.height))


def _on_page(ax: Axes3D, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corner of the points on the page [pixels]."""
    ax.apply_aspect()
    flat = proj_transform(*points.T, ax.get_proj())
    page = ax.transData.transform(np.column_stack(flat[:2]))
    return page.min(axis=0), page.max(axis=0)
