"""The kernels of `collision.c` in NumPy: for machines without a compiler, for shapes the C does not know, and to test it.

With c the centre of a sphere and J = ∂c/∂q,  ∂d/∂q = nᵀJ  and  ∂²d/∂q² = JᵀHJ + Σ_c n_c ∂²c/∂q²; for two spheres of the arm
n and H are of the length of c₁ − c₂, and J is J₁ − J₂.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from energyopt.collision.arm import SphereArm
from energyopt.collision.scene import Scene
from energyopt.geometry.kinematics import joint_placements, point_jacobians
from energyopt.geometry.shapes.round import norm_derivatives


class NumpyPairs:
    """See `kernels.PairKernels`."""

    kind = "interpreted"

    def __init__(self, arm: SphereArm):
        self.arm = arm

    def place(self, scene: Scene, q: np.ndarray) -> NumpyPlaced:
        return NumpyPlaced(self.arm, scene, np.asarray(q, dtype=float))

    def prepare(self, scene: Scene) -> Callable[[np.ndarray], NumpyPlaced]:
        return lambda q: self.place(scene, q)


class NumpyPlaced:
    """See `kernels.Placed`."""

    def __init__(self, arm: SphereArm, scene: Scene, q: np.ndarray):
        self._arm, self._scene, self._count = arm, scene, len(q)
        self._rotation, self._position = joint_placements(arm.model, q)
        turned = np.einsum("nsij,sj->nsi", self._rotation[:, arm.sphere_joint], arm.center)
        self._center = self._position[:, arm.sphere_joint] + turned
        turned = np.einsum("nsij,sj->nsi", self._rotation[:, arm.link_joint], arm.link_center)
        self._link_center = self._position[:, arm.link_joint] + turned
        self._times = np.broadcast_to(scene.times, self._count)

    def centers(self):
        return self._center

    def pairs(self, sample, pair):
        distance, normal, _ = self._distances(sample, pair)
        return distance, np.einsum("ri,riv->rv", normal, self._jacobian(sample, pair))

    def bends(self, sample, pair, multiplier):
        _, normal, curvature = self._distances(sample, pair)
        return self._summed(sample, self._second(sample, pair, normal, curvature, multiplier, np.zeros(len(sample))))

    def penalty(self, derivatives=True):
        scene = self._scene
        sample, pair = self._near()
        distance, normal, curvature = self._distances(sample, pair)
        priced, first, second = scene.hinge.derivatives(self._required(pair) + scene.hinge.band - distance)
        energy = np.stack([priced, np.zeros(len(distance))], axis=1)
        if scene.potential is not None:
            felt = [np.where(pair[:, 1] >= 0, value, 0.0) for value in scene.potential.derivatives(distance)]
            energy[:, 1] = felt[0]
            first, second = first + felt[1], second + felt[2]
        total = np.zeros((self._count, 2))
        np.add.at(total, sample, energy)
        if not derivatives:
            return total, None, None
        gradient = np.zeros((self._count, self._arm.nv))
        np.add.at(gradient, sample, first[:, None] * np.einsum("ri,riv->rv", normal, self._jacobian(sample, pair)))
        return total, gradient, self._summed(sample, self._second(sample, pair, normal, curvature, first, second))

    def least(self, cutoff):
        arm, scene = self._arm, self._scene
        obstacles, links = len(scene.obstacles), len(arm.links)
        least = np.full((self._count, links * obstacles + len(arm.self_pair)), np.inf)
        pair = np.zeros((*least.shape, 2), np.int64)
        pair[..., 0] = -1
        for link in range(links):
            spheres = slice(arm.link_start[link], arm.link_start[link + 1])
            for o in np.flatnonzero(scene.watched[link]):
                column = link * obstacles + o
                gap = self._from_obstacle(self._link_center[:, link], o) - arm.link_radius[link] - scene.margin
                least[:, column], pair[:, column, 1] = gap, o
                near = np.flatnonzero(gap < cutoff)
                points = self._center[near, spheres]
                d = self._from_obstacle(points.reshape(-1, 3), o, near).reshape(points.shape[:2])
                d = d - arm.radius[spheres] - scene.required[spheres, o]
                if len(near):
                    least[near, column], pair[near, column, 0] = d.min(axis=1), arm.link_start[link] + d.argmin(axis=1)
        for p, (first, second) in enumerate(arm.self_pair):
            self._least_of_links(cutoff, links * obstacles + p, first, second, least, pair)
        return least, pair

    def _least_of_links(self, cutoff, column, first, second, least, pair):
        arm, scene = self._arm, self._scene
        gap = np.linalg.norm(self._link_center[:, first] - self._link_center[:, second], axis=1)
        gap = gap - arm.link_radius[first] - arm.link_radius[second] - scene.margin
        least[:, column] = gap
        near = np.flatnonzero(gap < cutoff)
        if not near.size:
            return
        a, b = (slice(arm.link_start[k], arm.link_start[k + 1]) for k in (first, second))
        away = self._center[near, a][:, :, None] - self._center[near, b][:, None]
        rest = arm.radius[a][:, None] + arm.radius[b] + scene.required_self[a, b]
        d = (np.linalg.norm(away, axis=3) - rest).reshape(len(near), -1)
        i, j = np.unravel_index(d.argmin(axis=1), rest.shape)
        least[near, column] = d.min(axis=1)
        pair[near, column] = np.stack([arm.link_start[first] + i, -1 - (arm.link_start[second] + j)], axis=1)

    def _near(self) -> tuple[np.ndarray, np.ndarray]:
        """Samples and pairs that may feel a penalty."""
        arm, scene = self._arm, self._scene
        reach = max(scene.margin + scene.hinge.band, scene.potential.safe_distance if scene.potential else 0.0)
        found = [(np.empty(0, int), np.empty((0, 2), int))]
        for o in range(len(scene.obstacles)):
            spheres = np.flatnonzero(np.repeat(scene.watched[:, o], np.diff(arm.link_start)))
            d = self._from_obstacle(self._center[:, spheres].reshape(-1, 3), o).reshape(self._count, -1) - arm.radius[spheres]
            k, s = np.nonzero(d < reach)
            found.append((k, np.stack([spheres[s], np.full(len(k), o)], axis=1)))
        for first, second in arm.self_pair if scene.hinge.stiffness else ():
            a, b = (np.arange(arm.link_start[link], arm.link_start[link + 1]) for link in (first, second))
            away = np.linalg.norm(self._center[:, a][:, :, None] - self._center[:, b][:, None], axis=3)
            k, i, j = np.nonzero(away < arm.radius[a][:, None] + arm.radius[b] + scene.margin + scene.hinge.band)
            found.append((k, np.stack([a[i], -1 - b[j]], axis=1)))
        return tuple(np.concatenate([part[k] for part in found]) for k in (0, 1))

    def _from_obstacle(self, points: np.ndarray, o: int, samples: np.ndarray | None = None) -> np.ndarray:
        times = self._times if samples is None else self._times[samples]
        count = len(points) // max(len(times), 1)
        return self._scene.obstacles[o].distance(points, np.repeat(times, count))

    def _required(self, pair: np.ndarray) -> np.ndarray:
        a, b = pair.T
        own = b < 0
        result = np.empty(len(pair))
        result[own] = self._scene.required_self[a[own], -1 - b[own]]
        result[~own] = self._scene.required[a[~own], b[~own]]
        return result

    def _distances(self, sample: np.ndarray, pair: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance (R,), normal (R, 3) and curvature (R, 3, 3) in the centre of the first sphere, less that of a second."""
        a, b = pair.T
        center = self._center[sample, a]
        distance, normal, curvature = np.empty(len(a)), np.empty((len(a), 3)), np.empty((len(a), 3, 3))
        own = np.flatnonzero(b < 0)
        other = -1 - b[own]
        distance[own], normal[own], curvature[own] = norm_derivatives(center[own] - self._center[sample[own], other])
        distance[own] -= self._arm.radius[other]
        for o in np.unique(b[b >= 0]):
            rows = np.flatnonzero(b == o)
            found = self._scene.obstacles[o].signed_distance(center[rows], self._times[sample[rows]])
            distance[rows], normal[rows], curvature[rows] = found
        return distance - self._arm.radius[a], normal, curvature

    def _jacobian(self, sample: np.ndarray, pair: np.ndarray) -> np.ndarray:
        """∂c/∂q, less that of a second sphere, shape (R, 3, nv)."""
        result = self._of_spheres(sample, pair[:, 0])
        own = np.flatnonzero(pair[:, 1] < 0)
        result[own] -= self._of_spheres(sample[own], -1 - pair[own, 1])
        return result

    def _of_spheres(self, sample: np.ndarray, sphere: np.ndarray) -> np.ndarray:
        return self._all_jacobians[sample, sphere]

    @property
    def _all_jacobians(self) -> np.ndarray:
        if not hasattr(self, "_jacobian_cache"):
            arm = self._arm
            self._jacobian_cache = point_jacobians(arm.model, self._rotation, self._position, arm.sphere_joint, self._center)
        return self._jacobian_cache

    def _second(self, sample, pair, normal, curvature, first, second) -> np.ndarray:
        """first ∂²d/∂q² + second ∂d/∂q ∂d/∂qᵀ of every pair, shape (R, nv, nv)."""
        J = self._jacobian(sample, pair)
        G = first[:, None, None] * curvature + second[:, None, None] * normal[:, :, None] * normal[:, None, :]
        result = np.einsum("riv,rij,rjw->rvw", J, G, J)
        force = first[:, None] * normal
        result += self._bend(sample, pair[:, 0], force)
        own = np.flatnonzero(pair[:, 1] < 0)
        result[own] -= self._bend(sample[own], -1 - pair[own, 1], force[own])
        return result

    def _bend(self, sample: np.ndarray, sphere: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Σ_c force_c ∂²c/∂q² (R, nv, nv): z_i × J_j for i at or before j, where joint i turns."""
        arm, model = self._arm, self._arm.model
        J = self._of_spheres(sample, sphere)
        result = np.zeros((len(sample), arm.nv, arm.nv))
        for i in np.flatnonzero(arm.kind == 1).tolist():
            axis = np.einsum("nij,j->ni", self._rotation[:, i], arm.axis[i])[sample]
            turn = np.cross(axis, force)  # force · (z × J) = J · (force × z) = −J · (z × force)
            values = -np.einsum("ri,riv->rv", turn, J)
            for j in range(1, len(arm.kind)):
                if i in model.supports[j]:
                    on = np.array([j in model.supports[int(k)] for k in arm.sphere_joint])[sphere]
                    entry = np.where(on, values[:, arm.column[j]], 0.0)
                    result[:, arm.column[i], arm.column[j]] += entry
                    if i != j:
                        result[:, arm.column[j], arm.column[i]] += entry
        return result

    def _summed(self, sample: np.ndarray, values: np.ndarray) -> np.ndarray:
        total = np.zeros((self._count, self._arm.nv, self._arm.nv))
        np.add.at(total, sample, values)
        return total
