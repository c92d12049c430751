"""Covering solids by few balls that stick out little.

Given: convex bodies fixed to one another, whose union has the signed distance φ (the least of theirs), and a length ε.
Wanted: balls (c, r) that contain every point of every body's surface and stick out of the union by at most ε.

- Contained, exactly: each surface is cut into small triangles, and each triangle lies in ONE ball. A ball is convex, so it
  contains a triangle if it contains the three corners.
- Sticking out: a point x of the ball is at most |x − c| + φ(c) ≤ r + φ(c) away from the union (for φ(c) < 0: x is that close
  to the ball of radius −φ(c) about c, which is inside). So excess ≤ r + φ(c), and r = ε − φ(c) is allowed.

Which centres: from candidates inside the bodies, greedily the one whose allowed ball contains the most area not yet
contained (V. Chvátal, "A Greedy Heuristic for the Set-Covering Problem", 1979). Then balls are dropped one by one as long as
the others, each moved to where the triangles it answers for need the least excess, can take over. All is deterministic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from energyopt.geometry.hull import Hull
from energyopt.geometry.shapes import Shape, Sphere
from energyopt.threads import Wanted, always_wanted

CANDIDATES = 300
ELEMENT_SHARE = 0.7
"""Longest edge of the small triangles as a share of ε: finer ones waste less of a ball and cost more time."""
MAX_TABLE = 60_000_000
"""Pairs of elements and candidates: bounds the memory where a body is large."""
BLOCK = 1024
"""Elements whose areas are added up together."""
MAX_EFFORT = 3_000_000
"""Pairs of elements and balls looked at to save balls: bounds the time where a body is large or the resolution fine."""
ROUNDS = 3
"""Rounds of moving balls."""
ROUNDING = 1e-9
"""Added to every radius [m], so that what is contained stays contained after rounding."""
FINEST_STEP = 5e-4
"""The search for a centre ends at this step [m]."""
STEPS = np.array([d for d in np.ndindex(3, 3, 3) if np.abs(np.array(d) - 1).sum() % 2], dtype=float) - 1.0


@dataclass(frozen=True, eq=False)
class Cover:
    """Balls over one set of bodies.

    Attributes:
        centers: [m], shape (S, 3); radii: [m], shape (S,).
        excess: upper bound of how far each ball sticks out of the bodies [m], shape (S,).
        protrusion: largest distance by which the surface leaves the balls [m]; negative or zero.
    """

    centers: np.ndarray
    radii: np.ndarray
    excess: np.ndarray
    protrusion: float


@dataclass(frozen=True, eq=False)
class Elements:
    """Small triangles over surfaces: corner points [m], shape (P, 3), and three indices each, shape (E, 3)."""

    points: np.ndarray
    corners: np.ndarray

    @staticmethod
    def of_triangles(triangles: np.ndarray) -> Elements:
        points, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
        return Elements(points, index.reshape(-1, 3))

    def some(self, rows: np.ndarray) -> Elements:
        used, index = np.unique(self.corners[rows], return_inverse=True)
        return Elements(self.points[used], index.reshape(-1, 3))

    @property
    def areas(self) -> np.ndarray:
        a, b, c = (self.points[self.corners[:, k]] for k in range(3))
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)

    def farthest(self, centers: np.ndarray, exact: bool = False) -> np.ndarray:
        """Distance of each element's farthest corner from each centre [m], shape (E, S); in single precision, or exactly."""
        far = np.sqrt(np.maximum(self._squares(centers, float if exact else np.float32), 0.0))
        return np.maximum(np.maximum(far[self.corners[:, 0]], far[self.corners[:, 1]]), far[self.corners[:, 2]])

    def contained(self, centers: np.ndarray, radii: np.ndarray) -> np.ndarray:
        """Whether each ball contains each element, shape (E, S); in single precision."""
        inside = self._squares(centers, np.float32) <= (radii * np.abs(radii)).astype(np.float32)
        return inside[self.corners[:, 0]] & inside[self.corners[:, 1]] & inside[self.corners[:, 2]]

    def _squares(self, centers: np.ndarray, dtype: type) -> np.ndarray:
        middle = self.points.mean(axis=0)  # single precision wants small numbers
        points, centers = (self.points - middle).astype(dtype), (centers - middle).astype(dtype)
        return np.sum(points**2, axis=1)[:, None] - 2 * points @ centers.T + np.sum(centers**2, axis=1)


@dataclass(frozen=True, eq=False)
class Solid:
    """A union of convex polyhedra, as far as its depth goes: planes n·y = b of all, and where each one's planes start."""

    normals: np.ndarray
    offsets: np.ndarray
    starts: np.ndarray

    @staticmethod
    def of(hulls: Sequence[Hull]) -> Solid:
        counts = [len(hull.offsets) for hull in hulls]
        normals, offsets = (np.concatenate([getattr(hull, key) for hull in hulls]) for key in ("normals", "offsets"))
        return Solid(normals, offsets, np.cumsum([0, *counts[:-1]]))

    def heights(self, points: np.ndarray) -> np.ndarray:
        """φ of each polyhedron for points inside it; outside, a positive number that is not the distance; shape (N, hulls)."""
        return np.maximum.reduceat(points @ self.normals.T - self.offsets, self.starts, axis=1)

    def depth(self, points: np.ndarray) -> np.ndarray:
        """φ of the union in the same sense, shape (N,)."""
        return self.heights(points).min(axis=1)


def cover_bodies(shapes: Sequence[Shape], resolution: float, wanted: Wanted = always_wanted) -> Cover:
    """Balls that contain the surfaces of all ``shapes`` (in one common frame) and stick out by at most ``resolution`` [m].

    A `Sphere` among the shapes is its own ball. ``wanted`` is called now and then, and may raise to end the search.
    """
    own = [shape for shape in shapes if isinstance(shape, Sphere)]
    centers = np.array([shape.pose[:3, 3] for shape in own]).reshape(-1, 3)
    radii = np.array([shape.radius for shape in own])
    hulls = [Hull.of_points(posed_points(shape), shape.kind) for shape in shapes if not isinstance(shape, Sphere)]
    # Round shapes are covered with the polyhedron drawn around them, which sticks out a little by itself.
    spare = max([0.0, *(float(union_distance(shapes, hull.vertices, wanted).max()) for hull in hulls)])
    limit = max(resolution - spare, 0.5 * resolution)
    if not hulls:
        return Cover(centers, radii, np.maximum(radii + union_distance(shapes, centers), 0.0), 0.0)
    elements = _elements(hulls, own, ELEMENT_SHARE * limit, wanted)
    free = np.flatnonzero(~np.any(elements.farthest(centers, exact=True) <= radii, axis=1))
    if len(free):
        found = _Search(elements.some(free), hulls, limit, wanted).balls()
        centers, radii = np.concatenate([centers, found[0]]), np.concatenate([radii, found[1] + ROUNDING])
    excess = np.maximum(radii + union_distance(shapes, centers, wanted), 0.0)
    protrusion = float((elements.farthest(centers, exact=True) - radii).min(axis=1).max()) if len(elements.corners) else 0.0
    return Cover(centers, radii, excess, protrusion)


def union_distance(shapes: Sequence[Shape], points: np.ndarray, wanted: Wanted = always_wanted) -> np.ndarray:
    """φ, shape (N,): exact outside the union; inside, where bodies overlap, the true depth is at least −φ."""
    distances = []
    for shape in shapes:
        wanted()
        distances.append(shape.distance(points))
    return np.min(distances, axis=0)


def posed_points(shape: Shape) -> np.ndarray:
    """`Shape.enclosing_points` in the frame that the shape's pose refers to, shape (K, 3)."""
    pose = shape.pose_at(0.0)
    return shape.enclosing_points() @ pose[:3, :3].T + pose[:3, 3]


def _elements(hulls: list[Hull], balls: list[Sphere], edge: float, wanted: Wanted) -> Elements:
    """Triangles with edges ≤ ``edge`` [m] over the surfaces, without those hidden inside another body."""
    kept = [np.empty((0, 3, 3))]
    for hull in hulls:
        wanted()
        small = _subdivide(hull.vertices[hull.triangles], edge)
        depths = [Solid.of([other]).depth(small.reshape(-1, 3)) for other in hulls if other is not hull]
        depths += [ball.distance(small.reshape(-1, 3)) for ball in balls]
        hidden = [np.all(depth.reshape(-1, 3) < -ROUNDING, axis=1) for depth in depths]
        kept.append(small[~np.any(hidden, axis=0)] if hidden else small)
    return Elements.of_triangles(np.concatenate(kept))


def _subdivide(corners: np.ndarray, edge: float) -> np.ndarray:
    """Halve the longest edge of each triangle (E, 3, 3) until none is longer than ``edge``."""
    done = []
    while len(corners):
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        small = sides.max(axis=1) <= edge
        done.append(corners[small])
        rows, first = corners[~small], sides.argmax(axis=1)[~small]
        a, b, c = (rows[np.arange(len(rows)), (first + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(done)


class _Balls:
    """Balls in the search, with the distances of all elements from their centres kept up to date."""

    def __init__(self, elements: Elements, centers: np.ndarray, far: np.ndarray | None = None):
        self.elements, self.centers = elements, centers
        self.far = elements.farthest(centers) if far is None else far

    def without(self, ball: int) -> _Balls:
        return _Balls(self.elements, np.delete(self.centers, ball, axis=0), np.delete(self.far, ball, axis=1))

    def answers_for(self, owner: np.ndarray, ball: int) -> np.ndarray:
        """Corners of the elements that a ball owns, shape (N, 3)."""
        return self.elements.points[np.unique(self.elements.corners[owner == ball])]

    def move(self, balls: np.ndarray, centers: np.ndarray) -> None:
        self.centers[balls] = centers
        self.far[:, balls] = self.elements.farthest(centers)


class _Search:
    """The search for balls over the elements of one union of polyhedra; ``limit`` is the excess allowed."""

    def __init__(self, elements: Elements, hulls: list[Hull], limit: float, wanted: Wanted):
        self.elements, self.hulls, self.limit, self.wanted = elements, hulls, limit, wanted
        self.solid = Solid.of(hulls)

    def balls(self) -> tuple[np.ndarray, np.ndarray]:
        """Centres (S, 3) and radii (S,)."""
        balls = _Balls(self.elements, self._greedy())
        self._settle(balls, self._reach(balls).argmin(axis=1))
        balls = self._fewer(balls)
        for _ in range(ROUNDS):
            self._settle(balls, self._reach(balls).argmin(axis=1))
        owner = self._reach(balls).argmin(axis=1)
        used = np.unique(owner)
        radii = [np.linalg.norm(balls.answers_for(owner, k) - balls.centers[k], axis=1).max() for k in used]
        return balls.centers[used], np.array(radii)

    def _allowed(self, centers: np.ndarray) -> np.ndarray:
        """Radii (S,) that stick out by the limit; centres outside the bodies are not used."""
        depth = self.solid.depth(centers)
        return np.where(depth <= 0, self.limit - depth, 0.0)

    def _reach(self, balls: _Balls) -> np.ndarray:
        """How far each element reaches beyond each allowed ball [m], shape (E, S); contained where ≤ 0."""
        return balls.far - self._allowed(balls.centers).astype(np.float32)

    def _greedy(self) -> np.ndarray:
        """Candidates, each time the one with the most area that is still open."""
        centers, table = self._candidates()
        areas = self.elements.areas + 1e-12
        blocks = [slice(k, k + BLOCK) for k in range(0, len(areas), BLOCK)]
        gain, left, chosen = sum(areas[rows] @ table[rows] for rows in blocks), np.ones(len(areas), bool), []
        while left.any() and gain.max() > 0:
            self.wanted()
            chosen.append(int(gain.argmax()))
            news = np.flatnonzero(left & table[:, chosen[-1]])
            left[news] = False
            gain -= areas[news] @ table[news]
            gain[chosen[-1]] = -1.0
        return centers[chosen]

    def _candidates(self) -> tuple[np.ndarray, np.ndarray]:
        """Points inside the bodies: evenly through the bounding box of each, between its corners, and at its surface; and
        which elements the allowed ball about each contains, shape (E, S).

        The last are the first corners of the elements that the others miss, moved inside by a hair. A ball of the allowed
        excess about such a point contains its element, whose edges are shorter: so the candidates contain everything.
        """
        found = []
        wanted = max(CANDIDATES, int(self.elements.areas.sum() / self.limit**2))
        share = max(50, min(wanted, MAX_TABLE // (2 * len(self.elements.corners))) // len(self.hulls))
        for k, hull in enumerate(self.hulls):
            self.wanted()
            low, high = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
            even = low + qmc.Halton(3, scramble=False).random(4 * share) * (high - low)
            rng = np.random.default_rng(k)
            mixed = hull.vertices[rng.integers(len(hull.vertices), size=(share, 4))]
            mixed = np.einsum("nk,nki->ni", rng.dirichlet(np.ones(4), share), mixed)
            found += [even[Solid.of([hull]).depth(even) < 0][:share], mixed]
        inner = np.concatenate(found)
        table = self.elements.contained(inner, self._allowed(inner))
        missed = np.flatnonzero(~table.any(axis=1))
        outer = self._inward(self.elements.points[self.elements.corners[missed, 0]])
        more = self.elements.contained(outer, self._allowed(outer))
        return np.concatenate([inner, outer]), np.concatenate([table, more], axis=1)

    def _inward(self, points: np.ndarray) -> np.ndarray:
        """Points of the surface moved a little towards the middle of the body they are on."""
        if len(points) == 0:
            return points
        body = np.abs(self.solid.heights(points)).argmin(axis=1)
        way = np.array([hull.center for hull in self.hulls])[body] - points
        return points + way * np.minimum(1e-3, 0.05 * self.limit / np.linalg.norm(way, axis=1))[:, None]

    def _fewer(self, balls: _Balls) -> _Balls:
        """Drop balls, those with the least to answer for first, as long as their neighbours can take over."""
        owner = self._reach(balls).argmin(axis=1)
        stuck = np.zeros(len(balls.centers), bool)
        effort = 0
        while not stuck.all() and effort < MAX_EFFORT:
            load = np.bincount(owner, minlength=len(stuck))
            ball = int(np.where(stuck, len(owner) + 1, load).argmin())
            near = self._neighbours(balls.centers, ball)
            rows = np.flatnonzero(np.isin(owner, [ball, *near]))
            effort += len(rows) * len(near)
            part = _Balls(self.elements.some(rows), balls.centers[near], balls.far[np.ix_(rows, near)])
            stuck[ball] = not (len(near) and self._take_over(part))
            if not stuck[ball]:
                owner[rows] = near[self._reach(part).argmin(axis=1)]
                balls.move(near, part.centers)
                balls, stuck[near] = balls.without(ball), False
                owner, stuck = owner - (owner > ball), np.delete(stuck, ball)
        return balls

    def _neighbours(self, centers: np.ndarray, ball: int) -> np.ndarray:
        """Balls whose allowed size reaches that of one of them."""
        radii = self._allowed(centers)
        touching = np.linalg.norm(centers - centers[ball], axis=1) < radii + radii[ball]
        touching[ball] = False
        return np.flatnonzero(touching)

    def _take_over(self, balls: _Balls) -> bool:
        """Move the balls until everything is contained; False where that fails."""
        for _ in range(ROUNDS + 1):
            reach = self._reach(balls)
            owner = reach.argmin(axis=1)
            open_ = reach[np.arange(len(owner)), owner] > 0
            if not open_.any():
                return True
            self._settle(balls, owner, np.unique(owner[open_]))
        return False

    def _settle(self, balls: _Balls, owner: np.ndarray, which: np.ndarray | None = None) -> None:
        """Move balls (by default all that own elements) to where their elements need the least excess."""
        which = np.unique(owner) if which is None else which
        balls.move(which, np.array([self._best_center(balls.answers_for(owner, k), balls.centers[k]) for k in which]))

    def _best_center(self, points: np.ndarray, center: np.ndarray) -> np.ndarray:
        """The point near ``center`` from which a ball over ``points`` sticks out least: a pattern search, ever finer."""
        own = np.sum(points**2, axis=1)

        def excess(c: np.ndarray) -> np.ndarray:
            squares = (own - 2.0 * c @ points.T).max(axis=1) + np.sum(c**2, axis=1)
            depth = self.solid.depth(c)
            return np.where(depth < 0, np.sqrt(np.maximum(squares, 0.0)) + depth, np.inf)

        self.wanted()
        best, value, step = center, excess(center[None])[0], 0.5 * self.limit
        while step > FINEST_STEP:
            values = excess(best + step * STEPS)
            if values.min() < value - 1e-6:
                best, value = best + step * STEPS[values.argmin()], values.min()
            else:
                step *= 0.5
        return best
