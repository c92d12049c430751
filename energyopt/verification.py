"""The dense check of a motion, and its cost, both independent of the nonlinear program that made it.

A motion is valid if it starts, ends and passes where the problem says, has the asked duration, does not jump,
holds every limit (see `limit_checks` for how each is judged, and where: for all t, or at dense samples), and keeps the
clearance from everything at all times (see `clearance`).
The cost is J = ∫₀ᵀ (Σ wᵢ τᵢ² + Σ λᵢ q̇ᵢ² + U) dt, or that of other cost terms, by six-point Gauss quadrature on every span, U
being the potential.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from energyopt.avoidance import avoidance_of
from energyopt.clearance_checks import clearance_of
from energyopt.costs import Samples as CostSamples
from energyopt.limit_checks import Finding, kinematic_findings, torque_findings
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.plans import Violations
from energyopt.problem import FramePose, Problem
from energyopt.sampling import Samples, gauss_grid, sample_spans
from energyopt.waypoints import waypoint_misses

TOLERANCES = {
    "position": 1e-6,  # rad or m
    "velocity": 1e-6,  # rad/s or m/s
    "acceleration": 1e-6,  # rad/s² or m/s²
    "torque_percent": 1e-2,  # % of the joint's limit
    "boundary": 1e-6,  # rad, rad/s: start and goal; accelerations as a share of the largest in the motion (or of 1 rad/s²)
    "continuity": 1e-6,  # rad, rad/s: jumps at breaks
    "goal": 1e-5,  # m + rad: Cartesian goal
    "waypoint": 1e-6,  # rad
    "clearance": 1e-6,  # m
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
    "clearance": "m",
    "duration": "s",
}

LIMIT_NAMES = ("position", "velocity", "acceleration", "jerk", "torque_percent", "torque_rate")
"""The entries that are limits; the others are conditions on the motion's ends and on what it passes."""


COULOMB_NODES = 40
"""Least Gauss nodes a span of `cost` where there is Coulomb friction: it changes sign within a short part of a span."""


POTENTIAL_NODES = 20
"""Least Gauss nodes a span of the potential, which begins and ends within a span."""


def verify(problem: Problem, trajectory: Trajectory, per_span: int = 20, distances: bool = True) -> Violations:
    """Check a motion against everything its problem asks.

    Args:
        problem: limits, boundary conditions, waypoints, duration.
        trajectory: the motion.
        per_span: samples a smooth span; torques hold at these, kinematic limits also between them.
        distances: whether clearance is checked too.

    Returns:
        Violations: limits that are infinite for every joint have no entry; ``boundary``, ``continuity`` and
        ``duration`` always do, ``goal`` where the goal is Cartesian, ``waypoint`` where there are waypoints.
    """
    samples = sample_spans(trajectory, per_span)
    findings = [
        *kinematic_findings(problem, trajectory, samples),
        *torque_findings(problem, samples),
        _boundary_finding(problem, trajectory),
        _continuity_finding(problem, samples),
        Finding("duration", abs(trajectory.duration - problem.duration), time=trajectory.duration),
    ]
    if isinstance(problem.goal, FramePose):
        findings.append(_goal_finding(problem, trajectory))
    if problem.waypoints:
        worst = max(waypoint_misses(problem, trajectory), key=lambda miss: miss[0])
        findings.append(Finding("waypoint", worst[0], joint=worst[1], time=worst[2]))
    found, least = [f for f in findings if f is not None], None
    if distances and (verdict := clearance_of(problem, trajectory)) is not None:
        finding, least = verdict
        found.append(finding)
    return Violations(
        amount={f.name: f.amount for f in found},
        margin={f.name: f.margin for f in found if f.margin is not None},
        worst={f.name: (f.joint, f.time) for f in found},
        distance=least,
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
        left = max(violations.margin[name], 0.0)
        return f"every limit holds; tightest: {_plain(name)} of {joint} at {time:.3f} s ({left:.2g} % left)"
    name = broken[0]
    amount, (joint, time) = violations.amount[name], violations.worst[name]
    others = f" (also broken: {', '.join(map(_plain, broken[1:]))})" if len(broken) > 1 else ""
    if np.isnan(amount):
        return f"the motion is not a number: {_plain(name)} cannot be checked{others}"
    if name in LIMIT_NAMES:
        return f"{_plain(name)} of {joint} exceeds its limit by {amount:.3g} {UNITS[name]} at {time:.3f} s{others}"
    if name == "clearance":
        depth = "touch" if np.isclose(violations.distance, 0.0, atol=1e-6) else f"are {1e3 * violations.distance:.1f} mm apart"
        depth = f"overlap by {-1e3 * violations.distance:.1f} mm" if violations.distance < -1e-6 else depth
        return f"{joint} {depth} at {time:.3f} s{others}"
    place = f" at {joint}" if joint else ""
    return f"{_plain(name)} condition missed by {amount:.3g} {UNITS[name]}{place}, t = {time:.3f} s{others}"


def cost(problem: Problem, trajectory: Trajectory, per_span: int = 6) -> dict[str, float]:
    """The terms of J, recomputed by numeric Pinocchio on a Gauss grid; J is `objective` of them.

    Args:
        problem: robot and weights.
        trajectory: the motion.
        per_span: Gauss nodes a span.

    Returns:
        by name of the cost term, such as ``torque_squared`` ∫Σwτ² and ``velocity_squared`` ∫Σλq̇², and where there is one the
        ``potential`` ∫U.
    """
    if np.any(problem.robot.dynamics.coulomb_friction) or problem.costs is not None:
        per_span = max(per_span, COULOMB_NODES)
    t, weights = gauss_grid(trajectory, per_span)
    q, v, a, jerk = (trajectory(t, order) for order in range(4))
    samples = CostSamples(q, v, a, jerk, problem.robot.torque(q, v, a))
    terms = {term.name: term.weight * float(weights @ term.integrand(samples).value) for term in problem.cost_terms}
    if problem.potential is not None and (spheres := avoidance_of(problem)) is not None:
        t, weights = gauss_grid(trajectory, max(per_span, POTENTIAL_NODES))
        terms["potential"] = float(weights @ spheres.potential_energy(t, trajectory(t)))
    return terms


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


def _boundary_finding(problem: Problem, trajectory: Trajectory) -> Finding:
    first = [problem.start, problem.start_velocity, problem.start_acceleration]
    last = [problem.goal_position, problem.goal_velocity, problem.goal_acceleration]
    if problem.periodic:
        first, last = [problem.start, None, None], [problem.start, trajectory(0.0, 1), trajectory(0.0, 2)]
    ends = [(0.0, first), (trajectory.duration, last)]
    # An acceleration is a second difference of coefficients: its rounding grows with the accelerations of the motion.
    scale = max(1.0, float(np.max(np.abs(trajectory(trajectory.breaks, 2)))))
    found = []
    for time, wanted in ends:
        for order, value in enumerate(wanted):
            if value is not None:
                error = np.abs(trajectory(time, order) - value) / (scale if order == 2 else 1.0)
                joint = int(np.argmax(np.where(np.isnan(error), np.inf, error)))
                found.append(Finding("boundary", float(error[joint]), None, problem.robot.joint_names[joint], time))
    return max(found, key=lambda f: np.inf if np.isnan(f.amount) else f.amount)


def _continuity_finding(problem: Problem, samples: Samples) -> Finding:
    worst = Finding("continuity", 0.0)
    for order in (0, 1):
        values = samples.derivative(order)
        jump = np.abs(values[1:, 0] - values[:-1, -1])
        if jump.size and not jump.max() <= worst.amount:
            span, joint = np.unravel_index(np.argmax(np.where(np.isnan(jump), np.inf, jump)), jump.shape)
            name, time = problem.robot.joint_names[joint], float(samples.t[span + 1, 0])
            worst = Finding("continuity", float(jump[span, joint]), None, name, time)
    return worst


def _goal_finding(problem: Problem, trajectory: Trajectory) -> Finding:
    goal, end = problem.goal, trajectory(trajectory.duration)
    pose = problem.robot.placement(goal.frame, end)
    error = float(np.linalg.norm(pose.translation - goal.position))
    if goal.rotation is not None:
        error += float(np.linalg.norm(pin.log3(pose.rotation.T @ goal.rotation)))
    return Finding("goal", error, None, goal.frame, trajectory.duration)
