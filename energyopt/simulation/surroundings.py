"""What a replay watches for contact: the solids of the arm, what is attached to it, the obstacles, and which may not meet.

The solids are those of `energyopt.geometry`, so that planner, exact check and replay speak of the same bodies: convex pieces of
the collision meshes, and shapes. MuJoCo finds their contacts by its own algorithms: an independent second opinion. In the
model they carry no mass and exert no force.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from energyopt.geometry.bodies import Body, collision_bodies
from energyopt.geometry.exact import obstacle_names
from energyopt.geometry.self_collision import self_collision_pairs
from energyopt.geometry.shapes import Box, Capsule, Cylinder, HalfSpace, Shape, Sphere
from energyopt.problem import Problem
from energyopt.robots.model import RobotModel

_FAR = 1e3
"""[m]: the gap of a pair, with the opposite margin. MuJoCo then reports overlaps and makes no force of them."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Solids and pairs of them.

    Attributes:
        bodies: of the arm and what is attached; obstacles: the rest. A solid's number counts bodies first, then obstacles.
        names: of every solid: link, attached object or obstacle.
        pairs: numbers of solids that may not meet, shape (P, 2).
    """

    bodies: tuple[Body, ...] = ()
    obstacles: tuple[Shape, ...] = ()
    names: tuple[str, ...] = ()
    pairs: np.ndarray = field(default_factory=lambda: np.empty((0, 2), dtype=int))

    @property
    def moving(self) -> list[int]:
        """Numbers of the solids whose pose is a function of time."""
        return [len(self.bodies) + k for k, obstacle in enumerate(self.obstacles) if obstacle.moves]


def surroundings_of(problem: Problem, plant: RobotModel) -> Surroundings:
    """Everything that can touch in a replay of a problem by ``plant``.

    Walls of a workspace that binds the whole arm count as obstacles; one that binds only the origins of some frames holds no
    solid out.

    Raises:
        GeometryError, RobotError: a collision mesh is damaged or missing.
    """
    walls = [wall for item in problem.workspace if not item.frames for wall in item.walls]
    attached, obstacles = problem.attached, (*problem.obstacles, *walls)
    bodies = collision_bodies(plant, attached)
    names = (*(body.link for body in bodies), *obstacle_names(obstacles))
    kept = self_collision_pairs(plant, attached).checked if problem.self_collision else ()
    apart = {frozenset(pair) for pair in kept}
    moving = [k for k, body in enumerate(bodies) if body.joint]
    pairs = [(k, len(bodies) + j) for k in moving for j in range(len(obstacles))]
    pairs += [(i, j) for i in range(len(bodies)) for j in range(i + 1, len(bodies)) if frozenset((names[i], names[j])) in apart]
    return Surroundings(bodies, obstacles, names, np.array(pairs, dtype=int).reshape(-1, 2))


def add_to_model(spec: mujoco.MjSpec, surroundings: Surroundings, robot: RobotModel) -> None:
    """Add every solid to a model as a geometry named by its number, and the pairs to look at."""
    carrier = {joint.name: joint.parent for joint in spec.joints}
    for k, body in enumerate(surroundings.bodies):
        to = spec.worldbody if body.joint == 0 else carrier[robot.model.names[body.joint]]
        _add_solid(spec, to, _geom_name(k), body.shape, body.shape.pose_at(0.0))
    for k, obstacle in enumerate(surroundings.obstacles, start=len(surroundings.bodies)):
        pose = obstacle.pose_at(0.0)
        if obstacle.moves:
            carried = spec.worldbody.add_body(mocap=True, pos=pose[:3, 3], quat=quaternions(pose))
            _add_solid(spec, carried, _geom_name(k), obstacle, np.eye(4))
        else:
            _add_solid(spec, spec.worldbody, _geom_name(k), obstacle, pose)
    for first, second in surroundings.pairs:
        spec.add_pair(geomname1=_geom_name(first), geomname2=_geom_name(second), margin=-_FAR, gap=_FAR)


def solid_numbers(model: mujoco.MjModel, surroundings: Surroundings) -> np.ndarray:
    """Number of the solid of every geometry of a compiled model, shape (ngeom,)."""
    numbers = np.zeros(model.ngeom, dtype=int)
    for k in range(len(surroundings.names)):
        numbers[model.geom(_geom_name(k)).id] = k
    return numbers


def quaternions(pose: np.ndarray) -> np.ndarray:
    """Unit quaternions (w, x, y, z) of poses of shape (…, 4, 4)."""
    turned = Rotation.from_matrix(pose[..., :3, :3]).as_quat()
    return np.roll(turned, 1, axis=-1)


def _geom_name(number: int) -> str:
    return f"solid {number}"


def _add_solid(spec: mujoco.MjSpec, body: Any, name: str, shape: Shape, pose: np.ndarray) -> None:
    """One geometry of a body, at ``pose`` (4, 4) in the body's axes."""
    own = {"name": name, "contype": 0, "conaffinity": 0, "mass": 0.0}
    if isinstance(shape, HalfSpace):
        pose = pose @ _plane_pose(shape)
    elif not isinstance(shape, (Box, Capsule, Cylinder, Sphere)):
        corners = np.asarray(shape.enclosing_points(), dtype=float)
        spec.add_mesh(name=name, uservert=corners.ravel().tolist(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
        own["meshname"] = name
    kind, size = _geometry(shape)
    body.add_geom(type=kind, size=size, pos=pose[:3, 3], quat=quaternions(pose), **own)


def _geometry(shape: Shape) -> tuple[mujoco.mjtGeom, list[float]]:
    """MuJoCo's word for a shape, and its three sizes: half lengths and radii [m]."""
    kinds = mujoco.mjtGeom
    if isinstance(shape, HalfSpace):
        return kinds.mjGEOM_PLANE, [0.0, 0.0, 1.0]
    if isinstance(shape, Sphere):
        return kinds.mjGEOM_SPHERE, [shape.radius, 0.0, 0.0]
    if isinstance(shape, Box):
        return kinds.mjGEOM_BOX, (0.5 * shape.size).tolist()
    if isinstance(shape, (Capsule, Cylinder)):
        kind = kinds.mjGEOM_CAPSULE if isinstance(shape, Capsule) else kinds.mjGEOM_CYLINDER
        return kind, [shape.radius, 0.5 * shape.length, 0.0]
    return kinds.mjGEOM_MESH, [0.0, 0.0, 0.0]


def _plane_pose(shape: HalfSpace) -> np.ndarray:
    """MuJoCo's planes have the solid below z = 0; this turns z along the normal and moves it by the offset."""
    pose = np.eye(4)
    pose[:3, :3] = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array(shape.normal)).matrix()
    pose[:3, 3] = shape.offset * shape.normal
    return pose
