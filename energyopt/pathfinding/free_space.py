"""FreeSpace: which configurations and which straight ways between them are free of collisions; quick enough to search with.

Two stages. The balls that cover the robot settle most configurations, many at once (`overlaps`): where all of them stay away
from all obstacles and from one another, the configuration is free. Where some do not, the exact shapes of just those links
are asked through ``coal``: balls stick out by up to 20 mm, and the goals of real tasks stand nearer to things than that.

A straight way is free if its samples are. They are so dense that between two of them no distance of a pair changes by more
than the resolution, since it cannot change faster than its bodies move (`CollisionScene.rate_bounds`); half of that could be
missed, at worst. A search may take that risk, as what it finds is a guess; finished motions are judged without it.

Obstacles that move are taken at the time at which a motion would come past: at a configuration q on the way from start to
goal, t = T |q − start| / (|q − start| + |q − goal|), which is t ∝ length on the straight way. Paths found so avoid obstacles
at roughly the right time; whether the motion made of it does, is for the motion's own check.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from energyopt.geometry.bodies import Attached
from energyopt.geometry.exact import Closest, CollisionScene
from energyopt.geometry.kinematics import configurations, joint_placements, travel_bounds
from energyopt.geometry.robot_spheres import SphereModel, robot_spheres
from energyopt.geometry.self_collision import random_configurations, self_collision_pairs
from energyopt.geometry.shapes import Shape
from energyopt.geometry.values import non_negative, positive
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.pathfinding.overlaps import Overlaps
from energyopt.robots.model import Limits, RobotModel

RESOLUTION = 0.02
"""Between two samples of a straight way no distance changes by more than this [m]."""
LIMIT_SLACK = 1e-6
"""Excess over a position limit [rad] that is taken for rounding."""
HOLD = 0.9
"""Share of its torque limits that an arm may need to stand still; the rest is for moving. More only if start or goal need it."""
TURN = 0.1
"""Where the arm has to be able to stand still, no joint moves by more than this between samples [rad or m]."""
WEIGHED = 300
"""Random configurations by which it is decided whether gravity is any trouble."""
COARSE = 8
"""A straight way is tried at every eighth sample first: a way that is blocked is mostly blocked there too."""

Clock = Callable[[np.ndarray], np.ndarray]
"""Times [s] (N,) at which obstacles are taken at configurations (N, nv)."""


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """A robot among obstacles, asked whether configurations and ways are free. Made by `FreeSpace.of`.

    Attributes:
        robot: the arm.
        limits: position limits in force.
        scene: exact distances.
        overlaps: the quick first stage.
        bound: frames whose origins have to stay out of walls: pairs (frame, wall).
        margin: everything has to stay farther apart than this [m].
        resolution: of straight ways [m].
        clock: when obstacles are met; None takes all at t = 0.
        hold: share of the torque limits within which the arm has to be able to stand still; None asks for nothing.
    """

    robot: RobotModel
    limits: Limits
    scene: CollisionScene
    overlaps: Overlaps
    bound: tuple[tuple[str, Shape], ...] = ()
    margin: float = 0.0
    resolution: float = RESOLUTION
    clock: Clock | None = None
    hold: float | None = None

    @classmethod
    def of(
        cls,
        robot: RobotModel,
        obstacles: Sequence[Shape] = (),
        *,
        self_pairs: Sequence[tuple[str, str]] | None = None,
        attached: Sequence[Attached] = (),
        limits: Limits | None = None,
        bound: Sequence[tuple[str, Shape]] = (),
        margin: float = 0.0,
        resolution: float = RESOLUTION,
        spheres: SphereModel | None = None,
        compiled: bool = True,
    ) -> FreeSpace:
        """The free space of a robot among obstacles.

        Args:
            robot: the arm.
            obstacles: shapes, workspace walls among them.
            self_pairs: names of links to be kept apart; None takes those of `self_collision_pairs`.
            attached: tools and grasped objects.
            limits: in place of the robot's own.
            bound: frames whose origins have to stay out of walls (with nothing else of the robot): pairs (frame, wall).
            margin: clearance to be kept [m].
            resolution: by how much a distance may change between samples of a straight way [m].
            spheres: cover of the robot and of what is attached, where it is there already.
            compiled: False does without the compiled first stage (the answers are the same).

        Raises:
            GeometryError: a value is malformed; RobotError: no such frame.
        """
        pairs = self_collision_pairs(robot, attached).pairs if self_pairs is None else tuple(self_pairs)
        scene = CollisionScene(robot, obstacles, pairs, attached)
        overlaps = Overlaps(
            robot_spheres(robot, attached=attached) if spheres is None else spheres, scene.obstacles, pairs, compiled
        )
        margin, resolution = non_negative("margin", margin), positive("resolution", resolution)
        for frame, _ in bound:
            robot.frame_id(frame)
        return cls(robot, limits or robot.limits, scene, overlaps, tuple(bound), margin, resolution)

    def with_margin(self, margin: float) -> FreeSpace:
        """The same with another clearance [m]."""
        return replace(self, margin=non_negative("margin", margin))

    def timed(self, start: np.ndarray, goal: np.ndarray, duration: float) -> FreeSpace:
        """The same for a motion from ``start`` to ``goal`` (nv,) that takes ``duration`` [s]; matters where obstacles move."""
        if not any(obstacle.moves for obstacle in self.scene.obstacles):
            return self

        def clock(q: np.ndarray) -> np.ndarray:
            come, left = np.linalg.norm(q - start, axis=1), np.linalg.norm(q - goal, axis=1)
            return duration * come / np.maximum(come + left, 1e-12)

        return replace(self, clock=clock)

    def holding(self, stops: np.ndarray) -> FreeSpace:
        """The same, only where the arm can stand still, with some torque to spare; itself where gravity is no trouble.

        Args:
            stops: configurations that have to stay free [rad], shape (K, nv); where they cannot be held, nothing is asked.
        """
        need = self.load(stops).max()
        if need >= 1 or self.load(random_configurations(self.robot, WEIGHED, 0)).max() <= HOLD:
            return self
        return replace(self, hold=max(HOLD, 0.5 * (1.0 + need)))

    def inside(self, q: np.ndarray) -> np.ndarray:
        """Whether configurations (N, nv) are numbers inside the position limits, shape (N,)."""
        return np.all((q >= self.limits.lower - LIMIT_SLACK) & (q <= self.limits.upper + LIMIT_SLACK), axis=1)

    def free(self, q: ArrayLike, t: ArrayLike | None = None) -> np.ndarray:
        """Whether configurations are free and inside the limits, shape (N,).

        Args:
            q: [rad], shape (N, nv) or (nv,).
            t: times [s], one or one a configuration; None asks the clock.
        """
        q = configurations(self.robot.model, q)
        t = self.times(q) if t is None else np.broadcast_to(np.asarray(t, float), len(q))
        result = self.allowed(q)
        near = np.zeros((len(q), len(self.overlaps.columns)), bool)
        near[result] = self.overlaps.near(q[result], t[result], self.margin)
        for n in np.flatnonzero(near.any(axis=1)):
            result[n] = self._clear(q[n], t[n], near[n])
        return result

    def way(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Samples of the straight way between configurations (nv,), ``a`` left out and ``b`` the last; shape (N, nv)."""
        samples = a + np.linspace(0.0, 1.0, self._steps(b - a) + 1)[1:, None] * (b - a)
        samples[-1] = b
        return samples

    def free_way(self, a: np.ndarray, b: np.ndarray) -> bool:
        """Whether the straight way between two configurations (nv,) is free; ``a`` itself is not asked."""
        samples = self.way(a, b)
        return self._all_free(samples, self.times(samples))

    def free_path(self, path: np.ndarray) -> bool:
        """Whether a path of straight ways between configurations (K, nv) is free, its start included."""
        return bool(self.free(path[0])[0]) and all(self.free_way(a, b) for a, b in zip(path[:-1], path[1:], strict=True))

    def free_motion(self, trajectory: Trajectory) -> bool:
        """Whether a motion is free at samples so dense that no distance changes by more than the resolution between two."""
        t = trajectory.sample_times(4)
        changes = np.abs(np.diff(trajectory(t), axis=0)) @ self._rates.T
        drift = np.max(self.scene.speed_bounds, initial=0.0)
        changes = np.max(changes, axis=1, initial=0.0) + (drift if np.isfinite(drift) else 0.0) * np.diff(t)
        count = np.maximum(1, np.ceil(changes / self.resolution)).astype(int)
        fine = np.interp(np.arange(count.sum() + 1), np.append(0, np.cumsum(count)), t)
        return self._all_free(trajectory(fine), fine)

    def closest(self, q: np.ndarray, t: float = 0.0) -> Closest | None:
        """The nearest pair at a configuration (nv,), exactly; None where there is nothing to be kept apart."""
        return self.scene.closest(q, t)[0] if self.scene.pairs else None

    def allowed(self, q: np.ndarray) -> np.ndarray:
        """Whether configurations are inside the limits, can be held, and have bound frames where they belong, shape (N,)."""
        result = self.inside(q)
        if self.hold is not None:
            result[result] = self.load(q[result]) <= self.hold
        if self.bound:
            rotation, position = joint_placements(self.robot.model, np.where(result[:, None], q, 0.0))
            for name, wall in self.bound:
                frame = self.robot.model.frames[self.robot.frame_id(name)]
                j, offset = frame.parentJoint, frame.placement.translation
                result = result & (wall.distance(position[:, j] + rotation[:, j] @ offset) > self.margin)
        return result

    def _all_free(self, q: np.ndarray, t: np.ndarray) -> bool:
        """Whether configurations (N, nv) at times (N,) are all free: the last and every eighth before it are asked first."""
        coarse = np.arange(len(q) - 1, -1, -1) % COARSE == 0
        parts = (coarse, ~coarse) if len(q) > 2 * COARSE else (slice(None),)
        return all(self._part_free(q[part], t[part]) for part in parts)

    def _part_free(self, q: np.ndarray, t: np.ndarray) -> bool:
        if not self.allowed(q).all():
            return False
        near = self.overlaps.near(q, t, self.margin)
        return all(self._clear(q[n], t[n], near[n]) for n in np.flatnonzero(near.any(axis=1)))

    def load(self, q: np.ndarray) -> np.ndarray:
        """Largest share of a torque limit that it takes to stand still and to begin to move, shape (N,)."""
        held = np.abs(self.robot.torque(q, *np.zeros((2, *q.shape)))) + self.robot.dynamics.coulomb_friction
        return np.max(held / self.limits.torque, axis=1, initial=0.0)

    def times(self, q: np.ndarray) -> np.ndarray:
        """When obstacles are met at configurations (N, nv) [s], shape (N,)."""
        return np.zeros(len(q)) if self.clock is None else self.clock(q)

    def _steps(self, way: np.ndarray) -> int:
        return max(1, int(np.ceil(np.max(self._rates @ np.abs(way), initial=0.0) / self.resolution)))

    def _clear(self, q: np.ndarray, t: float, near: np.ndarray) -> bool:
        """Whether the exact shapes of the columns in question are farther apart than the margin."""
        rows = [row for column in np.flatnonzero(near) for row in self._rows[column]]
        return bool(np.all(self.scene.exact(q, t, rows) > self.margin))

    @cached_property
    def _rates(self) -> np.ndarray:
        """By how much a unit of each joint's motion may change any distance at most, without repetitions; shape (R, nv)."""
        frames = [self.robot.model.frames[self.robot.frame_id(name)] for name, _ in self.bound]
        joint = np.array([frame.parentJoint for frame in frames], dtype=int)
        offset = np.array([frame.placement.translation for frame in frames]).reshape(-1, 3)
        rates = [self.scene.rate_bounds, travel_bounds(self.robot.model, joint, offset, np.zeros(len(joint)))]
        if self.hold is not None:
            rates.append(np.eye(self.robot.nv) * self.resolution / TURN)
        return np.unique(np.concatenate(rates), axis=0)

    @cached_property
    def _rows(self) -> list[list[int]]:
        return self.overlaps.scene_pairs(self.scene)
