"""SphereModel: a robot as spheres, from its collision geometry.

Every point of every collision mesh lies inside a sphere of its link (protrusion ≤ 0, exactly: see `cover`), and no sphere
sticks out of its link by more than the resolution; small links, such as fingers, are covered finer in proportion, and links
that never move coarser. A motion that keeps the spheres clear keeps the robot clear; how much room that wastes is reported
link by link.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from energyopt.errors import GeometryError
from energyopt.geometry import bodies as bodies_module
from energyopt.geometry import cover as cover_module
from energyopt.geometry import hull as hull_module
from energyopt.geometry import pieces as pieces_module
from energyopt.geometry.bodies import Attached, Body, collision_bodies, mesh_files
from energyopt.geometry.cache import Arrays, cached_arrays, digest
from energyopt.geometry.cover import Cover, cover_bodies, posed_points, union_distance
from energyopt.geometry.kinematics import joint_placements, point_jacobians
from energyopt.geometry.shapes import Shape
from energyopt.geometry.shapes.round import ball_points
from energyopt.geometry.values import non_negative, positive
from energyopt.robots.messages import shown
from energyopt.robots.model import RobotModel

RESOLUTION = 0.02
"""Default of how far a sphere may stick out of its link [m]: about 100 spheres on a Panda."""
FINEST = 2e-3
SMALL_SHARE, SMALLEST = 0.1, 5e-3
"""Spheres stick out of a small link by at most this share of its extent, or 5 mm: it is fingers that go close to things."""
FIXED_SHARE = 0.05
"""Links that never move are often large (pedestals, torsos): their spheres may stick out by this share of their extent."""


@dataclass(frozen=True)
class LinkCover:
    """How one link is covered.

    Attributes:
        link: its name.
        count: number of spheres.
        mean_excess: mean distance from the link of the outer surface of its spheres [m].
        max_excess: upper bound of that distance [m]. Both without the inflation.
        protrusion: largest distance by which the link's surface leaves the spheres [m]; never positive.
    """

    link: str
    count: int
    mean_excess: float
    max_excess: float
    protrusion: float


@dataclass(frozen=True, eq=False)
class SphereModel:
    """A robot as spheres fixed to its joints.

    Attributes:
        model: the robot's kinematics.
        link: name of the link each sphere is on, length S.
        joint: index of the joint each sphere moves with, 0 for those that never move, shape (S,).
        center: in the joint's frame [m], shape (S, 3).
        radius: [m], inflation included, shape (S,).
        covers: one report a link.
    """

    model: pin.Model
    link: tuple[str, ...]
    joint: np.ndarray
    center: np.ndarray
    radius: np.ndarray
    covers: tuple[LinkCover, ...]

    @property
    def links(self) -> tuple[str, ...]:
        """Links that have spheres, in order."""
        return tuple(dict.fromkeys(self.link))

    def __len__(self) -> int:
        return len(self.radius)

    def summary(self) -> str:
        """One line: count, mean and largest excess."""
        if not len(self):
            return "no spheres: the robot has no geometry"
        weights = [c.count for c in self.covers]
        mean, worst = np.average([c.mean_excess for c in self.covers], weights=weights), max(c.max_excess for c in self.covers)
        return f"{len(self)} spheres on {len(self.links)} links; excess {1e3 * mean:.1f} mm mean, {1e3 * worst:.1f} mm at most"


def robot_spheres(
    robot: RobotModel, resolution: float = RESOLUTION, inflation: float = 0.0, attached: Sequence[Attached] = ()
) -> SphereModel:
    """Cover every link of a robot, and what is attached to it, by spheres. The result is kept in the user's cache.

    Args:
        robot: any robot; its URDF's collision meshes and primitives count (see `bodies`).
        resolution: how far a sphere may stick out of its link [m]; smaller means more spheres. Of a link less than ten times
            as large, a tenth of its extent, but not less than 5 mm.
        inflation: added to every radius [m].
        attached: tools and grasped objects.

    Raises:
        GeometryError: resolution or inflation is out of range, or a mesh is damaged; RobotError: a mesh is missing.
    """
    resolution, inflation = positive("resolution", resolution), non_negative("inflation", inflation)
    if resolution < FINEST:
        raise GeometryError(f"resolution is {resolution:g} m; expected at least {FINEST:g}: the count grows with its square")
    key = digest(_sources(), robot.urdf, *_file_bytes(robot), repr(resolution), robot.tool_frame, *_described(robot, attached))
    arrays = cached_arrays("spheres", key, lambda: _compute(robot, resolution, attached), _is_model)
    links = [str(name) for name in arrays["link_names"]]
    covers = [LinkCover(name, int(row[0]), *map(float, row[1:])) for name, row in zip(links, arrays["covers"], strict=True)]
    names = [name for cover in covers for name in [cover.link] * cover.count]
    model = SphereModel(
        robot.model,
        tuple(names),
        arrays["joint"],
        arrays["center"],
        arrays["radius"] + inflation,
        tuple(c for c in covers if c.count),
    )
    for array in (model.joint, model.center, model.radius):
        array.flags.writeable = False
    return model


def centers(spheres: SphereModel, q: ArrayLike) -> np.ndarray:
    """Centres of the spheres in the world [m], shape (N, S, 3), at configurations ``q`` (N, nv) [rad]."""
    rotation, position = joint_placements(spheres.model, q)
    return position[:, spheres.joint] + np.einsum("nsij,sj->nsi", rotation[:, spheres.joint], spheres.center)


def center_jacobians(spheres: SphereModel, q: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Centres [m], shape (N, S, 3), and their derivatives ∂center/∂q [m/rad], shape (N, S, 3, nv)."""
    rotation, position = joint_placements(spheres.model, q)
    points = position[:, spheres.joint] + np.einsum("nsij,sj->nsi", rotation[:, spheres.joint], spheres.center)
    return points, point_jacobians(spheres.model, rotation, position, spheres.joint, points)


def _compute(robot: RobotModel, resolution: float, attached: Sequence[Attached]) -> Arrays:
    groups: dict[str, list[Body]] = {}
    for body in collision_bodies(robot, attached):
        groups.setdefault(body.link, []).append(body)
    with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
        # The largest first, so that no thread ends with it alone.
        jobs = {link: pool.submit(_cover_link, bodies, resolution) for link, bodies in sorted(groups.items(), key=_size)}
        found = [jobs[link].result() for link in groups]
    rows = [
        (len(c.radii), mean_excess(c, [b.shape for b in bodies]), c.excess.max(initial=0.0), c.protrusion)
        for c, bodies in zip(found, groups.values(), strict=True)
    ]
    counts = [len(c.radii) for c in found]
    return {
        "link_names": np.array(list(groups), dtype=str) if groups else np.empty(0, dtype="<U1"),
        "covers": np.array(rows, dtype=float).reshape(-1, 4),
        "joint": np.repeat(np.array([bodies[0].joint for bodies in groups.values()], dtype=np.int64), counts),
        "center": np.concatenate([c.centers for c in found]) if found else np.empty((0, 3)),
        "radius": np.concatenate([c.radii for c in found]) if found else np.empty(0),
    }


def _size(item: tuple[str, Sequence[Body]]) -> float:
    return -sum(body.shape.bounding_radius for body in item[1])


def _cover_link(bodies: Sequence[Body], resolution: float) -> Cover:
    shapes = [body.shape for body in bodies]
    points = np.concatenate([posed_points(shape) for shape in shapes])
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    if bodies[0].joint == 0:
        return cover_bodies(shapes, max(resolution, FIXED_SHARE * extent))
    return cover_bodies(shapes, min(resolution, max(SMALL_SHARE * extent, SMALLEST)))


def mean_excess(cover: Cover, shapes: Sequence[Shape]) -> float:
    """Mean distance [m] from the bodies of the outer surface of their balls, over some 250 directions a ball."""
    unit = ball_points(1.0)
    unit = unit / np.linalg.norm(unit, axis=1)[:, None]
    points = (cover.centers[:, None] + cover.radii[:, None, None] * unit).reshape(-1, 3)
    weight = np.repeat(cover.radii**2, len(unit))
    buried = np.zeros(len(points), bool)
    for center, radius in zip(cover.centers, cover.radii, strict=True):
        buried |= np.linalg.norm(points - center, axis=1) < radius * (1 - 1e-9)
    outer = ~buried
    if not outer.any():
        return 0.0
    return float(np.average(np.maximum(union_distance(shapes, points[outer]), 0.0), weights=weight[outer]))


def _sources() -> bytes:
    """The text of the modules that decide the result, so that another version of them computes anew."""
    modules = (bodies_module, cover_module, hull_module, pieces_module)
    return b"".join(Path(file).read_bytes() for file in (__file__, *(m.__file__ for m in modules)))


def _file_bytes(robot: RobotModel) -> list[bytes]:
    return [part for name, path in mesh_files(robot).items() for part in (name.encode(), path.read_bytes())]


def _described(robot: RobotModel, attached: Sequence[Attached]) -> list[str | np.ndarray]:
    """What is attached, as parts of a hash.

    Raises:
        GeometryError: something else than `Attached`, or a name that is taken.
    """
    parts: list[str | np.ndarray] = []
    taken = set(robot.frame_names)
    for item in attached:
        if not isinstance(item, Attached):
            raise GeometryError(f"attached: holds {shown(item)}; expected energyopt.geometry.Attached(shape, frame)")
        if item.name in taken:
            raise GeometryError(f"attached: the name '{item.name}' is taken; give each attached shape a name of its own")
        taken.add(item.name)
        robot.frame_id(item.frame or robot.tool_frame)
        parts += [item.name, item.frame, item.shape.kind, np.array(item.shape.pose), np.array(item.shape.enclosing_points())]
    return parts


def _is_model(arrays: Arrays) -> bool:
    try:
        names, covers, joint, center, radius = (arrays[k] for k in ("link_names", "covers", "joint", "center", "radius"))
        count = len(radius)
        numbers_fit = covers.shape == (len(names), 4) and int(covers[:, 0].sum()) == count == len(joint) == len(center)
        finite = all(np.isfinite(x).all() for x in (covers, center, radius))
        return numbers_fit and finite and center.shape == (count, 3) and joint.dtype == np.int64 and bool(np.all(radius > 0))
    except (KeyError, TypeError, IndexError, ValueError):
        return False
