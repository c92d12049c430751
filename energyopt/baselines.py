"""Ordinary motions of the same duration, to which an optimal one is compared.

With s = t/T and Δ = q₁ − q₀, from rest to rest:

    quintic      q₀ + Δ (10 s³ − 15 s⁴ + 6 s⁵)      minimum jerk (Flash and Hogan, J. Neuroscience 5, 1985)
    cubic        q₀ + Δ (3 s² − 2 s³)               minimum acceleration
    cycloid      q₀ + Δ (s − sin 2πs / 2π)          acceleration a full sine
    trapezoidal  constant acceleration over a share β of T, constant velocity Δ / (T (1 − β)), constant deceleration

Velocities at the ends that are not zero are honoured by all, accelerations by quintic and cycloid. Waypoints are passed:
the quintic and the cubic become interpolating splines (the minimum-jerk and minimum-acceleration curves through them),
the cycloid carries a polynomial correction, the trapezoidal motion stops at each. A waypoint without a time gets one
in proportion to the length of the way.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import make_interp_spline

from energyopt.arguments import check_problem
from energyopt.errors import ProblemError
from energyopt.parameterizations.trajectory import PolynomialTrajectory, SinusoidTrajectory, SplineTrajectory, Trajectory
from energyopt.problem import Problem, Waypoint
from energyopt.problem_values import configuration, shown

ACCELERATION_SHARE = 1.0 / 3.0
"""β of the trapezoidal motion where the limits allow it: accelerate, cruise and decelerate for a third of T each."""


def baseline(problem: Problem, kind: str = "quintic", goal: np.ndarray | None = None) -> Trajectory:
    """An ordinary motion with the problem's ends and duration; its limits are NOT enforced (see `verify`).

    Args:
        problem: start, goal, waypoints, boundary velocities and accelerations, duration.
        kind: a key of `BASELINES`.
        goal: joint positions at the end [rad], shape (nv,); needed where the problem's goal is Cartesian.

    Returns:
        The motion.

    Raises:
        ProblemError: no such kind, or a Cartesian goal without ``goal``.
    """
    check_problem("baseline", problem)
    if not isinstance(kind, str) or kind not in BASELINES:
        raise ProblemError(f"baseline {shown(kind)} is unknown: expected one of {', '.join(BASELINES)}")
    end = problem.goal_position if goal is None else configuration("baseline goal", goal)
    if end is None:
        raise ProblemError("baseline: the goal is a Cartesian pose; pass goal=joint positions that reach it (the plan's last)")
    if end.shape != (problem.robot.nv,):
        raise ProblemError(f"baseline: goal must be {problem.robot.nv} finite joint positions, got shape {end.shape}")
    times, points = stations(problem, end)
    return BASELINES[kind](problem, times, points)


def quintic(problem: Problem, times: np.ndarray, points: np.ndarray) -> Trajectory:
    """The minimum-jerk motion through ``points`` (K + 1, nv) at ``times`` (K + 1,): a quintic, C⁴ at waypoints."""
    start = [(1, problem.start_velocity), (2, problem.start_acceleration)]
    end = [(1, problem.goal_velocity), (2, problem.goal_acceleration)]
    spline = make_interp_spline(times, points, k=5, bc_type=(start, end))
    return SplineTrajectory(spline.t, spline.c, 5)


def cubic(problem: Problem, times: np.ndarray, points: np.ndarray) -> Trajectory:
    """The minimum-acceleration motion through ``points``: a cubic, C² at waypoints; its end accelerations are what they are."""
    ends = ([(1, problem.start_velocity)], [(1, problem.goal_velocity)])
    spline = make_interp_spline(times, points, k=3, bc_type=ends)
    return SplineTrajectory(spline.t, spline.c, 3)


def cycloid(problem: Problem, times: np.ndarray, points: np.ndarray) -> Trajectory:
    """The cycloid plus the polynomial of least degree that meets the other conditions (zero from rest to rest)."""
    duration, change = times[-1], points[-1] - points[0]
    s = times / duration
    ideal = points[0] + change * (s - np.sin(2 * np.pi * s) / (2 * np.pi))[:, None]
    rows, values = [], []
    count = len(times) + 4
    conditions = [(x, 0, miss) for x, miss in zip(s, points - ideal, strict=True)]
    conditions += [(0.0, 1, problem.start_velocity * duration), (1.0, 1, problem.goal_velocity * duration)]
    conditions += [(0.0, 2, problem.start_acceleration * duration**2), (1.0, 2, problem.goal_acceleration * duration**2)]
    for x, order, value in conditions:
        rows.append([np.polynomial.polynomial.polyval(x, np.polynomial.polynomial.polyder(e, order)) for e in np.eye(count)])
        values.append(value)
    correction = np.linalg.solve(np.array(rows), np.array(values))
    correction[0] += points[0]
    correction[1] += change
    sine = -change[None] / (2 * np.pi)
    return SinusoidTrajectory(duration, correction, sine, np.zeros_like(sine))


def trapezoidal(problem: Problem, times: np.ndarray, points: np.ndarray, share: float | None = None) -> Trajectory:
    """Trapezoidal velocity between all stations, all joints together.

    Args:
        problem: velocity and acceleration limits, end velocities.
        times, points: stations, shape (K + 1,) [s] and (K + 1, nv) [rad].
        share: β, the part of the time spent accelerating, 0 < β ≤ 1/2; None takes `ACCELERATION_SHARE`, less where a
            velocity limit asks for it, more where an acceleration limit does.
    """
    rest = np.zeros(problem.robot.nv)
    breaks, pieces = [times[:1]], []
    for k, (span, change) in enumerate(zip(np.diff(times), np.diff(points, axis=0), strict=True)):
        first = problem.start_velocity if k == 0 else rest
        last = problem.goal_velocity if k == len(times) - 2 else rest
        beta = _acceleration_share(problem, span, change) if share is None else share
        cruise = (change / span - 0.5 * beta * (first + last)) / (1.0 - beta)
        ramp = beta * span
        corners = times[k] + np.array([ramp, span - ramp, span])
        corners[-1] = times[k + 1]
        q1 = points[k] + 0.5 * (first + cruise) * ramp
        q2 = q1 + cruise * (span - 2 * ramp)
        pieces.append([points[k], first, 0.5 * (cruise - first) / ramp])
        pieces.append([q1, cruise, rest])
        pieces.append([q2, cruise, 0.5 * (last - cruise) / ramp])
        breaks.append(corners)
    return _without_empty_pieces(np.concatenate(breaks), np.array(pieces))


BASELINES: dict[str, Callable[[Problem, np.ndarray, np.ndarray], Trajectory]] = {
    "quintic": quintic,
    "cubic": cubic,
    "cycloid": cycloid,
    "trapezoidal": trapezoidal,
}
"""Every kind of `baseline`, by name."""


def _acceleration_share(problem: Problem, span: float, change: np.ndarray) -> float:
    """β nearest `ACCELERATION_SHARE` with |Δ|/(T(1 − β)) ≤ v_max and |Δ|/(T²β(1 − β)) ≤ a_max, velocity first."""
    mean = np.abs(change) / span
    most = np.min(1.0 - mean / problem.limits.velocity)
    need = np.max(mean / span / problem.limits.acceleration)
    least = 0.5 * (1.0 - np.sqrt(max(0.0, 1.0 - 4.0 * need)))
    share = max(ACCELERATION_SHARE, least)
    if most > 0:
        share = min(share, most)
    return float(np.clip(share, 0.02, 0.5))


def _without_empty_pieces(breaks: np.ndarray, pieces: np.ndarray) -> PolynomialTrajectory:
    """β = 1/2 has no cruise: a piece without duration is left out."""
    keep = np.diff(breaks) > 1e-12 * breaks[-1]
    return PolynomialTrajectory(np.append(breaks[:-1][keep], breaks[-1]), pieces[keep])


def stations(problem: Problem, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and positions of start, waypoints and goal; shapes (K + 1,) and (K + 1, nv)."""
    stops = [Waypoint(problem.start, 0.0), *problem.waypoints, Waypoint(goal, problem.duration)]
    points = np.array([stop.position for stop in stops])
    # Equal neighbours still need time to pass: a small share of the whole way is added to every leg.
    legs = np.linalg.norm(np.diff(points, axis=0), axis=1)
    legs = legs + max(0.05 * legs.sum(), 1e-9)
    way = np.append(0.0, np.cumsum(legs))
    timed = [k for k, stop in enumerate(stops) if stop.time is not None]
    times = np.interp(way, way[timed], [stops[k].time for k in timed])
    return times, points
