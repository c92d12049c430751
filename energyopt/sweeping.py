"""sweep(): what a motion costs against the time it is given, the energy–time curve of a problem.

The optimum is followed from one duration to the next (`following`). Last, the duration itself is set free between the neighbours
of the cheapest one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from energyopt.arguments import check_names, check_options, check_problem
from energyopt.baselines import baseline
from energyopt.energy import energy_account
from energyopt.errors import InputError, NoSolutionFound, ProblemError
from energyopt.following import Follower, Found
from energyopt.metrics import metrics
from energyopt.parameterizations import BSpline
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.planning import DEFAULTS, Parameterization, planned
from energyopt.plans import Plan, Status
from energyopt.problem import Problem
from energyopt.problem_values import numbers, shown, whole
from energyopt.readable import Readable, counted
from energyopt.verification import limits_hold, objective, verify
from energyopt.workers import cores

BASELINES = ("quintic", "trapezoidal")
"""Ordinary motions to compare with at every duration."""
MOST_DURATIONS, MOST_PROCESSES = 1000, 1000
SAMPLES = 400
"""Samples of a motion for its measures of energy."""


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
        best: the plan of least J, its duration free between the neighbours of the cheapest point.
        interrupted: whether Ctrl-C came before the curve was whole; points that it left out have no plan, and ``best`` is the
            cheapest of the others.
    """

    problem: Problem
    points: tuple[SweepPoint, ...]
    best: Plan | None
    interrupted: bool = False

    @property
    def durations(self) -> np.ndarray:
        """[s], shape (N,)."""
        return np.array([point.duration for point in self.points])

    @property
    def baseline_kinds(self) -> list[str]:
        """Names of the ordinary motions to compare with."""
        return list(max((point.baselines for point in self.points), key=len))

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
        processes: 1, or 2 and more: longer durations are planned in a second process where that is worth its start; by default
            where there is more than one core. The curve is the same for any number.

    Returns:
        the curve. After Ctrl-C, what there is of it: further durations have no plan, and say so (`Sweep.interrupted`).

    Raises:
        InputError: an argument makes no sense. NoSolutionFound: there is no valid plan for any duration.
        KeyboardInterrupt: Ctrl-C came before there was one.
    """
    check_problem("sweep", problem)
    times = _checked(durations)
    parameterization = BSpline() if parameterization is None else parameterization
    given = DEFAULTS | options
    check_names("sweep", options, DEFAULTS)
    check_options(parameterization, given)
    most = cores() if processes is None else whole("sweep: processes", processes, 1, MOST_PROCESSES)
    follower = Follower(problem, parameterization, given)
    found = follower.optima(times, most)
    points = tuple(_point(problem, one, compared=not follower.interrupted) for one in found)
    if not any(point.solved for point in points):
        if follower.interrupted:
            raise KeyboardInterrupt
        last = next((point.plan for point in points if point.plan is not None), None)
        if last is None:
            raise ProblemError(f"sweep: {points[-1].why}")
        raise NoSolutionFound(last)
    cheapest = int(np.argmin([point.energy.get("objective", np.inf) for point in points]))
    best = None if follower.interrupted else _best(problem, parameterization, given, points, cheapest)
    return Sweep(problem, points, best or points[cheapest].plan, interrupted=best is None)


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


def _checked(durations: Sequence[float]) -> np.ndarray:
    expected = f"1 to {MOST_DURATIONS} durations in seconds"
    times = np.unique(numbers("sweep: durations", durations, expected))
    if not 0 < len(times) <= MOST_DURATIONS or not np.all(np.isfinite(times) & (times > 0)):
        raise InputError(f"sweep: durations is {shown(durations)}: expected {expected}")
    return times


def _point(problem: Problem, found: Found, compared: bool) -> SweepPoint:
    """What there is at one duration, ``compared`` with ordinary motions or not: whoever interrupts wants an end."""
    plan, pinned = found.plan, problem.lasting(found.duration)
    valid = plan is not None and plan.solved
    goal = plan.trajectory(plan.duration) if valid else problem.goal_position
    others = {}
    for kind in BASELINES if goal is not None and compared else ():
        motion = baseline(pinned, kind, goal=goal)
        others[kind] = energy_measures(pinned, motion) | {"holds": float(limits_hold(verify(pinned, motion, distances=False)))}
    why = found.why or ("" if valid else plan.message)
    return SweepPoint(found.duration, plan, why, energy_measures(pinned, plan.trajectory) if valid else {}, others)


def _best(
    problem: Problem, parameterization: Parameterization, given: dict, points: tuple[SweepPoint, ...], cheapest: int
) -> Plan | None:
    """The plan of least J with a free duration between the neighbours of the cheapest point; None after Ctrl-C."""
    k = cheapest
    low, high = points[max(k - 1, 0)].duration, points[min(k + 1, len(points) - 1)].duration
    if low == high:
        return points[k].plan
    guess = points[k].plan.trajectory
    try:
        free, _ = planned(replace(problem, duration=(low, high)), parameterization, given, guess=guess)
    except KeyboardInterrupt:
        return None
    if free.status is Status.INTERRUPTED:
        return None
    return min((plan for plan in (free, points[k].plan) if plan.solved), key=lambda plan: plan.objective)
