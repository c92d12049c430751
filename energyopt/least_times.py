"""How long a motion takes at least: from configuration to configuration, and between two torques.

For one joint that moves by d between two rests under |q̇| ≤ V, |q̈| ≤ A, |d³q/dt³| ≤ J the fastest motion is known (seven phases
of constant jerk; e.g. L. Biagiotti, C. Melchiorri, "Trajectory Planning for Automatic Machines and Robots", 2008, §3.4). With
the time r(v) = 2√(v/J) (or v/A + A/J where A is reached) from rest to a velocity v, both ramps together cover v·r(v), and

    T = d/V + r(V)  where d ≥ V·r(V),  else  T = 2 r(v) with v·r(v) = d:  (32 d/J)^⅓,  or  A/J + √(A²/J² + 4d/A).

Between a rest and a point passed at any velocity only one ramp is needed: T ≥ d/V, d/V + V/2A (or √(2d/A)) and (6d/J)^⅓. The
legs of a way through waypoints follow each other, so their times add up, each that of its slowest joint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from energyopt.impossible import called, impossible, joint
from energyopt.problem import Problem
from energyopt.robots.model import Limits

ROUNDING = 1e-9
"""Share by which a duration may be too short for rounding's sake."""


@dataclass(frozen=True, eq=False)
class Leg:
    """The way from one station to the next.

    Attributes:
        to: name of the station it ends at.
        least: shortest time of every joint [s], shape (nv,).
    """

    to: str
    least: np.ndarray

    @property
    def slowest(self) -> int:
        return int(np.argmax(self.least))

    @property
    def time(self) -> float:
        return float(self.least[self.slowest])


def kinematic_minimum(problem: Problem, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Least time [s] each joint needs from ``start`` to ``goal`` (nv,) with the problem's boundary velocities and accelerations.

    For a joint that is not at rest there only the velocity limit is counted (still a lower bound).
    """
    d = np.abs(np.asarray(goal) - np.asarray(start))
    return least_times(problem.limits, d, *_rests(problem))


def least_times(limits: Limits, distance: np.ndarray, from_rest: np.ndarray, to_rest: np.ndarray) -> np.ndarray:
    """Least time [s] of every joint, shape (nv,).

    Args:
        limits: velocity, acceleration and jerk count.
        distance: of each joint [rad or m], shape (nv,), not negative.
        from_rest, to_rest: whether velocity and acceleration vanish at the ends, shape (nv,).
    """
    v, a, j = limits.velocity, limits.acceleration, limits.jerk
    with np.errstate(all="ignore"):
        between_rests = _between_rests(distance, v, a, j)
        cruise = np.where(distance * 2 * a >= v * v, distance / v + v / (2 * a), np.sqrt(2 * distance / a))
        one_ramp = np.maximum(_number(cruise), np.cbrt(6 * distance / j))
    times = np.where(from_rest & to_rest, between_rests, np.where(from_rest | to_rest, one_ramp, 0.0))
    return np.maximum(distance / v, times)


def check_times(problem: Problem, goal: np.ndarray | None) -> None:
    """Raise where the way takes longer than the time there is for it.

    Args:
        problem: what is asked.
        goal: joint positions at the end, shape (nv,); None where they are not known.

    Raises:
        ProblemError: names the slowest joint of each leg, the time it needs, and the time there is.
    """
    began, before, legs = 0.0, "start", []
    for leg, time in legs_of(problem, goal):
        legs.append(leg)
        if time is None:
            continue
        if sum(leg.time for leg in legs) > (time - began) * (1 + ROUNDING):
            raise _too_little_time(problem, before, legs, time - began)
        began, before, legs = time, leg.to, []


def check_changes(problem: Problem, goal: np.ndarray | None) -> None:
    """Raise where velocity, acceleration or torque differ more between both ends than their rates can change them.

    Raises:
        ProblemError: names the joint, the change, the time it takes, and the rate that would do.
    """
    limits, T = problem.limits, problem.duration
    changes = [
        ("acceleration", "velocity", problem.start_velocity, problem.goal_velocity),
        ("jerk", "acceleration", problem.start_acceleration, problem.goal_acceleration),
    ]
    if goal is not None:
        torque = problem.robot.torque
        held = torque(problem.start, problem.start_velocity, problem.start_acceleration)
        changes.append(("torque_rate", "torque", held, torque(goal, problem.goal_velocity, problem.goal_acceleration)))
    for rate, what, first, last in changes:
        bound, change = getattr(limits, rate), np.abs(last - first)
        i = int(np.argmax(change / bound))
        if change[i] > bound[i] * T * (1 + ROUNDING):
            key = f"{rate}_limits"
            words = f"{joint(problem, i)} has to change its {what} from {first[i]:.4g} at the start to {last[i]:.4g} at the goal"
            least = f"at least {change[i] / bound[i]:.4g} s at its limit {bound[i]:.4g}, {T:.4g} s are given"
            remedy = f"allow more time, or {called(problem, key)} of at least {change[i] / T:.4g}"
            raise impossible(problem, key, f"{words}, which takes {least}; {remedy}")


def _between_rests(d: np.ndarray, v: np.ndarray, a: np.ndarray, j: np.ndarray) -> np.ndarray:
    """The formula of the module's text; NaN, where two infinities met, means no ramp."""
    ramp = _number(np.where(v * j <= a * a, 2 * np.sqrt(v / j), v / a + a / j))
    only_jerk = np.cbrt(32 * d / j)
    rise = _number(a / j)
    short = np.where(j * j * d <= 2 * a**3, only_jerk, rise + np.sqrt(rise * rise + 4 * d / a))
    return np.where(d >= v * ramp, d / v + ramp, short)


def _number(x: np.ndarray) -> np.ndarray:
    return np.where(np.isnan(x), 0.0, x)


def _rests(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Joints at rest at the start and at the goal, each (nv,)."""
    if problem.periodic:
        return (np.zeros(problem.robot.nv, bool),) * 2
    starts = (problem.start_velocity == 0) & (problem.start_acceleration == 0)
    return starts, (problem.goal_velocity == 0) & (problem.goal_acceleration == 0)


def legs_of(problem: Problem, goal: np.ndarray | None) -> list[tuple[Leg, float | None]]:
    """Every leg with the time at which it has to end; None where the optimiser chooses.

    Args:
        problem: what is asked, with a given duration. goal: joint positions at the end (nv,), None where they are not known.
    """
    stations = [(w.position, w.time, f"waypoints[{k}]") for k, w in enumerate(problem.waypoints)]
    stations.append((goal, problem.duration, "goal"))
    at_start, at_goal = _rests(problem)
    never = np.zeros(problem.robot.nv, bool)
    legs, here = [], problem.start
    for k, (there, time, name) in enumerate(stations):
        there = here if there is None else there  # a Cartesian goal: the way to it is not known
        rests = at_start if k == 0 else never, at_goal if name == "goal" and goal is not None else never
        legs.append((Leg(name, least_times(problem.limits, np.abs(there - here), *rests)), time))
        here = there
    return legs


def _too_little_time(problem: Problem, before: str, legs: list[Leg], given: float) -> Exception:
    needed, end = sum(leg.time for leg in legs), legs[-1].to
    remedy = f"{_feasible(problem)}allow more time, a shorter way, or higher limits"
    if len(legs) == 1:
        words = f"{joint(problem, legs[0].slowest)} needs at least {needed:.4g} s from {before} to {end} under its limits"
        return impossible(problem, "duration" if end == "goal" else end, f"{words}, {given:.4g} s are given; {remedy}")
    parts = [f"{leg.time:.4g} s to {leg.to} ({joint(problem, leg.slowest)})" for leg in legs if leg.time > 0]
    listed = ", ".join(parts[:4]) + (", …" if len(parts) > 4 else "")
    words = f"the way from {before} through {legs[0].to}{' …' if len(legs) > 2 else ''} to {end} takes at least {needed:.4g} s"
    return impossible(problem, legs[0].to, f"{words} under the limits: {listed}; {given:.4g} s are given; {remedy}")


def _feasible(problem: Problem) -> str:
    """What is known of a duration that suffices, for messages."""
    from energyopt.durations import duration_bounds  # it judges motions, which this module knows nothing of

    upper = duration_bounds(problem).upper
    return "" if upper is None else f"{upper:.4g} s is known to be feasible; "
