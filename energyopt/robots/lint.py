"""Is this robot possible? Masses, inertias and axes of a URDF, judged before anything is computed from them.

A rigid body's inertia matrix about its centre of mass has principal moments J₁ ≤ J₂ ≤ J₃ with J₁ ≥ 0 and
J₁ + J₂ ≥ J₃ (each moment is an integral of squared distances; P. M. Wensing et al., "Linear Matrix Inequalities for
Physically-Consistent Inertial Parameter Identification", 2018). Files round their numbers to four or five digits,
so an excess of 1e-4 of J₃, or of what the same mass would have at 0.03 mm, is let pass.

Real files also hold links of no weight, and trifles (antennas, foot contacts) with made-up inertias. What counts is
what moves: a fault is an error where it enters the dynamics, and a note where the link never moves, or where it is
fixed to a body a hundred times heavier.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin

from energyopt.errors import RobotError
from energyopt.robots.urdf_xml import child_link, moving_joints, numbers, parent_link

RELATIVE_EXCESS = 1e-4
SQUARED_LENGTH = 1e-9
"""Tolerances of the triangle inequality: of the largest moment, and per mass [m²]."""
SHORTEST_AXIS = 1e-3
"""An axis shorter than this is no rounded unit vector: its direction is what rounding made of it."""
TRIFLE = 0.01
"""A fixed link lighter than this share of the body it belongs to may have an impossible inertia."""


def inertia_fault(mass: float, inertia: np.ndarray) -> str:
    """What is impossible about an inertia matrix about the centre of mass [kg·m²], or ""."""
    moments = np.linalg.eigvalsh(inertia)
    slack = RELATIVE_EXCESS * abs(moments[2]) + SQUARED_LENGTH * abs(mass)
    shown = ", ".join(f"{m:.4g}" for m in moments)
    if moments[0] < -slack:
        return f"inertia has the principal moments {shown} kg·m²; expected none negative"
    if moments[0] + moments[1] < moments[2] - slack:
        return f"inertia has the principal moments {shown} kg·m²; no body has them: expected the largest ≤ the sum of the others"
    return ""


def lint_links(root: ET.Element, where: str) -> list[str]:
    """Check mass and inertia of every link of the prepared URDF (locked joints already fixed).

    Impossible numbers of links that never move are taken out, in place: they enter no torque, and other engines refuse them.

    Returns:
        notes: faults of links that do not matter to the dynamics, one sentence each.

    Raises:
        RobotError: names the link and the value.
    """
    bodies = _bodies(root)
    weights = {name: _link_mass(link) for name, link in _links(root).items()}
    notes = []
    driven = {child_link(j) for j in moving_joints(root)}
    for name, link in _links(root).items():
        fault = _link_fault(link, driven=name in driven)
        if not fault:
            continue
        body = bodies[name]
        total = sum(weights[n] for n, b in bodies.items() if b == body)
        light = name not in driven and 0 < weights[name] < TRIFLE * total
        still = body == _base(root)
        if weights[name] < 0 or not (still or light):
            raise RobotError(f"{where}: link '{name}': {fault}")
        if still:
            link.remove(link.find("inertial"))
            notes.append(f"Link '{name}': {fault}; left out, since it does not move.")
        else:
            notes.append(f"Link '{name}': {fault}; kept, since it weighs less than {TRIFLE:.0%} of the body it is fixed to.")
    return notes


def lint_bodies(model: pin.Model, joint_child: dict[str, str], where: str) -> None:
    """Check what each joint moves once fixed links are merged.

    Raises:
        RobotError: a moving body has no mass, or its merged inertia is impossible.
    """
    for i in range(1, model.njoints):
        body, name = model.inertias[i], model.names[i]
        label = f"{where}: link '{joint_child[name]}' (moved by joint '{name}')"
        if not body.mass > 0:
            raise RobotError(
                f"{label} has mass {body.mass:g} kg; expected a positive mass: give its <inertial>, or lock the joint"
            )
        fault = inertia_fault(body.mass, np.asarray(body.inertia))
        if fault:
            raise RobotError(f"{label}, with what is fixed to it: {fault}")


def lint_mass_matrix(model: pin.Model, q: np.ndarray, where: str) -> None:
    """Check that every joint has something to turn: a point mass on its axis leaves the dynamics singular.

    Raises:
        RobotError: names the joint.
    """
    inertia = np.diag(pin.crba(model, model.createData(), q))
    for name, value in zip(model.names[1:], inertia, strict=True):
        if not value > 1e-12:
            raise RobotError(
                f"{where}: joint '{name}' moves an inertia of {value:g} about its axis; give its link an inertia, or set armature"
            )


def normalise_axes(root: ET.Element, where: str) -> list[str]:
    """Make every joint axis a unit vector, in place; a note for each that was not.

    Raises:
        RobotError: a zero axis; names the joint.
    """
    notes = []
    for joint in moving_joints(root):
        if joint.get("type") in ("floating", "planar"):
            continue
        element, name = joint.find("axis"), joint.get("name")
        axis = np.array(numbers(element, "xyz", "1 0 0"))
        norm = np.linalg.norm(axis)
        if not norm > SHORTEST_AXIS:
            raise RobotError(f"{where}: joint '{name}' has the axis {axis.tolist()}; expected a unit vector, such as 0 0 1")
        if element is not None and abs(norm - 1) > 1e-12:
            element.set("xyz", " ".join(repr(float(x)) for x in axis / norm))
        if abs(norm - 1) > 1e-5:
            notes.append(f"Joint '{name}': axis of length {norm:.6g} made a unit vector.")
    return notes


def _links(root: ET.Element) -> dict[str, ET.Element]:
    return {link.get("name"): link for link in root.findall("link")}


def _base(root: ET.Element) -> str:
    return next(iter(set(_links(root)) - {child_link(j) for j in root.findall("joint")}))


def _bodies(root: ET.Element) -> dict[str, str]:
    """For each link, the topmost link of the rigid body it belongs to."""
    above = {child_link(j): j for j in root.findall("joint")}
    bodies = {}
    for name in _links(root):
        top = name
        while top in above and above[top].get("type") == "fixed":
            top = parent_link(above[top])
        bodies[name] = top
    return bodies


def _link_mass(link: ET.Element) -> float:
    return numbers(link.find("inertial/mass"), "value", "0")[0]


def _link_inertia(link: ET.Element) -> np.ndarray:
    get = lambda key: numbers(link.find("inertial/inertia"), key, "0")[0]
    return np.array(
        [
            [get("ixx"), get("ixy"), get("ixz")],
            [get("ixy"), get("iyy"), get("iyz")],
            [get("ixz"), get("iyz"), get("izz")],
        ]
    )


def _link_fault(link: ET.Element, driven: bool) -> str:
    """What is impossible about a link's own numbers; no <inertial>, or all zero on a fixed link, is a mere frame."""
    if link.find("inertial") is None:
        return ""
    mass, inertia = _link_mass(link), _link_inertia(link)
    if mass < 0:
        return f"mass is {mass:g} kg; expected a positive number"
    if mass == 0 and (driven or inertia.any()):
        return "mass is 0 kg; expected a positive number (or no <inertial>, for a mere frame)"
    return inertia_fault(mass, inertia)
