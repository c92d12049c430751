"""The dense check of a motion, and its cost, both independent of the nonlinear program that made it.

Positions, velocities, accelerations and jerks are compared with their limits at dense samples of every smooth span
and at the exact extrema between them (see `sampling`), so for piecewise polynomials these verdicts hold for ALL t.
Torques come from numeric Pinocchio at the same samples, the largest one of every joint refined by a parabola through
its neighbours. The torque rate is the derivative of inverse dynamics along the motion's own Taylor expansion,

    dτ/dt ≈ ( τ(q + εv + ε²a/2, v + εa + ε²j/2, a + εj) − τ(q − εv + ε²a/2, v − εa + ε²j/2, a − εj) ) / 2ε,

which stays on one side of every break. A jump of an acceleration or torque at a break counts as a rate over one sample.
The cost is J = ∫₀ᵀ (Σ wᵢ τᵢ² + Σ λᵢ q̇ᵢ²) dt by six-point Gauss quadrature on every span.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from energyopt.parameterizations.trajectory import Trajectory
from energyopt.plans import Violations
from energyopt.problem import FramePose, Problem
from energyopt.sampling import Samples, extrema, gauss_grid, sample_spans

TOLERANCES = {
    "position": 1e-6,  # rad or m
    "velocity": 1e-6,  # rad/s or m/s
    "acceleration": 1e-6,  # rad/s² or m/s²
    "torque_percent": 1e-2,  # % of the joint's limit
    "boundary": 1e-6,  # rad, rad/s, rad/s²: start and goal
    "continuity": 1e-6,  # rad, rad/s: jumps at breaks
    "goal": 1e-5,  # m + rad: Cartesian goal
    "waypoint": 1e-6,  # rad
    "duration": 1e-9,  # s
}
"""Largest excess, in the unit of the entry of `Violations.amount`, with which a motion still counts as valid."""

RELATIVE_TOLERANCES = {"jerk": 1e-4, "torque_rate": 1e-2}
"""The same in % of the limit, for rates whose limits differ by orders of magnitude."""

UNITS = {
    "position": "rad",
    "velocity": "rad/s",
    "acceleration": "rad/s²",
    "jerk": "rad/s³",
    "torque_percent": "% of its torque limit",
    "torque_rate": "N·m/s",
    "boundary": "rad (rad/s, rad/s²)",
    "continuity": "rad (rad/s)",
    "goal": "m + rad",
    "waypoint": "rad",
    "duration": "s",
}

LIMIT_NAMES = ("position", "velocity", "acceleration", "jerk", "torque_percent", "torque_rate")
"""The entries that are limits; the others are conditions on the motion's ends and on what it passes."""

_RATE_STEP = 1e-5
"""ε [s] of the torque rate: truncation ε²τ⃛/6 and rounding 1e-16·τ/ε are both near 1e-9 relative."""


@dataclass(frozen=True)
class _Finding:
    """One line of the check: the worst excess, the smallest margin [% of the limit], and where that is."""

    name: str
    amount: float
    margin: float | None = None
    joint: str = ""
    time: float = 0.0


def verify(problem: Problem, trajectory: Trajectory, per_span: int = 20) -> Violations:
    """Check a motion against everything its problem asks.

    Args:
        problem: limits, boundary conditions, waypoints, duration.
        trajectory: the motion.
        per_span: samples a smooth span; torques hold at these, kinematic limits also between them.

    Returns:
        Violations: limits that are infinite for every joint have no entry; ``boundary``, ``continuity`` and
        ``duration`` always do, ``goal`` where the goal is Cartesian, ``waypoint`` where there are waypoints.
    """
    samples = sample_spans(trajectory, per_span)
    findings = [
        *_kinematic_findings(problem, trajectory, samples),
        *_torque_findings(problem, samples),
        _boundary_finding(problem, trajectory),
        _continuity_finding(problem, samples),
        _Finding("duration", abs(trajectory.duration - problem.duration), time=trajectory.duration),
    ]
    if isinstance(problem.goal, FramePose):
        findings.append(_goal_finding(problem, trajectory))
    if problem.waypoints:
        from energyopt.waypoints import waypoint_misses

        misses = waypoint_misses(problem, trajectory)
        worst = max(misses, key=lambda miss: miss[0])
        findings.append(_Finding("waypoint", worst[0], joint=worst[1], time=worst[2]))
    found = [f for f in findings if f is not None]
    return Violations(
        amount={f.name: f.amount for f in found},
        margin={f.name: f.margin for f in found if f.margin is not None},
        worst={f.name: (f.joint, f.time) for f in found},
    )


def is_valid(violations: Violations) -> bool:
    """Whether every entry is within `TOLERANCES` (for rates, `RELATIVE_TOLERANCES`); NaN never is."""
    return not excessive(violations)


def limits_hold(violations: Violations) -> bool:
    """Whether the limits hold, whatever the ends of the motion are (a cubic starts with an acceleration, say)."""
    return not any(name in LIMIT_NAMES or name == "continuity" for name in excessive(violations))


def excessive(violations: Violations) -> list[str]:
    """Names of the entries beyond their tolerance, the relatively worst first."""
    ratios = {}
    for name, amount in violations.amount.items():
        if name in RELATIVE_TOLERANCES:
            ratios[name] = -violations.margin[name] / RELATIVE_TOLERANCES[name]
        else:
            ratios[name] = amount / TOLERANCES[name]
    ratios = {name: np.inf if np.isnan(ratio) else ratio for name, ratio in ratios.items()}
    return sorted((name for name, ratio in ratios.items() if ratio > 1.0), key=lambda name: -ratios[name])


def describe(violations: Violations) -> str:
    """One sentence: the worst broken limit with joint, time and amount, or the tightest one where all hold."""
    broken = excessive(violations)
    if not broken:
        if not violations.margin:
            return "every condition holds; no joint has a finite limit"
        name = min(violations.margin, key=violations.margin.get)
        joint, time = violations.worst[name]
        return f"every limit holds; tightest: {_plain(name)} of {joint} at {time:.3f} s ({max(violations.margin[name], 0.0):.2g} % left)"
    name = broken[0]
    amount, (joint, time) = violations.amount[name], violations.worst[name]
    others = f" (also broken: {', '.join(map(_plain, broken[1:]))})" if len(broken) > 1 else ""
    if np.isnan(amount):
        return f"the motion is not a number: {_plain(name)} cannot be checked{others}"
    if name in LIMIT_NAMES:
        return f"{_plain(name)} of {joint} exceeds its limit by {amount:.3g} {UNITS[name]} at {time:.3f} s{others}"
    place = f" at {joint}" if joint else ""
    return f"{_plain(name)} condition missed by {amount:.3g} {UNITS[name]}{place}, t = {time:.3f} s{others}"


def cost(problem: Problem, trajectory: Trajectory, per_span: int = 6) -> dict[str, float]:
    """The terms of J, recomputed by numeric Pinocchio on a Gauss grid; J is `objective` of them.

    Args:
        problem: robot and weights.
        trajectory: the motion.
        per_span: Gauss nodes a span.

    Returns:
        ``torque_squared`` ∫Σwτ² and ``velocity_squared`` ∫Σλq̇², weighted as in J.
    """
    torque, velocity = _square_integrals(problem, trajectory, per_span)
    return {
        "torque_squared": float(problem.torque_weights @ torque),
        "velocity_squared": float(problem.velocity_weight @ velocity),
    }


def objective(problem: Problem, trajectory: Trajectory) -> float:
    """J of a motion."""
    return sum(cost(problem, trajectory).values())


def unweighted_integrals(problem: Problem, trajectory: Trajectory, per_span: int = 6) -> dict[str, float]:
    """``torque_squared`` ∫Στ² dt [N²·m²·s] and ``velocity_squared`` ∫Σq̇² dt [rad²/s], without the weights of J."""
    torque, velocity = _square_integrals(problem, trajectory, per_span)
    return {"torque_squared": float(torque.sum()), "velocity_squared": float(velocity.sum())}


def _plain(name: str) -> str:
    return name.removesuffix("_percent").replace("_", " ")


def _square_integrals(problem: Problem, trajectory: Trajectory, per_span: int) -> tuple[np.ndarray, np.ndarray]:
    t, weights = gauss_grid(trajectory, per_span)
    q, v, a = (trajectory(t, order) for order in range(3))
    return weights @ problem.robot.torque(q, v, a) ** 2, weights @ v**2


def _kinematic_findings(problem: Problem, trajectory: Trajectory, samples: Samples) -> list[_Finding | None]:
    limits, found = problem.limits, []
    bounds = {
        "position": (limits.lower, limits.upper),
        "velocity": (-limits.velocity, limits.velocity),
        "acceleration": (-limits.acceleration, limits.acceleration),
        "jerk": (-limits.jerk, limits.jerk),
    }
    for order, (name, (lower, upper)) in enumerate(bounds.items()):
        if not np.any(np.isfinite(lower) | np.isfinite(upper)):
            continue
        times, values = extrema(trajectory, order)
        t = np.concatenate([np.repeat(samples.t.reshape(-1, 1), trajectory.nv, axis=1), times])
        values = np.concatenate([samples.flat(order), values])
        if order == 3:
            t, values = _with_jumps(t, values, samples.t, samples.derivative(2))
        found.append(_bounded(problem, name, t, values, lower, upper))
    return found


def _torque_findings(problem: Problem, samples: Samples) -> list[_Finding | None]:
    limits, robot = problem.limits, problem.robot
    if not np.any(np.isfinite(limits.torque) | np.isfinite(limits.torque_rate)):
        return []
    q, v, a = (samples.flat(order) for order in range(3))
    shape = (*samples.t.shape, robot.nv)
    t = np.repeat(samples.t.reshape(-1, 1), robot.nv, axis=1)
    found, tau = [], robot.torque(q, v, a)
    if np.any(np.isfinite(limits.torque)):
        peak_t, peak = _parabolic_peaks(samples.t, tau.reshape(shape))
        times, values = np.vstack([t, peak_t]), np.vstack([tau, peak])
        found.append(_bounded(problem, "torque_percent", times, values, -limits.torque, limits.torque))
    if np.any(np.isfinite(limits.torque_rate)):
        j, e = samples.flat(3), _RATE_STEP
        ahead = robot.torque(q + e * v + 0.5 * e * e * a, v + e * a + 0.5 * e * e * j, a + e * j)
        behind = robot.torque(q - e * v + 0.5 * e * e * a, v - e * a + 0.5 * e * e * j, a - e * j)
        times, rate = _with_jumps(t, (ahead - behind) / (2 * e), samples.t, tau.reshape(shape))
        found.append(_bounded(problem, "torque_rate", times, rate, -limits.torque_rate, limits.torque_rate))
    return found


def _bounded(problem: Problem, name: str, t: np.ndarray, values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> _Finding | None:
    """The finding for ``lower`` ≤ ``values`` ≤ ``upper``; times and values have shape (M, nv)."""
    with np.errstate(invalid="ignore"):
        excess = np.maximum(values - upper, lower - values)
        half = np.where(np.isfinite(upper - lower), 0.5 * (upper - lower), 1.0)
    # An infinite limit is never exceeded, but a value that is not a number must not pass for one that holds.
    excess = np.where(np.isnan(values), np.nan, excess)
    half = np.where(half > 0, half, 1.0)
    percent = 100.0 * excess / half
    row, joint = np.unravel_index(np.argmax(np.where(np.isnan(percent), np.inf, percent)), percent.shape)
    amounts = percent if name == "torque_percent" else excess
    amount = np.max(amounts)
    margin = -float(percent[row, joint])
    return _Finding(name, float(amount) if not amount <= 0 else 0.0, margin, problem.robot.joint_names[joint], float(t[row, joint]))


def _parabolic_peaks(t: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of the parabolas through every joint's largest |τ| and its two neighbours in the same span, shape (1, nv)."""
    spans, count, nv = tau.shape
    index = np.argmax(np.abs(tau).reshape(-1, nv), axis=0)
    span, left, joint = index // count, np.clip(index % count, 1, count - 2), np.arange(nv)
    before, at, after = (tau[span, left + d, joint] for d in (-1, 0, 1))
    slope, curvature = 0.5 * (after - before), after - 2.0 * at + before
    with np.errstate(all="ignore"):
        shift = -slope / curvature
    shift = np.where(np.abs(shift) <= 1.0, shift, 0.0)
    step = t[span, left + 1] - t[span, left]
    return (t[span, left] + shift * step)[None], (at + slope * shift + 0.5 * curvature * shift**2)[None]


def _with_jumps(t: np.ndarray, rates: np.ndarray, times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rates (M, nv) and, below them, those of the jumps of ``values`` (K, S, nv) at breaks, taken over one sample."""
    jump = values[1:, 0] - values[:-1, -1]
    step = np.minimum(np.diff(times[1:, :2], axis=1), np.diff(times[:-1, :2], axis=1))
    # Rounding is not a jump: coefficients of neighbouring spans agree to about 1e-12 of the values themselves.
    jump = np.where(np.abs(jump) > 1e-9 * (1.0 + np.abs(values[1:, 0])), jump, 0.0)
    at = np.repeat(times[1:, :1], values.shape[2], axis=1)
    return np.vstack([t, at]), np.vstack([rates, jump / step])


def _boundary_finding(problem: Problem, trajectory: Trajectory) -> _Finding:
    ends = [(0.0, [problem.start, problem.start_velocity, problem.start_acceleration])]
    ends.append((trajectory.duration, [problem.goal_position, problem.goal_velocity, problem.goal_acceleration]))
    found = []
    for time, wanted in ends:
        for order, value in enumerate(wanted):
            if value is not None:
                error = np.abs(trajectory(time, order) - value)
                joint = int(np.argmax(np.where(np.isnan(error), np.inf, error)))
                found.append(_Finding("boundary", float(error[joint]), None, problem.robot.joint_names[joint], time))
    return max(found, key=lambda f: np.inf if np.isnan(f.amount) else f.amount)


def _continuity_finding(problem: Problem, samples: Samples) -> _Finding:
    worst = _Finding("continuity", 0.0)
    for order in (0, 1):
        values = samples.derivative(order)
        jump = np.abs(values[1:, 0] - values[:-1, -1])
        if jump.size and not jump.max() <= worst.amount:
            span, joint = np.unravel_index(np.argmax(np.where(np.isnan(jump), np.inf, jump)), jump.shape)
            worst = _Finding("continuity", float(jump[span, joint]), None, problem.robot.joint_names[joint], float(samples.t[span + 1, 0]))
    return worst


def _goal_finding(problem: Problem, trajectory: Trajectory) -> _Finding:
    goal, end = problem.goal, trajectory(trajectory.duration)
    pose = problem.robot.placement(goal.frame, end)
    error = float(np.linalg.norm(pose.translation - goal.position))
    if goal.rotation is not None:
        error += float(np.linalg.norm(pin.log3(pose.rotation.T @ goal.rotation)))
    return _Finding("goal", error, None, goal.frame, trajectory.duration)
