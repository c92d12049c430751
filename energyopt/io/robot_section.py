"""The [robot] section of a problem file → RobotModel."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from energyopt.errors import RobotError
from energyopt.io.energy_section import actuators_of_file
from energyopt.io.toml_text import Document
from energyopt.io.units import ANGULAR, DEGREE, convert, joint_factors
from energyopt.robots import Payload, RobotModel, load_robot
from energyopt.robots.urdf_xml import parse_urdf, read_urdf

_AS_GIVEN = ("joints", "gravity", "armature", "viscous_friction", "coulomb_friction", "coulomb_velocity", "tool_frame")


def build_robot(document: Document, section: dict[str, Any], angles: str) -> RobotModel:
    """Load the robot a validated [robot] section asks for.

    Args:
        document: the file; relative paths count from its folder.
        section: its [robot] table.
        angles: "rad" or "deg".

    Raises:
        ProblemError: neither or both of name and urdf.
        RobotError: from `load_robot`, with the file and line in front.
    """
    target = _target(document, section)
    arguments = {key: section[key] for key in _AS_GIVEN if key in section}
    folder = document.path.parent
    if "package_dirs" in section:
        arguments["package_dirs"] = [folder / Path(p).expanduser() for p in section["package_dirs"]]
    scale = DEGREE if angles == "deg" else 1.0
    try:
        if "locked" in section:
            arguments["locked"] = _locked(section["locked"], scale, target)
        if "continuous_range" in section:
            arguments["continuous_range"] = _scaled(section["continuous_range"], scale)
        if "payload" in section:
            bodies = section["payload"] if isinstance(section["payload"], list) else [section["payload"]]
            arguments["payload"] = [Payload(**body) for body in bodies]
        robot = _load(target, arguments, section.get("limits", {}), angles)
    except RobotError as error:
        raise RobotError(f"{document.place('robot')}: {error}") from None
    if "actuators" not in section:
        return robot
    return replace(robot, actuators=actuators_of_file(document, section["actuators"], robot.joint_names))


def _target(document: Document, section: dict[str, Any]) -> str | Path:
    given = [key for key in ("name", "urdf") if key in section]
    if len(given) != 1:
        raise document.error("robot", f"has {' and '.join(given) or 'neither name nor urdf'}; expected exactly one of name, urdf")
    return section["name"] if given == ["name"] else document.path.parent / Path(section["urdf"]).expanduser()


def _load(target: str | Path, arguments: dict[str, Any], limits: dict[str, Any], angles: str) -> RobotModel:
    """Load with the section's limits; in degrees a first load tells which joints turn and which slide."""
    if angles == "deg" and any(key in limits for key in ANGULAR):
        draft = load_robot(target, **arguments, **_limit_arguments(limits))
        factors = joint_factors(draft, angles)
        limits = {k: convert(v, draft.joint_names, factors) if k in ANGULAR else v for k, v in limits.items()}
    return load_robot(target, **arguments, **_limit_arguments(limits))


def _limit_arguments(limits: dict[str, Any]) -> dict[str, Any]:
    arguments = {f"{key}_limits": value for key, value in limits.items() if key != "scale"}
    position = arguments.get("position_limits", {})
    if set(position) == {"lower", "upper"}:
        arguments["position_limits"] = (position["lower"], position["upper"])
    if "scale" in limits:
        arguments["limit_scale"] = limits["scale"]
    return arguments


def _locked(value: Any, scale: float, target: str | Path) -> Any:
    if scale == 1.0 or not isinstance(value, dict):
        return value
    sliding = _sliding_joints(target)
    return {joint: v if joint in sliding else v * scale for joint, v in value.items()}


def _sliding_joints(target: str | Path) -> set[str]:
    from energyopt.robots.catalogue import find_entry, robots_folder

    path = target if isinstance(target, Path) else robots_folder() / find_entry(target).urdf
    return {j.get("name") for j in parse_urdf(read_urdf(path), str(path)).iter("joint") if j.get("type") == "prismatic"}


def _scaled(value: Any, scale: float) -> Any:
    if isinstance(value, dict):
        return {joint: [scale * x for x in pair] for joint, pair in value.items()}
    return [scale * x for x in value]
