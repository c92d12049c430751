"""What is asked of a timing, and where the search for it starts.

A first law is the fastest one. Where there is more time than it takes, the arm moves almost as fast and waits for the rest at the
place of the path where it is held most cheaply: that is what optima of long durations do, and what is found depends on the start.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from energyopt.arguments import check_names
from energyopt.errors import InputError, ProblemError
from energyopt.parameterizations.path_trajectory import PathTrajectory
from energyopt.parameterizations.trajectory import PolynomialTrajectory, Trajectory
from energyopt.problem import Problem
from energyopt.problem_values import duration as checked_duration
from energyopt.problem_values import real, shown
from energyopt.robots.model import RobotModel
from energyopt.timing.law_search import even_law, smooth_law, with_pause
from energyopt.timing.law_space import Ends
from energyopt.timing.paths import as_path, by_length, check_positions, is_still
from energyopt.timing.reachability import fastest
from energyopt.timing.uniform import uniform_scaling

OPTIONS = (
    "velocity_weight", "torque_weights", "position_limits", "velocity_limits", "acceleration_limits", "jerk_limits",
    "torque_limits", "torque_rate_limits", "obstacles", "workspace", "clearance", "self_collision", "attached", "name",
)  # fmt: skip
"""Arguments of `Problem` that `retime` takes too."""
QUICK = 1.15
"""Times the shortest duration that a first law moves for; the rest it waits where the arm is held most cheaply, as optima do."""
LEAST_SPANS, MOST_SPANS = 40, 120
SPANS_PER_LEAST = 30
"""Spans in the shortest duration of the path: what happens fast in a slow motion needs them too."""
TOO_SHORT = 0.97
"""Share of the shortest duration below which none is looked for: the grid it was found on leaves an error."""
TOO_SHORT_WITH_FRICTION = 0.8
"""The same where friction, which is counted on the safe side, has made it longer."""


@dataclass(frozen=True, eq=False)
class PathTask:
    """A path to be timed.

    Attributes:
        curve: the path. problem: where limits and weights come from. ends: of the law.
        fastest: how fast it can be passed; None where nothing limits that.
    """

    curve: Trajectory
    problem: Problem
    ends: Ends
    fastest: FastestLaw | None


@dataclass(frozen=True, eq=False)
class FastestLaw:
    """How fast a path can be passed.

    Attributes:
        law: s(t). motion: the motion it gives.
    """

    law: Trajectory
    motion: Trajectory

    @property
    def duration(self) -> float:
        return self.law.duration


def path_task(
    path: Trajectory | ArrayLike,
    robot: RobotModel,
    duration: float | tuple[float, float],
    speeds: tuple[float, float],
    smooth_ends: bool,
    options: dict,
) -> tuple[PathTask, tuple[float, float]]:
    """The path as a task, and the shortest and longest duration it may get."""
    if not isinstance(robot, RobotModel):
        raise InputError(f"retime: robot is {shown(robot)}: expected what energyopt.load_robot gives")
    check_names("retime", options, OPTIONS)
    if not isinstance(smooth_ends, bool):
        raise InputError(f"smooth_ends is {shown(smooth_ends)}: expected True or False")
    speeds = tuple(real(key, x, lambda v: 0 <= v < np.inf, "a number ≥ 0: a law never runs backwards")
                   for key, x in zip(("start_speed", "goal_speed"), speeds, strict=True))  # fmt: skip
    curve, given = as_path(path, robot), checked_duration(duration)
    problem = Problem(robot, curve(0.0), curve(curve.duration), given, **options)
    check_positions(curve, robot, problem.limits)
    ends = Ends(tuple(None if is_still(curve, end) else v for end, v in zip((0, -1), speeds, strict=True)), smooth_ends)
    law = _fastest(curve, robot, problem, ends.speeds)
    low, high = problem.durations
    if law is not None:
        low = max(low, _shortest(law, robot, high))
    return PathTask(curve, problem, ends, law), (low, high)


def _fastest(curve: Trajectory, robot: RobotModel, problem: Problem, speeds: tuple[float | None, ...]) -> FastestLaw | None:
    """The fastest law; None where nothing limits it. A path that stands still at an end is passed over its length."""
    limits = problem.limits
    if not any(np.any(np.isfinite(x)) for x in (limits.velocity, limits.acceleration, limits.torque)):
        return None
    if None not in speeds:
        law = fastest(curve, robot, limits, *speeds).places()
        return FastestLaw(law, PathTrajectory(curve, law))
    even, u, places = by_length(curve)
    law = fastest(even, robot, limits).places()
    s = np.interp(law(law.breaks)[:, 0], u, places)
    steps = np.stack([s[:-1], np.diff(s) / np.diff(law.breaks)], axis=1)[:, :, None]
    return FastestLaw(PolynomialTrajectory(law.breaks, steps), PathTrajectory(even, law))


def _shortest(law: FastestLaw, robot: RobotModel, longest: float) -> float:
    """The duration from which a law is looked for, or an error where ``longest`` is below it."""
    dynamics = robot.dynamics
    rubs = np.any(dynamics.viscous_friction) or np.any(dynamics.coulomb_friction)
    least = (TOO_SHORT_WITH_FRICTION if rubs else TOO_SHORT) * law.duration
    if longest < least:
        raise ProblemError(
            f"duration: {longest:g} s is too short for this path: within the limits it takes at least {law.duration:.4g} s; "
            "allow more time, or higher limits"
        )
    return min(least, longest)


def first_law(task: PathTask, durations: tuple[float, float]) -> Trajectory:
    """The fastest law made to take the duration asked, or the cheapest that may be, with a pause; a smooth one without limits."""
    if task.fastest is not None:
        law, motion = task.fastest.law, task.fastest.motion
    else:
        shape = even_law if task.ends.speeds == (None, None) else smooth_law
        law = shape(task.curve, float(np.sqrt(durations[0] * durations[1])))
        motion = PathTrajectory(task.curve, law)
    T, problem = durations[0], task.problem
    if durations[0] < durations[1]:
        scaling = uniform_scaling(motion, problem.robot, problem.velocity_weight, problem.torque_weights)
        T = scaling.cheapest(durations)
    moving = QUICK * law.duration
    if task.fastest is None or moving >= T:
        return law.stretched(T)
    places = task.curve.sample_times(20)
    q = task.curve(places)
    held = problem.robot.torque(q, np.zeros_like(q), np.zeros_like(q)) ** 2 @ problem.torque_weights
    if np.ptp(held) <= 1e-9 * np.max(held, initial=1.0):  # it waits nowhere more cheaply than elsewhere
        return law.stretched(T)
    return with_pause(law.stretched(moving), float(places[np.argmin(held)]), T - moving)


def span_count(task: PathTask, duration: float) -> int:
    ratio = 1.0 if task.fastest is None else duration / task.fastest.duration
    wanted = max(LEAST_SPANS, SPANS_PER_LEAST * ratio, len(task.curve.breaks) - 1)
    return int(min(wanted, MOST_SPANS))
