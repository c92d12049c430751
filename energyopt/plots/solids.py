"""Convex solids as flat polygons ready to be painted: faces towards the eye, cut into small pieces, lit from one side.

Painting goes from far to near by the middles of the polygons, which is right only if they are small; so large faces are cut
into pieces (a quadrilateral into four, and so on). The eye is far away (parallel projection), so that which faces look towards
it depends on their normals alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import to_rgb

from energyopt.geometry.hull import Hull
from energyopt.geometry.shapes import HalfSpace, Shape

LIGHT = np.array([0.35, -0.45, 0.82])
"""Direction to the light, in the axes of the robot's base."""
AMBIENT = 0.7
MOST_CORNERS = 60
"""Of a solid that is drawn; more do not show."""
MOST_SIDES = 6
"""Of a polygon; a face with more is painted in pieces."""
COARSEST = 0.12
"""Longest edge of a piece [m]."""
SAME_PLANE = 1e-6


@dataclass(frozen=True, eq=False)
class Faces:
    """The faces of a solid in its own axes: ``polygons``, each of shape (K, 3) and counter-clockwise; ``normals`` (F, 3)."""

    polygons: list[np.ndarray]
    normals: np.ndarray

    def placed(self, pose: np.ndarray) -> Faces:
        """The same at a pose (4, 4)."""
        rotation, position = pose[:3, :3], pose[:3, 3]
        return Faces([polygon @ rotation.T + position for polygon in self.polygons], self.normals @ rotation.T)

    def seen_from(self, eye: np.ndarray) -> Faces:
        """Only what looks towards the eye, whose direction is ``eye`` (3,)."""
        ahead = self.normals @ eye > 1e-9
        return Faces([polygon for polygon, seen in zip(self.polygons, ahead, strict=True) if seen], self.normals[ahead])

    def cut(self, longest: float = COARSEST) -> Faces:
        """With no piece of a face longer than ``longest`` [m] along an edge, as far as three cuts can do."""
        polygons, normals = [], []
        for polygon, normal in zip(self.polygons, self.normals, strict=True):
            pieces = _pieces(polygon, longest, 5)
            polygons += pieces
            normals += [normal] * len(pieces)
        return Faces(polygons, np.reshape(normals, (-1, 3)))

    def colours(self, colour: str | tuple, alpha: float) -> np.ndarray:
        """Red, green, blue and alpha of every face, shape (F, 4)."""
        light = LIGHT / np.linalg.norm(LIGHT)
        shade = AMBIENT + (1.0 - AMBIENT) * np.clip(self.normals @ light, -0.6, 1.0)
        return np.column_stack([np.clip(shade[:, None] * to_rgb(colour), 0, 1), np.full(len(shade), alpha)])


def faces_of(shape: Shape) -> Faces:
    """The faces of a shape of finite size, in its own axes."""
    corners = np.asarray(shape.enclosing_points(), dtype=float)
    return _faces(Hull.of_points(_spread(np.unique(corners, axis=0), MOST_CORNERS), "a solid that is drawn"))


def same_length(polygons: list[np.ndarray]) -> np.ndarray:
    """All polygons as one array, shape (F, K, 3), corners repeated where there are fewer.

    Matplotlib would fill up the shorter ones with whatever is in memory, and warn now and then of what it found there.
    """
    most = max(map(len, polygons))
    return np.array([polygon[np.arange(most) * len(polygon) // most] for polygon in polygons])


def plane_patch(wall: HalfSpace, pose: np.ndarray, center: np.ndarray, half: float) -> Faces:
    """A square piece of the surface of a half-space at ``pose``, near ``center`` [m], of half width ``half`` [m]."""
    normal = pose[:3, :3] @ wall.normal
    point = pose[:3, 3] + wall.offset * normal
    middle = center - ((center - point) @ normal) * normal
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    corners = [middle + half * (a * first + b * second) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return Faces([np.array(corners)], normal[None])


def _spread(points: np.ndarray, most: int) -> np.ndarray:
    """At most so many of the points, far from each other."""
    if len(points) <= most:
        return points
    kept = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    nearest = np.linalg.norm(points - points[kept[0]], axis=1)
    while len(kept) < most:
        kept.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(points - points[kept[-1]], axis=1))
    return points[kept]


def _faces(hull: Hull) -> Faces:
    """Triangles in one plane make one polygon."""
    keys = np.round(np.column_stack([hull.normals, hull.offsets]) / (100 * SAME_PLANE)).astype(int)
    _, group = np.unique(keys, axis=0, return_inverse=True)
    polygons, normals = [], []
    for k in range(group.max() + 1):
        rows = np.flatnonzero(group.ravel() == k)
        normal = hull.normals[rows[0]]
        if len(rows) == 1:
            polygons.append(hull.vertices[hull.triangles[rows[0]]])
            normals.append(normal)
            continue
        corners = hull.vertices[np.unique(hull.triangles[rows])]
        first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        away = corners - corners.mean(axis=0)
        turn = np.arctan2(away @ np.cross(normal, first), away @ first)
        fan = _fan(corners[np.argsort(turn)])
        polygons += fan
        normals += [normal] * len(fan)
    return Faces(polygons, np.array(normals))


def _fan(polygon: np.ndarray) -> list[np.ndarray]:
    """A convex polygon in pieces of at most `MOST_SIDES` corners that share its first one."""
    step = MOST_SIDES - 2
    return [np.concatenate([polygon[:1], polygon[k : k + step + 1]]) for k in range(1, len(polygon) - 1, step)]


def _pieces(polygon: np.ndarray, longest: float, times: int) -> list[np.ndarray]:
    """A quadrilateral in two along its longer side, a triangle in two, others as they are, until all are short enough."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    length = np.linalg.norm(edges, axis=1)
    if times == 0 or length.max() <= longest or len(polygon) > 4:
        return [polygon]
    k = int(np.argmax(length))
    turned = np.roll(polygon, -k, axis=0)
    middle = 0.5 * (turned[0] + turned[1])
    if len(polygon) == 3:
        halves = [np.array([turned[0], middle, turned[2]]), np.array([middle, turned[1], turned[2]])]
    else:
        other = 0.5 * (turned[2] + turned[3])
        halves = [np.array([turned[0], middle, other, turned[3]]), np.array([middle, turned[1], turned[2], other])]
    return [piece for half in halves for piece in _pieces(half, longest, times - 1)]
