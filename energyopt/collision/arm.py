"""SphereArm: the spheres of a robot and its kinematics as plain arrays, ready for the kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from energyopt.dynamics.body import joint_axis
from energyopt.geometry.robot_spheres import SphereModel

_KINDS = {"revolute": 1, "prismatic": 2}


@dataclass(frozen=True, eq=False)
class SphereArm:
    """An arm of J joints (the world is joint 0) with S spheres on L links.

    Attributes:
        model: its kinematics.
        links: names, length L; the spheres of a link stand together.
        parent, kind, column: per joint: its parent, 1 if it turns and 2 if it slides, its index in q; shape (J,).
        placement: parent_T_joint at q = 0, rotation by rows and then position, shape (J, 12); axis: shape (J, 3).
        sphere_joint, center, radius: shapes (S,), (S, 3), (S,) [m], in the joint's frame.
        link_start: where the spheres of each link start, shape (L + 1,).
        link_joint, link_center, link_radius: a ball around all spheres of a link, shapes (L,), (L, 3), (L,).
        self_pair: links to be kept apart, shape (P, 2).
    """

    model: pin.Model
    links: tuple[str, ...]
    parent: np.ndarray
    kind: np.ndarray
    column: np.ndarray
    placement: np.ndarray
    axis: np.ndarray
    sphere_joint: np.ndarray
    center: np.ndarray
    radius: np.ndarray
    link_start: np.ndarray
    link_joint: np.ndarray
    link_center: np.ndarray
    link_radius: np.ndarray
    self_pair: np.ndarray

    @staticmethod
    def of(spheres: SphereModel, self_pairs: Sequence[tuple[str, str]] = ()) -> SphereArm:
        """From the cover of a robot and the names of links to be kept apart (those without spheres are left out)."""
        links = spheres.links
        counts = np.array([spheres.link.count(name) for name in links], dtype=np.int64)
        start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        balls = [_ball(spheres.center[a:b], spheres.radius[a:b]) for a, b in zip(start[:-1], start[1:], strict=True)]
        number = {name: k for k, name in enumerate(links)}
        pairs = [(number[a], number[b]) for a, b in self_pairs if a in number and b in number]
        return SphereArm(
            model=spheres.model,
            links=links,
            **_joints(spheres.model),
            sphere_joint=np.asarray(spheres.joint, dtype=np.int64),
            center=np.ascontiguousarray(spheres.center),
            radius=np.ascontiguousarray(spheres.radius),
            link_start=start,
            link_joint=np.asarray(spheres.joint, dtype=np.int64)[start[:-1]] if len(links) else np.empty(0, np.int64),
            link_center=np.array([center for center, _ in balls]).reshape(-1, 3),
            link_radius=np.array([radius for _, radius in balls]),
            self_pair=np.array(pairs, dtype=np.int64).reshape(-1, 2),
        )

    def with_points(self, points: dict[str, tuple[int, np.ndarray]]) -> SphereArm:
        """With further links of one sphere of no size: by name, its joint and its place in that joint's frame [m]."""
        if not points:
            return self
        joint = np.array([j for j, _ in points.values()], np.int64)
        center, none = np.array([p for _, p in points.values()], dtype=float), np.zeros(len(points))
        ends = self.spheres + 1 + np.arange(len(points))
        return replace(
            self,
            links=(*self.links, *points),
            sphere_joint=np.concatenate([self.sphere_joint, joint]),
            center=np.concatenate([self.center, center]),
            radius=np.concatenate([self.radius, none]),
            link_start=np.concatenate([self.link_start, ends]),
            link_joint=np.concatenate([self.link_joint, joint]),
            link_center=np.concatenate([self.link_center, center]),
            link_radius=np.concatenate([self.link_radius, none]),
        )

    @property
    def nv(self) -> int:
        return self.model.nv

    @property
    def spheres(self) -> int:
        return len(self.radius)

    def link_of(self, sphere: int) -> int:
        """Index of the link a sphere is on."""
        return int(np.searchsorted(self.link_start, sphere, side="right") - 1)

    @property
    def moving_links(self) -> np.ndarray:
        """Which links move at all, shape (L,)."""
        return self.link_joint > 0


def _ball(centers: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, float]:
    middle = 0.5 * (np.min(centers - radii[:, None], axis=0) + np.max(centers + radii[:, None], axis=0))
    return middle, float(np.max(np.linalg.norm(centers - middle, axis=1) + radii))


def _joints(model: pin.Model) -> dict[str, np.ndarray]:
    kind, axis = np.zeros(model.njoints, np.int64), np.zeros((model.njoints, 3))
    column, placement = np.zeros(model.njoints, np.int64), np.zeros((model.njoints, 12))
    for j in range(1, model.njoints):
        word, direction = joint_axis(model, j)
        kind[j], axis[j], column[j] = _KINDS[word], direction, model.joints[j].idx_v
        place = model.jointPlacements[j]
        placement[j] = np.concatenate([place.rotation.ravel(), place.translation])
    return {
        "parent": np.array(list(model.parents), np.int64),
        "kind": kind,
        "column": column,
        "placement": placement,
        "axis": axis,
    }
