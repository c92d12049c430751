"""Variation: the same arm, carrying more, heavier or rubbing differently.

Masses and inertias of the bodies are multiplied, body by body (one body a joint: all that is fixed behind it); centres of mass
stay. Friction is multiplied joint by joint. A payload is added to what the arm carries already. Rotor inertia stays.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from energyopt.dynamics.body import Dynamics
from energyopt.errors import RobotError
from energyopt.robots import preparation
from energyopt.robots.arguments import gravity_vector, non_negative
from energyopt.robots.messages import as_numbers, shown
from energyopt.robots.model import RobotModel
from energyopt.robots.payload import Payload
from energyopt.robots.urdf_xml import child_link, parent_link


@dataclass(frozen=True, eq=False)
class Variation:
    """How an arm differs from its model.

    Attributes:
        payload: a body it carries besides; None for none.
        masses: factors > 0 on mass and inertia of each joint's body, one number or shape (nv,).
        friction: factors ≥ 0 on viscous and Coulomb friction of each joint, likewise.

    Raises:
        RobotError: a factor is no such number.
    """

    payload: Payload | None = None
    masses: ArrayLike = 1.0
    friction: ArrayLike = 1.0

    def __post_init__(self):
        if self.payload is not None and not isinstance(self.payload, Payload):
            raise RobotError(f"variation: payload is {shown(self.payload)}; expected an energyopt.Payload or None")
        for key, least in (("masses", "> 0"), ("friction", "≥ 0")):
            values = as_numbers(getattr(self, key))
            good = values is not None and values.ndim <= 1 and np.all(np.isfinite(values))
            if not good or not np.all(values > 0 if key == "masses" else values >= 0):
                raise RobotError(f"variation: {key} is {shown(getattr(self, key))}; expected factors {least}, one or one a joint")
            object.__setattr__(self, key, values)


def varied_dynamics(robot: RobotModel, variation: Variation) -> Dynamics:
    """The dynamics of a robot under a variation, without its URDF (much quicker than `vary`).

    Raises:
        RobotError: another number of factors than joints, or a payload at a frame the robot does not have.
    """
    masses, friction = (_factors(robot, key, getattr(variation, key)) for key in ("masses", "friction"))
    model = pin.Model(robot.model)
    for joint, factor in enumerate(masses, start=1):
        body = model.inertias[joint]
        model.inertias[joint] = pin.Inertia(body.mass * factor, body.lever, body.inertia * factor)
    if variation.payload is not None:
        joint, body = payload_body(robot, variation.payload)
        if joint:
            model.inertias[joint] = model.inertias[joint] + body
    dynamics = robot.dynamics
    return replace(
        dynamics,
        model=model,
        viscous_friction=dynamics.viscous_friction * friction,
        coulomb_friction=dynamics.coulomb_friction * friction,
    )


def vary(robot: RobotModel, variation: Variation) -> RobotModel:
    """A robot under a variation, its URDF included: something to plan for, or to replay a plan with.

    Raises:
        RobotError: see `varied_dynamics`.
    """
    dynamics = varied_dynamics(robot, variation)
    root = ET.fromstring(robot.urdf)
    _scale_bodies(root, robot, _factors(robot, "masses", variation.masses))
    notes = robot.notes
    if variation.payload is not None:
        notes += (preparation.attach_payload(root, variation.payload, robot.tool_frame, robot.name),)
    return replace(robot, dynamics=dynamics, urdf=preparation.to_text(root), notes=notes)


def with_numbers(
    robot: RobotModel,
    variation: Variation = Variation(),
    armature: ArrayLike | None = None,
    viscous_friction: ArrayLike | None = None,
    coulomb_friction: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
) -> RobotModel:
    """A robot with a variation, and with some numbers of its dynamics replaced; all as `load_robot` takes them.

    What is prepared of the robot's geometry, and its compiled kernels, serve the new one too.

    Raises:
        RobotError: a number makes no sense.
    """
    given = {"armature": armature, "viscous_friction": viscous_friction, "coulomb_friction": coulomb_friction}
    given = {key: non_negative(key, value, robot.joint_names, robot.name) for key, value in given.items() if value is not None}
    if gravity is not None:
        gravity = gravity_vector(gravity, robot.name)
    varied = vary(robot, variation)
    model, dynamics = varied.dynamics.model, varied.dynamics  # a model of its own: `varied_dynamics` copies it
    if "armature" in given:
        model.armature = given.pop("armature").copy()
    if gravity is not None:
        model.gravity = pin.Motion(gravity, np.zeros(3))
    return replace(varied, dynamics=replace(dynamics, **given), like=robot.geometry)


def payload_body(robot: RobotModel, payload: Payload) -> tuple[int, pin.Inertia]:
    """Number of the joint that carries a payload (0: the fixed base), and the payload's inertia in its frame."""
    # The name of a joint stands for the link that it moves, whose frame is at the same place.
    frame = robot.model.frames[robot.frame_id(payload.frame or robot.tool_frame)]
    body = pin.Inertia(payload.mass, np.asarray(payload.center), np.asarray(payload.inertia))
    return int(frame.parentJoint), frame.placement.act(body)


def _factors(robot: RobotModel, key: str, values: np.ndarray) -> np.ndarray:
    if values.ndim and values.shape != (robot.nv,):
        raise RobotError(f"{robot.name}: variation: {key} has {values.size} factors; expected one, or {robot.nv}")
    return np.broadcast_to(values, (robot.nv,))


def _scale_bodies(root: ET.Element, robot: RobotModel, factors: np.ndarray) -> None:
    """Multiply mass and inertia of every link by the factor of the joint that moves it, in place."""
    above = {child_link(joint): joint for joint in root.findall("joint")}
    numbers = {name: k for k, name in enumerate(robot.joint_names)}
    for link in root.findall("link"):
        joint = above.get(link.get("name"))
        while joint is not None and joint.get("name") not in numbers:
            joint = above.get(parent_link(joint))
        inertial = link.find("inertial")
        if joint is None or inertial is None:
            continue
        factor = float(factors[numbers[joint.get("name")]])
        for element, keys in (("mass", ("value",)), ("inertia", ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))):
            found = inertial.find(element)
            for key in keys if found is not None and factor != 1.0 else ():
                if found.get(key) is not None:
                    found.set(key, repr(float(found.get(key)) * factor))
