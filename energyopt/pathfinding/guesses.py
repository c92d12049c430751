"""Guesses for the optimiser among obstacles, in order of what they cost to find.

    straight     the quintic from start to goal
    bent 1, 2…   quintics through one random configuration, those that turned out free, the shortest first
    rrt 1, 2…    a path found by RRT-Connect, shortened, its corners rounded, timed at the problem's duration
    ompl 2…      the same by OMPL, where that is installed and the search before found nothing

The straight one is given even where it is not free, as the optimiser can push a motion out of a shallow overlap; all others
are free at samples, as far as the clock of `FreeSpace` is right about obstacles that move. The same seed gives the same
guesses, as long as no time limit cuts a search short (and, by OMPL, as long as nothing else in the process uses that).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from energyopt.baselines import baseline, quintic, stations
from energyopt.errors import ProblemError
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.pathfinding.curves import rounded
from energyopt.pathfinding.free_space import FreeSpace
from energyopt.pathfinding.ompl_search import ompl_installed, ompl_rrt_connect
from energyopt.pathfinding.rrt import Budget, PathSearch, rrt_connect
from energyopt.pathfinding.shortening import Effort, shorten
from energyopt.pathfinding.timing import timed, timed_smoothly
from energyopt.problem import Problem

Searcher = Callable[[FreeSpace, np.ndarray, np.ndarray, np.random.Generator, Budget | None], PathSearch]
"""Looks for a path between two configurations."""
SEARCHERS: dict[str, Searcher] = {"rrt": rrt_connect, "ompl": ompl_rrt_connect}
"""By the name that guesses get."""
SPREAD = 0.25
"""Standard deviation of a random via configuration, as a share of each joint's range (2π at most)."""
DRAWN = 24
"""Bent motions drawn, of which the free ones count."""
EXTRA = 5e-3
"""Paths are looked for with so much more margin [m], so that rounding their corners does no harm."""
END_SHARE = 0.9
"""Where start or goal is nearer to something than that, a path is looked for with this share of their clearance."""


@dataclass(frozen=True, eq=False)
class Guess:
    """A motion to start the optimiser from.

    Attributes:
        name: "straight", "bent 1", "rrt 1", "ompl 2" and so on; the number of a path is that of the search.
        trajectory: over the problem's duration.
        free: whether it is free at samples.
        seconds: wall time spent on it.
        path: the path that was followed, shape (K, nv) [rad]; None of straight and bent ones.
    """

    name: str
    trajectory: Trajectory
    free: bool
    seconds: float
    path: np.ndarray | None = None


def guesses(
    problem: Problem,
    free: FreeSpace,
    goal: np.ndarray | None = None,
    *,
    seed: int = 0,
    bent: int = 2,
    searches: int = 4,
    budget: Budget | None = None,
    path_search: str = "auto",
    missed: Callable[[str], None] = lambda text: None,
) -> Iterator[Guess]:
    """Guesses one after another; nothing is computed before it is asked for.

    Args:
        problem: start, goal, waypoints, duration, limits.
        free: the robot among the problem's obstacles.
        goal: joint positions to reach [rad], (nv,); needed where the problem's goal is Cartesian.
        seed: of everything random.
        bent: how many bent motions at most.
        searches: how many paths at most.
        budget: of each search, and for all.
        path_search: "built-in", "ompl", or "auto": by turns where OMPL is installed, a turn ending with a failure.
        missed: called where a search finds nothing, with its name and what it spent.

    Raises:
        ProblemError: start or goal is not free; the message names the pair and the depth. Only when a path is looked for.
        MissingDependencyError: OMPL alone is asked for and not installed; as the other.
    """
    began = time.monotonic()
    straight = baseline(problem, "quintic", goal=goal)
    yield Guess("straight", straight, free.free_motion(straight), time.monotonic() - began)
    yield from _bent(problem, free, straight(problem.duration), np.random.default_rng([seed, 1]), bent)
    turns, turn = searchers(path_search), 0
    for k in range(searches):
        if budget is not None and budget.over:
            return
        rng, name = np.random.default_rng([seed, 2, k]), turns[turn % len(turns)]
        found = _followed(problem, free, straight(problem.duration), rng, budget, SEARCHERS[name])
        if isinstance(found, Guess):
            yield replace(found, name=f"{name} {k + 1}")
        else:
            turn += 1
            missed(f"{name} {k + 1}: {found.reason}")


def searchers(path_search: str) -> tuple[str, ...]:
    """Names of the searches that take turns, as of `guesses`."""
    if path_search == "auto":
        return ("rrt", "ompl") if ompl_installed() else ("rrt",)
    return ("ompl",) if path_search == "ompl" else ("rrt",)


def find_guess(
    problem: Problem, free: FreeSpace, goal: np.ndarray | None = None, *, seed: int = 0, seconds: float | None = 5.0
) -> Guess | None:
    """The first guess that is free; None where none was found in the time given [s]. Arguments and errors as of `guesses`."""
    deadline = np.inf if seconds is None else time.monotonic() + seconds
    for guess in guesses(problem, free, goal, seed=seed, budget=Budget(seconds, until=deadline)):
        if guess.free:
            return guess
    return None


def via_points(problem: Problem, rng: np.random.Generator, goal: np.ndarray | None = None) -> Trajectory:
    """A bent motion: the quintic through one random configuration, put between two of start, waypoints and goal.

    Args:
        problem: start, goal, waypoints, duration, limits.
        rng: source of the configuration: normal around the middle of the straight way there, inside the limits.
        goal: joint positions at the end [rad], (nv,); needed where the problem's goal is Cartesian.
    """
    times, points = stations(problem, problem.goal_position if goal is None else np.asarray(goal, float))
    low, high = problem.limits.lower, problem.limits.upper
    leg = int(rng.integers(len(times) - 1))
    reach = np.minimum(high - low, 2.0 * np.pi)
    via = np.clip(0.5 * (points[leg] + points[leg + 1]) + SPREAD * reach * rng.normal(size=len(reach)), low, high)
    to, onward = np.linalg.norm(via - points[leg]), np.linalg.norm(points[leg + 1] - via)
    share = np.clip(to / max(to + onward, 1e-12), 0.1, 0.9)
    at = times[leg] + share * (times[leg + 1] - times[leg])
    return quintic(problem, np.insert(times, leg + 1, at), np.insert(points, leg + 1, via, axis=0))


def _bent(problem: Problem, free: FreeSpace, goal: np.ndarray, rng: np.random.Generator, most: int) -> Iterator[Guess]:
    began = time.monotonic()
    drawn = [via_points(problem, rng, goal) for _ in range(DRAWN if most > 0 else 0)]
    drawn.sort(key=_travel)
    count = 0
    for trajectory in drawn:
        if count == most:
            return
        if free.free_motion(trajectory):
            count += 1
            yield Guess(f"bent {count}", trajectory, True, time.monotonic() - began)
            began = time.monotonic()


def _travel(trajectory: Trajectory) -> float:
    """Length of a motion [rad]."""
    return float(np.linalg.norm(np.diff(trajectory(trajectory.sample_times(20)), axis=0), axis=1).sum())


def find_path(
    free: FreeSpace,
    stops: Sequence[np.ndarray],
    rng: np.random.Generator,
    budget: Budget | None = None,
    search: Searcher = rrt_connect,
) -> PathSearch:
    """A short path through configurations, in their order.

    It keeps a little more margin than asked, so that its corners can be rounded, where its stops have as much to spare; and
    where gravity is near what the arm can hold, it goes where the arm can stand still.

    Args:
        free: the robot among obstacles.
        stops: start, configurations to pass, goal [rad], each of shape (nv,).
        rng: source of everything random.
        budget: of the search from each stop to the next.
        search: `rrt_connect`, or another of the same form, such as `ompl_search.ompl_rrt_connect`.

    Raises:
        ProblemError: a stop is not free; the message names the pair and the depth.
    """
    return _path(roomy(free, stops), stops, rng, budget, search)


def _path(
    space: FreeSpace, stops: Sequence[np.ndarray], rng: np.random.Generator, budget: Budget | None, search: Searcher
) -> PathSearch:
    began, legs, nodes = time.monotonic(), [], 0
    for a, b in zip(stops[:-1], stops[1:], strict=True):
        found = search(space, a, b, rng, budget)
        nodes += found.nodes
        if not found.found:
            return PathSearch(None, found.reason, nodes, time.monotonic() - began)
        legs.append(shorten(space, found.path, rng, Effort(until=np.inf if budget is None else budget.until)))
    path = np.concatenate([legs[0], *(leg[1:] for leg in legs[1:])])
    return PathSearch(path, "", nodes, time.monotonic() - began)


def roomy(free: FreeSpace, stops: Sequence[np.ndarray]) -> FreeSpace:
    """The free space in which `find_path` looks: a little more margin, but less than what the stops have to spare."""
    closest = [free.closest(q, t) for q, t in zip(stops, free.times(np.array(stops)), strict=True)]
    least = min((c.distance for c in closest if c is not None), default=np.inf)
    return free.with_margin(max(0.0, min(free.margin + EXTRA, END_SHARE * least))).holding(np.array(stops))


def _followed(
    problem: Problem, free: FreeSpace, goal: np.ndarray, rng: np.random.Generator, budget: Budget | None, search: Searcher
) -> Guess | PathSearch:
    """A guess from a path through all waypoints, whose name is still to be given; where there is none, how the search ended."""
    began = time.monotonic()
    stops = [problem.start, *(w.position for w in problem.waypoints), goal]
    space = roomy(free.timed(problem.start, goal, problem.duration), stops)
    found = _path(space, stops, rng, budget, search)
    if not found.found:
        return found
    curve = rounded(found.path, space, min(free.margin, space.margin))
    try:
        trajectory = timed(curve, problem.robot, problem.limits, problem.duration)
    except ProblemError:  # nothing limits the arm, or it cannot hold this path; the optimiser may still find another
        trajectory = timed_smoothly(curve, problem.duration)
    clear = free.with_margin(min(free.margin, space.margin)).free_motion(trajectory)
    return Guess("rrt", trajectory, clear, time.monotonic() - began, found.path)
