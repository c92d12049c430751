"""Hull: the convex hull of points, with its signed distance and derivatives, for many query points at once.

Inside, φ is the largest of the plane distances n_f·y − b_f. Outside it is the distance to the nearest face, edge or
corner; such a feature lies on a face f with n_f·y > b_f, whose plane is no farther than the feature itself. Both facts
leave a handful of faces per point, which are then examined exactly (C. Ericson, "Real-Time Collision Detection", 2005, §5.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from energyopt.errors import GeometryError

BLOCK = 2_000_000
"""Pairs of points and faces examined at a time, to bound the memory."""
SAME_FEATURE = 1e-10
"""A nearest point this close to an edge or corner, as a share of the triangle, lies on it."""


@dataclass(frozen=True, eq=False)
class Hull:
    """A convex polyhedron. Inside, where several faces are equally near, the first counts.

    Attributes:
        vertices: its corners [m], shape (V, 3).
        triangles: indices of the corners of each face, counter-clockwise seen from outside, shape (F, 3).
        normals: outward unit normals, shape (F, 3).
        offsets: b, the face f lies in the plane n_f·y = b_f [m], shape (F,).
        volume: [m³].
    """

    vertices: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    offsets: np.ndarray
    volume: float

    @staticmethod
    def of_points(points: np.ndarray, where: str) -> Hull:
        """The convex hull of ``points`` [m], shape (N, 3); ``where`` names them in messages.

        Raises:
            GeometryError: fewer than four points, or all of them in one plane.
        """
        try:
            hull = ConvexHull(points)
        except (QhullError, ValueError):
            extent = np.ptp(points, axis=0).tolist() if len(points) else []
            raise GeometryError(
                f"{where}: its {len(points)} points enclose no volume (extent {extent} m); expected a solid, not a flat sheet"
            ) from None
        number = np.full(len(points), -1)
        number[hull.vertices] = np.arange(len(hull.vertices))
        triangles = number[hull.simplices]
        vertices = np.asarray(points, dtype=float)[hull.vertices]
        normals, offsets = hull.equations[:, :3].copy(), -hull.equations[:, 3]
        return Hull(vertices, _outward(vertices, triangles, normals), normals, offsets, float(hull.volume))

    @property
    def center(self) -> np.ndarray:
        """Mean of the corners, a point inside; shape (3,)."""
        return self.vertices.mean(axis=0)

    def distance(self, y: np.ndarray) -> np.ndarray:
        """Signed distance [m], shape (N,), of points ``y`` [m], shape (N, 3)."""
        return self._nearest(y)[0]

    def derivatives(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Signed distance (N,), gradient (N, 3) and second derivative [1/m] (N, 3, 3).

        On the surface itself the normal of a face is chosen, and no curvature.
        """
        distance, gradient, face, weights = self._nearest(y)
        outside = np.flatnonzero((distance > SAME_FEATURE) & (weights.min(axis=1) <= SAME_FEATURE))
        curvature = np.zeros((len(y), 3, 3))
        normal = gradient[outside]
        flat = np.eye(3) - normal[:, :, None] * normal[:, None, :]
        edge = self._edge_direction(face[outside], weights[outside])
        curvature[outside] = (flat - edge[:, :, None] * edge[:, None, :]) / distance[outside, None, None]
        return distance, gradient, curvature

    def _nearest(self, y: np.ndarray) -> tuple[np.ndarray, ...]:
        """Signed distance, gradient, nearest face, and barycentric weights of the nearest point on it."""
        step = max(1, BLOCK // len(self.offsets))
        blocks = [self._nearest_block(y[k : k + step]) for k in range(0, max(len(y), 1), step)]
        return tuple(np.concatenate(parts) for parts in zip(*blocks, strict=True))

    def _nearest_block(self, y: np.ndarray) -> tuple[np.ndarray, ...]:
        heights = y @ self.normals.T - self.offsets
        face = heights.argmax(axis=1)
        distance = heights[np.arange(len(y)), face]
        gradient, weights = self.normals[face], np.ones((len(y), 3))
        out = np.flatnonzero(distance > 0)
        if len(out):
            face[out], weights[out], away = self._nearest_outside(y[out], heights[out], face[out])
            distance[out] = np.linalg.norm(away, axis=1)
            far = distance[out] > SAME_FEATURE
            unit = away / np.where(far, distance[out], 1.0)[:, None]
            gradient[out] = np.where(far[:, None], unit, self.normals[face[out]])
        return distance, gradient, face, weights

    def _nearest_outside(self, y: np.ndarray, heights: np.ndarray, face: np.ndarray) -> tuple[np.ndarray, ...]:
        """Nearest face, weights on it, and the vector from there, of points outside; ``face`` is a first guess."""
        reach = np.linalg.norm(y - self._points(face, self._closest(y, face)), axis=1)
        rows, faces = np.nonzero(self._candidates(y, heights, reach))
        weights = self._closest(y[rows], faces)
        away = y[rows] - self._points(faces, weights)
        order = np.lexsort((faces, np.linalg.norm(away, axis=1), rows))
        best = order[np.unique(rows[order], return_index=True)[1]]
        return faces[best], weights[best], away[best]

    def _candidates(self, y: np.ndarray, heights: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """Which faces may hold the nearest point, given that something lies at most ``reach`` away; shape (N, F)."""
        center, radius = self._face_balls
        squares = np.sum(y * y, axis=1)[:, None] + np.sum(center * center, axis=1) - 2.0 * y @ center.T
        slack = reach[:, None] * (1 + 1e-9) + 1e-12
        return (heights > 0) & (heights <= slack) & (squares <= (slack + radius) ** 2 + 1e-12)

    def _closest(self, y: np.ndarray, face: np.ndarray) -> np.ndarray:
        """Nearest point of one triangle a row, as barycentric weights (N, 3): over its plane, else on an edge."""
        corners = self.vertices[self.triangles[face]]
        ab, ac, ay = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], y - corners[:, 0]
        dot = lambda u, v: np.einsum("ni,ni->n", u, v)
        aa, bb, cc, d1, d2 = dot(ab, ab), dot(ac, ac), dot(ab, ac), dot(ab, ay), dot(ac, ay)
        determinant = np.maximum(aa * bb - cc * cc, 1e-300)
        weights = np.empty((len(y), 3))
        weights[:, 1], weights[:, 2] = (bb * d1 - cc * d2) / determinant, (aa * d2 - cc * d1) / determinant
        weights[:, 0] = 1.0 - weights[:, 1] - weights[:, 2]
        beyond = np.flatnonzero(weights.min(axis=1) < 0)
        if len(beyond):
            weights[beyond] = _on_edges(y[beyond], corners[beyond])
        return weights

    def _points(self, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        return np.einsum("nk,nki->ni", weights, self.vertices[self.triangles[face]])

    def _edge_direction(self, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Unit direction of the edge on which the nearest point lies; zero where it is a corner."""
        corners = self.vertices[self.triangles[face]]
        gone = weights.argmin(axis=1)
        rows = np.arange(len(face))
        direction = corners[rows, (gone + 2) % 3] - corners[rows, (gone + 1) % 3]
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        direction[np.sort(weights, axis=1)[:, 1] <= SAME_FEATURE] = 0.0
        return direction

    @cached_property
    def _face_balls(self) -> tuple[np.ndarray, np.ndarray]:
        corners = self.vertices[self.triangles]
        center = corners.mean(axis=1)
        return center, np.linalg.norm(corners - center[:, None], axis=2).max(axis=1)


def _on_edges(y: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Barycentric weights (N, 3) of the nearest point on the border of a triangle (N, 3, 3)."""
    weights = np.zeros((len(y), 3, 3))
    gaps = np.empty((len(y), 3))
    for edge in range(3):
        start, end = corners[:, edge], corners[:, (edge + 1) % 3]
        along = end - start
        s = np.einsum("ni,ni->n", y - start, along) / np.maximum(np.einsum("ni,ni->n", along, along), 1e-300)
        s = np.clip(s, 0.0, 1.0)
        weights[:, edge, edge], weights[:, edge, (edge + 1) % 3] = 1.0 - s, s
        gaps[:, edge] = np.linalg.norm(y - start - s[:, None] * along, axis=1)
    return weights[np.arange(len(y)), gaps.argmin(axis=1)]


def _outward(vertices: np.ndarray, triangles: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The triangles with their corners counter-clockwise seen from outside."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    inward = np.einsum("fi,fi->f", np.cross(b - a, c - a), normals) < 0
    turned = triangles.copy()
    turned[inward] = triangles[inward][:, ::-1]
    return turned
