"""Requests that no motion can meet, found before anything is solved.

Each check is a necessary condition with its own remedy in the message: boundary states inside the limits, torques that
hold the arm at both ends, and a duration that the kinematic limits allow. For a joint that moves by d from rest to rest,

    T ≥ d/v_max,   T ≥ d/v_max + v_max/a_max  (or 2 √(d/a_max) where v_max is not reached),   T ≥ (32 d/j_max)^⅓.
"""

from __future__ import annotations

import numpy as np

from energyopt.errors import ProblemError
from energyopt.problem import Problem

SLACK = 1e-6
"""Excess over a limit [rad, rad/s, rad/s²] that is taken for rounding in the input."""


def check_feasibility(problem: Problem, goal: np.ndarray | None = None) -> None:
    """Raise where a problem is impossible whatever the motion.

    Args:
        problem: what is asked.
        goal: joint positions of the goal, where the problem gives it as a frame pose and they are known.

    Raises:
        ProblemError: names the joint, by how much, and what would make it possible.
    """
    goal = problem.goal_position if goal is None else goal
    _check_states(problem, goal)
    _check_static_torque(problem, goal)
    _check_duration(problem, goal)


def kinematic_minimum(problem: Problem, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Least time [s] each joint needs from ``start`` to ``goal`` (nv,) under velocity, acceleration and jerk limits.

    With boundary velocities or accelerations other than zero only the velocity limit is counted (still a lower bound).
    """
    limits, d = problem.limits, np.abs(np.asarray(goal) - np.asarray(start))
    least = d / limits.velocity
    moving = [problem.start_velocity, problem.goal_velocity, problem.start_acceleration, problem.goal_acceleration]
    if any(np.any(state) for state in moving):
        return least
    with np.errstate(invalid="ignore", divide="ignore"):
        reaches = d >= limits.velocity**2 / limits.acceleration
        ramps = np.where(
            reaches, d / limits.velocity + limits.velocity / limits.acceleration, 2 * np.sqrt(d / limits.acceleration)
        )
        ramps = np.where(np.isfinite(limits.acceleration), ramps, 0.0)
    return np.maximum.reduce([least, ramps, np.cbrt(32 * d / limits.jerk)])


def _check_states(problem: Problem, goal: np.ndarray | None) -> None:
    limits = problem.limits
    stations = [("start", problem.start), ("goal", goal)]
    stations += [(f"waypoints[{k}]", w.position) for k, w in enumerate(problem.waypoints)]
    for where, q in stations:
        if q is None:
            continue
        for bound, excess, word in ((limits.lower, limits.lower - q, "below"), (limits.upper, q - limits.upper, "above")):
            i = int(np.argmax(excess))
            if excess[i] > SLACK:
                raise ProblemError(
                    f"{where}: {_joint(problem, i)} is {q[i]:.6g} rad, {excess[i]:.3g} {word} its position limit {bound[i]:.6g}; "
                    "move it inside or widen position_limits"
                )
    for kind, bound in (("velocity", limits.velocity), ("acceleration", limits.acceleration)):
        for end in ("start", "goal"):
            value = getattr(problem, f"{end}_{kind}")
            i = int(np.argmax(np.abs(value) - bound))
            if abs(value[i]) > bound[i] + SLACK:
                raise ProblemError(
                    f"{end}_{kind}: {_joint(problem, i)} has {value[i]:.6g}, beyond its limit {bound[i]:.6g}; "
                    f"lower it or raise {kind}_limits"
                )


def _check_static_torque(problem: Problem, goal: np.ndarray | None) -> None:
    """At the ends position, velocity and acceleration are given, and so is the torque."""
    limits = problem.limits
    ends = [("start", problem.start, problem.start_velocity, problem.start_acceleration)]
    if goal is not None:
        ends.append(("goal", goal, problem.goal_velocity, problem.goal_acceleration))
    for where, q, v, a in ends:
        tau = problem.robot.torque(q, v, a)
        i = int(np.argmax(np.abs(tau) / limits.torque))
        if abs(tau[i]) > limits.torque[i] * (1 + 1e-6):
            raise ProblemError(
                f"{where}: {_joint(problem, i)} needs {abs(tau[i]):.4g} N·m there, its torque limit is {limits.torque[i]:.4g}; "
                f"choose another {where}, a lighter payload, or torque_limits of at least {abs(tau[i]):.4g}"
            )


def _check_duration(problem: Problem, goal: np.ndarray | None) -> None:
    timed = [(0.0, problem.start, "start")]
    timed += [(w.time, w.position, f"waypoints[{k}]") for k, w in enumerate(problem.waypoints) if w.time is not None]
    if goal is not None:
        timed.append((problem.duration, goal, "goal"))
    several = len(timed) > 2
    for (t0, q0, name0), (t1, q1, name1) in zip(timed[:-1], timed[1:], strict=True):
        least = np.abs(q1 - q0) / problem.limits.velocity if several else kinematic_minimum(problem, q0, q1)
        i = int(np.argmax(least))
        if least[i] > (t1 - t0) * (1 + 1e-9):
            raise ProblemError(
                f"duration: {_joint(problem, i)} needs at least {least[i]:.4g} s from {name0} to {name1} under its limits, "
                f"{t1 - t0:.4g} s are given; allow more time, a shorter way, or higher limits"
            )


def _joint(problem: Problem, i: int) -> str:
    return f"joint '{problem.robot.joint_names[i]}'"
