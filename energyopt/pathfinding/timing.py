"""Motions along paths with corners: rounded first, then timed as `energyopt.timing.reachability` does it."""

from __future__ import annotations

import numpy as np

from energyopt.parameterizations.trajectory import SplineTrajectory, Trajectory
from energyopt.pathfinding.curves import rounded
from energyopt.robots.model import Limits, RobotModel
from energyopt.timing import reachability
from energyopt.timing.reachability import TimeLaw, motion


def fastest(path: np.ndarray | SplineTrajectory, robot: RobotModel, limits: Limits | None = None) -> TimeLaw:
    """The time law that takes the least time from rest to rest inside the limits of velocity, acceleration and torque.

    Args:
        path: a curve, or configurations (K, nv) [rad] whose corners are rounded.
        robot: the arm.
        limits: in place of the robot's own.

    Raises:
        ProblemError: the arm cannot hold itself still somewhere on the path, or nothing limits it.
    """
    return reachability.fastest(_as_curve(path), robot, limits)


def shortest_duration(path: np.ndarray | SplineTrajectory, robot: RobotModel, limits: Limits | None = None) -> float:
    """The least time [s] in which an arm can follow a path from rest to rest; arguments and errors as of `fastest`."""
    return fastest(path, robot, limits).duration


def timed(
    path: np.ndarray | SplineTrajectory, robot: RobotModel, limits: Limits | None = None, duration: float | None = None
) -> Trajectory:
    """A motion from rest to rest along a path, as fast as the limits allow or that law scaled to a duration.

    Args:
        path, robot, limits: as of `fastest`.
        duration: [s]; None for the shortest. One below the shortest is obeyed too, and then breaks limits.
    """
    curve = _as_curve(path)
    law = fastest(curve, robot, limits)
    return motion(curve, law if duration is None else law.scaled(duration))


def timed_smoothly(path: np.ndarray | SplineTrajectory, duration: float) -> Trajectory:
    """A motion along a path with the quintic law of `reachability.timed_smoothly`: no limits are looked at."""
    return reachability.timed_smoothly(_as_curve(path), duration)


def _as_curve(path: np.ndarray | SplineTrajectory) -> SplineTrajectory:
    return path if isinstance(path, SplineTrajectory) else rounded(path)
