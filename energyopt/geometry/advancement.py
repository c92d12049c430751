"""The least distance over a whole motion, proved: branch and bound over (interval of time, pair of bodies).

In the middle t_m of an interval a pair has the distance d(t_m). Up to any other instant of the interval its bodies can only
come closer by as much as they move, so that on all of it

    d(t) ≥ d(t_m) − D,     D = Σ_v ρ_v Δ_v + (motion of the obstacle)

(adaptive conservative advancement: B. Mirtich, "Impulse-based Dynamic Simulation of Rigid Body Systems", 1996, §2.3). Δ_v
bounds |q_v(t) − q_v(t_m)|. ρ_v is the largest distance of a point of the body from the axis of joint v AT t_m (1 for a slide):
let the joints go from q(t_m) to q(t) one after the other, the one nearest the base first; then, while joint v turns, every joint
farther out still is where it was, and so is the body as seen from that axis. Joints that carry both bodies do not count.

Intervals that this does not settle are halved. Balls around bodies give lower bounds of d(t_m) for all pairs and intervals
at once; the collision library is asked only where the exact distance could settle what the balls do not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from energyopt.geometry.exact import CollisionScene
from energyopt.geometry.kinematics import joint_axes, joint_placements

BLOCK = 1024
"""Exact distances taken before it is looked again which others are still needed: with fewer, the robot is placed more often."""
FIRST_LOOKS = 8
"""Instants looked at in full before the search, for a first estimate of the least distance."""
COARSE, SHARE = 1e-3, 0.25
"""Where a pair is too close by e, the search along it ends when its motion bound D is this long [m], or this share of e."""
SLACK = 0.01
"""A least distance above what is required is sought with an error of this share of the difference, or the tolerance."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """What a search over a motion found.

    Attributes:
        proved: lower bound of the distance of every pair at all times [m].
        pair, time, distance: exact distances taken on the way: index of the pair, t [s], d [m]; each of shape (M,).
        open_pair, open_time: what was given up when the budget was spent; empty where all is settled.
        intervals: number of (interval, pair) items looked at.
    """

    proved: float
    pair: np.ndarray
    time: np.ndarray
    distance: np.ndarray
    open_pair: np.ndarray
    open_time: np.ndarray
    intervals: int


class Advancement:
    """One search. ``required`` is the distance to be kept and ``tolerance`` how precisely it is decided [m]."""

    def __init__(
        self,
        scene: CollisionScene,
        motion: Callable[[np.ndarray], np.ndarray],
        excursions: Callable[[np.ndarray, np.ndarray], np.ndarray],
        required: float,
        tolerance: float,
    ):
        """``motion``: t (K,) → q (K, nv); ``excursions``: t_m, half width (K,) → bounds Δ (K, nv) of |q(t) − q(t_m)|."""
        self.scene, self.motion, self.excursions = scene, motion, excursions
        self.required, self.tolerance = required, tolerance
        self.best, self.proved, self.count = np.inf, np.inf, 0
        self._seen: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def run(self, edges: np.ndarray, budget: int) -> Sweep:
        """Search the intervals between ``edges`` [s], shape (K + 1,), with at most about ``budget`` items."""
        count, pairs = len(edges) - 1, len(self.scene.pairs)
        start, end = edges[:-1], edges[1:]
        rows, pair = np.repeat(np.arange(count), pairs), np.tile(np.arange(pairs), count)
        self._look(np.concatenate([edges[[0, -1]], 0.5 * (start + end)[:: -(-count // FIRST_LOOKS)]]))
        while len(rows):
            middle, half = 0.5 * (start + end), 0.5 * (end - start)
            unsettled, lower = self._settle(middle, half, rows, pair)
            self.count += len(rows)
            rows, pair = rows[unsettled], pair[unsettled]
            if self.count + 2 * len(rows) > budget:
                self.proved = min(self.proved, lower[unsettled].min(initial=np.inf))
                return self._sweep(pair, middle[rows])
            used, index = np.unique(rows, return_inverse=True)
            start, end = np.repeat(start[used], 2), np.repeat(end[used], 2)
            end[0::2] = start[1::2] = middle[used]
            rows, pair = np.concatenate([2 * index, 2 * index + 1]), np.concatenate([pair, pair])
        return self._sweep(pair, np.empty(0))

    def _sweep(self, open_pair: np.ndarray, open_time: np.ndarray) -> Sweep:
        pair, time, distance = (np.concatenate(parts) for parts in zip(*self._seen, strict=True))
        return Sweep(min(self.proved, self.best), pair, time, distance, open_pair, open_time, self.count)

    @property
    def _bar(self) -> float:
        """A lower bound of at least this settles an item [m]."""
        spare = max(self.best - self.required, 0.0)
        return self.required + spare - max(self.tolerance, SLACK * spare)

    def _deep_enough(self, distance: np.ndarray, travel: np.ndarray) -> np.ndarray:
        """Whether an item is surely too close and its interval short enough to know by how much."""
        deep = self.required - 0.5 * self.tolerance - distance
        return (deep > 0) & (travel <= np.maximum(COARSE, SHARE * deep))

    def _look(self, times: np.ndarray) -> None:
        """The nearest pair at each of some instants, as a first estimate."""
        for t, found in zip(times, self.scene.nearest(self.motion(times), times), strict=True):
            self._note(np.array([found[0]]), np.array([t]), np.array([found[1]]))

    def _note(self, pair: np.ndarray, time: np.ndarray, distance: np.ndarray) -> None:
        self._seen.append((pair, time, distance))
        self.best = min(self.best, distance.min(initial=np.inf))

    def _settle(self, middle: np.ndarray, half: np.ndarray, rows: np.ndarray, pair: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which items have to be halved, as a mask, and the lower bound of each item's distance [m]; both (M,)."""
        q = self.motion(middle)
        gap, spread, travel = pair_bounds(self.scene, q, middle, half, self.excursions(middle, half), rows, pair)
        lower, unsettled = gap - travel, np.zeros(len(rows), bool)
        todo = np.argsort(lower, kind="stable")
        poses = Placement(self.scene, q, middle)
        while len(todo):
            todo = todo[lower[todo] < self._bar]
            # The exact distance is between gap and gap + spread: where neither would settle the item, it is halved at once.
            hopeless = gap[todo] + spread[todo] - travel[todo] < self._bar
            hopeless &= ~self._deep_enough(gap[todo], travel[todo])
            unsettled[todo[hopeless]] = True
            now, todo = np.split(todo[~hopeless], [BLOCK])
            exact = poses.distances(rows[now], pair[now])
            self._note(pair[now], middle[rows[now]], exact)
            lower[now] = exact - travel[now]
            unsettled[now] = ~self._deep_enough(exact, travel[now]) & (lower[now] < self._bar)
        # What was found unsettled under an earlier, higher bar may be settled now.
        unsettled &= lower < self._bar
        self.proved = min(self.proved, lower[~unsettled].min(initial=np.inf))
        return unsettled, lower


class Placement:
    """Exact distances of single pairs at some of many instants."""

    def __init__(self, scene: CollisionScene, q: np.ndarray, t: np.ndarray):
        self.scene, self.q, self.t = scene, q, t

    def distances(self, rows: np.ndarray, pair: np.ndarray) -> np.ndarray:
        """Of each ``pair`` at the instant of its row [m], shape (M,)."""
        found, order = np.empty(len(rows)), np.argsort(rows, kind="stable")
        for here in np.split(order, np.flatnonzero(np.diff(rows[order])) + 1) if len(rows) else ():
            row = rows[here[0]]
            found[here] = self.scene.exact(self.q[row], self.t[row], pair[here])
        return found


def pair_bounds(
    scene: CollisionScene,
    q: np.ndarray,
    t: np.ndarray,
    half: np.ndarray,
    excursion: np.ndarray,
    rows: np.ndarray,
    pair: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bounds for items: pair ``pair[i]`` on the interval ``t[rows[i]]`` ± ``half[rows[i]]``.

    Args:
        q: in the middle of each interval (K, nv); excursion: bounds Δ of the joints' motion from there (K, nv).

    Returns:
        gap: lower bound of the distance in the middle [m]; spread: the distance is at most gap + spread [m];
        travel: D, by how much it can change within the interval [m]; each of shape (M,).
    """
    first, second = scene.index[pair].T
    count, bodies = len(scene.bodies), len(scene.bodies)
    own = second < count
    keys, where = np.unique(np.concatenate([rows * bodies + first, (rows * bodies + second)[own]]), return_inverse=True)
    center, travel = ball_travel(scene, q, excursion, keys // bodies, keys % bodies)
    one = where[: len(rows)]
    radius = scene.ball_radius[first]
    gap, spread, moved = np.empty(len(rows)), 2.0 * radius, np.empty(len(rows))
    two, a = where[len(rows) :], one[own]
    radii = radius[own] + scene.ball_radius[second[own]]
    gap[own], spread[own] = np.linalg.norm(center[a] - center[two], axis=1) - radii, 2.0 * radii
    moved[own] = np.sum((travel[a] + travel[two]) * scene.relative[pair[own]], axis=1)
    free = np.flatnonzero(~own)
    moved[free] = travel[one[free]].sum(axis=1)
    for k, obstacle in enumerate(scene.obstacles):
        items = free[second[free] == count + k]
        at, row = center[one[items]], rows[items]
        if len(items) == 0:
            continue
        gap[items] = obstacle.distance(at, t[row]) - radius[items]
        if obstacle.moves:
            reach = np.linalg.norm(at - obstacle.pose_at(t[row])[:, :3, 3], axis=1) + radius[items]
            moved[items] += _obstacle_travel(obstacle, reach + moved[items], half[row])
    return gap, spread, moved


def ball_travel(
    scene: CollisionScene, q: np.ndarray, excursion: np.ndarray, row: np.ndarray, body: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Centres of the bodies' balls [m], shape (U, 3), and ρ_v Δ_v [m], shape (U, nv), for bodies at rows of ``q``."""
    model = scene.robot.model
    rotation, position = joint_placements(model, q)
    joint = scene.body_joint[body]
    center = position[row, joint] + np.einsum("uij,uj->ui", rotation[row, joint], scene.ball_center[body])
    rho = np.zeros((len(row), model.nv))
    for j in range(1, model.njoints):
        v = model.joints[j].idx_v
        kind, axis = joint_axes(model)[j]
        moved = np.flatnonzero(scene.carried[body, v])
        if kind == "prismatic":
            rho[moved, v] = 1.0
            continue
        direction = rotation[:, j] @ axis
        away = np.cross(center[moved] - position[row[moved], j], direction[row[moved]])
        rho[moved, v] = np.linalg.norm(away, axis=1) + scene.ball_radius[body[moved]]
    return center, rho * excursion[row]


def _obstacle_travel(obstacle, reach: np.ndarray, half: np.ndarray) -> np.ndarray:
    """How far the points of a moving obstacle that matter can go in a time [m]: all of a bounded one; of a half-space those
    within ``reach`` [m] of its origin, and farther by what the origin itself moves."""
    bound = obstacle.speed_bound()
    if not np.isfinite(bound):
        bound = obstacle.pose.speed_bound(float(np.max(reach + obstacle.pose.speed_bound(0.0) * half)))
    return bound * half
