"""How long a motion has to take: on a path, and for a problem.

On a path the shortest duration is known (see `timing.reachability`). For a problem only bounds are: no motion is faster than the
joints allow each for itself (see `least_times`), and a duration is feasible where a motion of it is known. Such motions are
straight ways in joint space, from station to station and at rest at each, with velocities that rise and fall as
v(x) = v_c (3x² − 2x³) over a share β of the time, and are constant between: each made as fast as its limits allow as a whole
(see `timing.uniform`), the fastest β of each leg taken, and the whole put to the dense check.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from energyopt.arguments import check_problem
from energyopt.errors import InputError
from energyopt.least_times import legs_of
from energyopt.parameterizations.trajectory import PolynomialTrajectory, Trajectory
from energyopt.problem import FramePose, Problem
from energyopt.readable import Readable
from energyopt.robots.model import Limits, RobotModel
from energyopt.timing.paths import as_path, by_length, check_positions, is_still
from energyopt.timing.reachability import fastest
from energyopt.timing.slowness import allowed_durations
from energyopt.verification import describe, is_valid, verify

RAMPS = (0.5, 0.4, 0.3, 0.22, 0.15, 0.1, 0.06)
"""Shares β that are tried."""
SLOWER = (1.0 + 1e-9, 1.1, 1.3, 1.7, 2.5)
"""Factors by which the fastest of these motions is slowed down until the dense check holds (of torque rates, say)."""


@dataclass(frozen=True, eq=False, repr=False)
class DurationBounds(Readable):
    """Between what lies the shortest duration of a problem.

    Attributes:
        lower: no motion is faster [s]. joint: the slowest joint on the longest leg.
        upper: a motion of this duration is known [s]; None where none is. motion: that motion.
        reason: why none is known; empty where one is.
    """

    lower: float
    joint: str
    upper: float | None
    motion: Trajectory | None
    reason: str = ""

    def in_brief(self) -> str:
        return str(self)

    def __str__(self) -> str:
        least = f"at least {self.lower:.4g} s ({self.joint})"
        known = f"no duration is known to be feasible: {self.reason}" if self.upper is None else f"{self.upper:.4g} s is feasible"
        return f"{least}; {known}"


def minimum_duration(
    path: Trajectory | ArrayLike,
    robot: RobotModel,
    limits: Limits | None = None,
    *,
    start_speed: float = 0.0,
    goal_speed: float = 0.0,
) -> float:
    """The least time [s] in which an arm can follow a path within its limits of velocity, acceleration and torque.

    Friction counts on the safe side; limits of jerk and torque rate are not looked at.

    Args:
        path: a motion, whose timing does not count, or configurations (K, nv) [rad], through which a natural cubic spline goes.
        robot: the arm. limits: in place of its own.
        start_speed, goal_speed: ds/dt at the ends (of a motion that starts or ends at rest: of its length), zero by default.

    Returns:
        seconds.

    Raises:
        InputError: no path, one outside the position limits, or one that the arm cannot be held still on.
    """
    curve, limits = as_path(path, robot), limits or robot.limits
    check_positions(curve, robot, limits)
    if is_still(curve, 0) or is_still(curve, -1):
        curve = by_length(curve)[0]
    return fastest(curve, robot, limits, start_speed, goal_speed).duration


def duration_bounds(problem: Problem) -> DurationBounds:
    """Bounds of the shortest duration of a problem; its own duration does not count.

    Args:
        problem: what is asked. Waypoints with a time are as if they had none.

    Returns:
        DurationBounds: least time [s] with the joint that needs it, and a time known to be feasible, or why none is.

    Raises:
        InputError: no problem.
    """
    check_problem("duration_bounds", problem)
    legs = [leg for leg, _ in legs_of(problem.lasting(problem.durations[1]), problem.goal_position)]
    longest = max(legs, key=lambda leg: leg.time)
    lower, joint = sum(leg.time for leg in legs), problem.robot.joint_names[longest.slowest]
    motion, reason = _known(problem)
    if motion is None:
        return DurationBounds(lower, joint, None, None, reason)
    return DurationBounds(lower, joint, motion.duration, motion)


def _known(problem: Problem) -> tuple[Trajectory | None, str]:
    """A valid motion along straight ways, or why there is none."""
    if isinstance(problem.goal, FramePose):
        return None, "the goal is a pose"
    rates = (problem.start_velocity, problem.goal_velocity, problem.start_acceleration, problem.goal_acceleration)
    if any(np.any(rate != 0) for rate in rates):
        return None, "start or goal is no rest"
    if any(w.time is not None for w in problem.waypoints):
        return None, "waypoints have times"
    stations = np.array([problem.start, *(w.position for w in problem.waypoints), problem.goal_position])
    legs = [(a, b) for a, b in zip(stations[:-1], stations[1:], strict=True) if np.any(a != b)]
    if not legs:
        return None, "nothing moves"
    try:
        fast = _joined([_fastest_leg(problem, a, b) for a, b in legs])
    except InputError as error:
        return None, str(error)
    for factor in SLOWER:
        motion = fast.stretched(factor * fast.duration)
        violations = verify(problem.lasting(motion.duration), motion)
        if is_valid(violations):
            return motion, ""
    return None, f"on the straight way {describe(violations)}"


def _fastest_leg(problem: Problem, start: np.ndarray, goal: np.ndarray) -> PolynomialTrajectory:
    found = []
    for ramp in RAMPS:
        motion = straight(start, goal, ramp)
        found.append(motion.stretched(allowed_durations(motion, problem.robot, problem.limits)[0, 0]))
    return min(found, key=lambda motion: motion.duration)


def straight(start: np.ndarray, goal: np.ndarray, ramp: float) -> PolynomialTrajectory:
    """The straight motion of one second whose velocity rises and falls smoothly over a share ``ramp`` ≤ ½ of it."""
    v, b = 1.0 / (1.0 - ramp), ramp
    rise = [0.0, 0.0, 0.0, v / b**2, -0.5 * v / b**3]
    cruise = [0.5 * v * b, v, 0.0, 0.0, 0.0]
    fall = [1.0 - 0.5 * v * b, v, 0.0, -v / b**2, 0.5 * v / b**3]
    breaks, shapes = ([0.0, b, 1.0 - b, 1.0], [rise, cruise, fall]) if ramp < 0.5 else ([0.0, b, 1.0], [rise, fall])
    pieces = np.array(shapes)[:, :, None] * (goal - start)
    pieces[:, 0] += start
    return PolynomialTrajectory(breaks, pieces)


def _joined(motions: list[PolynomialTrajectory]) -> PolynomialTrajectory:
    """One motion after another."""
    ends = np.cumsum([motion.duration for motion in motions])
    begins = np.append(0.0, ends[:-1])
    breaks = [motion.breaks[1:] + begin for motion, begin in zip(motions, begins, strict=True)]
    return PolynomialTrajectory(np.concatenate([[0.0], *breaks]), np.concatenate([m.coefficients for m in motions]))
