"""Problem files: TOML → (Problem, options of `energyopt.plan`). The keys stand in `problem_schema`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from energyopt.errors import ProblemError, RobotError
from energyopt.io.avoidance_section import avoidance_arguments
from energyopt.io.energy_section import cost_terms
from energyopt.io.find import find_problem
from energyopt.io.poses import rotation_of
from energyopt.io.problem_schema import METHOD, PLAN_OPTIONS, PROBLEM_FILE
from energyopt.io.robot_section import build_robot
from energyopt.io.schema import nearest, validate
from energyopt.io.toml_text import Document, read_toml, shown
from energyopt.io.units import ANGULAR, convert, joint_factors
from energyopt.parameterizations import BSpline, HermiteSimpson, Sinusoid
from energyopt.problem import FramePose, Problem, Waypoint
from energyopt.robots import RobotModel

_CLASSES = {"bspline": BSpline, "sinusoid": Sinusoid, "hermite_simpson": HermiteSimpson}
_ANGULAR_KEYS = ("start", "goal", "start_velocity", "goal_velocity", "start_acceleration", "goal_acceleration")


def load_problem(path_or_name: str | Path) -> Problem:
    """The problem of a TOML file, or of a catalogue problem by its bare name such as "panda_reach".

    Raises:
        FileError: missing, unreadable or not text; nearest names are listed.
        ProblemError, RobotError: one line that names file, line, key, value and expectation.
    """
    return load_task(path_or_name)[0]


def load_task(path_or_name: str | Path, overrides: Mapping[str, Any] | None = None) -> tuple[Problem, dict[str, Any]]:
    """The problem of a file and how the file wants it solved.

    Args:
        path_or_name: path of a TOML file, or the bare name of a catalogue problem.
        overrides: values in place of the file's, by dotted key, such as {"problem.duration": 2.0}.

    Returns:
        problem; options: keyword arguments of `energyopt.plan` (parameterization, seed, starts, time_limit), those given only.

    Raises:
        as `load_problem`.
    """
    document = read_toml(find_problem(path_or_name))
    document = replace(document, overridden=frozenset(overrides or ()))
    _override(document.table, overrides or {})
    table = validate(document, PROBLEM_FILE)
    angles = table.get("angles", "rad")
    robot = build_robot(document, table["robot"], angles)
    problem = _problem(document, table, robot, angles)
    return problem, method_options(document, table.get("method", {}))


def method_options(document: Document, section: Mapping[str, Any]) -> dict[str, Any]:
    """Keyword arguments of `energyopt.plan` from a validated [method] section.

    Raises:
        ProblemError: an option belongs to another parameterisation, or does not fit.
    """
    options = {key: section[key] for key in PLAN_OPTIONS if key in section}
    own = {key: value for key, value in section.items() if key not in PLAN_OPTIONS and key != "parameterization"}
    kind = section.get("parameterization", "bspline")
    for key, value in own.items():
        if key not in METHOD[kind]:
            owner = next(name for name, keys in METHOD.items() if key in keys)
            reason = f"is {shown(value)}; expected only with {owner} (this is {kind}, which has {', '.join(METHOD[kind])})"
            raise document.error(f"method.{key}", reason)
    if own.get("accuracy") is False:
        own["accuracy"] = None
    if own or "parameterization" in section:
        try:
            options["parameterization"] = _CLASSES[kind](**own)
        except ProblemError as error:
            raise ProblemError(f"{document.place('method')}: {error}") from None
    return options


def _override(table: dict[str, Any], overrides: Mapping[str, Any]) -> None:
    """Put values in place; another parameterisation drops the options of the file's own."""
    kind = overrides.get("method.parameterization")
    method = table.get("method")
    if kind and isinstance(method, dict):
        table["method"] = {k: v for k, v in method.items() if k in PLAN_OPTIONS or k in METHOD.get(kind, ())}
    for dotted, value in overrides.items():
        section, key = dotted.split(".")
        entry = table.setdefault(section, {})
        if isinstance(entry, dict):
            entry[key] = value


def _problem(document: Document, table: dict[str, Any], robot: RobotModel, angles: str) -> Problem:
    names, factors = robot.joint_names, joint_factors(robot, angles)
    si = lambda value: convert(value, names, factors)  # in this file's unit
    asked = {k: robot.home if v == "home" and k in ("start", "goal") else v for k, v in table["problem"].items()}
    for key in _ANGULAR_KEYS:
        if key in asked and not isinstance(asked[key], (dict, np.ndarray)):
            asked[key] = si(asked[key])
    limits = {k: si(v) if k in ANGULAR else v for k, v in table.get("limits", {}).items()}
    try:
        if isinstance(asked["goal"], dict):
            asked["goal"] = _frame_goal(document, asked["goal"], robot, angles)
        listed = enumerate(table.get("waypoints", []))
        waypoints = tuple(Waypoint(_vector(k, si(w["position"]), robot), w.get("time")) for k, w in listed)
        own = {f"{key}_limits": _limit(document, key, value, robot) for key, value in limits.items()}
        more = {"name": table.get("name", document.path.stem), "origin": partial(key_in_file, document)}
        more |= avoidance_arguments(document, table, robot, angles)
        if "cost" in asked:
            more["costs"] = cost_terms(document, asked.pop("cost"), robot)
        return Problem(robot, **asked, **own, **more, waypoints=waypoints)
    except ProblemError as error:
        message = str(error)
        placed = message.startswith(str(document.path))
        raise ProblemError(message if placed else _in_file(document, message)) from None


def _vector(k: int, value: Any, robot: RobotModel) -> np.ndarray:
    if len(value) != robot.nv:
        joints = ", ".join(robot.joint_names)
        raise ProblemError(f"waypoints[{k}].position has {len(value)} numbers; expected {robot.nv}, for {joints}")
    return np.array(value, dtype=float)


def _frame_goal(document: Document, goal: dict[str, Any], robot: RobotModel, angles: str) -> FramePose:
    rotation = rotation_of(document, "problem.goal", goal, angles)
    frame = goal.get("frame", robot.tool_frame)
    try:
        robot.frame_id(frame)
    except RobotError as error:
        raise ProblemError(f"{document.place('problem.goal.frame')}: {error}") from None
    return FramePose(frame, np.array(goal["position"], dtype=float), rotation)


def _limit(document: Document, key: str, value: Any, robot: RobotModel) -> Any:
    """A limit for `Problem`: numbers as they are, a table by joint filled up with the robot's own limits."""
    if key == "position":
        if set(value) == {"lower", "upper"}:
            return value["lower"], value["upper"]
        lower = _filled(document, key, {j: p[0] for j, p in value.items()}, robot, robot.limits.lower)
        return lower, _filled(document, key, {j: p[1] for j, p in value.items()}, robot, robot.limits.upper)
    return _filled(document, key, value, robot, getattr(robot.limits, key)) if isinstance(value, dict) else value


def _filled(document: Document, key: str, by_joint: dict[str, float], robot: RobotModel, own: np.ndarray) -> np.ndarray:
    for joint in by_joint:
        if joint not in robot.joint_names:
            raise document.error(f"limits.{key}.{joint}", f"is not a joint that moves; {nearest(joint, robot.joint_names)}")
    return np.array([by_joint.get(joint, default) for joint, default in zip(robot.joint_names, own, strict=True)])


def key_in_file(document: Document, key: str) -> tuple[str, str]:
    """Where an argument of `Problem`, such as "start" or "torque_limits", stands in a file, and what it is called there."""
    name = f"problem.{key}"
    if key.endswith("_limits"):
        kind = key.removesuffix("_limits")
        of_robot = kind in document.table["robot"].get("limits", {}) and kind not in document.table.get("limits", {})
        name = f"robot.limits.{kind}" if of_robot else f"limits.{kind}"
    elif (section := re.match(r"\w*", key)[0]) in PROBLEM_FILE.keys:
        alone = isinstance(document.table.get(section), dict)  # one table is written without a number
        name = key.replace("[0]", "", 1) if alone else key
    return document.place(name), name


def _in_file(document: Document, message: str) -> str:
    """A message of `Problem`, which begins with the name of an argument, in the words of the file."""
    begins = re.match(r"(waypoints|obstacles|workspace|attached)\[\d+\](\.(name|frames?)\b)?|[a-z_]+", message)
    key = begins[0] if begins else ""
    place, name = key_in_file(document, key)
    return f"{place}: {name}{message.removeprefix(key)}" if key else f"{place}: {message}"
