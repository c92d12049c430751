"""How closely a motion passes its waypoints.

A timed waypoint is judged at its time. An untimed one is judged where the motion comes nearest, later than the waypoint
listed before it and earlier than the next timed one: the minima of ½‖q(t) − w‖² are the upward zeros of (q − w)·q̇,
found by Newton's method from the sign changes on a dense grid. Of several passes the earliest exact one counts, which
leaves most of the motion to the waypoints that follow.
"""

from __future__ import annotations

import numpy as np

from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.sampling import sample_spans

EXACT = 1e-6
"""Distance [rad] below which a pass counts as exact."""


def waypoint_misses(problem: Problem, trajectory: Trajectory) -> list[tuple[float, str, float]]:
    """For every waypoint: largest joint error [rad], the joint, and the time [s] of the pass that counts."""
    misses, after = [], 0.0
    for k, waypoint in enumerate(problem.waypoints):
        if waypoint.time is None:
            later = [w.time for w in problem.waypoints[k + 1 :] if w.time is not None]
            times = _nearest_times(trajectory, waypoint.position, after, later[0] if later else trajectory.duration)
        else:
            times = np.array([waypoint.time])
        errors = np.abs(trajectory(times) - waypoint.position)
        largest = errors.max(axis=1)
        exact = np.flatnonzero(largest <= EXACT)
        best = exact[0] if exact.size else int(np.argmin(largest))
        joint = problem.robot.joint_names[int(np.argmax(errors[best]))]
        misses.append((float(largest[best]), joint, float(times[best])))
        after = float(times[best])
    return misses


def _nearest_times(trajectory: Trajectory, position: np.ndarray, low: float, high: float) -> np.ndarray:
    """Times in [low, high] at which the distance to ``position`` has a local minimum, ascending; both ends are candidates."""
    grid = np.unique(sample_spans(trajectory).t)
    grid = np.concatenate([[low], grid[(grid > low) & (grid < high)], [high]])
    slope = np.sum((trajectory(grid) - position) * trajectory(grid, 1), axis=1)
    turn = np.flatnonzero((slope[:-1] <= 0) & (slope[1:] >= 0))
    left, right = grid[turn], grid[turn + 1]
    at = 0.5 * (left + right)
    for _ in range(8):
        q, v, a = (trajectory(at, order) for order in range(3))
        value = np.sum((q - position) * v, axis=1)
        curvature = np.sum(v * v + (q - position) * a, axis=1)
        at = np.clip(at - value / np.where(curvature > 1e-300, curvature, np.inf), left, right)
    return np.unique(np.concatenate([[low], at, grid[turn], [high]]))
