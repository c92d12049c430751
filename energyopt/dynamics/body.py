"""What the joints of an arm have to produce: inverse dynamics with armature and friction, numerically.

    τ = M(q) q̈ + C(q, q̇) q̇ + g(q) + I_a q̈ + d q̇ + f tanh(q̇ / v_s)

M, C, g: rigid-body terms (Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 5, through ``pin.rnea``);
I_a: armature, the rotor inertia seen at the joint; d: viscous and f: Coulomb friction, whose sign function is
smoothed over the velocity v_s so that the torque has derivatives of every order.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

COULOMB_SMOOTHING = 0.05
"""Joint velocity v_s [rad/s or m/s] over which Coulomb friction changes sign."""


@dataclass(frozen=True, eq=False)
class Dynamics:
    """The numeric dynamics of an arm with nq = nv.

    Attributes:
        model: Pinocchio model; its ``gravity`` and ``armature`` are in force.
        viscous_friction: d [N·m·s/rad], shape (nv,).
        coulomb_friction: f [N·m], shape (nv,).
        coulomb_velocity: v_s [rad/s], one number or one a joint.
    """

    model: pin.Model
    viscous_friction: np.ndarray
    coulomb_friction: np.ndarray
    coulomb_velocity: float | np.ndarray = COULOMB_SMOOTHING

    @property
    def nv(self) -> int:
        return self.model.nv

    @property
    def armature(self) -> np.ndarray:
        return np.asarray(self.model.armature).copy()

    def friction(self, v: np.ndarray) -> np.ndarray:
        """Friction torque d q̇ + f tanh(q̇/v_s) [N·m], same shape as ``v`` [rad/s]."""
        v = np.asarray(v, dtype=float)
        return self.viscous_friction * v + self.coulomb_friction * np.tanh(v / self.coulomb_velocity)

    def torque(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Joint torques by numeric Pinocchio.

        Args:
            q, v, a: position [rad], velocity [rad/s], acceleration [rad/s²], shape (nv,) or (N, nv).

        Returns:
            tau: joint torques [N·m], same shape.
        """
        q, v, a = (np.asarray(x, dtype=float) for x in (q, v, a))
        rows = zip(np.atleast_2d(q), np.atleast_2d(v), np.atleast_2d(a), strict=True)
        model, data = self.model, self._data
        tau = np.array([pin.rnea(model, data, *row) for row in rows]).reshape(q.shape)
        return tau + self.friction(v)

    def energy(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Kinetic (armature included) plus potential energy [J], one value a row of ``q``, ``v`` (N, nv)."""
        model, data = self.model, self._data
        rotors = 0.5 * np.square(np.atleast_2d(v)) @ self.armature
        rigid = [
            pin.computeKineticEnergy(self._bare, data, qi, vi) + pin.computePotentialEnergy(model, data, qi)
            for qi, vi in zip(np.atleast_2d(q), np.atleast_2d(v), strict=True)
        ]
        return np.array(rigid) + rotors

    @cached_property
    def digest(self) -> str:
        """Hash of every number the torque depends on; two arms with the same digest have the same dynamics."""
        h = hashlib.sha256()
        m = self.model
        for i in range(1, m.njoints):
            h.update(f"{m.joints[i].shortname()} {m.parents[i]} ".encode())
            h.update(_joint_axis_bytes(m, i))
            h.update(np.ascontiguousarray(m.jointPlacements[i].homogeneous).tobytes())
            h.update(np.ascontiguousarray(m.inertias[i].toDynamicParameters()).tobytes())
        velocity = np.broadcast_to(self.coulomb_velocity, self.nv)
        for values in (m.gravity.linear, m.armature, self.viscous_friction, self.coulomb_friction, velocity):
            h.update(np.ascontiguousarray(values, dtype=float).tobytes())
        return h.hexdigest()

    @cached_property
    def _data(self) -> pin.Data:
        return self.model.createData()

    @cached_property
    def _bare(self) -> pin.Model:
        bare = pin.Model(self.model)
        bare.armature = np.zeros(self.nv)
        return bare


def joint_axis(model: pin.Model, joint: int) -> tuple[str, np.ndarray]:
    """Kind ("revolute" or "prismatic") and unit axis, in the joint frame, of a one-degree-of-freedom joint.

    Read off the joint's motion subspace, so that aligned and unaligned joints are treated alike.
    """
    data = model.joints[joint].createData()
    model.joints[joint].calc(data, np.zeros(model.nq))
    subspace = np.asarray(data.S).reshape(6)
    if np.linalg.norm(subspace[:3]) > 0.5:
        return "prismatic", subspace[:3]
    return "revolute", subspace[3:]


def _joint_axis_bytes(model: pin.Model, joint: int) -> bytes:
    return np.ascontiguousarray(joint_axis(model, joint)[1]).tobytes()
