"""A path of one's own: any motion, whose time is read as the place s, or configurations through which a curve is laid.

Through configurations q_k a natural cubic spline is laid over the lengths of the straight ways between them,
s_k = Σ_{j≤k} ‖q_j − q_{j−1}‖: it passes every q_k, is twice continuously differentiable, straight at both ends, and has
|q'| near one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline

from energyopt.errors import ProblemError
from energyopt.parameterizations.trajectory import SplineTrajectory, Trajectory
from energyopt.problem_values import numbers, shown
from energyopt.robots.model import Limits, RobotModel
from energyopt.sampling import extrema, sample_spans

STILL = 1e-6
"""A path whose |q'| at an end is below this share of its largest stands still there."""
PLACES = 300
"""Points of a path from which it is made again over its length."""
SLACK = 1e-6
"""Excess over a position limit [rad or m] that is taken for rounding, as in the dense check."""


def as_path(path: Trajectory | ArrayLike, robot: RobotModel) -> Trajectory:
    """A path as a curve q(s), 0 ≤ s ≤ its ``duration``.

    Args:
        path: a motion, or configurations [rad] of shape (K, nv), K ≥ 2.
        robot: the arm.

    Raises:
        ProblemError: fewer than two different configurations, numbers that are not finite, or another number of joints.
    """
    if not isinstance(robot, RobotModel):
        raise ProblemError(f"robot is {shown(robot)}: expected what energyopt.load_robot gives")
    if isinstance(path, Trajectory):
        if path.nv != robot.nv:
            raise ProblemError(f"path: a motion of {path.nv} joints; expected {robot.nv}, as {robot.name} has")
        return _moving(path)
    expected = f"a trajectory, or at least two different configurations of {robot.nv} joint positions, one a row"
    points = numbers("path", path, expected)
    if points.ndim != 2 or points.shape[1] != robot.nv or len(points) < 2:
        raise ProblemError(f"path has the shape {points.shape}: expected {expected}")
    bad = np.argwhere(~np.isfinite(points))
    if len(bad):
        k, i = bad[0]
        raise ProblemError(f"path[{k}] (joint '{robot.joint_names[i]}') is {points[k, i]}: expected a finite number")
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    points, steps = points[np.append(True, steps > 0)], steps[steps > 0]
    if not len(steps):
        raise ProblemError(f"path: all its configurations are the same: expected {expected}")
    along = np.append(0.0, np.cumsum(steps))
    degree = 3 if len(points) > 2 else 1
    spline = make_interp_spline(along, points, k=degree, bc_type="natural" if degree == 3 else None)
    return SplineTrajectory(spline.t, spline.c, degree)


def is_still(path: Trajectory, end: int) -> bool:
    """Whether q' vanishes at the start (0) or at the end (−1): there the arm rests, however fast the path is passed."""
    rates = np.abs(path(path.sample_times(4), 1)).max(axis=1)
    return bool(rates[end] <= STILL * rates.max())


def by_length(path: Trajectory) -> tuple[SplineTrajectory, np.ndarray, np.ndarray]:
    """The same path over its length u, |dq/du| near one: how fast it can be passed is asked of this one where it stands still.

    Returns:
        A spline through `PLACES` + 1 points of the path, and the lengths u and places s of these, (N + 1,) each.
    """
    s = np.linspace(0.0, path.duration, 20 * PLACES + 1)
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path(s), axis=0), axis=1)))
    moving = np.append(True, np.diff(along) > 0)
    u = np.linspace(0.0, along[-1], PLACES + 1)
    places = np.interp(u, along[moving], s[moving])
    places[-1] = path.duration
    spline = make_interp_spline(u, path(places), k=3, bc_type="natural")
    return SplineTrajectory(spline.t, spline.c, 3), u, places


def check_positions(path: Trajectory, robot: RobotModel, limits: Limits) -> None:
    """Refuse a path that leaves the position limits: no timing can help.

    Raises:
        ProblemError: names the joint, the place and the excess.
    """
    samples = sample_spans(path)
    places, peaks = extrema(path, 0)
    s = np.concatenate([np.repeat(samples.t.reshape(-1, 1), path.nv, axis=1), places])
    q = np.concatenate([samples.flat(0), peaks])
    excess = np.maximum(q - limits.upper, limits.lower - q)
    k, i = np.unravel_index(np.argmax(excess), excess.shape)
    if excess[k, i] > SLACK:
        place = f"{100 * s[k, i] / path.duration:.0f} % of its way"
        raise ProblemError(
            f"path: joint '{robot.joint_names[i]}' is at {q[k, i]:.4g} at {place}, {excess[k, i]:.3g} beyond its position limit; "
            "put the path's points closer together, or away from the limit"
        )


def _moving(path: Trajectory) -> Trajectory:
    samples = path(path.sample_times(8))
    if not np.all(np.isfinite(samples)):
        raise ProblemError("path: a motion that is not finite; expected joint positions at all of its times")
    if not np.any(np.abs(samples - samples[0]) > 0):
        raise ProblemError(f"path: {shown(type(path).__name__)} stands still; expected a path with some length")
    return path
