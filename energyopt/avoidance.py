"""Avoidance: what a problem wants kept apart, as spheres for the program and as names for the exact check.

Spheres stick out of the links they cover, by up to 2 cm, and a start or goal often stands closer than that to something. So a
pair of spheres is asked for

    required = min(clearance + reserve, its distance at the start, its distance at the goal),

without the clearance for two links of the arm (those only must not touch), which the ends can always meet. Where that is less
than the clearance, spheres do not prove it any more; the exact check of the finished motion does, and where it fails, more is
asked of the spheres around that instant (see `transcription.clearance`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from energyopt.collision import PairKernels, Scene, SphereArm, pair_kernels
from energyopt.errors import RobotError
from energyopt.geometry.bodies import collision_bodies
from energyopt.geometry.exact import obstacle_names
from energyopt.geometry.robot_spheres import robot_spheres
from energyopt.geometry.self_collision import self_collision_pairs
from energyopt.geometry.shapes import Shape
from energyopt.problem import Problem
from energyopt.robots.model import RobotModel

RESERVE = 3e-4
"""Distance [m] asked beyond the clearance, so that it holds between the samples too."""
END_RESERVE = 2e-5
"""By how much [m] less is asked than a pair has at the ends, so that they are not the boundary themselves."""


@dataclass(frozen=True, eq=False)
class Avoidance:
    """Obstacles and spheres of one problem.

    Attributes:
        arm: the spheres, with a point for every frame that a workspace binds.
        kernels: distances between them.
        scene: obstacles, walls and requirements; its times are those of nothing yet.
        margin: clearance from obstacles, and reserve [m].
        given: how much less is asked than that, by exact geometry (see `transcription.easing`), of each link and obstacle and
            then of each two links [m], shape (L·O + P,).
    """

    arm: SphereArm
    kernels: PairKernels
    scene: Scene
    margin: float
    given: np.ndarray | float = 0.0

    @property
    def eased(self) -> bool:
        """Whether less is asked of some pair of spheres than proves the clearance."""
        watched = np.repeat(self.scene.watched.astype(bool), np.diff(self.arm.link_start), axis=0)
        return bool(
            np.any(self.scene.required[watched] < self.margin - 1e-12) or np.any(self.scene.required_self < self.margin - 1e-12)
        )

    @property
    def names(self) -> list[str]:
        """Of the obstacles and walls."""
        return obstacle_names(self.scene.obstacles)

    def pair_names(self, a: int, b: int) -> tuple[str, str]:
        """Link of sphere ``a``, and the obstacle ``b`` or the link of sphere −1 − b."""
        second = self.names[b] if b >= 0 else self.arm.links[self.arm.link_of(-1 - b)]
        return self.arm.links[self.arm.link_of(a)], second

    def potential_energy(self, t: np.ndarray, q: np.ndarray) -> np.ndarray:
        """U summed over spheres and obstacles at times ``t`` (N,) and configurations ``q`` (N, nv), shape (N,)."""
        return self.kernels.place(self.scene.at(t), q).penalty(derivatives=False)[0][:, 1]

    def relaxed(self, instants: Iterable[tuple[float, np.ndarray]]) -> Avoidance:
        """With no more asked of any pair than it has at the given instants (time, configuration)."""
        required, required_self = self.scene.required.copy(), self.scene.required_self.copy()
        for t, q in instants:
            d, d_self = self._all_distances(t, q)
            np.minimum(required, d - END_RESERVE, out=required)
            np.minimum(required_self, d_self - END_RESERVE, out=required_self)
        return replace(self, scene=replace(self.scene, required=required, required_self=required_self))

    def less(self, more: np.ndarray, most: float) -> Avoidance:
        """With that much less asked of each link and obstacle, then of each two links [m], (L·O + P,), than is now; more where
        that is negative. In all no more than at first, and less by ``most`` [m] at most."""
        arm, count = self.arm, len(self.scene.obstacles)
        given = np.clip(self.given + more, 0.0, most)
        change = given - self.given
        of_sphere = np.repeat(np.arange(len(arm.links)), np.diff(arm.link_start))
        required = self.scene.required - change[: len(arm.links) * count].reshape(len(arm.links), count)[of_sphere]
        required_self = self.scene.required_self.copy()
        for (first, second), amount in zip(arm.self_pair, change[len(arm.links) * count :], strict=True):
            a, b = (slice(arm.link_start[k], arm.link_start[k + 1]) for k in (first, second))
            required_self[a, b] -= amount
        return replace(self, scene=replace(self.scene, required=required, required_self=required_self), given=given)

    def centers(self, q: np.ndarray) -> np.ndarray:
        """Centres of all spheres [m], shape (K, S, 3), at configurations ``q`` (K, nv)."""
        return self.kernels.place(self._empty.at(np.zeros(len(q))), q).centers()

    @cached_property
    def _empty(self) -> Scene:
        """The arm alone."""
        return Scene.of(self.arm, (), [0.0])

    def _all_distances(self, t: float, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        arm, obstacles = self.arm, self.scene.obstacles
        placed = self.kernels.place(self.scene.at([t]), np.atleast_2d(q))
        spheres = np.arange(arm.spheres)
        pairs = np.stack(np.meshgrid(spheres, np.arange(len(obstacles)), indexing="ij"), axis=-1).reshape(-1, 2)
        d = placed.pairs(np.zeros(len(pairs), int), pairs)[0].reshape(arm.spheres, -1)
        d_self = np.full((arm.spheres, arm.spheres), np.inf)
        for first, second in arm.self_pair:
            a, b = (np.arange(arm.link_start[k], arm.link_start[k + 1]) for k in (first, second))
            pairs = np.stack(np.meshgrid(a, -1 - b, indexing="ij"), axis=-1).reshape(-1, 2)
            d_self[np.ix_(a, b)] = placed.pairs(np.zeros(len(pairs), int), pairs)[0].reshape(len(a), len(b))
        return d, d_self


def avoidance_of(problem: Problem) -> Avoidance | None:
    """What a problem wants kept apart; None where there is nothing.

    Raises:
        GeometryError, RobotError: the geometry of the robot is needed and damaged or missing.
    """
    pairs = checked_pairs(problem)
    obstacles = problem.obstacles
    whole = [wall for item in problem.workspace if not item.frames for wall in item.walls]
    bound = [(frame, wall) for item in problem.workspace for frame in item.frames for wall in item.walls]
    if not (pairs or obstacles or whole or bound):
        return None
    own = _sphere_arm(problem.robot.geometry, problem.attached, planned_pairs(problem))
    arm = own.with_points(_points(problem.robot, [frame for frame, _ in bound]))
    everything = (*obstacles, *whole, *(wall for _, wall in bound))
    watched = np.zeros((len(arm.links), len(everything)), bool)
    common = len(obstacles) + len(whole)
    watched[: len(own.links), :common] = own.moving_links[:, None]
    for k, (frame, _) in enumerate(bound):
        watched[arm.links.index(_point_name(frame)), common + k] = True
    margin = problem.clearance + RESERVE
    scene = Scene.of(arm, everything, [0.0], margin, RESERVE, watched, potential=problem.potential)
    return Avoidance(arm, pair_kernels(arm, everything), scene, margin)


@lru_cache(maxsize=16)
def _sphere_arm(robot: RobotModel, attached: tuple, pairs: tuple) -> SphereArm:
    return SphereArm.of(robot_spheres(robot, attached=attached), pairs)


def arm_obstacles(problem: Problem) -> tuple[Shape, ...]:
    """Obstacles and the walls that bind the whole arm: what the exact check looks at."""
    return (*problem.obstacles, *(wall for item in problem.workspace if not item.frames for wall in item.walls))


def bound_frames(problem: Problem) -> list[tuple[str, Shape]]:
    """(frame, wall) of workspaces that bind only some frames."""
    return [(frame, wall) for item in problem.workspace for frame in item.frames for wall in item.walls]


def checked_pairs(problem: Problem) -> tuple[tuple[str, str], ...]:
    """Pairs of links that the finished motion is checked for."""
    return _pairs(problem.robot, problem.attached)[1] if problem.self_collision else ()


def planned_pairs(problem: Problem) -> tuple[tuple[str, str], ...]:
    """Pairs of links that planning keeps apart."""
    return _pairs(problem.robot, problem.attached)[0] if problem.self_collision else ()


def unchecked(problem: Problem) -> str | None:
    """Why self-collision is not looked at although it is asked for; None where it is."""
    return _pairs(problem.robot, problem.attached)[2] if problem.self_collision else None


def _pairs(robot: RobotModel, attached: Sequence) -> tuple:
    return _pairs_of(robot.geometry, tuple(attached))


@lru_cache(maxsize=16)
def _pairs_of(robot: RobotModel, attached: tuple) -> tuple:
    """Planned pairs, checked pairs, and why there are none where the geometry of the robot is not there."""
    try:
        if not collision_bodies(robot, attached):
            return (), (), "the robot has no collision geometry: self-collision is not checked"
        found = self_collision_pairs(robot, attached)
    except RobotError as error:
        return (), (), f"self-collision is not checked: {error}"
    return found.pairs, found.checked, None


def _points(robot: RobotModel, frames: list[str]) -> dict[str, tuple[int, np.ndarray]]:
    """Joint and position of the origin of each frame, by a name of its own."""
    found = {}
    for name in frames:
        frame = robot.model.frames[robot.frame_id(name)]
        found[_point_name(name)] = (int(frame.parentJoint), np.array(frame.placement.translation))
    return found


def _point_name(frame: str) -> str:
    return f"frame {frame}"
