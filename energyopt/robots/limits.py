"""Joint limits: what the URDF states, what the caller states in its place, and what neither does.

Position, velocity and torque limits must come from one of the two: a URDF that says 0, or nothing, means "not known",
and planning needs them. Acceleration, jerk and torque rate are unlimited (∞) unless given.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from energyopt.errors import RobotError
from energyopt.robots.arguments import joint_values
from energyopt.robots.messages import shown
from energyopt.robots.model import Limits
from energyopt.robots.urdf_xml import numbers

FROM_URDF = {"velocity": "velocity", "torque": "effort"}
SCALABLE = ("velocity", "torque", "acceleration", "jerk", "torque_rate")
UNLIMITED = 1e9
"""How an infinite velocity or torque limit is written into a URDF, which knows no infinity."""


def build_limits(
    root: ET.Element,
    names: Sequence[str],
    given: Mapping[str, ArrayLike | None],
    scale: Mapping[str, ArrayLike] | None,
    where: str,
) -> Limits:
    """The limits in force.

    Args:
        root: prepared URDF.
        names: joint names, in model order.
        given: "position" (a pair), "velocity", "torque", "acceleration", "jerk", "torque_rate"; None means the URDF's own.
        scale: factors by kind, applied last.

    Raises:
        RobotError: a limit is missing, inverted, zero, negative or NaN; names the joint, the value and the remedy.
    """
    joints = {j.get("name"): j for j in root.findall("joint")}
    limit = [joints[n].find("limit") for n in names]
    lower, upper = _positions(limit, names, given.get("position"), where)
    own = {}
    for kind in SCALABLE:
        attribute = FROM_URDF.get(kind)
        stated = np.array([numbers(x, attribute, "0")[0] for x in limit]) if attribute else np.full(len(names), np.inf)
        value = given.get(kind)
        array = stated if value is None else joint_values(f"{kind}_limits", value, names, stated, where)
        own[kind] = _checked(kind, array, names, attribute if value is None else None, where)
    if scale is not None and not isinstance(scale, Mapping):
        raise RobotError(f"{where}: limit_scale is {shown(scale)}; expected a dict such as {{'velocity': 0.5}}")
    for kind, factor in (scale or {}).items():
        if kind not in SCALABLE:
            raise RobotError(f"{where}: limit_scale: no limit '{kind}' to scale; expected {', '.join(SCALABLE)}")
        factors = joint_values(f"limit_scale['{kind}']", factor, names, 1.0, where)
        if not (np.isfinite(factors).all() and (factors > 0).all()):
            raise RobotError(f"{where}: limit_scale['{kind}'] is {factors.tolist()}; expected positive factors")
        own[kind] = _frozen(own[kind] * factors)
    return Limits(lower=lower, upper=upper, **own)


def write_limits(root: ET.Element, names: Sequence[str], limits: Limits) -> None:
    """Write the limits in force into the URDF, in place, so that every engine reads the same."""
    joints = {j.get("name"): j for j in root.findall("joint")}
    for i, name in enumerate(names):
        limit = joints[name].find("limit")
        limit = ET.SubElement(joints[name], "limit") if limit is None else limit
        limit.attrib.clear()
        stated = {"lower": limits.lower, "upper": limits.upper, "effort": limits.torque, "velocity": limits.velocity}
        for key, value in stated.items():
            limit.set(key, repr(float(min(value[i], UNLIMITED))))


def _positions(limit: Sequence, names: Sequence[str], given: ArrayLike | None, where: str) -> tuple[np.ndarray, np.ndarray]:
    lower, upper = (np.array([numbers(x, key, "0")[0] for x in limit]) for key in ("lower", "upper"))
    if given is not None:
        lower, upper = _given_positions(given, names, lower, upper, where)
    for name, low, high in zip(names, lower, upper, strict=True):
        remedy = f"expected lower < upper; correct the file, or give position_limits={{'{name}': (lower, upper)}}"
        if low == 0 and high == 0:
            raise RobotError(f"{where}: joint '{name}': position limits are missing (lower = upper = 0); {remedy}")
        if not low < high:
            raise RobotError(f"{where}: joint '{name}': position limits are inverted or empty ({low:g} to {high:g}); {remedy}")
        if not (np.isfinite(low) and np.isfinite(high)):
            raise RobotError(f"{where}: joint '{name}': position limits {low:g} to {high:g} are not finite; give a range")
    return _frozen(lower), _frozen(upper)


def _given_positions(given: ArrayLike, names: Sequence[str], lower: np.ndarray, upper: np.ndarray, where: str):
    """The caller's (lower, upper), from a pair or from a dict of pairs; a dict keeps the stated ones elsewhere."""
    try:
        if isinstance(given, Mapping):
            low, high = ({name: pair[k] for name, pair in given.items() if len(pair) == 2} for k in (0, 1))
            if len(low) < len(given):
                raise ValueError
        else:
            low, high = given
    except (TypeError, ValueError, KeyError):
        raise RobotError(f"{where}: position_limits is {shown(given)}; expected (lower, upper), or such pairs by joint") from None
    return (
        joint_values("position_limits (lower)", low, names, lower, where),
        joint_values("position_limits (upper)", high, names, upper, where),
    )


def _checked(kind: str, array: np.ndarray, names: Sequence[str], attribute: str | None, where: str) -> np.ndarray:
    for name, number in zip(names, array, strict=True):
        if number > 0:
            continue
        place = f'<limit {attribute}="{number:g}">' if attribute else f"{kind}_limits {number:g}"
        fault = "is negative" if number < 0 else f"states no {kind} limit" if attribute else f"allows no {kind}"
        remedy = f"; correct the file, or give {kind}_limits={{'{name}': …}}" if attribute else ""
        raise RobotError(f"{where}: joint '{name}': {place} {fault}; expected a positive number{remedy}")
    return _frozen(array)


def _frozen(array: np.ndarray) -> np.ndarray:
    array = np.array(array, dtype=float)
    array.flags.writeable = False
    return array
