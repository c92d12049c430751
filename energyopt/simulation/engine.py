"""The MuJoCo model of a robot, read by MuJoCo's own URDF compiler from the same text that Pinocchio read.

What is taken from the URDF: the tree, placements, axes, masses, inertias. What is set to what the plan assumes:
gravity, armature, friction (see `replaying`). What is left out: visual shapes; collision shapes unless asked for;
MuJoCo's joint limits, which are springs that add forces near a limit, where a plan is allowed to be (positions beyond
a limit are reported by validation instead). Collision shapes only report contacts; they exert no force.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from energyopt.errors import RobotError, SimulationError
from energyopt.robots.meshes import resolve_mesh
from energyopt.robots.model import RobotModel

LEAST_MASS, LEAST_INERTIA = 1e-12, 1e-12
"""[kg], [kg·m²] given to links that have none: MuJoCo refuses a moving body with less than 1e-15."""

MESH_SUFFIXES = (".stl", ".obj")
"""Mesh formats MuJoCo reads; others (Collada) are left out of the collision shapes."""


@dataclass(frozen=True, eq=False)
class Engine:
    """A compiled MuJoCo model with the maps from the robot's joint order to MuJoCo's.

    Attributes:
        model, data: MuJoCo's.
        qpos, dof: address of every joint of the robot in ``data.qpos`` and ``data.qvel``, shape (nv,).
        skipped_meshes: collision meshes that could not be used, by file name.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    qpos: np.ndarray
    dof: np.ndarray
    skipped_meshes: tuple[str, ...] = ()


def build_engine(robot: RobotModel, collisions: bool = False) -> Engine:
    """Compile the robot for MuJoCo.

    Args:
        robot: the arm; its URDF, gravity and armature are used.
        collisions: keep the URDF's collision shapes, so that contacts are reported.

    Raises:
        SimulationError: MuJoCo does not accept the model; the message carries its reason.
    """
    root = ET.fromstring(robot.urdf)
    skipped = _strip(root, robot, collisions)
    _fill_inertias(root)
    try:
        spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
        model = spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise SimulationError(f"{robot.name}: MuJoCo does not accept the model: {reason}") from None
    qpos, dof = _addresses(model, robot)
    model.opt.gravity[:] = robot.model.gravity.linear
    model.dof_armature[dof] = robot.dynamics.armature
    model.dof_damping[:] = model.dof_frictionloss[:] = model.jnt_stiffness[:] = 0.0
    model.jnt_limited[:] = 0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return Engine(model, mujoco.MjData(model), qpos, dof, tuple(skipped))


def _strip(root: ET.Element, robot: RobotModel, collisions: bool) -> list[str]:
    """Take out what MuJoCo must not read, in place; returns the collision meshes that were dropped."""
    skipped = []
    for tag in ("transmission", "gazebo", "material", "mujoco"):
        for element in root.findall(tag):
            root.remove(element)
    for link in root.iter("link"):
        for element in link.findall("visual"):
            link.remove(element)
        for element in link.findall("collision"):
            mesh = element.find("geometry/mesh")
            path = _mesh_path(robot, mesh) if collisions and mesh is not None else None
            if not collisions or (mesh is not None and path is None):
                link.remove(element)
                skipped += [mesh.get("filename", "")] if collisions else []
            elif path is not None:
                mesh.set("filename", str(path))
    for joint in root.iter("joint"):
        for element in [*joint.findall("dynamics"), *joint.findall("mimic"), *joint.findall("safety_controller")]:
            joint.remove(element)
    options = {"strippath": "false", "inertiafromgeom": "false", "fusestatic": "true", "balanceinertia": "false"}
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", options)
    return skipped


def _mesh_path(robot: RobotModel, mesh: ET.Element) -> Path | None:
    try:
        path = resolve_mesh(robot, mesh.get("filename", ""))
    except RobotError:
        return None
    return path if path.suffix.lower() in MESH_SUFFIXES else None


def _fill_inertias(root: ET.Element) -> None:
    """Make every link's mass and inertia such that MuJoCo accepts them, without changing the dynamics.

    A link without mass, or without inertia about some axis, gets the least there may be. A light link whose moments
    break the triangle inequality (A + B ≥ C) gets x·1 added, and the link it is fixed to gives x·1 up: an isotropic
    inertia has no direction, so the merged body is the same.
    """
    links = {link.get("name"): link for link in root.iter("link")}
    carrier = {
        joint.find("child").get("link"): joint.find("parent").get("link")
        for joint in root.findall("joint")
        if joint.get("type") == "fixed"
    }
    for name, link in links.items():
        mass = _child(_child(link, "inertial"), "mass")
        if float(mass.get("value", 0.0)) < LEAST_MASS:
            mass.set("value", repr(LEAST_MASS))
        moments = np.linalg.eigvalsh(_inertia(link))
        needed = max(LEAST_INERTIA - moments[0], moments[2] - moments[0] - moments[1])
        if needed <= -LEAST_INERTIA:
            continue
        needed += LEAST_INERTIA
        _add_inertia(link, needed)
        if needed > 3 * LEAST_INERTIA and name in carrier:
            while name in carrier:
                name = carrier[name]
            _add_inertia(links[name], -needed)


def _inertia(link: ET.Element) -> np.ndarray:
    """Inertia matrix of a link [kg·m²]; zero where the URDF has none."""
    inertia = _child(_child(link, "inertial"), "inertia")
    xx, xy, xz, yy, yz, zz = (float(inertia.get(key, 0.0)) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _add_inertia(link: ET.Element, amount: float) -> None:
    values = _inertia(link) + amount * np.eye(3)
    inertia = _child(_child(link, "inertial"), "inertia")
    for i, j, key in ((0, 0, "ixx"), (0, 1, "ixy"), (0, 2, "ixz"), (1, 1, "iyy"), (1, 2, "iyz"), (2, 2, "izz")):
        inertia.set(key, repr(float(values[i, j])))


def _child(element: ET.Element, tag: str) -> ET.Element:
    child = element.find(tag)
    return ET.SubElement(element, tag) if child is None else child


def _addresses(model: mujoco.MjModel, robot: RobotModel) -> tuple[np.ndarray, np.ndarray]:
    """Where the robot's joints are in MuJoCo's vectors, by name: branches may come in another order."""
    index = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in robot.joint_names]
    if -1 in index or model.njnt != robot.nv or model.nv != robot.nv:
        wanted = ", ".join(robot.joint_names)
        raise SimulationError(f"{robot.name}: MuJoCo reads {model.njnt} joints; expected exactly {wanted}")
    return model.jnt_qposadr[index].copy(), model.jnt_dofadr[index].copy()
