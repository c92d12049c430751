"""judge(): what any motion costs, and whether an arm can do it: one recorded, taught, or made by another planner."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline

from energyopt.arguments import check_names
from energyopt.errors import InputError
from energyopt.geometry.shapes import Shape
from energyopt.parameterizations.trajectory import SplineTrajectory, Trajectory
from energyopt.plans import Plan
from energyopt.problem import Problem
from energyopt.problem_values import numbers, shown
from energyopt.robots.model import RobotModel
from energyopt.validation import ValidationReport, validate_motion

CONDITIONS = (
    "velocity_weight", "torque_weights", "costs", "waypoints", "position_limits", "velocity_limits", "acceleration_limits",
    "jerk_limits", "torque_limits", "torque_rate_limits", "workspace", "clearance", "potential", "self_collision", "attached",
    "name",
)  # fmt: skip
"""Arguments of `Problem` that are not read from the motion itself."""
DEGREE = 3
"""Of the spline through samples."""


def judge(
    trajectory: Trajectory | Plan | tuple[ArrayLike, ArrayLike],
    robot: RobotModel,
    obstacles: Sequence[Shape] = (),
    **conditions: Any,
) -> ValidationReport:
    """Check a motion that nobody has planned here against the limits of an arm and what stands around it, and say what it costs.

    Ordinary motions between the same configurations in the same time stand beside it, so that it shows what could be saved; that
    one of them costs less is no fault of a motion that does not claim to cost least.

    Args:
        trajectory: the motion; a plan stands for its own; or a pair of times (N,) [s], rising from 0, and positions (N, nv)
            [rad], through which a cubic spline is laid: what is said of the motion between samples is then said of that spline.
        robot: the arm.
        obstacles: shapes to stay clear of.
        conditions: as for `Problem`: limits (``velocity_limits`` …), ``workspace``, ``clearance``, ``self_collision``,
            ``attached``, ``potential``, ``waypoints``, and ``velocity_weight``, ``torque_weights`` or ``costs`` for J.

    Returns:
        ValidationReport: ``passed``, and ``str(report)`` for the table.

    Raises:
        InputError: an argument makes no sense.
    """
    if not isinstance(robot, RobotModel):
        raise InputError(f"judge: robot is {shown(robot)}: expected what energyopt.load_robot gives")
    check_names("judge", conditions, CONDITIONS)
    motion = _motion(trajectory, robot)
    ends = {}
    for end, t in (("start", 0.0), ("goal", motion.duration)):
        ends |= {end: motion(t), f"{end}_velocity": motion(t, 1), f"{end}_acceleration": motion(t, 2)}
    problem = Problem(robot, duration=motion.duration, obstacles=obstacles, **ends, **conditions)
    return validate_motion(problem, motion, claims_least=False)


def _motion(given: Any, robot: RobotModel) -> Trajectory:
    motion = given.trajectory if isinstance(given, Plan) else given if isinstance(given, Trajectory) else _through(given, robot)
    if motion.nv != robot.nv:
        raise InputError(f"judge: the motion has {motion.nv} joints, {robot.name} has {robot.nv}: expected the same")
    return motion


def _through(samples: Any, robot: RobotModel) -> Trajectory:
    """The cubic spline through samples."""
    if not isinstance(samples, (tuple, list)) or len(samples) != 2:
        expected = "a Trajectory, such as plan.trajectory, or a pair of times (N,) and positions (N, nv)"
        raise InputError(f"judge: trajectory is {shown(samples)}: expected {expected}")
    t = numbers("judge: times", samples[0], "seconds, rising from 0")
    q = numbers("judge: positions", samples[1], f"an array of shape (N, {robot.nv})")
    if t.ndim != 1 or t.size <= DEGREE or t[0] != 0 or not np.all(np.diff(t) > 0) or not np.isfinite(t).all():
        raise InputError(f"judge: times is {shown(samples[0])}: expected more than {DEGREE} times in seconds, rising from 0")
    if q.shape != (t.size, robot.nv) or not np.isfinite(q).all():
        raise InputError(f"judge: positions has the shape {q.shape}: expected {(t.size, robot.nv)}, finite")
    spline = make_interp_spline(t, q, DEGREE)
    return SplineTrajectory(spline.t, spline.c, DEGREE)
