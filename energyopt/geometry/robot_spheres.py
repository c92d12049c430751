"""SphereModel: a robot as spheres, from its collision geometry.

Every point of every collision mesh lies inside a sphere of its link (protrusion ≤ 0, exactly: see `cover`), and no sphere
sticks out of its link by more than the resolution; small links, such as fingers, are covered finer in proportion, and links
that never move coarser. A motion that keeps the spheres clear keeps the robot clear; how much room that wastes is reported
link by link.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from energyopt.errors import GeometryError
from energyopt.geometry.bodies import Attached, Body, collision_bodies
from energyopt.geometry.cache import VERSION, Arrays, cached_arrays, digest
from energyopt.geometry.cover import Cover, cover_bodies, posed_points, union_distance
from energyopt.geometry.kinematics import joint_placements, point_jacobians
from energyopt.geometry.shapes import Shape
from energyopt.geometry.shapes.round import ball_points
from energyopt.geometry.values import non_negative, positive
from energyopt.robots.messages import shown
from energyopt.robots.model import RobotModel
from energyopt.threads import Wanted, always_wanted, side_by_side

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
    _check_attached(robot, attached)
    links = _covered_links(robot, resolution, attached)
    parts = lambda key, empty: np.concatenate([getattr(link, key) for link in links]) if links else empty
    counts = [len(link.radius) for link in links]
    model = SphereModel(
        robot.model,
        tuple(link.report.link for link in links for _ in link.radius),
        np.repeat(np.array([link.joint for link in links], dtype=np.int64), counts),
        parts("center", np.empty((0, 3))),
        parts("radius", np.empty(0)) + inflation,
        tuple(link.report for link in links if link.report.count),
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


@dataclass(frozen=True, eq=False)
class _LinkBalls:
    """The balls over one link: in its joint's frame, centre [m] (S, 3) and radius [m] (S,)."""

    joint: int
    center: np.ndarray
    radius: np.ndarray
    report: LinkCover


def _covered_links(robot: RobotModel, resolution: float, attached: Sequence[Attached]) -> list[_LinkBalls]:
    groups: dict[str, list[Body]] = {}
    for body in collision_bodies(robot, attached):
        groups.setdefault(body.link, []).append(body)
    order = sorted(groups.items(), key=_size)  # the largest first, so that no thread ends with it alone
    covers = side_by_side(lambda item, wanted: _cover_link(item[1], resolution, wanted), order)
    found = dict(zip((link for link, _ in order), covers, strict=True))
    return [found[link] for link in groups]


def _size(item: tuple[str, Sequence[Body]]) -> float:
    return -sum(body.shape.bounding_radius for body in item[1])


def _cover_link(bodies: Sequence[Body], resolution: float, wanted: Wanted) -> _LinkBalls:
    """Cover one link in the frame of its first body: so a link has the same cover, and the same key in the cache, whatever
    joint it is fixed to and whichever joints are locked."""
    frame = bodies[0].shape.pose
    shapes = [_posed(body.shape, np.linalg.inv(frame)) for body in bodies]
    limit = _link_resolution(shapes, bodies[0].joint == 0, resolution)
    key = digest(VERSION, repr(limit), *(part for shape in shapes for part in _outline(shape)))

    def compute() -> Arrays:
        cover = cover_bodies(shapes, limit, wanted)
        quality = np.array([mean_excess(cover, shapes, wanted), cover.excess.max(initial=0.0), cover.protrusion])
        return {"center": cover.centers, "radius": cover.radii, "quality": quality}

    arrays = cached_arrays("cover", key, compute, _is_cover)
    center = arrays["center"] @ frame[:3, :3].T + frame[:3, 3]
    report = LinkCover(bodies[0].link, len(center), *map(float, arrays["quality"]))
    return _LinkBalls(bodies[0].joint, center, arrays["radius"], report)


def _posed(shape: Shape, frame: np.ndarray) -> Shape:
    """The shape as seen from another frame, its pose rounded to 1e-10, so that rounding does not make it another one."""
    pose = np.round(frame @ shape.pose, 10) + 0.0
    return replace(shape, pose=pose)


def _outline(shape: Shape) -> list[str | np.ndarray]:
    """What a cover depends on, as parts of a hash; the corners of meshes in an order that does not depend on their file."""
    points = np.round(shape.enclosing_points(), 9) + 0.0
    return [shape.kind, np.round(shape.pose, 9) + 0.0, points[np.lexsort(points.T)]]


def _link_resolution(shapes: Sequence[Shape], fixed: bool, resolution: float) -> float:
    points = np.concatenate([posed_points(shape) for shape in shapes])
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    limit = max(resolution, FIXED_SHARE * extent) if fixed else min(resolution, max(SMALL_SHARE * extent, SMALLEST))
    return round(limit, 6)


def mean_excess(cover: Cover, shapes: Sequence[Shape], wanted: Wanted = always_wanted) -> float:
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
    return float(np.average(np.maximum(union_distance(shapes, points[outer], wanted), 0.0), weights=weight[outer]))


def _check_attached(robot: RobotModel, attached: Sequence[Attached]) -> None:
    """Each is an `Attached` at a frame of the robot, under a name of its own.

    Raises:
        GeometryError: something else, or a name that is taken; RobotError: no such frame.
    """
    taken = set(robot.frame_names)
    for item in attached:
        if not isinstance(item, Attached):
            raise GeometryError(f"attached: holds {shown(item)}; expected energyopt.geometry.Attached(shape, frame)")
        if item.name in taken:
            raise GeometryError(f"attached: the name '{item.name}' is taken; give each attached shape a name of its own")
        taken.add(item.name)
        robot.frame_id(item.frame or robot.tool_frame)


def _is_cover(arrays: Arrays) -> bool:
    try:
        center, radius, quality = (arrays[key] for key in ("center", "radius", "quality"))
        finite = all(x.dtype == float and np.isfinite(x).all() for x in (center, radius, quality))
        return finite and center.shape == (len(radius), 3) and quality.shape == (3,) and bool(np.all(radius > 0))
    except (KeyError, TypeError, IndexError, ValueError):
        return False
