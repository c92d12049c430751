"""Reads planning problems of MotionBenchMaker (C. Chamzas et al., IEEE Robotics and Automation Letters 7, 2022) from JSON.

A folder holds files with a list of problems each: a robot by name, the joints that move and the state of those that do not,
start and goal [rad], and obstacles (boxes, cylinders, spheres) in the frame of one of the robot's links. The robots are those
of the catalogue; for others, and for another version of one, the path of a URDF is given by name.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from energyopt.errors import FileError, RobotError
from energyopt.geometry.shapes import Box, Cylinder, Shape, Sphere
from energyopt.robots import RobotModel, load_robot
from energyopt.robots.catalogue import CATALOGUE, catalogue, robots_folder
from energyopt.robots.urdf_xml import moving_joints, parse_urdf, read_urdf

KEYS = ("id", "robot", "frame", "joint_names", "q_start", "q_goal", "fixed_joints", "obstacles")


class MbmProblem(NamedTuple):
    """One problem: its name, the arm with its other joints locked, obstacles in the base, start and goal [rad], (nv,).

    ``entry`` is the problem as the file has it.
    """

    id: str
    robot: RobotModel
    obstacles: tuple[Shape, ...]
    start: np.ndarray
    goal: np.ndarray
    entry: Mapping[str, Any]


def read_mbm(folder: str | Path, urdfs: Mapping[str, str | Path] | None = None) -> Iterator[MbmProblem]:
    """The problems of every JSON file in a folder, in the order of file names; robots with the same state are loaded once.

    Args:
        folder: where the files are, or one file.
        urdfs: URDF files of robots by their names in the problems, in place of the catalogue's.

    Raises:
        FileError: there are no such files, or one is malformed; RobotError: a robot is not known.
    """
    folder, robots = Path(folder), {}
    files = [folder] if folder.is_file() else sorted(folder.glob("*.json"))
    if not files:
        raise FileError(f"{folder}: holds no .json file; expected problems of MotionBenchMaker")
    for path in files:
        for k, entry in enumerate(_entries(path)):
            where = f"{path.name}: problem {k + 1}"
            missing = [key for key in KEYS if key not in entry] if isinstance(entry, dict) else KEYS
            if missing:
                raise FileError(f"{where}: '{missing[0]}' is missing; expected {', '.join(KEYS)}")
            _check_kinds(entry, where)
            key = json.dumps([entry[name] for name in ("robot", "joint_names", "fixed_joints")])
            if key not in robots:
                robots[key] = mbm_robot(entry["robot"], entry["joint_names"], entry["fixed_joints"], urdfs or {})
            try:
                yield _problem(entry, robots[key])
            except KeyError as error:
                raise FileError(
                    f"{where}: an obstacle has no {error}; expected name, type, its sizes, xyz and quat_wxyz"
                ) from None
            except (TypeError, ValueError) as error:
                raise FileError(f"{where}: {type(error).__name__}: {error}") from None


def _check_kinds(entry: Mapping[str, Any], where: str) -> None:
    """Refuse values of the wrong kind, and numbers that are none.

    Raises:
        FileError: says which.
    """
    kinds = {
        "robot": str,
        "frame": str,
        "joint_names": list,
        "fixed_joints": dict,
        "obstacles": list,
        "q_start": list,
        "q_goal": list,
    }
    words = {str: "a text", list: "a list", dict: "an object of numbers by joint"}
    for key, kind in kinds.items():
        if not isinstance(entry[key], kind):
            raise FileError(f"{where}: {key} is {entry[key]!r:.60}; expected {words[kind]}")
    given = [*entry["q_start"], *entry["q_goal"], *entry["fixed_joints"].values()]
    wrong = [value for value in given if not isinstance(value, int | float) or not np.isfinite(value)]
    if wrong:
        raise FileError(f"{where}: a joint position is {wrong[0]!r:.60}; expected finite numbers")


def mbm_robot(name: str, joints: list[str], fixed: Mapping[str, float], urdfs: Mapping[str, str | Path]) -> RobotModel:
    """A robot of which ``joints`` move and the others are locked, at ``fixed`` [rad or m] where that names them.

    A state outside a joint's range is taken as it is: the collection opens the fingers of its Panda by 65 mm each.

    Raises:
        RobotError: the name is in neither the catalogue nor ``urdfs``.
    """
    entry = CATALOGUE.get(name)
    if name not in urdfs and entry is None:
        raise RobotError(f"robot '{name}' is not in the catalogue ({', '.join(catalogue())}); give its URDF: {name}=path.urdf")
    path = Path(urdfs[name]) if name in urdfs else robots_folder() / entry.urdf
    root = parse_urdf(read_urdf(path), str(path))
    known = {joint.get("name"): joint for joint in moving_joints(root)}
    locked = {joint: value for joint, value in fixed.items() if joint in known and joint not in joints}
    options: dict[str, Any] = {"locked": locked, "joints": joints}
    outside = {joint: value for joint, value in locked.items() if not _inside(known[joint], value)}
    if outside:
        robot = _with_wider_ranges(root, known, outside, path, options, entry.tool_frame if entry else None)
        robot = replace(robot, name=name, srdf=robots_folder() / entry.srdf if entry and entry.srdf else None, source=path)
    else:
        robot = load_robot(path if name in urdfs else name, **options)
    absent = [joint for joint in fixed if joint not in known]
    notes = (f"The problems state {', '.join(absent)}, which this robot does not have.",) if absent else ()
    return replace(robot, notes=(*robot.notes, *notes))


def _with_wider_ranges(
    root: Any, joints: Mapping[str, Any], states: Mapping[str, float], path: Path, options: dict[str, Any], tool: str | None
) -> RobotModel:
    """The robot of a URDF in which the ranges of some joints reach as far as their states."""
    from xml.etree import ElementTree

    for joint, value in states.items():
        limit = joints[joint].find("limit")
        limit.set("lower", repr(min(float(limit.get("lower", 0)), value)))
        limit.set("upper", repr(max(float(limit.get("upper", 0)), value)))
    with tempfile.TemporaryDirectory() as folder:
        widened = Path(folder) / path.name
        widened.write_bytes(ElementTree.tostring(root))
        dirs = [robots_folder().parent.parent, *path.resolve().parents[:4]]
        return load_robot(widened, package_dirs=dirs, tool_frame=tool, **options)


def _inside(joint: Any, value: float) -> bool:
    limit = joint.find("limit")
    if limit is None or joint.get("type") not in ("revolute", "prismatic"):
        return True
    return float(limit.get("lower", 0)) <= value <= float(limit.get("upper", 0))


def _entries(path: Path) -> list[Any]:
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot be read as JSON: {error}") from None
    if not isinstance(entries, list):
        raise FileError(f"{path}: holds no list; expected a list of problems")
    return entries


def _problem(entry: Mapping[str, Any], robot: RobotModel) -> MbmProblem:
    order = [entry["joint_names"].index(name) for name in robot.joint_names]
    for key in ("q_start", "q_goal"):
        if len(entry[key]) != len(order):
            raise ValueError(f"{key} holds {len(entry[key])} numbers; expected {len(order)}")
    start, goal = (np.array(entry[key], dtype=float)[order] for key in ("q_start", "q_goal"))
    frame = robot.model.frames[robot.frame_id(entry["frame"])]
    if frame.parentJoint != 0:
        raise FileError(f"{entry['id']}: frame '{entry['frame']}' moves with a joint; expected a link that does not move")
    base = frame.placement.homogeneous
    return MbmProblem(entry["id"], robot, tuple(_obstacle(o, base) for o in entry["obstacles"]), start, goal, entry)


def _obstacle(entry: Mapping[str, Any], base: np.ndarray) -> Shape:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(entry["quat_wxyz"], scalar_first=True).as_matrix()
    pose[:3, 3] = entry["xyz"]
    options = {"pose": base @ pose, "name": entry["name"]}
    if entry["type"] == "box":
        return Box(entry["size"], **options)
    if entry["type"] == "cylinder":
        return Cylinder(entry["radius"], entry["length"], **options)
    if entry["type"] == "sphere":
        return Sphere(entry["radius"], **options)
    raise ValueError(f"obstacle '{entry['name']}' is a '{entry['type']}'; expected box, cylinder or sphere")
