"""A robot as its URDF file has it, for `_mbm_judge`: all joints, torques by Pinocchio, collision meshes for coal.

Nothing of energyopt's own model is used but where the files are. Locked joints are held where the problem has them. Meshes stay
what they are, triangles and not hulls. Of all pairs of bodies those are left out that are fixed to one another or neighbours,
that the SRDF lets touch, or that overlap in every one of many random configurations.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from energyopt.robots import RobotModel
from energyopt.robots.meshes import resolve_mesh

RANDOM = 100
"""Configurations in all of which a pair of links has to overlap to be left out."""


class Body(NamedTuple):
    """A piece of collision geometry, or an obstacle: coal's shape, the name of its link, and a ball around it [m]."""

    shape: Any
    link: str
    center: np.ndarray
    radius: float


class RobotJudge:
    """One robot with its locked joints, as its URDF file has it."""

    def __init__(self, robot: RobotModel, joints: list[str], fixed: Mapping[str, float]):
        """``joints``: names of those that move, in the order of the problem; ``fixed``: state of others [rad or m]."""
        root = ET.parse(robot.source).getroot()
        for mesh in root.iterfind("link/collision/geometry/mesh"):
            mesh.set("filename", str(resolve_mesh(robot, mesh.get("filename"))))
        text = ET.tostring(root, encoding="unicode")
        self.model = pin.buildModelFromXML(text)
        self.geometry = pin.buildGeomFromUrdfString(self.model, text, pin.GeometryType.COLLISION)
        self.data, self.geometry_data = self.model.createData(), pin.GeometryData(self.geometry)
        own = [self.model.joints[self.model.getJointId(name)] for name in joints]
        self.places, self.columns = [j.idx_q for j in own], [j.idx_v for j in own]
        self.turns = np.array([j.nq == 2 for j in own])
        self.rest = self._locked(fixed, {j.get("name"): j for j in root.iterfind("joint")})
        model = self.model
        self.lower = np.where(self.turns, -np.inf, model.lowerPositionLimit[self.places])
        self.upper = np.where(self.turns, np.inf, model.upperPositionLimit[self.places])
        self.velocity, self.torque = model.upperVelocityLimit[self.columns], model.upperEffortLimit[self.columns]
        self.bodies = [body_of(o.geometry, model.frames[o.parentFrame].name) for o in self.geometry.geometryObjects]
        self.moving = [k for k, support in enumerate(self._supports()) if support]
        self.own_pairs = self._own_pairs(root, robot)

    def placements(self, q: np.ndarray) -> np.ndarray:
        """base_T_body of all bodies at configurations (N, n), shape (N, B, 4, 4)."""
        full, result = self.full(q), np.empty((len(q), len(self.bodies), 4, 4))
        for row, configuration in zip(result, full, strict=True):
            pin.updateGeometryPlacements(self.model, self.data, self.geometry, self.geometry_data, configuration)
            for k, place in enumerate(self.geometry_data.oMg):
                row[k] = place.homogeneous
        return result

    def full(self, q: np.ndarray) -> np.ndarray:
        """Configurations of all joints, shape (N, nq)."""
        full = np.tile(self.rest, (len(q), 1))
        for k, (place, turns) in enumerate(zip(self.places, self.turns, strict=True)):
            full[:, place] = np.cos(q[:, k]) if turns else q[:, k]
            if turns:
                full[:, place + 1] = np.sin(q[:, k])
        return full

    def torques(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Of the moving joints [N·m], shape (N, n)."""
        full, speed, acceleration = self.full(q), *np.zeros((2, len(q), self.model.nv))
        speed[:, self.columns], acceleration[:, self.columns] = v, a
        rows = zip(full, speed, acceleration, strict=True)
        return np.array([pin.rnea(self.model, self.data, *row)[self.columns] for row in rows])

    def frame(self, name: str) -> np.ndarray:
        """base_T_frame at rest."""
        pin.framesForwardKinematics(self.model, self.data, self.rest)
        return self.data.oMf[self.model.getFrameId(name, pin.FrameType.BODY)].homogeneous

    def _locked(self, fixed: Mapping[str, float], joints: Mapping[str, ET.Element]) -> np.ndarray:
        """Locked joints in place; those of which nothing is stated follow what they mimic, or are as near to 0 as they can be."""

        def value(name: str) -> float:
            mimic = joints[name].find("mimic")
            if name in fixed or mimic is None:
                joint = self.model.joints[self.model.getJointId(name)]
                low, high = (array[joint.idx_q] for array in (self.model.lowerPositionLimit, self.model.upperPositionLimit))
                return fixed[name] if name in fixed else (0.0 if joint.nq == 2 else float(np.clip(0.0, low, high)))
            return float(mimic.get("multiplier", 1)) * value(mimic.get("joint")) + float(mimic.get("offset", 0))

        rest = pin.neutral(self.model)
        for name in list(self.model.names)[1:]:
            joint, at = self.model.joints[self.model.getJointId(name)], value(name)
            rest[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(at), np.sin(at)) if joint.nq == 2 else at
        return rest

    def _supports(self) -> list[frozenset[int]]:
        """Which of the moving joints carry each body."""
        above = [set(support) for support in self.model.supports]
        moving = {k for k in range(1, self.model.njoints) if self.model.joints[k].idx_v in self.columns}
        return [frozenset(above[o.parentJoint] & moving) for o in self.geometry.geometryObjects]

    def _own_pairs(self, root: ET.Element, robot: RobotModel) -> list[tuple[int, int]]:
        self.geometry.addAllCollisionPairs()
        if robot.srdf is not None:
            pin.removeCollisionPairs(self.model, self.geometry, str(robot.srdf))
        solid, supports = {body.link for body in self.bodies}, self._supports()
        parent = {j.find("child").get("link"): j.find("parent").get("link") for j in root.iterfind("joint")}
        beside = {frozenset((link, _solid_above(parent, link, solid))) for link in solid}
        pairs = [(pair.first, pair.second) for pair in self.geometry.collisionPairs]
        pairs = [(a, b) for a, b in pairs if supports[a] != supports[b]]
        pairs = [(a, b) for a, b in pairs if frozenset((self.bodies[a].link, self.bodies[b].link)) not in beside]
        always = self._always(pairs)
        return [pair for pair in pairs if pair not in always]

    def _always(self, pairs: list[tuple[int, int]]) -> set[tuple[int, int]]:
        """Pairs that overlap in every random configuration."""
        rng, finite = np.random.default_rng(0), np.isfinite(self.lower) & np.isfinite(self.upper)
        low, high = np.where(finite, self.lower, -np.pi), np.where(finite, self.upper, np.pi)
        for place in self.placements(rng.uniform(low, high, (RANDOM, len(low)))):
            if not pairs:
                break
            pairs = [(a, b) for a, b in pairs if distance(self.bodies[a], place[a], self.bodies[b], place[b]) <= 0]
        return set(pairs)


def body_of(shape: Any, link: str) -> Body:
    """A shape of coal with a ball around it."""
    shape.computeLocalAABB()
    return Body(shape, link, np.array(shape.aabb_center).ravel(), float(shape.aabb_radius))


def distance(first: Body, at: np.ndarray, second: Body, there: np.ndarray) -> float:
    """Of two bodies with their placements (4, 4) [m]; 0 or less where they touch."""
    place = lambda matrix: coal.Transform3s(np.array(matrix[:3, :3]), np.array(matrix[:3, 3]))
    return coal.distance(first.shape, place(at), second.shape, place(there), coal.DistanceRequest(), coal.DistanceResult())


def _solid_above(parent: Mapping[str, str], link: str, solid: set[str]) -> str:
    """The nearest link above that has geometry; itself where there is none."""
    above = parent.get(link)
    while above is not None and above not in solid:
        above = parent.get(above)
    return link if above is None else above
