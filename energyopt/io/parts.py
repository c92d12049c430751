"""Robots and problems as arrays and plain values, and back: the inner parts of a plan file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from energyopt.dynamics.body import Dynamics
from energyopt.io.energy_parts import actuators_from_meta, actuators_meta, costs_from_meta, costs_meta
from energyopt.io.shape_parts import avoidance_arrays, avoidance_from_arrays
from energyopt.problem import FramePose, Problem, Waypoint
from energyopt.robots import Limits, RobotModel
from energyopt.robots.lint import lint_bodies, lint_links
from energyopt.robots.urdf_xml import child_link, moving_joints, parse_urdf

Arrays = dict[str, np.ndarray]

LIMIT_KINDS = ("velocity", "torque", "acceleration", "jerk", "torque_rate")
_VECTORS = ("velocity_weight", "torque_weights", "start_velocity", "goal_velocity", "start_acceleration", "goal_acceleration")


def robot_arrays(robot: RobotModel, arrays: Arrays) -> dict[str, Any]:
    """Put the robot's numbers into ``arrays``; returns what is no array. The URDF text is stored apart."""
    dynamics = robot.dynamics
    arrays["robot.gravity"] = np.array(dynamics.model.gravity.linear)
    arrays["robot.armature"] = dynamics.armature
    arrays["robot.viscous_friction"] = np.asarray(dynamics.viscous_friction, float)
    arrays["robot.coulomb_friction"] = np.asarray(dynamics.coulomb_friction, float)
    arrays["robot.coulomb_velocity"] = np.array(dynamics.coulomb_velocity)
    arrays["robot.home"] = np.asarray(robot.home, float)
    arrays |= {f"robot.limits.{key}": np.asarray(getattr(robot.limits, key), float) for key in ("lower", "upper", *LIMIT_KINDS)}
    paths = {"source": robot.source, "srdf": robot.srdf}
    return {
        "name": robot.name,
        "tool_frame": robot.tool_frame,
        "notes": list(robot.notes),
        "package_dirs": [str(p) for p in robot.package_dirs],
        "actuators": actuators_meta(robot.actuators),
        **{key: None if path is None else str(path) for key, path in paths.items()},
    }


def robot_from_arrays(meta: dict[str, Any], urdf: str, arrays: Arrays) -> RobotModel:
    """The robot of `robot_arrays`.

    Raises:
        RobotError: the URDF is not a possible robot.
        KeyError, ValueError: something is missing or has another shape.
    """
    root = parse_urdf(urdf, "its robot")
    lint_links(root, "its robot")
    try:
        model = pin.buildModelFromXML(urdf)
    except Exception as error:  # the bindings raise several types, none documented
        raise ValueError(f"Pinocchio cannot build its robot: {error}") from None
    if model.nq != model.nv or model.nv == 0:
        raise ValueError(f"its robot has {model.nq} positions and {model.nv} velocities; expected as many, and one at least")
    lint_bodies(model, {j.get("name"): child_link(j) for j in moving_joints(root)}, "its robot")
    nv = model.nv
    limits = _limits(arrays, "limits.", nv)
    model.gravity = pin.Motion(_vector(arrays, "gravity", 3), np.zeros(3))
    model.armature = _vector(arrays, "armature", nv)
    model.lowerPositionLimit, model.upperPositionLimit = np.array(limits.lower), np.array(limits.upper)
    model.velocityLimit, model.effortLimit = np.array(limits.velocity), np.array(limits.torque)
    friction = [_vector(arrays, f"{kind}_friction", nv) for kind in ("viscous", "coulomb")]
    robot = RobotModel(
        name=str(meta["name"]),
        dynamics=Dynamics(model, *friction, _friction_velocity(arrays, nv)),
        limits=limits,
        urdf=urdf,
        package_dirs=tuple(Path(str(p)) for p in meta["package_dirs"]),
        tool_frame=str(meta["tool_frame"]),
        notes=tuple(str(note) for note in meta["notes"]),
        home=_vector(arrays, "home", nv),
        actuators=actuators_from_meta(meta.get("actuators"), nv),
        **{key: None if meta[key] is None else Path(str(meta[key])) for key in ("source", "srdf")},
    )
    robot.frame_id(robot.tool_frame)
    return robot


def problem_arrays(problem: Problem, arrays: Arrays) -> dict[str, Any]:
    """Put the problem's numbers into ``arrays``; returns what is no array."""
    goal = problem.goal
    arrays["problem.start"] = problem.start
    if isinstance(goal, FramePose):
        arrays["problem.goal_position"] = goal.position
        if goal.rotation is not None:
            arrays["problem.goal_rotation"] = goal.rotation
    else:
        arrays["problem.goal"] = goal
    arrays["problem.duration"] = np.array(problem.duration)
    arrays |= {f"problem.{key}": getattr(problem, key) for key in _VECTORS}
    if problem.waypoints:
        arrays["problem.waypoints"] = np.array([w.position for w in problem.waypoints])
    limits = problem.limits
    given = [kind for kind in ("position", *LIMIT_KINDS) if getattr(problem, f"{kind}_limits") is not None]
    sides = [side for kind in given for side in (("lower", "upper") if kind == "position" else (kind,))]
    arrays |= {f"problem.limits.{side}": np.asarray(getattr(limits, side), float) for side in sides}
    return {
        "name": problem.name,
        "periodic": bool(problem.periodic),
        "goal_frame": goal.frame if isinstance(goal, FramePose) else None,
        "waypoint_times": [w.time for w in problem.waypoints],
        "costs": None if problem.costs is None else costs_meta(problem.costs, problem.robot.actuators),
        **avoidance_arrays(problem, arrays),
    }


def problem_from_arrays(meta: dict[str, Any], robot: RobotModel, arrays: Arrays) -> Problem:
    """The problem of `problem_arrays`.

    Raises:
        ProblemError: its values do not fit each other.
        KeyError, ValueError: something is missing or has another shape.
    """
    nv = robot.nv
    if meta["goal_frame"] is None:
        goal = _vector(arrays, "goal", nv)
    else:
        rotation = arrays.get("goal_rotation")
        goal = FramePose(str(meta["goal_frame"]), _vector(arrays, "goal_position", 3), rotation)
    times, points = meta["waypoint_times"], arrays.get("waypoints", np.empty((0, nv)))
    if points.shape != (len(times), nv):
        raise ValueError(f"problem.waypoints has the shape {points.shape}; expected {(len(times), nv)}")
    limits = {f"{kind}_limits": _bound(arrays, f"limits.{kind}", nv) for kind in LIMIT_KINDS if f"limits.{kind}" in arrays}
    if "limits.lower" in arrays:
        limits["position_limits"] = (_bound(arrays, "limits.lower", nv), _bound(arrays, "limits.upper", nv))
    return Problem(
        robot,
        start=_vector(arrays, "start", nv),
        goal=goal,
        duration=_duration(arrays),
        waypoints=tuple(Waypoint(p, None if t is None else float(t)) for p, t in zip(points, times, strict=True)),
        name=str(meta["name"]),
        periodic=bool(meta.get("periodic", False)),
        costs=None if meta.get("costs") is None else costs_from_meta(meta["costs"], robot.actuators, nv),
        **{key: _vector(arrays, key, nv) for key in _VECTORS},
        **limits,
        **avoidance_from_arrays(meta, arrays),
    )


def _friction_velocity(arrays: Arrays, nv: int) -> float | np.ndarray:
    if arrays["coulomb_velocity"].ndim:
        return _vector(arrays, "coulomb_velocity", nv)
    return float(_vector(arrays, "coulomb_velocity", None))


def _duration(arrays: Arrays) -> float | tuple[float, float]:
    if arrays["duration"].ndim:
        least, most = _vector(arrays, "duration", 2).tolist()
        return least, most
    return float(_vector(arrays, "duration", None))


def _limits(arrays: Arrays, prefix: str, nv: int) -> Limits:
    limits = Limits(**{key: _bound(arrays, prefix + key, nv) for key in ("lower", "upper", *LIMIT_KINDS)})
    if not np.all(limits.lower < limits.upper) or any(np.any(getattr(limits, kind) <= 0) for kind in LIMIT_KINDS):
        raise ValueError("its joint limits are inverted or not positive")
    return limits


def _vector(arrays: Arrays, name: str, size: int | None) -> np.ndarray:
    array = _bound(arrays, name, size)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds a number that is not finite")
    return array


def _bound(arrays: Arrays, name: str, size: int | None) -> np.ndarray:
    """A member of the given size, one number where ``size`` is None; infinities pass."""
    array = arrays[name]
    if array.shape != (() if size is None else (size,)) or array.dtype != np.float64 or np.isnan(array).any():
        raise ValueError(
            f"{name} has the shape {array.shape} and the type {array.dtype}; expected {size or 1} numbers, none of them nan"
        )
    array.flags.writeable = False
    return array
