"""Which links of a robot may be near which obstacles, and near which other links, at many configurations at once.

The robot is its cover by balls, so the answer errs on one side only: where the balls of a link stay more than a margin away
from an obstacle, so does the link; where they do not, the exact geometry has to be asked (see `free_space`). A ball around
all of a link is tried first, the balls that cover it only where that one is near.

Compiled (see `compiled`) this takes a few microseconds a configuration; without a compiler, NumPy does the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from energyopt.geometry.exact import CollisionScene
from energyopt.geometry.kinematics import joint_placements
from energyopt.geometry.robot_spheres import SphereModel
from energyopt.geometry.shapes import Shape
from energyopt.pathfinding.compiled import CompiledOverlaps

BLOCK = 2048
"""Configurations taken at a time, to bound the memory."""


@dataclass(frozen=True, eq=False)
class Balls:
    """The balls of a robot, link by link; L links, S balls.

    Attributes:
        links: names.
        joint: index of the joint each link moves with, shape (L,).
        first: the balls of link l are first[l] … first[l + 1] − 1, shape (L + 1,).
        ball: centre in the joint's frame and radius [m], shape (S, 4).
        around: one ball that contains those of each link, shape (L, 4).
    """

    links: tuple[str, ...]
    joint: np.ndarray
    first: np.ndarray
    ball: np.ndarray
    around: np.ndarray

    @classmethod
    def of(cls, spheres: SphereModel) -> Balls:
        links = spheres.links
        members = [np.flatnonzero(np.array(spheres.link) == link) for link in links]
        order = np.concatenate([np.zeros(0, int), *members])
        ball = np.column_stack([spheres.center, spheres.radius])[order]
        first = np.cumsum([0, *map(len, members)])
        around = [_around(ball[a:b]) for a, b in zip(first[:-1], first[1:], strict=True)]
        joint = np.array([spheres.joint[m[0]] for m in members], dtype=np.int64)
        return cls(links, joint, first, ball, np.array(around).reshape(-1, 4))


class Overlaps:
    """A robot's balls among obstacles.

    Attributes:
        columns: what each column of `near` stands for: (number of the link, number of the obstacle) for all of them, link by
            link, and then (number of a link, number of a link).
    """

    def __init__(
        self, spheres: SphereModel, obstacles: tuple[Shape, ...], pairs: tuple[tuple[str, str], ...], compiled: bool = True
    ):
        """``pairs``: names of links to be kept apart; ``compiled``: False never uses the compiled routine."""
        self._model, self._obstacles = spheres.model, obstacles
        self.balls = balls = Balls.of(spheres)
        number = {link: k for k, link in enumerate(balls.links)}
        self._pairs = np.array([(number[a], number[b]) for a, b in pairs if a in number and b in number], int).reshape(-1, 2)
        self.columns = (*((k, o) for k in range(len(number)) for o in range(len(obstacles))), *map(tuple, self._pairs.tolist()))
        self._compiled = CompiledOverlaps.make(self._model, balls, obstacles, self._pairs) if compiled else None

    def near(self, q: np.ndarray, t: np.ndarray, margin: float) -> np.ndarray:
        """Whether balls are within the margin of an obstacle or of one another, shape (N, columns).

        Args:
            q: configurations [rad], shape (N, nv), finite.
            t: times [s], shape (N,); they matter only where obstacles move.
            margin: [m], not negative.
        """
        if not self.columns or not len(q):
            return np.zeros((len(q), len(self.columns)), bool)
        if self._compiled is not None:
            return self._compiled.near(q, self._poses(t), margin)
        return np.concatenate([self._block(q[k : k + BLOCK], t[k : k + BLOCK], margin) for k in range(0, len(q), BLOCK)])

    def scene_pairs(self, scene: CollisionScene) -> list[list[int]]:
        """For each column, the numbers of the pairs of bodies of a scene with the same obstacles that it stands for."""
        found: dict[tuple, list[int]] = {}
        for row, (i, j) in enumerate(scene.index):
            other = scene.bodies[j].link if j < len(scene.bodies) else int(j) - len(scene.bodies)
            found.setdefault((scene.bodies[i].link, other), []).append(row)
        links, count = self.balls.links, len(self.balls.links) * len(self._obstacles)
        names = [(links[a], b if k < count else links[b]) for k, (a, b) in enumerate(self.columns)]
        return [found.get(name, []) for name in names]

    def _poses(self, t: np.ndarray) -> np.ndarray:
        """Rotation and position of every obstacle, shape (1 or N, O, 12): one row for all where none moves."""
        return _poses(self._obstacles, t) if self._moving else self._still

    @cached_property
    def _moving(self) -> bool:
        return any(obstacle.moves for obstacle in self._obstacles)

    @cached_property
    def _still(self) -> np.ndarray:
        return _poses(self._obstacles, np.zeros(1))

    def _block(self, q: np.ndarray, t: np.ndarray, margin: float) -> np.ndarray:
        """`near` by NumPy."""
        balls, placed = self.balls, joint_placements(self._model, q)
        around = _moved(placed, balls.joint, balls.around[:, :3])
        owner = np.repeat(balls.joint, np.diff(balls.first))
        centers = _moved(placed, owner, balls.ball[:, :3])
        flags = np.zeros((len(q), len(self.columns)), bool)
        for k, (first, second) in enumerate(self.columns):
            own = slice(*balls.first[first : first + 2])
            reach = balls.around[first, 3] + margin
            if k < len(balls.links) * len(self._obstacles):
                obstacle = self._obstacles[second]
                if balls.joint[first] == 0:
                    continue
                rows = np.flatnonzero(obstacle.distance(around[:, first], t) <= reach)
                points = centers[rows, own]
                gap = obstacle.distance(points.reshape(-1, 3), np.repeat(t[rows], points.shape[1])).reshape(points.shape[:2])
                flags[rows, k] = np.any(gap <= balls.ball[own, 3] + margin, axis=1)
            else:
                other = slice(*balls.first[second : second + 2])
                gap = np.linalg.norm(around[:, first] - around[:, second], axis=1)
                rows = np.flatnonzero(gap <= reach + balls.around[second, 3])
                gap = np.linalg.norm(centers[rows, own, None] - centers[rows, None, other], axis=3)
                flags[rows, k] = np.any(gap <= balls.ball[own, 3][:, None] + balls.ball[other, 3] + margin, axis=(1, 2))
        return flags


def _around(ball: np.ndarray) -> np.ndarray:
    """A ball that contains some balls (K, 4)."""
    middle = 0.5 * ((ball[:, :3] - ball[:, 3:]).min(axis=0) + (ball[:, :3] + ball[:, 3:]).max(axis=0))
    return np.append(middle, np.max(np.linalg.norm(ball[:, :3] - middle, axis=1) + ball[:, 3]))


def _moved(placed: tuple[np.ndarray, np.ndarray], joint: np.ndarray, points: np.ndarray) -> np.ndarray:
    rotation, position = placed
    return position[:, joint] + np.einsum("nsij,sj->nsi", rotation[:, joint], points)


def _poses(obstacles: tuple[Shape, ...], t: np.ndarray) -> np.ndarray:
    poses = np.empty((len(t), len(obstacles), 12))
    for k, obstacle in enumerate(obstacles):
        matrix = obstacle.pose_at(t)
        poses[:, k, :9], poses[:, k, 9:] = matrix[:, :3, :3].reshape(-1, 9), matrix[:, :3, 3]
    return poses
