"""The arguments of `load_robot`: what callers may write, and what it means joint by joint."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from energyopt.errors import RobotError
from energyopt.robots.messages import as_numbers, did_you_mean, shown
from energyopt.robots.payload import Payload
from energyopt.robots.preparation import CONTINUOUS_RANGE
from energyopt.robots.urdf_xml import LARGEST, moving_joints, numbers

GRAVITY = (0.0, 0.0, -9.81)
STRONGEST_GRAVITY = 1e4
"""[m/s²]: a thousand times the Earth's."""


def joint_values(
    key: str, value: ArrayLike | Mapping[str, float], names: Sequence[str], default: ArrayLike, where: str
) -> np.ndarray:
    """One number a joint, from one number for all, a sequence in joint order, or a dict by joint name.

    Args:
        key: argument name, for messages.
        value: what the caller gave.
        names: joint names, in order.
        default: values of the joints a dict leaves out, shape (nv,).

    Raises:
        RobotError: wrong count, unknown joint, not a number.
    """
    if isinstance(value, Mapping):
        unknown = [n for n in value if n not in names]
        if unknown:
            raise RobotError(f"{where}: {key}: no moving joint named '{unknown[0]}'; {did_you_mean(str(unknown[0]), names)}")
        for name, entry in value.items():
            if getattr(as_numbers(entry), "shape", None) != ():
                raise RobotError(f"{where}: {key} of joint '{name}' is {shown(entry)}; expected a number")
        value = [value.get(name, old) for name, old in zip(names, np.broadcast_to(default, len(names)), strict=True)]
    array = as_numbers(value)
    if array is None:
        raise RobotError(f"{where}: {key} is {shown(value)}; expected a number, {len(names)} numbers, or a dict by joint")
    if array.ndim == 0:
        array = np.full(len(names), float(array))
    if array.shape != (len(names),):
        raise RobotError(f"{where}: {key} has shape {array.shape}; expected {len(names)} numbers, for {', '.join(names)}")
    for name, number in zip(names, array, strict=True):
        if np.isnan(number):
            raise RobotError(f"{where}: {key} of joint '{name}' is nan; expected a number")
    array.flags.writeable = False
    return array


def non_negative(key: str, value: ArrayLike | Mapping[str, float], names: Sequence[str], where: str) -> np.ndarray:
    """Like `joint_values`, and every number ≥ 0 and no larger than any robot's; None means 0."""
    array = joint_values(key, 0.0 if value is None else value, names, 0.0, where)
    for name, number in zip(names, array, strict=True):
        if not 0 <= number <= LARGEST:
            raise RobotError(f"{where}: {key} of joint '{name}' is {number:g}; expected a number from 0 to {LARGEST:g}")
    return array


def locked_joints(locked: Any, where: str) -> tuple[dict[str, float], set[str]]:
    """Joints locked at a value, and joints locked at neutral."""
    if isinstance(locked, Mapping):
        return dict(locked), set()
    return {}, set(texts("locked", locked, "a dict of joint values, or joint names", where))


def texts(key: str, value: Any, expected: str, where: str) -> list[str]:
    """A list of strings or paths as strings, from None, one, or several.

    Raises:
        RobotError: something else.
    """
    if value is None:
        return []
    try:
        values = [value] if isinstance(value, (str, Path)) else list(value)
    except TypeError:
        values = [None]
    if not all(isinstance(v, (str, Path)) for v in values):
        raise RobotError(f"{where}: {key} is {shown(value)}; expected {expected}")
    return [str(v) for v in values]


def continuous_ranges(given: Any, names: list[str], where: str) -> dict[str, tuple[float, float]]:
    """The range of each continuous joint [rad]."""
    if given is None:
        return dict.fromkeys(names, CONTINUOUS_RANGE)
    if not isinstance(given, Mapping):
        return dict.fromkeys(names, _range(given, f"{where}: continuous_range"))
    ranges = dict.fromkeys(names, CONTINUOUS_RANGE)
    for name, pair in given.items():
        if name not in names:
            raise RobotError(f"{where}: continuous_range: no continuous joint named '{name}'; {did_you_mean(str(name), names)}")
        ranges[name] = _range(pair, f"{where}: continuous_range of joint '{name}'")
    return ranges


def _range(pair: Any, label: str) -> tuple[float, float]:
    array = as_numbers(pair)
    if array is None or array.shape != (2,) or not np.isfinite(array).all() or not array[0] < array[1]:
        raise RobotError(f"{label} is {shown(pair)}; expected a finite pair lower < upper [rad]")
    return float(array[0]), float(array[1])


def payloads(payload: Any, where: str) -> list[Payload]:
    """The bodies held, from None, one, or several."""
    bodies = [] if payload is None else list(payload) if isinstance(payload, (list, tuple)) else [payload]
    for body in bodies:
        if not isinstance(body, Payload):
            raise RobotError(f"{where}: payload is {shown(body)}; expected energyopt.Payload(mass, center, inertia, frame)")
    return bodies


def gravity_vector(value: ArrayLike | None, where: str) -> np.ndarray:
    """Gravity in the base frame [m/s²]; None means the Earth's, along −z."""
    array = as_numbers(GRAVITY if value is None else value)
    if array is None or array.shape != (3,) or not np.all(np.abs(array) <= STRONGEST_GRAVITY):
        expected = f"three numbers [m/s²], none beyond {STRONGEST_GRAVITY:g}, such as (0, 0, -9.81)"
        raise RobotError(f"{where}: gravity is {shown(value)}; expected {expected}")
    return array


def friction_velocity(value: Any, default: float, names: Sequence[str], where: str) -> float | np.ndarray:
    """v_s of Coulomb friction [rad/s]: one positive number, or one a joint; a dict leaves the others at ``default``."""
    array = as_numbers(value)
    if array is None and not isinstance(value, Mapping):
        raise RobotError(f"{where}: coulomb_velocity is {shown(value)}; expected a positive number, or one a joint")
    if array is None or array.shape != ():
        array = joint_values("coulomb_velocity", value, names, default, where)
    each = np.atleast_1d(array)
    bad = each[~((each > 0) & (each <= LARGEST))]
    if bad.size:
        raise RobotError(f"{where}: coulomb_velocity is {bad[0]:g}; expected a positive number, or one a joint")
    return array if array.shape else float(array)


def stated_friction(root: ET.Element) -> dict[str, dict[str, float]]:
    """Viscous and Coulomb friction by joint name, as the file states them."""
    joints = {j.get("name"): j.find("dynamics") for j in moving_joints(root)}
    attributes = {"viscous": "damping", "coulomb": "friction"}
    return {kind: {n: numbers(d, attribute, "0")[0] for n, d in joints.items()} for kind, attribute in attributes.items()}


def friction(stated: dict[str, dict[str, float]], viscous: Any, coulomb: Any, names: tuple[str, ...], where: str):
    """Viscous and Coulomb coefficients, and a note where the file states some that are not used."""
    arrays, unused = [], False
    for kind, value in (("viscous", viscous), ("coulomb", coulomb)):
        own = [stated[kind][n] for n in names]
        from_urdf = isinstance(value, str) and value == "urdf"
        arrays.append(non_negative(f"{kind}_friction", own if from_urdf else value, names, where))
        unused |= any(own) and not from_urdf and not np.any(arrays[-1])
    note = "The URDF's joint damping and friction are not used; viscous_friction='urdf', coulomb_friction='urdf' would use them."
    return arrays[0], arrays[1], [note] if unused else []
