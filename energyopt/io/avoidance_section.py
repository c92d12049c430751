"""Obstacles, workspace, potential and attached solids of a problem file → arguments of `Problem`."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from energyopt.errors import GeometryError, ProblemError
from energyopt.geometry import Attached, Moving, RepulsivePotential, Workspace
from energyopt.geometry.shapes import SHAPES, Shape
from energyopt.io.avoidance_schema import CALLED, MOTION, SIZES, sizes_of
from energyopt.io.poses import pose_of
from energyopt.io.toml_text import Document, shown
from energyopt.io.units import DEGREE
from energyopt.robots import RobotModel

Made = TypeVar("Made")
Entry = Mapping[str, Any]


def avoidance_arguments(document: Document, table: Entry, robot: RobotModel, angles: str) -> dict[str, Any]:
    """What a validated file says of things to stay clear of, as keyword arguments of `Problem`.

    Args:
        document: the file; meshes are looked for in its folder. table: its content.
        robot: the arm, for its tool frame. angles: "rad" or "deg".

    Raises:
        ProblemError: names file, line, key, value and expectation.
    """
    found: dict[str, Any] = {}
    if "obstacles" in table:
        found["obstacles"] = _obstacles(document, table["obstacles"], angles)
    if "workspace" in table:
        found["workspace"] = _workspaces(document, table["workspace"], angles)
    if "attached" in table:
        found["attached"] = _attached(document, table["attached"], robot, angles)
    if "potential" in table:
        found["potential"] = _made(document, "potential", table["potential"], lambda: RepulsivePotential(**table["potential"]))
    return found


def _obstacles(document: Document, entries: list[Entry], angles: str) -> list[Shape]:
    made = []
    for k, entry in enumerate(entries):
        key = f"obstacles[{k}]"
        made.append(_shape(document, key, entry, _place(document, key, entry, angles), entry.get("name", "")))
    return made


def _workspaces(document: Document, section: Entry | list[Entry], angles: str) -> list[Workspace]:
    made = []
    for key, entry, number in _listed("workspace", section):
        frames = entry.get("frames", [])
        region = _shape(document, key, entry, pose_of(document, key, entry, angles), entry.get("name", f"workspace{number}"))
        made.append(_made(document, key, entry, lambda region=region, frames=frames: Workspace(region, frames)))
    return made


def _attached(document: Document, section: Entry | list[Entry], robot: RobotModel, angles: str) -> list[Attached]:
    made = []
    for key, entry, number in _listed("attached", section):
        frame = entry.get("frame", robot.tool_frame)
        shape = _shape(document, key, entry, pose_of(document, key, entry, angles), entry.get("name", f"attached{number}"))
        made.append(_made(document, key, entry, lambda shape=shape, frame=frame: Attached(shape, frame)))
    return made


def _listed(section: str, given: Entry | list[Entry]) -> list[tuple[str, Entry, str]]:
    """(key, table, number for its name) of every table of a section that may be one table or a list."""
    if isinstance(given, Mapping):
        return [(section, given, "")]
    return [(f"{section}[{k}]", entry, f" {k + 1}" if len(given) > 1 else "") for k, entry in enumerate(given)]


def _shape(document: Document, key: str, entry: Entry, pose: np.ndarray | Moving, name: str) -> Shape:
    """The shape of a table, from the sizes of its type."""
    kind, own = entry["type"], sizes_of(entry["type"])
    for size in (name for name in entry if name in SIZES and name not in own):
        owners = ", ".join(other for other in SHAPES if size in sizes_of(other))
        reason = f"is {shown(entry[size])}; expected only with {owners} (this is {kind}, which has {', '.join(own)})"
        raise document.error(f"{key}.{size}", reason)
    for size, required in own.items():
        if required and size not in entry:
            raise ProblemError(f"{document.place(key)}: {key}.{size} is missing; expected {SIZES[size].expected}")
    fields = {called: field for field, called in CALLED.items()}
    given = {fields.get(size, size): entry[size] for size in own if size in entry}
    if "path" in given:
        given["folder"] = document.path.parent
    return _made(document, key, entry, lambda: SHAPES[kind](**given, pose=pose, name=name))


def _place(document: Document, key: str, entry: Entry, angles: str) -> np.ndarray | Moving:
    """The pose of an obstacle, at rest or moving."""
    stations = entry.get("waypoints")
    if stations is None:
        if "smooth" in entry:
            raise document.error(f"{key}.smooth", "is given without waypoints; expected both, or neither")
        pose = pose_of(document, key, entry, angles)
        turn = np.array(entry.get("angular_velocity", (0, 0, 0)), float) * (DEGREE if angles == "deg" else 1.0)
        if not entry.keys() & MOTION.keys():
            return pose
        return _made(document, key, entry, lambda: Moving(pose, entry.get("velocity", (0, 0, 0)), turn))
    other = [name for name in ("position", "quaternion", "rpy", "velocity", "angular_velocity") if name in entry]
    if other:
        raise document.error(
            f"{key}.{other[0]}", "is given beside waypoints; expected one of them: waypoints have poses of their own"
        )
    poses = [pose_of(document, f"{key}.waypoints[{j}]", station, angles) for j, station in enumerate(stations)]
    times = [station["time"] for station in stations]
    return _made(document, f"{key}.waypoints", entry, lambda: Moving(poses, times=times, smooth=entry.get("smooth", False)))


def _made(document: Document, key: str, entry: Entry, make: Callable[[], Made]) -> Made:
    """What ``make`` gives; where it refuses, the line of the value it names, if the table has that."""
    try:
        return make()
    except GeometryError as error:
        message = str(error)
        said = re.match(r"(mesh) '|[\w-]+: (\w+)", message)
        word = next((group for group in said.groups() if group), "") if said else ""
        word = "position" if word == "pose" else word
        raise ProblemError(f"{document.place(f'{key}.{word}' if word in entry else key)}: {key}: {message}") from None
