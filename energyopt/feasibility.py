"""Requests that no motion can meet, found before anything is solved.

Each check is a necessary condition with its own remedy in the message: boundary states inside the limits, torques that hold
the arm at both ends, a goal within the length of the arm, and (see `least_times`) the time that the way takes at least.
"""

from __future__ import annotations

import numpy as np

from energyopt.dynamics.body import joint_axis
from energyopt.impossible import called, impossible, joint, unit
from energyopt.least_times import check_changes, check_times, kinematic_minimum
from energyopt.problem import FramePose, Problem
from energyopt.reach import check_reach

__all__ = ["check_feasibility", "kinematic_minimum"]

SLACK = 1e-6
"""Excess over a limit [rad, rad/s, rad/s²] that is taken for rounding in the input."""
MANY_TURNS = 3 * np.pi
"""Positions [rad] beyond this are rare enough for a hint that they might be degrees."""


def check_feasibility(problem: Problem, goal: np.ndarray | None = None) -> None:
    """Raise where a problem is impossible whatever the motion.

    Args:
        problem: what is asked.
        goal: joint positions of the goal, where the problem gives it as a frame pose and they are known.

    Raises:
        ProblemError: names the joint, by how much, and what would make it possible.
    """
    if goal is None and isinstance(problem.goal, FramePose):
        check_reach(problem)
    goal = problem.goal_position if goal is None else goal
    _check_positions(problem, goal)
    _check_rates(problem)
    check_times(problem, goal)
    if not problem.periodic:  # a cycle is at rest nowhere
        _check_static_torque(problem, goal)
        check_changes(problem, goal)


def _check_positions(problem: Problem, goal: np.ndarray | None) -> None:
    limits = problem.limits
    stations = [("start", problem.start), *((f"waypoints[{k}]", w.position) for k, w in enumerate(problem.waypoints))]
    stations += [] if goal is None else [("goal", goal)]
    for where, q in stations:
        for bound, excess, word in ((limits.lower, limits.lower - q, "below"), (limits.upper, q - limits.upper, "above")):
            i = int(np.argmax(excess))
            if excess[i] > SLACK:
                beyond = f"{excess[i]:.3g} {word} its position limit {bound[i]:.6g}"
                words = f"{joint(problem, i)} is {q[i]:.6g} {unit(problem, i)}, {beyond}"
                remedy = _degrees_hint(problem, q) or f"move it inside or widen {called(problem, 'position_limits')}"
                raise impossible(problem, where, f"{words}; {remedy}")


def _degrees_hint(problem: Problem, q: np.ndarray) -> str:
    """A remedy where positions make sense as degrees and not as radians; else ""."""
    limits, model = problem.limits, problem.robot.model
    turns = np.array([joint_axis(model, i + 1)[0] != "prismatic" for i in range(problem.robot.nv)])
    converted = np.where(turns, np.deg2rad(q), q)
    fits = np.all((converted >= limits.lower - SLACK) & (converted <= limits.upper + SLACK))
    if not (fits and np.any(np.abs(q[turns]) > MANY_TURNS)):
        return ""
    remedy = "numpy.deg2rad converts them" if problem.origin is None else 'angles = "deg" at the top of the file reads them so'
    return f"looks like degrees, expected radians: {remedy}"


def _check_rates(problem: Problem) -> None:
    for kind, u in (("velocity", "s"), ("acceleration", "s²")):
        bound = getattr(problem.limits, kind)
        for end in ("start", "goal"):
            value = getattr(problem, f"{end}_{kind}")
            i = int(np.argmax(np.abs(value) - bound))
            if abs(value[i]) > bound[i] + SLACK:
                words = f"{joint(problem, i)} has {value[i]:.6g} {unit(problem, i)}/{u}, beyond its limit {bound[i]:.6g}"
                remedy = f"lower it or raise {called(problem, f'{kind}_limits')}"
                raise impossible(problem, f"{end}_{kind}", f"{words}; {remedy}")


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
            u = "N·m" if unit(problem, i) == "rad" else "N"
            least = f"{called(problem, 'torque_limits')} of at least {abs(tau[i]):.4g}"
            words = f"{joint(problem, i)} needs {abs(tau[i]):.4g} {u} there, its torque limit is {limits.torque[i]:.4g}"
            raise impossible(problem, where, f"{words}; choose another {where}, a lighter payload, or {least}")
