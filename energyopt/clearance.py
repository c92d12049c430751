"""How far a motion stays from obstacles and from itself: certified for ALL times, not for samples.

`check_clearance` finds the least exact distance over the whole motion by conservative advancement (see
`geometry.advancement`): distances are taken at single instants, and between them bounded by how far the bodies can move (see
`parameterizations.excursions`).

A motion passes if the distance is proved to be at least ``margin − tolerance``, and in any case at least zero: what passes
touches nothing, even with no margin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from energyopt.errors import GeometryError
from energyopt.geometry.advancement import Advancement, Sweep
from energyopt.geometry.bodies import Attached
from energyopt.geometry.exact import Closest, CollisionScene
from energyopt.geometry.shapes import Shape
from energyopt.geometry.values import non_negative, positive
from energyopt.parameterizations.excursions import excursions
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.robots.model import RobotModel

TOLERANCE = 1e-4
BUDGET = 400_000
"""Items (interval, pair of bodies) after which a search gives up: a few seconds."""
LEAST_INTERVALS = 16
POLISH_STEPS = 12
"""Golden-section steps that sharpen the time of a violation."""
GOLDEN = 0.5 * (5**0.5 - 1)


@dataclass(frozen=True)
class Instant:
    """A moment at which a pair is too close, and closer than just before and after.

    Attributes:
        time: [s].
        first: link, or name of what is attached; second: another link, or the obstacle.
        distance: [m]; negative is the depth of penetration.
        certified: False where the search gave up here: the distance is what was seen, and less could not be excluded.
    """

    time: float
    first: str
    second: str
    distance: float
    certified: bool = True


@dataclass(frozen=True)
class Clearance:
    """The verdict over a whole motion.

    Attributes:
        distance: least distance seen [m]; inf where there is nothing to keep apart. Where the motion passes, no distance at
            any time is smaller by more than the tolerance, or 1 % of what is left above the margin.
        first, second: the pair that comes so close; time: when [s].
        certified_margin: proved lower bound of the distance of every pair at all times [m].
        margin: what was to be kept [m]; tolerance: how precisely that was decided [m].
        violations: worst first; empty exactly where the motion passes.
        checks: number of (interval, pair) items looked at.
    """

    distance: float
    first: str
    second: str
    time: float
    certified_margin: float
    margin: float
    tolerance: float
    violations: tuple[Instant, ...]
    checks: int

    @property
    def passes(self) -> bool:
        """Whether the margin is certified for all times."""
        return not self.violations

    def __str__(self) -> str:
        if not self.first:
            return "nothing to keep apart"
        said = f"closest: {self.first}–{self.second}, {1e3 * self.distance:.1f} mm at {self.time:.3f} s"
        if self.passes:
            return f"{said}; at least {1e3 * self.certified_margin:.1f} mm at all times"
        if self.violations[0].certified:
            return f"{said}; too close at {len(self.violations)} instants"
        return f"{said}; more than {1e3 * self.certified_margin:.1f} mm could not be proved"


def check_clearance(
    robot: RobotModel,
    trajectory: Trajectory,
    obstacles: Sequence[Shape] = (),
    self_pairs: Sequence[tuple[str, str]] = (),
    attached: Sequence[Attached] = (),
    margin: float = 0.0,
    tolerance: float = TOLERANCE,
    budget: int = BUDGET,
) -> Clearance:
    """The least exact distance over a whole motion, between the robot and obstacles and between its own links.

    Args:
        robot: its collision geometry counts (see `geometry.bodies`); links that never move are not checked.
        trajectory: the motion; obstacles that move do so in its time.
        self_pairs: pairs of links to be kept apart, ``self_collision_pairs(robot).checked``.
        margin: distance to be kept [m]; tolerance: how precisely it is decided [m].
        budget: of the search; where it is spent, what is not certified counts as violated.

    Raises:
        GeometryError: a number is out of range, the motion is not finite or has another number of joints.
    """
    margin, tolerance = non_negative("margin", margin), positive("tolerance", tolerance)
    scene = scene_of(robot, obstacles, self_pairs, attached)
    if not scene.pairs:
        return Clearance(np.inf, "", "", 0.0, np.inf, margin, tolerance, (), 0)
    _checked(robot, trajectory)
    required = max(margin, tolerance)
    search = Advancement(scene, trajectory, lambda t, half: excursions(trajectory, t, half), required, tolerance)
    sweep = search.run(_edges(trajectory), budget)
    found = [_least(scene, trajectory, sweep), *_violations(scene, trajectory, sweep, required - 0.5 * tolerance)]
    worst = min(found, key=lambda instant: instant.distance)
    return Clearance(
        distance=worst.distance,
        first=worst.first,
        second=worst.second,
        time=worst.time,
        certified_margin=min(sweep.proved, worst.distance),
        margin=margin,
        tolerance=tolerance,
        violations=tuple(found[1:]),
        checks=sweep.intervals,
    )


def touching(
    robot: RobotModel,
    q: ArrayLike,
    obstacles: Sequence[Shape] = (),
    self_pairs: Sequence[tuple[str, str]] = (),
    attached: Sequence[Attached] = (),
    t: float = 0.0,
    margin: float = 0.0,
) -> list[Closest]:
    """Pairs closer than ``margin`` [m] at one configuration ``q`` (nv,), deepest first; one entry a pair of names."""
    scene = scene_of(robot, obstacles, self_pairs, attached)
    if not scene.pairs:
        return []
    return _below(scene.pairs, scene.distances(q, t, cutoff=margin)[0], margin)


def around_base(
    robot: RobotModel, obstacles: Sequence[Shape], attached: Sequence[Attached] = (), t: float = 0.0, margin: float = 0.0
) -> list[Closest]:
    """Obstacles that come closer than ``margin`` [m] to links that never move, deepest first.

    No motion can change those, so `check_clearance` does not look at them; the table that a robot stands on is the usual case.
    """
    scene = CollisionScene(robot, obstacles, (), attached, fixed=True)
    return _below(scene.pairs, scene.distances(robot.home, t, cutoff=margin)[0], margin)


def clearance_at(
    robot: RobotModel,
    q: ArrayLike,
    t: ArrayLike = 0.0,
    obstacles: Sequence[Shape] = (),
    self_pairs: Sequence[tuple[str, str]] = (),
    attached: Sequence[Attached] = (),
) -> list[Closest]:
    """The nearest pair at each of many configurations ``q`` (N, nv) and times ``t`` [s] (one, or (N,)), length N; for figures."""
    return scene_of(robot, obstacles, self_pairs, attached).closest(q, t)


def scene_of(
    robot: RobotModel,
    obstacles: Sequence[Shape] = (),
    self_pairs: Sequence[tuple[str, str]] = (),
    attached: Sequence[Attached] = (),
) -> CollisionScene:
    """The `CollisionScene` of these, kept for the next call with the same objects."""
    return _scene(robot.geometry, tuple(obstacles), tuple(map(tuple, self_pairs)), tuple(attached))


@lru_cache(maxsize=8)
def _scene(robot, obstacles, self_pairs, attached) -> CollisionScene:
    return CollisionScene(robot, obstacles, self_pairs, attached)


def _checked(robot: RobotModel, trajectory: Trajectory) -> None:
    if trajectory.nv != robot.nv:
        raise GeometryError(f"motion: has {trajectory.nv} joints; expected {robot.nv}, those of {robot.name}")
    times = trajectory.sample_times(2)
    wrong = ~np.isfinite(trajectory(times)).all(axis=1)
    if wrong.any():
        raise GeometryError(f"motion: is not finite at t = {times[wrong.argmax()]:g} s; expected finite joint positions")


def _edges(trajectory: Trajectory) -> np.ndarray:
    """Ends of the first intervals: the breaks, and points between them where those are few."""
    breaks = np.asarray(trajectory.breaks, dtype=float)
    parts = -(-LEAST_INTERVALS // (len(breaks) - 1))
    return np.append(np.linspace(breaks[:-1], breaks[1:], parts + 1, axis=1)[:, :-1].ravel(), breaks[-1])


def _below(pairs: Sequence[tuple[str, str]], distance: np.ndarray, margin: float) -> list[Closest]:
    found: dict[tuple[str, str], float] = {}
    for pair, d in zip(pairs, distance.tolist(), strict=True):
        if d < margin and d < found.get(pair, np.inf):
            found[pair] = d
    return [Closest(d, *pair) for pair, d in sorted(found.items(), key=lambda item: item[1])]


def _least(scene: CollisionScene, trajectory: Trajectory, sweep: Sweep) -> Instant:
    """The least distance seen, sharpened."""
    row = int(np.argmin(sweep.distance))
    pair = int(sweep.pair[row])
    times = np.sort(sweep.time[sweep.pair == pair])
    return _sharpened(scene, trajectory, pair, times, int(np.searchsorted(times, sweep.time[row])), sweep.distance[row])


def _violations(scene: CollisionScene, trajectory: Trajectory, sweep: Sweep, least: float) -> list[Instant]:
    """The local minima below ``least``, each sharpened, and after them one instant a pair that the search gave up."""
    found = []
    for pair in np.unique(sweep.pair[sweep.distance < least]):
        rows = np.flatnonzero(sweep.pair == pair)
        t, first = np.unique(sweep.time[rows], return_index=True)
        found += _minima(scene, trajectory, int(pair), t, sweep.distance[rows[first]], least)
    found.sort(key=lambda instant: instant.distance)
    open_ = []
    for pair in np.unique(sweep.open_pair):
        times = np.unique(sweep.open_time[sweep.open_pair == pair])
        t = float(times[len(times) // 2])
        d = float(scene.exact(trajectory(t), t, np.array([pair]))[0])
        open_.append(Instant(t, *scene.pairs[pair], d, certified=False))
    named = {(i.first, i.second) for i in found}
    open_ = {(i.first, i.second): i for i in sorted(open_, key=lambda i: -i.distance)}
    return [*found, *(i for name, i in open_.items() if name not in named)]


def _minima(scene, trajectory, pair: int, t: np.ndarray, d: np.ndarray, least: float) -> list[Instant]:
    """Local minima of one pair of bodies, as far as no other body of the same names is nearer then."""
    before, after = np.append(np.inf, d[:-1]), np.append(d[1:], np.inf)
    found = []
    for k in np.flatnonzero((d < least) & (d <= before) & (d < after)):
        instant = _sharpened(scene, trajectory, pair, t, int(k), float(d[k]))
        same = np.array([i for i, names in enumerate(scene.pairs) if names == scene.pairs[pair]])
        if scene.exact(trajectory(instant.time), instant.time, same).min() >= instant.distance - 1e-9:
            found.append(instant)
    return found


def _sharpened(scene: CollisionScene, trajectory: Trajectory, pair: int, t: np.ndarray, k: int, value: float) -> Instant:
    """The minimum between the neighbours of ``t[k]``, where it is ``value``, by golden sections (J. Kiefer, 1953)."""
    low, best, high = t[k - 1] if k else 0.0, t[k], t[k + 1] if k + 1 < len(t) else trajectory.duration
    index = np.array([pair])
    for _ in range(POLISH_STEPS):
        left = best - low > high - best
        now = best - (1 - GOLDEN) * (best - low) if left else best + (1 - GOLDEN) * (high - best)
        d = scene.exact(trajectory(now), now, index)[0]
        if d < value:
            low, high = (low, best) if left else (best, high)
            best, value = now, d
        elif left:
            low = now
        else:
            high = now
    return Instant(float(best), *scene.pairs[pair], float(value))
