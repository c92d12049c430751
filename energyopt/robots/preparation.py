"""From a URDF as it is found to the URDF that every engine reads.

All joints left after preparation are revolute or prismatic with one degree of freedom each, so nq = nv:

- a locked joint becomes fixed; with its placement parent_T_joint and its motion J(q) at the locked value, the new
  origin is parent_T_joint · J(q);
- a continuous joint becomes revolute with a stated range;
- a mimic joint is locked at multiplier · (its master's locked or neutral value) + offset;
- floating and planar joints are refused, unless they are locked at their origin;
- a payload becomes one more link, fixed to the link it is held by.

Joint damping and friction leave the text: `Dynamics` states the friction in force, and no engine adds its own.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Mapping
from copy import deepcopy
from fnmatch import fnmatchcase

import numpy as np

from energyopt.errors import RobotError
from energyopt.robots.messages import did_you_mean, shown
from energyopt.robots.payload import Payload
from energyopt.robots.urdf_xml import child_link, moving_joints, numbers

CONTINUOUS_RANGE = (-2 * math.pi, 2 * math.pi)
"""Range [rad] given to continuous joints: one turn either way."""
KEPT = ("link", "joint", "material")


def selected_joints(root: ET.Element, patterns: Iterable[str], key: str, where: str) -> set[str]:
    """Names of the moving joints that match one of the names or patterns.

    Args:
        key: argument the patterns come from, for messages.

    Raises:
        RobotError: a name or pattern matches no moving joint.
    """
    names = [j.get("name") for j in moving_joints(root)]
    chosen: set[str] = set()
    for pattern in patterns:
        matches = [n for n in names if n == pattern or fnmatchcase(n, pattern)]
        if not matches:
            raise RobotError(f"{where}: {key}: no moving joint matches '{pattern}'; {did_you_mean(pattern, names)}")
        chosen.update(matches)
    return chosen


def lock_values(root: ET.Element, free: set[str], locked: Mapping[str, float], where: str) -> dict[str, float]:
    """Values at which joints are fixed [rad or m]: as asked, else neutral (0, or the limit nearest to it).

    Raises:
        RobotError: an unknown joint, a value that is no number or outside the joint's range, a circle of mimic joints.
    """
    joints = {j.get("name"): j for j in moving_joints(root)}
    for name, value in locked.items():
        if name not in joints:
            raise RobotError(f"{where}: locked: no moving joint named '{name}'; {did_you_mean(str(name), joints)}")
        _check_lock(joints[name], value, where)
    values = {n: float(v) for n, v in locked.items()}
    for name in joints.keys() - free:
        _refuse_inverted_range(joints[name], where)
    for name, joint in joints.items():
        if name not in free and name not in values and joint.find("mimic") is None:
            values[name] = _neutral(joint)
    for name, joint in joints.items():
        if joint.find("mimic") is not None and name not in values:
            values[name] = _mimic_value(joints, name, values, where)
    return values


def lock_notes(root: ET.Element, values: Mapping[str, float]) -> list[str]:
    """One sentence for the locked joints, and one for each mimic joint."""
    joints = {j.get("name"): j for j in moving_joints(root)}
    plain = [n for n in values if joints[n].find("mimic") is None]
    notes = [f"Locked: {', '.join(f'{n} at {values[n]:g}' for n in plain)}."] if plain else []
    for name, value in values.items():
        mimic = joints[name].find("mimic")
        if mimic is not None:
            alone = "" if mimic.get("joint") in values else ", though its master moves"
            notes.append(f"Joint '{name}' mimics '{mimic.get('joint')}' and is locked at {value:g}{alone}.")
    return notes


def fix_joints(root: ET.Element, values: Mapping[str, float]) -> None:
    """Turn the named joints into fixed ones at the given values, in place."""
    for joint in moving_joints(root):
        name = joint.get("name")
        if name not in values:
            continue
        if values[name] != 0.0:
            _compose_origin(joint, values[name])
        joint.set("type", "fixed")


def refuse_free_bodies(root: ET.Element, where: str) -> None:
    """Raises RobotError where a floating or planar joint is left."""
    for joint in moving_joints(root):
        kind, name = joint.get("type"), joint.get("name")
        if kind in ("floating", "planar"):
            raise RobotError(
                f"{where}: joint '{name}' is {kind}: a base that moves freely has no actuator, so the joint torques do not "
                f"follow from the joint motion; where the base is bolted down, make the joint fixed (locked={{'{name}': 0}})"
            )


def bound_continuous_joints(root: ET.Element, ranges: Callable[[str], tuple[float, float]]) -> list[str]:
    """Turn continuous joints into revolute ones with a range, in place; one note for all of them."""
    names = []
    for joint in moving_joints(root):
        if joint.get("type") == "continuous":
            lower, upper = ranges(joint.get("name"))
            joint.set("type", "revolute")
            limit = joint.find("limit")
            limit = ET.SubElement(joint, "limit") if limit is None else limit
            limit.set("lower", repr(lower))
            limit.set("upper", repr(upper))
            names.append(f"{joint.get('name')} [{lower:.4g}, {upper:.4g}]")
    return [f"Continuous joints made revolute with the range: {', '.join(names)} rad."] if names else []


def dynamics_only(root: ET.Element) -> ET.Element:
    """A copy without shapes and colours, whose limits are all ±1: enough for a model's dynamics, whatever the file lacks."""
    copy = deepcopy(root)
    for material in copy.findall("material"):
        copy.remove(material)
    for link in copy.findall("link"):
        for shape in [c for c in link if c.tag in ("visual", "collision")]:
            link.remove(shape)
    for joint in moving_joints(copy):
        for limit in joint.findall("limit"):
            joint.remove(limit)
        ET.SubElement(joint, "limit", lower="-1", upper="1", effort="1", velocity="1")
    return copy


def attach_payload(root: ET.Element, payload: Payload, tool_frame: str, where: str) -> str:
    """Add the payload as a link fixed to its frame, in place; returns the note.

    Raises:
        RobotError: no such frame.
    """
    frame = payload.frame or tool_frame
    links = {link.get("name") for link in root.findall("link")}
    children = {j.get("name"): child_link(j) for j in root.findall("joint")}
    link = frame if frame in links else children.get(frame)
    if link is None:
        raise RobotError(f"{where}: payload: no link or joint named '{frame}'; {did_you_mean(frame, [*links, *children])}")
    name, number = "payload", 1
    while name in links or f"{name}_joint" in children:
        number += 1
        name = f"payload_{number}"
    inertial = ET.SubElement(ET.SubElement(root, "link", name=name), "inertial")
    ET.SubElement(inertial, "origin", xyz=_words(payload.center), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(payload.mass))
    upper = {f"i{'xyz'[r]}{'xyz'[c]}": repr(float(payload.inertia[r, c])) for r in range(3) for c in range(r, 3)}
    ET.SubElement(inertial, "inertia", upper)
    joint = ET.SubElement(root, "joint", name=f"{name}_joint", type="fixed")
    ET.SubElement(joint, "parent", link=link)
    ET.SubElement(joint, "child", link=name)
    return f"Payload of {payload.mass:g} kg fixed to link '{link}'."


def strip_extras(root: ET.Element) -> None:
    """Remove what no engine should read, in place: transmissions, simulator tags, joint damping and friction."""
    for element in [e for e in root if e.tag not in KEPT]:
        root.remove(element)
    for joint in root.findall("joint"):
        kept = ("origin", "parent", "child") + (("axis", "limit") if joint.get("type") != "fixed" else ())
        for child in [c for c in joint if c.tag not in kept]:
            joint.remove(child)


def to_text(root: ET.Element) -> str:
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def rotation_from_rpy(rpy: Iterable[float]) -> np.ndarray:
    """R = Rz(yaw) Ry(pitch) Rx(roll), the URDF convention; shape (3, 3)."""
    roll, pitch, yaw = rpy
    return rotation_about((0, 0, 1), yaw) @ rotation_about((0, 1, 0), pitch) @ rotation_about((1, 0, 0), roll)


def rpy_from_rotation(rotation: np.ndarray) -> tuple[float, float, float]:
    """Roll, pitch, yaw [rad] of a rotation; exact at pitch = ±π/2 too, where any yaw will do.

    The yaw is removed first, and roll is read from what is left, so an arbitrary yaw is made up for by the roll.
    """
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    rest = rotation_about((0, 0, 1), -yaw) @ rotation
    return math.atan2(-rest[1, 2], rest[1, 1]), math.atan2(-rest[2, 0], rest[0, 0]), yaw


def rotation_about(axis: Iterable[float], angle: float) -> np.ndarray:
    """Rotation by ``angle`` about a unit axis (Rodrigues, 1840): I + sin θ [u]× + (1 − cos θ) [u]×²."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=float)
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def _compose_origin(joint: ET.Element, value: float) -> None:
    origin = joint.find("origin")
    rotation = rotation_from_rpy(numbers(origin, "rpy", "0 0 0"))
    position = np.array(numbers(origin, "xyz", "0 0 0"))
    axis = np.array(numbers(joint.find("axis"), "xyz", "1 0 0"))
    axis = axis / np.linalg.norm(axis)
    if joint.get("type") == "prismatic":
        position = position + rotation @ axis * value
    else:
        rotation = rotation @ rotation_about(axis, value)
    origin = ET.SubElement(joint, "origin") if origin is None else origin
    origin.set("xyz", _words(position))
    origin.set("rpy", _words(rpy_from_rotation(rotation)))


def _range(joint: ET.Element) -> tuple[float, float]:
    """Limits that mean something, else the whole line: a continuous joint, or one without stated limits, has none."""
    lower, upper = (numbers(joint.find("limit"), key, "0")[0] for key in ("lower", "upper"))
    bounded = joint.get("type") in ("revolute", "prismatic") and lower < upper
    return (lower, upper) if bounded else (-math.inf, math.inf)


def _neutral(joint: ET.Element) -> float:
    lower, upper = _range(joint)
    return min(max(0.0, lower), upper) + 0.0


def _refuse_inverted_range(joint: ET.Element, where: str) -> None:
    lower, upper = (numbers(joint.find("limit"), key, "0")[0] for key in ("lower", "upper"))
    if lower > upper and joint.get("type") in ("revolute", "prismatic"):
        name = joint.get("name")
        raise RobotError(f"{where}: joint '{name}': position limits are inverted ({lower:g} to {upper:g}); correct the file")


def _check_lock(joint: ET.Element, value: float, where: str) -> None:
    name = joint.get("name")
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise RobotError(f"{where}: locked: joint '{name}' at {shown(value)}; expected a finite number [rad or m]")
    lower, upper = _range(joint)
    slack = 1e-6
    if not lower - slack <= number <= upper + slack:
        raise RobotError(f"{where}: locked: joint '{name}' at {number:g} is outside its range [{lower:g}, {upper:g}]")
    if joint.get("type") in ("floating", "planar") and number != 0:
        raise RobotError(f"{where}: locked: joint '{name}' is {joint.get('type')}; it can only be locked at its origin: 0")


def _mimic_value(joints: Mapping[str, ET.Element], name: str, values: Mapping[str, float], where: str) -> float:
    chain = [name]
    while chain[-1] not in values and (mimic := joints[chain[-1]].find("mimic")) is not None:
        master = mimic.get("joint")
        if master not in joints:
            raise RobotError(
                f"{where}: joint '{chain[-1]}' mimics '{master}', which is no moving joint; {did_you_mean(str(master), joints)}"
            )
        if master in chain:
            raise RobotError(
                f"{where}: joint '{name}' mimics itself through {', '.join(chain[1:]) or 'its own name'}; expected another joint"
            )
        chain.append(master)
    value = values[chain[-1]] if chain[-1] in values else _neutral(joints[chain[-1]])
    for follower in reversed(chain[:-1]):
        mimic = joints[follower].find("mimic")
        value = numbers(mimic, "multiplier", "1")[0] * value + numbers(mimic, "offset", "0")[0]
    return value


def _words(values: Iterable[float]) -> str:
    return " ".join(repr(float(x)) for x in values)
