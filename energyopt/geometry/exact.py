"""CollisionScene: exact distances between the bodies of a robot and obstacles, and between its own links, through ``coal``.

For judging motions, not for planning them: the bodies are the convex solids of the collision geometry itself. Balls around
bodies give lower bounds for all pairs and configurations at once; coal is asked only where those do not settle the matter. Its
iteration ends within some 1e-6 m, and begins where it last ended: a distance asked for again may differ by that.

Between two instants the distance of a pair cannot change faster than its bodies move:

    |d/dt distance| ≤ Σ_v rate_v |q̇_v| + speed of the obstacle,

which is what conservative advancement needs (B. Mirtich, "Impulse-based Dynamic Simulation of Rigid Body Systems", 1996, §2.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from energyopt.errors import GeometryError
from energyopt.geometry.bodies import Attached, Body, collision_bodies
from energyopt.geometry.kinematics import configurations, joint_placements, travel_bounds
from energyopt.geometry.shapes import Cylinder, Shape, Sphere
from energyopt.geometry.values import LARGEST
from energyopt.robots.messages import did_you_mean, shown
from energyopt.robots.model import RobotModel


@dataclass(frozen=True)
class Closest:
    """The nearest pair at one instant.

    Attributes:
        distance: [m]; negative is the depth of penetration.
        first: link, or name of what is attached; second: another link, or the obstacle.
    """

    distance: float
    first: str
    second: str


class CollisionScene:
    """A robot among obstacles, ready to be asked for distances at many configurations and times.

    A pair is a moving body of the robot and an obstacle, or two bodies of links that are to be kept apart. Bodies that never
    move are not checked against obstacles: no plan could change anything.

    Attributes:
        pairs: names (first, second) of every pair, length P.
        index: the same as numbers of bodies, those of obstacles counted on, shape (P, 2).
        bodies, obstacles: what is looked at.
        body_joint: joint of each body, shape (B,); ball_center, ball_radius: a ball around it in that joint's frame [m].
        carried: which joints move a body, shape (B, nv).
        relative: which joints move one body of a pair and not the other, shape (P, nv).
    """

    def __init__(
        self,
        robot: RobotModel,
        obstacles: Sequence[Shape] = (),
        self_pairs: Sequence[tuple[str, str]] = (),
        attached: Sequence[Attached] = (),
        fixed: bool = False,
    ):
        """Make a scene.

        Args:
            robot: its collision geometry; obstacles: shapes; attached: tools and grasped objects.
            self_pairs: names of links, and of what is attached, to be kept apart.
            fixed: look at the bodies that never move, and at no others, against the obstacles.

        Raises:
            GeometryError: an obstacle is no shape, or a pair names a link without geometry.
        """
        self.robot, self.obstacles = robot, tuple(obstacles)
        for obstacle in self.obstacles:
            if not isinstance(obstacle, Shape):
                raise GeometryError(f"obstacles: holds {shown(obstacle)}; expected shapes such as energyopt.Sphere(radius, pose)")
        self.bodies = collision_bodies(robot, attached)
        self.body_joint = np.array([body.joint for body in self.bodies], dtype=int)
        self.ball_center, self.ball_radius = _balls(self.bodies)
        self.index = self._pair_indices(self_pairs, fixed)
        names = [body.link for body in self.bodies] + obstacle_names(self.obstacles)
        self.pairs = tuple((names[i], names[j]) for i, j in self.index)
        self.carried = _carried(robot.model, self.body_joint)
        moves = np.concatenate([self.carried, np.zeros((len(self.obstacles), robot.nv), bool)])
        self.relative = moves[self.index[:, 0]] != moves[self.index[:, 1]]
        kinds = np.array([body.shape.kind for body in self.bodies] + [obstacle.kind for obstacle in self.obstacles], dtype=object)
        self._by_formula = [set(kinds[ij]) == {Sphere.kind, Cylinder.kind} for ij in self.index]
        self._moving = [(k, obstacle) for k, obstacle in enumerate(self.obstacles) if obstacle.moves]
        self._geometry = self._geometry_model()
        self._data, self._geometry_data = robot.model.createData(), pin.GeometryData(self._geometry)

    @cached_property
    def rate_bounds(self) -> np.ndarray:
        """Rate of each pair, shape (P, nv) [m/rad]; joints that move both bodies alike do not change their distance."""
        single = travel_bounds(self.robot.model, self.body_joint, self.ball_center, self.ball_radius)
        single = np.concatenate([single, np.zeros((len(self.obstacles), self.robot.nv))])
        return self.relative * (single[self.index[:, 0]] + single[self.index[:, 1]])

    @cached_property
    def speed_bounds(self) -> np.ndarray:
        """Of the obstacle of each pair [m/s], shape (P,); zero for pairs of links."""
        speeds = np.array([0.0] * len(self.bodies) + [obstacle.speed_bound() for obstacle in self.obstacles])
        return speeds[self.index[:, 1]]

    def exact(self, q: np.ndarray, t: float, pairs: np.ndarray) -> np.ndarray:
        """Distances [m], shape (M,), of some pairs, by number, at one configuration ``q`` (nv,) and time [s]."""
        self._place(q, t)
        return np.array([self._exact(k) for k in np.asarray(pairs).tolist()])

    def distances(self, q: ArrayLike, t: ArrayLike = 0.0, cutoff: float = np.inf) -> np.ndarray:
        """Distance of every pair [m], shape (N, P).

        Args:
            q: configurations [rad], shape (N, nv); t: one time, or one a configuration [s].
            cutoff: where a pair is surely farther apart than this [m], a lower bound of its distance is returned instead.
        """
        q, t, bounds = self._prepared(q, t)
        for n, row in enumerate(bounds):
            near = np.flatnonzero(row <= cutoff)
            if len(near):
                row[near] = self.exact(q[n], t[n], near)
        return bounds

    def nearest(self, q: ArrayLike, t: ArrayLike = 0.0) -> list[tuple[int, float]]:
        """Number and distance [m] of the nearest pair of each configuration, length N; arguments as of `distances`.

        Raises:
            GeometryError: there is no pair at all.
        """
        if not self.pairs:
            raise GeometryError(f"{self.robot.name}: nothing to keep apart; expected obstacles, or pairs of links with geometry")
        q, t, bounds = self._prepared(q, t)
        found = []
        for n, row in enumerate(bounds):
            self._place(q[n], t[n])
            best, which = np.inf, 0
            for k in np.argsort(row, kind="stable").tolist():
                if row[k] >= best:
                    break
                distance = self._exact(k)
                if distance < best:
                    best, which = distance, k
            found.append((which, best))
        return found

    def closest(self, q: ArrayLike, t: ArrayLike = 0.0) -> list[Closest]:
        """The nearest pair of each configuration, length N; arguments and errors as of `nearest`."""
        return [Closest(distance, *self.pairs[k]) for k, distance in self.nearest(q, t)]

    def _prepared(self, q: ArrayLike, t: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        q = configurations(self.robot.model, q)
        t = np.broadcast_to(np.asarray(t, dtype=float), len(q))
        return q, t, self._lower_bounds(q, t)

    def _lower_bounds(self, q: np.ndarray, t: np.ndarray) -> np.ndarray:
        """From the balls around bodies, shape (N, P)."""
        joint = self.body_joint
        rotation, position = joint_placements(self.robot.model, q)
        center = position[:, joint] + np.einsum("nbij,bj->nbi", rotation[:, joint], self.ball_center)
        bounds, count = np.empty((len(q), len(self.index))), len(self.bodies)
        own = np.flatnonzero(self.index[:, 1] < count)
        first, second = self.index[own].T
        gap = np.linalg.norm(center[:, first] - center[:, second], axis=2)
        bounds[:, own] = gap - self.ball_radius[first] - self.ball_radius[second]
        for k, obstacle in enumerate(self.obstacles):
            rows = np.flatnonzero(self.index[:, 1] == count + k)
            first = self.index[rows, 0]
            distance = obstacle.distance(center[:, first].reshape(-1, 3), np.repeat(t, len(first)))
            bounds[:, rows] = distance.reshape(len(q), -1) - self.ball_radius[first]
        return bounds

    def _place(self, q: np.ndarray, t: float) -> None:
        for k, obstacle in self._moving:
            self._geometry.geometryObjects[len(self.bodies) + k].placement = pin.SE3(obstacle.pose_at(t))
        pin.updateGeometryPlacements(self.robot.model, self._data, self._geometry, self._geometry_data, q)

    def _exact(self, pair: int) -> float:
        if self._by_formula[pair]:
            return self._ball_in_cylinder(*self.index[pair].tolist())
        distance = pin.computeDistance(self._geometry, self._geometry_data, pair).min_distance
        # Where its iteration fails the library answers with the largest number there is, which would pass for clear.
        return distance if abs(distance) < LARGEST else self._gap_of_balls(*self.index[pair].tolist())

    def _gap_of_balls(self, first: int, second: int) -> float:
        """A lower bound of the distance of a body and a body or obstacle [m]."""
        joints, joint = self._data.oMi, self.body_joint.tolist()
        center = joints[joint[first]].act(self.ball_center[first])
        if second < len(self.bodies):
            away = center - joints[joint[second]].act(self.ball_center[second])
            return float(np.linalg.norm(away) - self.ball_radius[first] - self.ball_radius[second])
        obstacle = self._geometry_data.oMg[second].actInv(center)
        shape = self.obstacles[second - len(self.bodies)]
        return float(shape.local_distance(obstacle[None])[0] - self.ball_radius[first])

    def _ball_in_cylinder(self, first: int, second: int) -> float:
        """The library's distance of a ball and a cylinder is wrong where the ball's middle is inside (by up to its radius)."""
        solids = (*self.bodies, *self.obstacles)
        shapes = [getattr(solid, "shape", solid) for solid in (solids[first], solids[second])]
        places = [self._geometry_data.oMg[k] for k in (first, second)]
        ball = 0 if isinstance(shapes[0], Sphere) else 1
        center = places[1 - ball].actInv(places[ball].translation)
        return float(shapes[1 - ball].local_distance(center[None])[0]) - shapes[ball].radius

    def _pair_indices(self, self_pairs: Sequence[tuple[str, str]], fixed: bool) -> np.ndarray:
        by_link: dict[str, list[int]] = {}
        for k, body in enumerate(self.bodies):
            by_link.setdefault(body.link, []).append(k)
        looked_at = [k for k, body in enumerate(self.bodies) if (body.joint == 0) == fixed]
        pairs = [(k, len(self.bodies) + j) for k in looked_at for j in range(len(self.obstacles))]
        for first, second in self_pairs:
            for name in (first, second):
                if name not in by_link:
                    raise GeometryError(f"self_pairs: no link with geometry named '{name}'; {did_you_mean(str(name), by_link)}")
            pairs += product(by_link[first], by_link[second])
        return np.array(pairs, dtype=int).reshape(-1, 2)

    def _geometry_model(self) -> pin.GeometryModel:
        geometry = pin.GeometryModel()
        placed = [(f"body {k}", body.joint, body.shape) for k, body in enumerate(self.bodies)]
        placed += [(f"obstacle {k}", 0, obstacle) for k, obstacle in enumerate(self.obstacles)]
        for name, joint, shape in placed:
            geometry.addGeometryObject(pin.GeometryObject(name, joint, pin.SE3(shape.pose_at(0.0)), _for_coal(shape)))
        for i, j in self.index:
            geometry.addCollisionPair(pin.CollisionPair(int(i), int(j)))
        return geometry


def exact_distance(
    robot: RobotModel,
    obstacles: Sequence[Shape],
    q: ArrayLike,
    t: float = 0.0,
    self_pairs: Sequence[tuple[str, str]] = (),
    attached: Sequence[Attached] = (),
) -> Closest:
    """The nearest pair of a robot at one configuration ``q`` (nv,); for many, make one `CollisionScene` and ask it."""
    return CollisionScene(robot, obstacles, self_pairs, attached).closest(q, t)[0]


def obstacle_names(obstacles: Sequence[Shape]) -> list[str]:
    """A name for each: its own, else its kind and its number from 1."""
    return [obstacle.name or f"{obstacle.kind} {k + 1}" for k, obstacle in enumerate(obstacles)]


@lru_cache(maxsize=512)
def _for_coal(shape: Shape):
    """The solid for the collision library, made once: for a mesh that takes a millisecond or two."""
    return shape.coal_geometry()


def _carried(model: pin.Model, body_joint: np.ndarray) -> np.ndarray:
    carried = np.zeros((len(body_joint), model.nv), bool)
    for k, j in enumerate(body_joint):
        carried[k, [model.joints[i].idx_v for i in model.supports[int(j)] if i > 0]] = True
    return carried


def _balls(bodies: Sequence[Body]) -> tuple[np.ndarray, np.ndarray]:
    """A ball around each body in its joint's frame: centre [m] (B, 3), radius [m] (B,)."""
    centers, radii = np.empty((len(bodies), 3)), np.empty(len(bodies))
    for k, body in enumerate(bodies):
        points = body.shape.enclosing_points()
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        pose = body.shape.pose_at(0.0)
        centers[k] = pose[:3, :3] @ middle + pose[:3, 3]
        radii[k] = np.linalg.norm(points - middle, axis=1).max()
    return centers, radii
