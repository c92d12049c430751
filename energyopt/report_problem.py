"""The part of a report that says what was asked: ends, weights, limits, the arm."""

from __future__ import annotations

import numpy as np

from energyopt.actuators import Actuators
from energyopt.costs import formula
from energyopt.geometry.exact import obstacle_names
from energyopt.problem import FramePose, Problem
from energyopt.report_parts import Cell, Markup, definitions, section, table


def problem_sections(problem: Problem) -> list[Markup]:
    """What is asked, and of which arm."""
    return [_asked(problem), _joints(problem)]


def _asked(problem: Problem) -> Markup:
    dynamics, model = problem.robot.dynamics, problem.robot.model
    span = dict.fromkeys(problem.durations)  # one time where it is given
    facts = {"Robot": problem.robot.name, "Goal": _goal(problem), "Duration": " to ".join(f"{t:g}" for t in span) + " s"}
    if problem.costs is None:
        facts["Weight λ of Σq̇²"] = _values(problem.velocity_weight)
        facts["Weight w of Στ²"] = _values(problem.torque_weights)
    else:
        facts["Minimised"] = formula(problem.costs)
        facts |= {f"Weights w of {t.symbol}": _values(t.weights) for t in problem.costs if np.any(getattr(t, "weights", 1) != 1)}
    for k, waypoint in enumerate(problem.waypoints, start=1):
        when = "at a time left free" if waypoint.time is None else f"at {waypoint.time:g} s"
        facts[f"Waypoint {k}, {when}"] = _values(waypoint.position)
    for end in ("start", "goal"):
        for kind in ("velocity", "acceleration"):
            value = getattr(problem, f"{end}_{kind}")
            if np.any(value):
                facts[f"{end.capitalize()} {kind}"] = _values(value)
    facts["Gravity"] = f"{_values(model.gravity.linear)} m/s²"
    for name, value, unit in (
        ("Armature", dynamics.armature, "kg·m²"),
        ("Viscous friction", dynamics.viscous_friction, "N·m·s/rad"),
        ("Coulomb friction", dynamics.coulomb_friction, "N·m"),
    ):
        facts[name] = f"{_values(value)} {unit}" if np.any(value) else "none"
    if problem.robot.actuators is not None:
        facts["Drives"] = _drives(problem.robot.actuators)
    return section("What was asked", definitions(facts | _kept_clear(problem)))


def _drives(drives: Actuators) -> str:
    bus = "one shared bus" if drives.shared_bus else "each for itself"
    power = f"{drives.constant_power:.4g} W drawn at all times"
    return "; ".join([bus, power, *([f"from {drives.source}"] if drives.source else [])])


def _kept_clear(problem: Problem) -> dict[str, str]:
    """What the arm keeps clear of; nothing where that is only itself, with no distance asked."""
    facts = {}
    for name, shape in zip(obstacle_names(problem.obstacles), problem.obstacles, strict=True):
        pose, moves = shape.pose_at(0.0), ", moving" if shape.moves else ""
        facts[f"Obstacle {name}"] = f"{shape.kind} at {_values(pose[:3, 3])} m{moves}"
    for item in problem.workspace:
        bound = ", ".join(item.frames) or "the whole arm"
        facts[f"Workspace {item.region.name}".strip()] = f"{item.region.kind} for {bound}"
    for item in problem.attached:
        facts[f"Attached {item.name}"] = f"{item.shape.kind} at {item.frame or problem.robot.tool_frame}"
    if problem.potential is not None:
        own = problem.potential
        facts["Repulsive potential"] = f"gain {own.gain:.4g} N²·m⁴, felt below {own.safe_distance:.4g} m"
    if facts or problem.clearance:
        facts["Clearance"] = f"{problem.clearance:.4g} m"
    if not problem.self_collision:
        facts["Self-collision"] = "allowed"
    return facts


def _joints(problem: Problem) -> Markup:
    limits, goal = problem.limits, problem.goal_position
    columns = {"Start": problem.start, "Goal": goal, "Lower": limits.lower, "Upper": limits.upper, "Velocity": limits.velocity}
    columns |= {
        "Acceleration": limits.acceleration,
        "Jerk": limits.jerk,
        "Torque": limits.torque,
        "Torque rate": limits.torque_rate,
    }
    columns = {name: value for name, value in columns.items() if value is not None and np.any(np.isfinite(value))}
    rows = [
        [joint, *(Cell(f"{value[i]:.5g}" if np.isfinite(value[i]) else "∞", "n") for value in columns.values())]
        for i, joint in enumerate(problem.robot.joint_names)
    ]
    text = "SI units and radians (metres and newtons for joints that slide). Limits that are not set have no column."
    return section("Joints", table(["Joint", *(f"{name}|n" for name in columns)], rows), text)


def _goal(problem: Problem) -> str:
    goal = problem.goal
    if not isinstance(goal, FramePose):
        return "joint positions, below"
    turned = "in any orientation" if goal.rotation is None else "in a given orientation"
    return f"{goal.frame} at {_values(goal.position)} m, {turned}"


def _values(array: np.ndarray) -> str:
    """One number where all are equal, else all of them."""
    array = np.atleast_1d(array)
    if len(array) > 1 and np.all(array == array[0]):
        return f"{array[0]:.4g} for each"
    return ", ".join(f"{value:.4g}" for value in array)
