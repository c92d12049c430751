"""Scene: obstacles at a row of instants, and what distance is asked of each pair there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from energyopt.collision.arm import SphereArm
from energyopt.geometry.potential import RepulsivePotential
from energyopt.geometry.shapes import Shape


@dataclass(frozen=True)
class Hinge:
    """A penalty E(m) on what a pair misses, m = required + band − d > 0, twice continuously differentiable.

    E″ rises from 0 at m = 0 to the stiffness k at m = band and stays: E = k m³ / (6 band), and beyond the band
    k (½ m (m − band) + band²/6).

    Attributes:
        stiffness: k; 0 for no penalty. band: [m].
    """

    stiffness: float = 0.0
    band: float = 0.0

    def derivatives(self, missing: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """E, dE/dd and d²E/dd² where ``missing`` [m] is missing, each of its shape."""
        k, band = self.stiffness, self.band
        m = np.maximum(missing, 0.0)
        inner = np.minimum(m, band)
        share = inner / band if band > 0 else (m > 0).astype(float)
        energy = np.where(m < band, k * m * m * share / 6.0, k * (0.5 * m * (m - band) + band**2 / 6.0))
        return energy, -k * np.where(m < band, 0.5 * m * share, m - 0.5 * band), k * share


@dataclass(frozen=True, eq=False)
class Scene:
    """Obstacles at K instants.

    Attributes:
        obstacles: O shapes.
        times: [s], shape (K,).
        pose: base_T_obstacle, rotation by rows and then position, shape (K, O, 12).
        watched: which links mind which obstacles, shape (L, O).
        required: distance asked of each sphere and obstacle [m], shape (S, O); required_self: of each two spheres, (S, S).
        hinge, potential: penalties.
    """

    obstacles: tuple[Shape, ...]
    times: np.ndarray
    pose: np.ndarray
    watched: np.ndarray
    required: np.ndarray
    required_self: np.ndarray
    hinge: Hinge = Hinge()
    potential: RepulsivePotential | None = None

    @staticmethod
    def of(
        arm: SphereArm,
        obstacles: Sequence[Shape],
        times: np.ndarray,
        required: np.ndarray | float = 0.0,
        required_self: np.ndarray | float = 0.0,
        watched: np.ndarray | None = None,
        **penalties,
    ) -> Scene:
        """A scene; numbers stand for all pairs, and by default every link that moves minds every obstacle."""
        times = np.atleast_1d(np.asarray(times, dtype=float))
        obstacles = tuple(obstacles)
        if watched is None:
            watched = np.repeat(arm.moving_links[:, None], len(obstacles), axis=1)
        return Scene(
            obstacles=obstacles,
            times=times,
            pose=poses(obstacles, times),
            watched=np.ascontiguousarray(watched, dtype=np.uint8),
            required=_filled(required, (arm.spheres, len(obstacles))),
            required_self=_filled(required_self, (arm.spheres, arm.spheres)),
            **penalties,
        )

    def at(self, times: np.ndarray) -> Scene:
        """The same at other instants."""
        times = np.atleast_1d(np.asarray(times, dtype=float))
        return replace(self, times=times, pose=poses(self.obstacles, times))

    @property
    def margin(self) -> float:
        """The largest requirement [m]."""
        return max(float(self.required.max(initial=0.0)), float(self.required_self.max(initial=0.0)))


def poses(obstacles: Sequence[Shape], times: np.ndarray) -> np.ndarray:
    """base_T_obstacle at K times, rotation by rows and then position, shape (K, O, 12)."""
    pose = np.empty((len(times), len(obstacles), 12))
    for o, obstacle in enumerate(obstacles):
        matrix = obstacle.pose_at(times) if obstacle.moves else obstacle.pose_at(0.0)[None]
        pose[:, o, :9], pose[:, o, 9:] = matrix[:, :3, :3].reshape(-1, 9), matrix[:, :3, 3]
    return pose


def _filled(value: np.ndarray | float, shape: tuple[int, int]) -> np.ndarray:
    return np.ascontiguousarray(np.broadcast_to(np.asarray(value, dtype=float), shape))
