"""sweep(): what a motion costs against the time it is given, the energy–time curve of a problem.

The problem is solved once in the middle of the durations; from there the optimum is followed to both sides, each motion starting
from its neighbour's, run through in its own time, on the same knots and with the rows found so far. Where two neighbours have
reached different optima, the better one is carried over as well: J of a stretched motion is known before anything is solved.
Last, the duration itself is set free between the neighbours of the cheapest one.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from energyopt.arguments import check_names, check_options, check_problem
from energyopt.baselines import baseline
from energyopt.energy import energy_account
from energyopt.errors import InputError, NoSolutionFound, ProblemError
from energyopt.metrics import metrics
from energyopt.parameterizations import BSpline
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.parcels import packed, unpacked
from energyopt.planning import DEFAULTS, Parameterization, planned
from energyopt.plans import Plan, Status
from energyopt.pool import Workers
from energyopt.problem import Problem
from energyopt.problem_values import numbers, shown
from energyopt.readable import Readable, counted
from energyopt.search import Search
from energyopt.verification import limits_hold, objective, verify
from energyopt.workers import cores

BASELINES = ("quintic", "trapezoidal")
"""Ordinary motions to compare with at every duration."""
MOST_DURATIONS = 1000
WORTH_CARRYING = 0.01
"""Share of J that a neighbour's motion has to promise before a duration is solved again, and to give to be taken."""
OTHER_BRANCH = 0.08
"""Share of J by which a longer motion has to be cheaper than a slowed one, to be another optimum."""
SAMPLES = 400
"""Samples of a motion for its measures of energy."""
ENOUGH = 1.5
"""Estimated errors up to this many times the accuracy asked are accepted where knots are taken over from a neighbour."""
WORTH_PROCESSES = 6.0
"""Estimated seconds of a sweep from which a second process, which takes some to start, is worth it."""
SHARE = 0.5
"""Estimated time of a solve that follows another, as a share of the first."""


@dataclass(frozen=True, eq=False)
class SweepPoint:
    """One duration.

    Attributes:
        duration: T [s]. plan: what was found; None where no motion is possible, and why: then the reason, else "".
        energy: of the plan: ``objective``, ``torque_squared``, ``mechanical_abs_J`` and, where the drives are known,
            ``electrical_J``; empty where there is no valid plan.
        baselines: the same of ordinary motions of the same duration, and ``holds``, whether they keep the limits.
    """

    duration: float
    plan: Plan | None
    why: str
    energy: dict[str, float]
    baselines: dict[str, dict[str, float]]

    @property
    def solved(self) -> bool:
        return self.plan is not None and self.plan.solved


@dataclass(frozen=True, eq=False, repr=False)
class Sweep(Readable):
    """An energy–time curve; ``str()`` is a table.

    Attributes:
        problem: what was asked. points: one a duration, in rising order.
        best: the plan of least J, its duration free between the neighbours of the cheapest point; None where nothing was solved.
    """

    problem: Problem
    points: tuple[SweepPoint, ...]
    best: Plan | None

    @property
    def durations(self) -> np.ndarray:
        """[s], shape (N,)."""
        return np.array([point.duration for point in self.points])

    @property
    def recommended(self) -> float | None:
        """The cheapest duration [s] within the range."""
        return None if self.best is None else self.best.duration

    def curve(self, measure: str = "objective") -> np.ndarray:
        """A measure of energy at every duration, NaN where there is no valid plan or the measure is not known; shape (N,)."""
        return np.array([point.energy.get(measure, np.nan) for point in self.points])

    def baseline_curve(self, kind: str, measure: str = "objective") -> np.ndarray:
        """The same of an ordinary motion, whether or not it keeps the limits."""
        return np.array([point.baselines.get(kind, {}).get(measure, np.nan) for point in self.points])

    def in_brief(self) -> str:
        solved = sum(point.solved for point in self.points)
        cheapest = "" if self.best is None else f", cheapest {self.best.duration:.4g} s, J {self.best.objective:.6g}"
        return f"{counted(len(self.points), 'duration')}, {solved} solved{cheapest}"

    def __str__(self) -> str:
        from energyopt.sweep_text import sweep_table

        return sweep_table(self)


def sweep(
    problem: Problem,
    durations: Sequence[float],
    parameterization: Parameterization | None = None,
    *,
    processes: int | None = None,
    **options: Any,
) -> Sweep:
    """Plan a problem for several durations.

    Args:
        problem: its own duration does not matter.
        durations: [s], in any order.
        parameterization, options: as for `plan` (starts, seed, time_limit, iterations, path_search); limits hold for each.
        processes: at most this many; one a core by default. The curve is the same for any number.

    Raises:
        InputError: an argument makes no sense. NoSolutionFound: there is no valid plan for any duration.
    """
    check_problem("sweep", problem)
    times = _checked(durations)
    parameterization = BSpline() if parameterization is None else parameterization
    given = DEFAULTS | options
    check_names("sweep", options, DEFAULTS)
    check_options(parameterization, given)
    found = followed(problem, times, parameterization, given, cores() if processes is None else processes)
    points = tuple(_point(problem, T, plan, why) for T, plan, _, why in found)
    if not any(point.solved for point in points):
        last = next((point.plan for point in points if point.plan is not None), None)
        if last is None:
            raise ProblemError(f"sweep: {points[-1].why}")
        raise NoSolutionFound(last)
    return Sweep(problem, points, _best(problem, parameterization, given, points))


def followed(problem: Problem, times: np.ndarray, parameterization: Parameterization, given: dict, processes: int = 1) -> list:
    """The optimum at each of some rising durations: (duration, plan or None, its search or None, why there is no plan)."""
    middle = len(times) // 2
    first = _cold(problem, times[middle], parameterization, given)
    sides = times[middle - 1 :: -1] if middle else times[:0], times[middle + 1 :]
    spent = SHARE * len(times) * sum(first[0].time_s.values()) if first[0] is not None else 0.0
    both = processes > 1 and spent > WORTH_PROCESSES and all(map(len, sides))
    below, above = _both_sides(problem, parameterization, given, first, sides, both)
    return _carried(problem, parameterization, given, [*below[::-1], (float(times[middle]), *first), *above])


def energy_measures(problem: Problem, motion: Trajectory) -> dict[str, float]:
    """J, ∫Στ² dt, Σ∫|τq̇| dt [J] and, where the drives are known, the electrical energy [J] of a motion."""
    seen = metrics(problem, motion, SAMPLES)
    found = {
        "objective": objective(problem, motion),
        "torque_squared": seen.torque_squared,
        "mechanical_abs_J": seen.mechanical_abs_J,
    }
    if problem.robot.actuators is not None:
        found["electrical_J"] = energy_account(motion, problem.robot).electrical_J
    return found


_Found = tuple[Plan | None, Search | None, str]
"""A plan or None, the search that found it or None, and why there is no plan."""


def _checked(durations: Sequence[float]) -> np.ndarray:
    expected = f"1 to {MOST_DURATIONS} durations in seconds"
    times = np.unique(numbers("sweep: durations", durations, expected))
    if not 0 < len(times) <= MOST_DURATIONS or not np.all(np.isfinite(times) & (times > 0)):
        raise InputError(f"sweep: durations is {shown(durations)}: expected {expected}")
    return times


def _cold(problem: Problem, duration: float, parameterization: Parameterization, given: dict) -> _Found:
    try:
        return *planned(problem.lasting(float(duration)), parameterization, given), ""
    except ProblemError as error:
        return None, None, str(error)


def _followed(problem: Problem, duration: float, parameterization: Parameterization, given: dict, begun: Search | None) -> _Found:
    """The optimum near that of another duration; where it leads to no valid motion, a new search."""
    if begun is None:
        return _cold(problem, duration, parameterization, given)
    try:
        plan, search = planned(problem.lasting(float(duration)), parameterization, given, begun=begun)
    except ProblemError as error:
        return None, None, str(error)
    if plan.status is Status.INTERRUPTED or (plan.solved and _accurate(plan, parameterization)):
        return plan, search, ""
    return _cold(problem, duration, parameterization, given)


def _accurate(plan: Plan, parameterization: Parameterization) -> bool:
    """Whether knots made for another duration do for this one, by a margin: the estimate is one."""
    wanted = getattr(parameterization, "accuracy", None)
    error = plan.discretization_error
    return wanted is None or (error is not None and error <= ENOUGH * wanted)


def _chain(problem: Problem, times: np.ndarray, parameterization: Parameterization, given: dict, begun: Search | None) -> list:
    """(duration, plan, search, why) of each duration, one after another."""
    chain, anchor = [], begun
    for duration in times:
        plan, search, why = _followed(problem, duration, parameterization, given, begun)
        chain.append((float(duration), plan, search, why))
        if search is not None and plan.solved:
            anchor = anchor or search
            begun = search.on_knots_of(anchor)
    return chain


def chain_of_parcel(parcel, times: np.ndarray, parameterization: Parameterization, given: dict, begun: Search | None) -> list:
    """In a worker: `_chain`, without what the caller has or cannot be sent."""
    problem = unpacked(parcel)
    begun = None if begun is None else begun.received(problem)
    chain = _chain(problem, times, parameterization, given, begun)
    return [(T, plan and replace(plan, problem=None), search and search.sent(), why) for T, plan, search, why in chain]


def _both_sides(problem, parameterization, given, first: _Found, sides, parallel: bool) -> list[list]:
    plan, search, _ = first
    begun = search if plan is not None and plan.solved else None
    if not parallel:
        return [_chain(problem, times, parameterization, given, begun) for times in sides]
    with Workers(1) as workers:
        sent = None if begun is None else begun.sent()
        away: Future = workers.submit(chain_of_parcel, packed(problem), sides[1], parameterization, given, sent)
        below = _chain(problem, sides[0], parameterization, given, begun)
        above = away.result()
    restored = []
    for T, plan, search, why in above:
        own = problem.lasting(T)
        restored.append((T, plan and replace(plan, problem=own), search and search.received(own), why))
    return [below, restored]


def _carried(problem: Problem, parameterization: Parameterization, given: dict, found: list) -> list:
    """Better optima carried over from neighbours, upwards and then downwards."""
    found = list(found)
    for step in (1, -1):
        for k in range(len(found))[::step]:
            T, plan, search, why = found[k]
            other = found[k - step] if 0 <= k - step < len(found) else None
            if other is None or not _promises(T, plan, other[1]):
                continue
            answer = _followed(problem, T, parameterization, given, other[2])
            found[k] = min(((T, plan, search, why), (T, *answer)), key=lambda entry: _price(entry[1]))
    return found


def _price(plan: Plan | None) -> float:
    return plan.objective if plan is not None and plan.solved else np.inf


def _promises(duration: float, plan: Plan | None, other: Plan | None) -> bool:
    """Whether the neighbour has found another, better optimum, so far as can be told without solving.

    A motion slowed down keeps its limits, so J of it is a bound of what its branch costs at the longer of the two durations.
    """
    if other is None or not other.solved:
        return False
    if plan is None or not plan.solved:
        return plan is not None
    if other.duration < duration:
        return objective(plan.problem, other.trajectory.stretched(duration)) < (1.0 - WORTH_CARRYING) * plan.objective
    slowed = objective(other.problem, plan.trajectory.stretched(other.duration))
    return other.objective < (1.0 - OTHER_BRANCH) * slowed


def _point(problem: Problem, duration: float, plan: Plan | None, why: str) -> SweepPoint:
    pinned = problem.lasting(duration)
    valid = plan is not None and plan.solved
    goal = plan.trajectory(plan.duration) if valid else problem.goal_position
    others = {}
    for kind in BASELINES if goal is not None else ():
        motion = baseline(pinned, kind, goal=goal)
        others[kind] = energy_measures(pinned, motion) | {"holds": float(limits_hold(verify(pinned, motion, distances=False)))}
    why = why or ("" if valid else plan.message)
    return SweepPoint(duration, plan, why, energy_measures(pinned, plan.trajectory) if valid else {}, others)


def _best(problem: Problem, parameterization: Parameterization, given: dict, points: tuple[SweepPoint, ...]) -> Plan:
    """The plan of least J with a free duration between the neighbours of the cheapest point."""
    k = int(np.argmin([_price(point.plan) for point in points]))
    low, high = points[max(k - 1, 0)].duration, points[min(k + 1, len(points) - 1)].duration
    if low == high:
        return points[k].plan
    guess = points[k].plan.trajectory
    free, _ = planned(replace(problem, duration=(low, high)), parameterization, given, guess=guess)
    return min((plan for plan in (free, points[k].plan) if plan.solved), key=lambda plan: plan.objective)
