"""`load_robot`: from a name or a URDF to a checked RobotModel."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from energyopt.actuators import ActuatorModel, Actuators, actuators_of
from energyopt.dynamics.body import COULOMB_SMOOTHING, Dynamics
from energyopt.errors import RobotError
from energyopt.robots import preparation as prepare
from energyopt.robots.arguments import (
    GRAVITY,
    continuous_ranges,
    friction,
    friction_velocity,
    gravity_vector,
    joint_values,
    locked_joints,
    non_negative,
    payloads,
    stated_friction,
    texts,
)
from energyopt.robots.catalogue import CATALOGUE, CatalogueEntry, find_entry, robots_folder
from energyopt.robots.identified import with_identified
from energyopt.robots.limits import build_limits, write_limits
from energyopt.robots.lint import lint_bodies, lint_links, lint_mass_matrix, normalise_axes
from energyopt.robots.meshes import declared_package_dirs, default_package_dirs, lint_meshes
from energyopt.robots.messages import shown
from energyopt.robots.model import Limits, RobotModel
from energyopt.robots.payload import Payload
from energyopt.robots.urdf_xml import child_link, moving_joints, parent_link, parse_urdf, read_urdf


def load_robot(
    name_or_path: str | Path,
    *,
    locked: Mapping[str, float] | Iterable[str] | None = None,
    joints: Iterable[str] | str | None = None,
    position_limits: Any = None,
    velocity_limits: Any = None,
    torque_limits: Any = None,
    acceleration_limits: Any = None,
    jerk_limits: Any = None,
    torque_rate_limits: Any = None,
    limit_scale: Mapping[str, ArrayLike] | None = None,
    armature: Any = None,
    viscous_friction: Any = None,
    coulomb_friction: Any = None,
    coulomb_velocity: Any = COULOMB_SMOOTHING,
    payload: Payload | Sequence[Payload] | None = None,
    gravity: ArrayLike = GRAVITY,
    package_dirs: Iterable[str | Path] | str | Path = (),
    continuous_range: Any = None,
    tool_frame: str | None = None,
    home: ArrayLike | None = None,
    actuators: Actuators | ActuatorModel | Sequence[ActuatorModel] | Mapping[str, ActuatorModel] | None = None,
) -> RobotModel:
    """Load a robot of the catalogue, or a URDF file, check it, and make it ready to plan with.

    Wherever a value a joint is expected, one number stands for all joints, a sequence follows ``joint_names``, and a
    dict by joint name changes only the joints it names.

    Args:
        name_or_path: a name from `catalogue`, or the path of a URDF.
        locked: joints to fix: a dict of values [rad or m], or names (then at 0, or the limit nearest to it).
        joints: the joints that move, names or patterns such as "arm_left_*"; all others are locked. A catalogue robot
            has its own choice; a plain URDF moves every joint.
        position_limits: (lower, upper) or a dict of such pairs [rad or m]; velocity_limits [rad/s]; torque_limits [N·m];
            acceleration_limits [rad/s²]; jerk_limits [rad/s³]; torque_rate_limits [N·m/s]: in place of the URDF's.
        limit_scale: factors on limits, such as {"velocity": 0.5, "torque": 0.8}, applied last.
        armature: rotor inertia seen at the joint [kg·m²], none by default.
        viscous_friction: [N·m·s/rad]; coulomb_friction: [N·m]; none by default; "urdf" takes the
            file's damping and friction, and the name of a published set (see `identified`) its numbers.
        coulomb_velocity: velocity over which Coulomb friction changes sign [rad/s].
        payload: one body, or several, held by the robot.
        gravity: acceleration of gravity in the base frame [m/s²], shape (3,).
        package_dirs: folders that hold the packages of ``package://`` mesh paths; a URDF's own place is searched too.
        continuous_range: (lower, upper) [rad] of continuous joints, or a dict of such pairs.
        tool_frame: link or joint whose motion is reported.
        home: resting configuration [rad or m].
        actuators: electric drives, for costs and accounts in electrical joules; a dict names every joint.

    Returns:
        The robot; its ``notes`` say what loading changed or assumed.

    Raises:
        RobotError: not found, unreadable, impossible, or an argument does not fit; one line says what and where.
        MissingDependencyError: the catalogue's data package is not installed.
    """
    entry, path = _find(name_or_path)
    where = str(name_or_path) if entry else str(path)
    root = parse_urdf(read_urdf(path), where)
    root.set("name", root.get("name") or path.stem)
    folders = _mesh_folders(root, entry, path, package_dirs, where)
    of_file = stated_friction(root)
    tool = next(iter(texts("tool_frame", tool_frame, "the name of a link or joint", where)), "")
    tool = tool or (entry.tool_frame if entry else "") or _last_link(root)

    notes = _prepare(root, entry, locked, joints, continuous_range, where)
    notes += [prepare.attach_payload(root, body, tool, where) for body in payloads(payload, where)]
    notes += lint_links(root, where)
    model = _pinocchio(root, where)
    names = tuple(model.names[1:])
    lint_bodies(model, {j.get("name"): child_link(j) for j in moving_joints(root)}, where)

    given = (position_limits, velocity_limits, torque_limits, acceleration_limits, jerk_limits, torque_rate_limits)
    given, assumed_note = _given_limits(given, entry)
    limits = build_limits(root, names, given, limit_scale, where)
    write_limits(root, names, limits)
    _finish_model(model, limits, non_negative("armature", armature, names, where), gravity_vector(gravity, where))
    lint_mass_matrix(model, 0.5 * (limits.lower + limits.upper), where)
    coulomb_friction, coulomb_velocity, set_note = with_identified(
        coulomb_friction, coulomb_velocity, COULOMB_SMOOTHING, names, where
    )
    viscous, coulomb, friction_note = friction(of_file, viscous_friction, coulomb_friction, names, where)
    robot = RobotModel(
        name=str(name_or_path) if entry else root.get("name"),
        dynamics=Dynamics(model, viscous, coulomb, friction_velocity(coulomb_velocity, COULOMB_SMOOTHING, names, where)),
        limits=limits,
        urdf=prepare.to_text(root),
        package_dirs=folders,
        tool_frame=tool,
        notes=(*assumed_note, *notes, *friction_note, *set_note),
        home=_home(entry, home, names, limits, where),
        source=path,
        srdf=_srdf(entry, path),
        actuators=actuators_of(actuators, names, where),
    )
    robot.frame_id(tool)
    return robot


def _find(name_or_path: str | Path) -> tuple[CatalogueEntry | None, Path]:
    """The catalogue entry, or None for a file, and the absolute path of the URDF."""
    if not isinstance(name_or_path, (str, Path)):
        raise RobotError(f"load_robot: got {shown(name_or_path)}; expected a catalogue name or the path of a URDF")
    text = str(name_or_path)
    is_path = isinstance(name_or_path, Path) or "/" in text or "\\" in text or Path(text).suffix or os.path.isfile(text)
    if is_path and not (isinstance(name_or_path, str) and text in CATALOGUE):
        return None, Path(os.path.abspath(os.path.expanduser(text)))
    entry = find_entry(text)
    return entry, robots_folder() / entry.urdf


def _mesh_folders(root: ET.Element, entry: CatalogueEntry | None, path: Path, declared: Any, where: str) -> tuple[Path, ...]:
    folders = declared_package_dirs(texts("package_dirs", declared, "folders", where), where)
    folders += (robots_folder().parent.parent,) if entry else default_package_dirs(root, path.parent)
    lint_meshes(root, folders, path.parent, where)
    return folders


def _given_limits(given: tuple, entry: CatalogueEntry | None) -> tuple[dict[str, Any], list[str]]:
    """The caller's limits by kind, filled up with what the catalogue assumes, and the note on that."""
    assumed = {key.removesuffix("_limits"): value for key, value in (entry.assumed if entry else {}).items()}
    used, limits = {}, {}
    for kind, value in zip(("position", "velocity", "torque", "acceleration", "jerk", "torque_rate"), given, strict=True):
        limits[kind] = value
        if value is None and kind in assumed:
            limits[kind] = used[kind] = assumed[kind]
    shown = ", ".join(f"{kind} {np.round(value, 4).tolist()}" for kind, value in used.items())
    return limits, [f"The file states no {' or '.join(used)} limits; assumed: {shown}."] if used else []


def _prepare(
    root: ET.Element, entry: CatalogueEntry | None, locked: Any, joints: Any, continuous_range: Any, where: str
) -> list[str]:
    """The preparation step of `preparation`, in place; returns its notes."""
    wanted = entry.joints.split() if entry else [j.get("name") for j in moving_joints(root)]
    if joints is not None:
        wanted = texts("joints", joints, "joint names or patterns", where)
    asked, named = locked_joints(locked, where)
    free = prepare.selected_joints(root, wanted, "joints", where) - prepare.selected_joints(root, named, "locked", where)
    values = prepare.lock_values(root, free, asked, where)
    notes = normalise_axes(root, where)
    notes += prepare.lock_notes(root, values)
    prepare.fix_joints(root, values)
    prepare.refuse_free_bodies(root, where)
    continuous = [j.get("name") for j in moving_joints(root) if j.get("type") == "continuous"]
    ranges = continuous_ranges(continuous_range, continuous, where)
    notes += prepare.bound_continuous_joints(root, ranges.__getitem__)
    prepare.strip_extras(root)
    if not moving_joints(root):
        raise RobotError(f"{where}: no joint is left to move; expected at least one that is not fixed, locked or a mimic")
    return notes


def _pinocchio(root: ET.Element, where: str) -> pin.Model:
    try:
        return pin.buildModelFromXML(prepare.to_text(prepare.dynamics_only(root)))
    except Exception as error:  # the bindings raise several types, none documented
        raise RobotError(f"{where}: Pinocchio cannot build a model of it: {' '.join(str(error).split())[:200]}") from None


def _finish_model(model: pin.Model, limits: Limits, armature: np.ndarray, gravity: np.ndarray) -> None:
    model.armature = np.array(armature)
    model.gravity = pin.Motion(gravity, np.zeros(3))
    model.lowerPositionLimit, model.upperPositionLimit = np.array(limits.lower), np.array(limits.upper)
    model.velocityLimit, model.effortLimit = np.array(limits.velocity), np.array(limits.torque)


def _home(entry: CatalogueEntry | None, given: Any, names: tuple[str, ...], limits: Limits, where: str) -> np.ndarray:
    """Home configuration: the caller's, else the catalogue's inside the limits, else the middle of the range."""
    q = 0.5 * (limits.lower + limits.upper)
    if given is not None:
        q = joint_values("home", given, names, q, where)
        outside = np.flatnonzero((q < limits.lower) | (q > limits.upper))
        if outside.size:
            i = outside[0]
            raise RobotError(
                f"{where}: home of joint '{names[i]}' is {q[i]:g}; expected {limits.lower[i]:g} to {limits.upper[i]:g}"
            )
    elif entry:
        known = _catalogue_home(entry, names)
        q = np.clip([known.get(name, middle) for name, middle in zip(names, q, strict=True)], limits.lower, limits.upper)
    q.flags.writeable = False
    return q


def _catalogue_home(entry: CatalogueEntry, names: tuple[str, ...]) -> dict[str, float]:
    """The catalogue's home by joint name; where the caller moves other joints, the order is read off the whole model."""
    if len(names) == len(entry.home):
        return dict(zip(names, entry.home, strict=True))
    root = parse_urdf(read_urdf(robots_folder() / entry.urdf), entry.urdf)
    chosen = prepare.selected_joints(root, entry.joints.split(), "joints", entry.urdf)
    ordered = [n for n in _pinocchio(root, entry.urdf).names if n in chosen]
    return dict(zip(ordered, entry.home, strict=True))


def _srdf(entry: CatalogueEntry | None, path: Path) -> Path | None:
    if entry:
        return robots_folder() / entry.srdf if entry.srdf else None
    near = (path.with_suffix(".srdf"), path.parent.parent / "srdf" / f"{path.stem}.srdf")
    return next((p for p in near if p.is_file()), None)


def _last_link(root: ET.Element) -> str:
    """The link at the end of the longest chain of moving joints (then of joints): the tool of an unknown arm."""
    above = {child_link(j): j for j in root.findall("joint")}

    def depth(link: str) -> tuple[int, int]:
        moving = total = 0
        while link in above:
            moving += above[link].get("type") != "fixed"
            total += 1
            link = parent_link(above[link])
        return moving, total

    return max((link.get("name") for link in root.findall("link")), key=depth)
