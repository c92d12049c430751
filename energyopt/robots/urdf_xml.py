"""Reading URDF text from anywhere, safely: size and depth are capped, entities refused, every number checked.

A URDF is a tree of links joined by joints. What leaves this file is an ElementTree whose names are unique, whose
joints form one tree, and whose numbers all parse; nothing physical has been judged yet (see `lint`).
"""

from __future__ import annotations

import math
import os
import re
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path
from xml.parsers import expat

from energyopt.errors import RobotError
from energyopt.robots.messages import shown

MAX_URDF_BYTES = 20_000_000
"""Larger URDF files are refused: the largest robots known to us need less than 1 MB."""
MAX_DEPTH = 64
MAX_LINKS = 2000
MAX_NAME = 200
LARGEST = 1e12
"""Numbers larger than this are mistakes: products of such numbers leave the range of double precision."""

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "dynamics": {"damping": 1, "friction": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "mesh": {"scale": 3},
    "color": {"rgba": 4},
}
"""Attributes that hold numbers, by element, with how many."""
SOLIDS = ("box", "cylinder", "capsule", "sphere")
"""Elements all of whose attributes are lengths. A length of zero is a placeholder, and takes no space."""
PLAIN_NUMBER = re.compile(r"[+\-.0-9a-zA-Z]{1,60}")
"""Excludes what Python reads as a number and C++ does not: underscores and digits of other scripts."""
MAY_BE_INFINITE = ("lower", "upper", "effort", "velocity")


def read_urdf(path: Path) -> str:
    """The text of a URDF file.

    Raises:
        RobotError: missing, a folder, not a regular file, too large, unreadable, or not text.
    """
    if os.path.isdir(path):
        raise RobotError(f"{path}: is a folder; expected a URDF file")
    if not os.path.exists(path):
        raise RobotError(f"{path!s:.300}: no such file; expected a URDF file or a name of energyopt.robots.catalogue()")
    if not os.path.isfile(path):
        raise RobotError(f"{path}: is not a regular file; expected a URDF file")
    try:
        size = path.stat().st_size
        data = path.read_bytes() if size <= MAX_URDF_BYTES else b""
    except OSError as error:
        raise RobotError(f"{path}: cannot be read ({error.strerror or error})") from None
    if size > MAX_URDF_BYTES:
        raise RobotError(f"{path}: {size / 1e6:.0f} MB; expected a URDF file of at most {MAX_URDF_BYTES / 1e6:.0f} MB")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise RobotError(f"{path}: is not UTF-8 text; expected a URDF file") from None


def parse_urdf(text: str, where: str) -> ET.Element:
    """The checked tree of a URDF; ``where`` names the source in messages.

    Raises:
        RobotError: malformed XML, a DOCTYPE, not a URDF, duplicate names, no tree, or a value that is no number.
    """
    _refuse_unsafe_xml(text, where)
    root = ET.fromstring(text.encode("utf-8"), parser=ET.XMLParser(encoding="utf-8"))
    if root.tag != "robot":
        raise RobotError(f"{where}: the outer element is <{root.tag}>; expected <robot> (a URDF, not SDF or MJCF)")
    if any(isinstance(e.tag, str) and "xacro" in e.tag for e in root.iter()):
        raise RobotError(f"{where}: contains xacro macros; expand it first: xacro robot.urdf.xacro > robot.urdf")
    _check_names(root, where)
    _check_numbers(root, where)
    _check_tree(root, where)
    return root


def numbers(element: ET.Element | None, key: str, default: str) -> list[float]:
    """The numbers of an attribute that `parse_urdf` has checked; ``default`` where it is absent."""
    return [float(x) for x in ((element.get(key) if element is not None else None) or default).split()]


def moving_joints(root: ET.Element) -> list[ET.Element]:
    return [j for j in root.findall("joint") if j.get("type") != "fixed"]


def parent_link(joint: ET.Element) -> str:
    return joint.find("parent").get("link")


def child_link(joint: ET.Element) -> str:
    return joint.find("child").get("link")


def _refuse_unsafe_xml(text: str, where: str) -> None:
    parser = expat.ParserCreate("utf-8")
    depth = 0

    def doctype(*_):
        raise RobotError(f"{where}: contains a DOCTYPE; a URDF needs none, and entities can expand without bound: remove it")

    def opened(*_):
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise RobotError(f"{where}: elements nested deeper than {MAX_DEPTH}; not a URDF")

    def closed(*_):
        nonlocal depth
        depth -= 1

    parser.StartDoctypeDeclHandler, parser.StartElementHandler, parser.EndElementHandler = doctype, opened, closed
    try:
        parser.Parse(text.encode("utf-8", "replace"), True)
    except expat.ExpatError as error:
        raise RobotError(f"{where}: malformed XML: {expat.errors.messages[error.code]} (line {error.lineno})") from None


def _check_names(root: ET.Element, where: str) -> None:
    for kind in ("link", "joint"):
        names = [e.get("name") or "" for e in root.findall(kind)]
        if "" in names:
            raise RobotError(f"{where}: {kind} number {names.index('') + 1} has no name")
        unprintable = [n for n in names if not n.isprintable() or len(n) > MAX_NAME]
        if unprintable:
            raise RobotError(f"{where}: {kind} name {unprintable[0][:40]!r} is too long or has control characters")
        repeated = [name for name, count in Counter(names).items() if count > 1]
        if repeated:
            raise RobotError(f"{where}: {kind} '{repeated[0]}' is defined more than once; names must be unique")
    count = len(root.findall("link"))
    if count > MAX_LINKS:
        raise RobotError(f"{where}: has {count} links; expected at most {MAX_LINKS}")
    if not count:
        raise RobotError(f"{where}: has no <link>; expected a robot")
    for joint in root.findall("joint"):
        if joint.get("type") not in JOINT_TYPES:
            kinds = ", ".join(JOINT_TYPES[:4])
            kind = shown(joint.get("type"))
            raise RobotError(f"{where}: joint '{joint.get('name')}' has type {kind}; expected one of {kinds}")


def _check_numbers(root: ET.Element, where: str) -> None:
    for owner in (*root.findall("link"), *root.findall("joint"), *root.findall("material")):
        label = f"{where}: {owner.tag} '{owner.get('name')}'"
        for element in owner.iter():
            for key, count in NUMBERS.get(element.tag, {}).items():
                if element.get(key) is not None:
                    _check_number(element, key, count, label)
                elif element.tag in SOLIDS:
                    raise RobotError(f"{label}: <{element.tag}> has no {key}; expected one [m]")
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is not None:
            _check_inertial_is_complete(inertial, f"{where}: link '{link.get('name')}'")


def _check_number(element: ET.Element, key: str, count: int, owner: str) -> None:
    words = element.get(key).split()
    expected = f"a finite number below {LARGEST:g}" if count == 1 else f"{count} finite numbers below {LARGEST:g}"
    try:
        values = [float(word) for word in words if PLAIN_NUMBER.fullmatch(word)]
    except ValueError:
        values = []
    if element.tag in SOLIDS and values and min(values) < 0:
        values, expected = [], "no negative size"
    largest = math.inf if element.tag == "limit" and key in MAY_BE_INFINITE else LARGEST
    good = all(abs(x) <= largest for x in values)  # nan is not
    if len(values) != count or not good:
        raise RobotError(f'{owner}: <{element.tag} {key}="{" ".join(words)[:80]}">: expected {expected}')


def _check_inertial_is_complete(inertial: ET.Element, owner: str) -> None:
    for tag in ("mass", "inertia"):
        element = inertial.find(tag)
        missing = [k for k in NUMBERS[tag] if element is None or element.get(k) is None]
        if missing:
            raise RobotError(f"{owner}: <inertial> has no {tag} {missing[0]}; give it, or remove the <inertial>")


def _check_tree(root: ET.Element, where: str) -> None:
    links = {link.get("name") for link in root.findall("link")}
    joint_above: dict[str, ET.Element] = {}
    for joint in root.findall("joint"):
        name = joint.get("name")
        for side in ("parent", "child"):
            end = joint.find(side)
            if end is None or end.get("link") not in links:
                what = "has no" if end is None else f"names the unknown link '{end.get('link')}' as its"
                raise RobotError(f"{where}: joint '{name}' {what} {side}")
        child = child_link(joint)
        if child in joint_above:
            other = joint_above[child].get("name")
            raise RobotError(
                f"{where}: link '{child}' hangs on two joints, '{other}' and '{name}': kinematic loops are not supported"
            )
        joint_above[child] = joint
    rooted: set[str] = set()
    for link in sorted(links):
        path: dict[str, None] = {}
        while link in joint_above and link not in rooted:
            if link in path:
                raise RobotError(f"{where}: link '{link}' is its own ancestor: kinematic loops are not supported")
            path[link] = None
            link = parent_link(joint_above[link])
        rooted.update(path)
    roots = sorted(links - set(joint_above))
    if len(roots) > 1:
        raise RobotError(f"{where}: links '{roots[0]}' and '{roots[1]}' both have no parent; expected one base link")
