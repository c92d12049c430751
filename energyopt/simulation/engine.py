"""The MuJoCo model of a robot, read by MuJoCo's own URDF compiler from the same text that Pinocchio read.

What is taken from the URDF: the tree, placements, axes, masses, inertias. What is set to what the plan assumes:
gravity, armature, friction (see `control`). What is left out: shapes, of which only those of `surroundings` come back, to
report contacts; MuJoCo's joint limits, which are springs that add forces near a limit, where a plan is allowed to be
(positions beyond a limit are reported by validation instead).
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field

import mujoco
import numpy as np

from energyopt.errors import SimulationError
from energyopt.robots.model import RobotModel
from energyopt.simulation.surroundings import Surroundings, add_to_model, quaternions, solid_numbers

LEAST_MASS, LEAST_INERTIA = 1e-12, 1e-12
"""[kg], [kg·m²] given to links that have none: MuJoCo refuses a moving body with less than 1e-15."""


DEPTH_ITERATIONS = 100
"""Of MuJoCo's search for the depth of an overlap: its own 35 end 1 mm short for a mesh deep inside another solid."""


@dataclass(frozen=True, eq=False)
class Engine:
    """A compiled MuJoCo model with the maps from the robot's joint order to MuJoCo's.

    Attributes:
        model, data: MuJoCo's.
        qpos, dof: address of every joint of the robot in ``data.qpos`` and ``data.qvel``, shape (nv,).
        surroundings: what can touch; solid: number of the solid of every geometry, shape (ngeom,).
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    qpos: np.ndarray
    dof: np.ndarray
    surroundings: Surroundings = field(default_factory=Surroundings)
    solid: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))

    def drive_obstacles(self, times: np.ndarray) -> MovingBodies:
        """Poses of all moving obstacles at ``times`` [s], shape (N,), ready to be set step by step."""
        solids = self.surroundings.moving
        poses = [self.surroundings.obstacles[k - len(self.surroundings.bodies)].pose_at(times) for k in solids]
        bodies = [self.model.geom_bodyid[int(np.flatnonzero(self.solid == k)[0])] for k in solids]
        rows = np.array([self.model.body_mocapid[body] for body in bodies], dtype=int)
        stacked = np.stack(poses, axis=1) if poses else np.zeros((len(times), 0, 4, 4))
        return MovingBodies(rows, stacked[..., :3, 3].copy(), quaternions(stacked) if poses else np.zeros((len(times), 0, 4)))


@dataclass(frozen=True, eq=False)
class MovingBodies:
    """Moving obstacles at N instants.

    Attributes:
        rows: MuJoCo's numbers for them, shape (M,).
        position: [m], shape (N, M, 3); quaternion: (w, x, y, z), shape (N, M, 4).
    """

    rows: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray

    def place(self, k: int, data: mujoco.MjData) -> None:
        """Put every moving obstacle where it is at the k-th instant."""
        if len(self.rows):
            data.mocap_pos[self.rows], data.mocap_quat[self.rows] = self.position[k], self.quaternion[k]


def build_engine(robot: RobotModel, surroundings: Surroundings | None = None) -> Engine:
    """Compile the robot for MuJoCo.

    Args:
        robot: the arm; its URDF, gravity and armature are used.
        surroundings: solids whose contacts are to be reported; none by default.

    Raises:
        SimulationError: MuJoCo does not accept the model; the message carries its reason.
    """
    surroundings = surroundings or Surroundings()
    root = ET.fromstring(robot.urdf)
    _strip(root)
    _fill_inertias(root)
    try:
        spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
        add_to_model(spec, surroundings, robot)
        model = spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise SimulationError(f"{robot.name}: MuJoCo does not accept the model: {reason}") from None
    qpos, dof = _addresses(model, robot)
    model.opt.gravity[:] = robot.model.gravity.linear
    model.dof_armature[dof] = robot.dynamics.armature
    model.dof_damping[:] = model.dof_frictionloss[:] = model.jnt_stiffness[:] = 0.0
    model.jnt_limited[:] = 0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    model.opt.ccd_iterations = DEPTH_ITERATIONS
    return Engine(model, mujoco.MjData(model), qpos, dof, surroundings, solid_numbers(model, surroundings))


def _strip(root: ET.Element) -> None:
    """Take out what MuJoCo must not read, in place."""
    for tag in ("transmission", "gazebo", "material", "mujoco"):
        for element in root.findall(tag):
            root.remove(element)
    for link in root.iter("link"):
        for element in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(element)
    for joint in root.iter("joint"):
        for element in [*joint.findall("dynamics"), *joint.findall("mimic"), *joint.findall("safety_controller")]:
            joint.remove(element)
    options = {"strippath": "false", "inertiafromgeom": "false", "fusestatic": "true", "balanceinertia": "false"}
    options["discardvisual"] = "false"  # or MuJoCo would discard solids that exert no force as if they were decoration
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", options)


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
