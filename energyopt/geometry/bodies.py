"""What a robot occupies: the collision geometry of its URDF as convex bodies fixed to joints, and what is attached to it.

Every engine reads the same bodies: the cover by spheres, the exact distance check, the replay. Meshes become convex pieces
(see `pieces`); boxes, cylinders, spheres and capsules stay what they are. Where a URDF has no collision geometry at all, its
visual geometry stands in.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from energyopt.errors import GeometryError
from energyopt.geometry.cache import VERSION, cached_arrays, digest
from energyopt.geometry.mesh_files import read_mesh
from energyopt.geometry.pieces import convex_pieces
from energyopt.geometry.shapes import Box, Capsule, ConvexMesh, Cylinder, HalfSpace, Shape, Sphere
from energyopt.geometry.values import label
from energyopt.robots.meshes import MAX_MESH_BYTES, resolve_mesh
from energyopt.robots.messages import shown
from energyopt.robots.model import RobotModel
from energyopt.robots.preparation import rotation_from_rpy
from energyopt.robots.urdf_xml import numbers


@dataclass(frozen=True, eq=False)
class Attached:
    """A tool or a grasped object: a shape fixed to a frame of the robot.

    Attributes:
        shape: its pose is frame_T_shape and must not move.
        frame: a link, joint or frame; "" for the robot's tool frame.
        name: for reports and for pairs that may touch; by default the shape's name, else "attached".

    Raises:
        GeometryError: no shape, an unbounded or moving one.
    """

    shape: Shape
    frame: str = ""
    name: str = ""

    def __post_init__(self):
        if not isinstance(self.shape, Shape) or isinstance(self.shape, HalfSpace) or self.shape.moves:
            raise GeometryError(
                f"attached: shape is {shown(self.shape)}; expected a shape of finite size whose pose does not move"
            )
        label("attached: frame", self.frame)
        object.__setattr__(self, "name", label("attached: name", self.name) or self.shape.name or "attached")


@dataclass(frozen=True, eq=False)
class Body:
    """One convex solid of a robot.

    Attributes:
        link: the link it belongs to, or the name of what is attached.
        joint: index of the joint it moves with in ``robot.model``; 0 where it never moves.
        shape: its pose is joint_T_shape.
    """

    link: str
    joint: int
    shape: Shape


def collision_bodies(robot: RobotModel, attached: Sequence[Attached] = ()) -> tuple[Body, ...]:
    """The convex bodies of a robot, in the order of its URDF, and then what is attached.

    Raises:
        GeometryError: a mesh is damaged; the message names the link. RobotError: a mesh file is missing; no such frame.
    """
    return (*_own_bodies(robot), *(_fixed(robot, item.name, item.frame or robot.tool_frame, item.shape) for item in attached))


@lru_cache(maxsize=8)
def _own_bodies(robot: RobotModel) -> tuple[Body, ...]:
    root = ET.fromstring(robot.urdf)
    bodies = []
    for link in root.findall("link"):
        for element in link.findall(geometry_tag(root)):
            for shape in _shapes(robot, link.get("name"), element):
                bodies.append(_fixed(robot, link.get("name"), link.get("name"), shape))
    return tuple(bodies)


def geometry_tag(root: ET.Element) -> str:
    """Which elements of the links are the geometry: "collision", or "visual" where the whole file has none of those."""
    return "collision" if root.find("link/collision/geometry") is not None else "visual"


def mesh_files(robot: RobotModel) -> dict[str, Path]:
    """Files of the meshes that `collision_bodies` reads, by their name in the URDF."""
    root = ET.fromstring(robot.urdf)
    names = [mesh.get("filename") or "" for mesh in root.iterfind(f"link/{geometry_tag(root)}/geometry/mesh")]
    return {name: resolve_mesh(robot, name) for name in dict.fromkeys(names)}


def _fixed(robot: RobotModel, name: str, frame: str, shape: Shape) -> Body:
    place = robot.model.frames[robot.frame_id(frame)]
    return Body(name, int(place.parentJoint), replace(shape, pose=place.placement.homogeneous @ shape.pose))


def _shapes(robot: RobotModel, link: str, element: ET.Element) -> list[Shape]:
    """The convex solids of one collision element, in the link's frame; none where its size is zero."""
    where = f"{robot.name}: link '{link}'"
    pose = np.eye(4)
    origin = element.find("origin")
    pose[:3, :3], pose[:3, 3] = rotation_from_rpy(numbers(origin, "rpy", "0 0 0")), numbers(origin, "xyz", "0 0 0")
    geometry = element.find("geometry")
    kind = next(iter(geometry), None) if geometry is not None else None
    if kind is None:
        return []
    if kind.tag == "mesh":
        return [ConvexMesh(points=points, pose=pose, name=link) for points in _mesh_pieces(robot, kind, where)]
    size = {key: numbers(kind, key, "0") for key in ("size", "radius", "length") if kind.get(key)}
    if any(value <= 0 for values in size.values() for value in values) or not size:
        return []
    try:
        return [_primitive(kind.tag, size, pose, link)]
    except GeometryError as error:
        raise GeometryError(f"{where}: collision geometry: {error}") from None


def _primitive(tag: str, size: dict[str, list[float]], pose: np.ndarray, name: str) -> Shape:
    makers: dict[str, Any] = {"box": Box, "sphere": Sphere, "cylinder": Cylinder, "capsule": Capsule}
    if tag not in makers:
        raise GeometryError(f"<{tag}> is not known; expected mesh, {', '.join(makers)}")
    values = size.get("size"), *(size.get(key, [None])[0] for key in ("radius", "length"))
    arguments = {"box": values[:1], "sphere": values[1:2]}.get(tag, values[1:])
    return makers[tag](*arguments, pose=pose, name=name)


def _mesh_pieces(robot: RobotModel, mesh: ET.Element, where: str) -> list[np.ndarray]:
    """Corners of the convex pieces of a mesh file, in metres; kept in the cache."""
    path = resolve_mesh(robot, mesh.get("filename") or "")
    scale = np.array(numbers(mesh, "scale", "1 1 1"))
    key = digest(VERSION, path.read_bytes(), path.suffix.lower(), scale)

    def compute() -> dict[str, np.ndarray]:
        vertices, triangles = read_mesh(path, MAX_MESH_BYTES, f"{where}: mesh '{path.name}'")
        pieces = convex_pieces(vertices * scale, triangles)
        return {f"piece{k}": piece for k, piece in enumerate(pieces)}

    arrays = cached_arrays("mesh", key, compute, _are_pieces)
    return [arrays[f"piece{k}"] for k in range(len(arrays))]


def _are_pieces(arrays: dict[str, np.ndarray]) -> bool:
    tables = [arrays.get(f"piece{k}") for k in range(len(arrays))]
    return bool(tables) and all(
        t is not None and t.dtype == float and t.ndim == 2 and t.shape[1] == 3 and len(t) > 3 and np.isfinite(t).all()
        for t in tables
    )
