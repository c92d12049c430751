"""Inverse dynamics and frame kinematics as CasADi graphs.

Two sources give the same functions: ``pinocchio.casadi`` where it can be imported (conda-forge, source builds), else
the recursive Newton–Euler algorithm written here over the numbers of a `pin.Model` (Featherstone, "Rigid Body Dynamics
Algorithms", 2008, table 5.1; body frames, spatial vectors split into a linear and an angular part):

    v_i = ⁱX_p v_p + S_i q̇_i              a_i = ⁱX_p a_p + S_i q̈_i + v_i × S_i q̇_i
    f_i = I_i a_i + v_i ×* I_i v_i + Σ_children ⁱX*_c f_c          τ_i = S_iᵀ f_i

Armature, viscous and Coulomb friction are added to both as `Dynamics` states them.
"""

from __future__ import annotations

from functools import lru_cache
from types import ModuleType

import casadi as ca
import numpy as np
import pinocchio as pin

from energyopt.dynamics.body import Dynamics, joint_axis

ROUNDING = 2e-11
"""Entries of unit rotations below this are the rounding of π in URDF files; as exact zeros they keep the graph sparse."""


@lru_cache(maxsize=1)
def _pinocchio_casadi() -> ModuleType | None:
    try:
        from pinocchio import casadi as symbolic_pinocchio
    except ImportError:
        return None
    return symbolic_pinocchio


def backend() -> str:
    """Where symbolic dynamics come from: "pinocchio.casadi", or "recursion" (energyopt's own over the pin.Model)."""
    return "recursion" if _pinocchio_casadi() is None else "pinocchio.casadi"


def inverse_dynamics(dynamics: Dynamics, source: str | None = None) -> ca.Function:
    """CasADi function (q, v, a) → tau [N·m], everything in `Dynamics.torque` included.

    Args:
        dynamics: the arm.
        source: "recursion" or "pinocchio.casadi"; by default what `backend` says.
    """
    nv = dynamics.nv
    q, v, a = (ca.SX.sym(name, nv) for name in "qva")
    if (source or backend()) == "pinocchio.casadi":
        cpin = _pinocchio_casadi()
        model = cpin.Model(dynamics.model)
        tau = cpin.rnea(model, model.createData(), q, v, a)
    else:
        tau = _newton_euler(dynamics.model, q, v, a) + ca.DM(dynamics.armature) * a
    tau = tau + ca.DM(dynamics.viscous_friction) * v
    if np.any(dynamics.coulomb_friction):
        tau = tau + ca.DM(dynamics.coulomb_friction) * ca.tanh(v / ca.DM(dynamics.coulomb_velocity))
    return ca.Function("inverse_dynamics", [q, v, a], [ca.densify(tau)], ["q", "v", "a"], ["tau"])


def mass_matrix(dynamics: Dynamics) -> ca.Function:
    """CasADi function (q) → M(q) + armature [kg·m²], shape (nv, nv): the derivative of the torque in q̈."""
    q, a = ca.SX.sym("q", dynamics.nv), ca.SX.sym("a", dynamics.nv)
    tau = inverse_dynamics(dynamics)(q, ca.SX(dynamics.nv, 1), a)
    return ca.Function("mass_matrix", [q], [ca.densify(ca.jacobian(tau, a))], ["q"], ["M"])


def frame_placement(model: pin.Model, frame: int) -> ca.Function:
    """CasADi function (q) → R (3×3), p (3,) [m]: world_T_frame of the frame with this index."""
    q = ca.SX.sym("q", model.nq)
    chain, joint = [], model.frames[frame].parentJoint
    while joint > 0:
        chain.append(joint)
        joint = model.parents[joint]
    rotation, position = ca.SX.eye(3), ca.SX.zeros(3)
    for joint in reversed(chain):
        parent_R, parent_p = _joint_placement(model, joint, q)
        rotation, position = rotation @ parent_R, position + rotation @ parent_p
    local = model.frames[frame].placement
    position = position + rotation @ ca.SX(_rounded(local.translation))
    rotation = rotation @ ca.SX(_rounded(local.rotation))
    return ca.Function("frame_placement", [q], [ca.densify(rotation), ca.densify(position)], ["q"], ["R", "p"])


def _newton_euler(model: pin.Model, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
    """Torques of the rigid bodies alone, by the recursion of the module docstring."""
    placements, axes, linear, angular = {}, {}, {0: ca.SX(3, 1)}, {0: ca.SX(3, 1)}
    d_linear, d_angular = {0: ca.SX(-model.gravity.linear)}, {0: ca.SX(3, 1)}
    force, moment = {}, {}
    for i in range(1, model.njoints):
        p, k = model.parents[i], model.joints[i].idx_v
        R, r = placements[i] = _joint_placement(model, i, q)
        kind, axis = joint_axis(model, i)
        axes[i] = slide, turn = (ca.SX(axis), ca.SX(3, 1)) if kind == "prismatic" else (ca.SX(3, 1), ca.SX(axis))
        linear[i] = R.T @ (linear[p] + ca.cross(angular[p], r)) + slide * v[k]
        angular[i] = R.T @ angular[p] + turn * v[k]
        d_linear[i] = (
            R.T @ (d_linear[p] + ca.cross(d_angular[p], r))
            + slide * a[k]
            + ca.cross(angular[i], slide * v[k])
            + ca.cross(linear[i], turn * v[k])
        )
        d_angular[i] = R.T @ d_angular[p] + turn * a[k] + ca.cross(angular[i], turn * v[k])
        force[i], moment[i] = _body_wrench(model.inertias[i], linear[i], angular[i], d_linear[i], d_angular[i])
    tau = ca.SX(model.nv, 1)
    for i in range(model.njoints - 1, 0, -1):
        slide, turn = axes[i]
        tau[model.joints[i].idx_v] = ca.dot(slide, force[i]) + ca.dot(turn, moment[i])
        p, (R, r) = model.parents[i], placements[i]
        if p > 0:
            f = R @ force[i]
            force[p] = force[p] + f
            moment[p] = moment[p] + R @ moment[i] + ca.cross(r, f)
    return tau


def _joint_placement(model: pin.Model, joint: int, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    """parent_T_joint at q: rotation (Rodrigues' formula about the joint axis) and position."""
    fixed, k = model.jointPlacements[joint], model.joints[joint].idx_q
    R, p = ca.SX(_rounded(fixed.rotation)), ca.SX(_rounded(fixed.translation))
    kind, axis = joint_axis(model, joint)
    axis = _rounded(axis)
    if kind == "prismatic":
        return ca.sparsify(R), p + R @ (ca.SX(axis) * q[k])
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    along = _rounded(np.outer(axis, axis))
    turn = ca.SX(along) + ca.cos(q[k]) * ca.SX(np.eye(3) - along) + ca.sin(q[k]) * ca.SX(cross)
    return ca.sparsify(R @ ca.sparsify(turn)), p


def _body_wrench(inertia: pin.Inertia, v: ca.SX, w: ca.SX, dv: ca.SX, dw: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Force and moment about the joint origin that give a body its acceleration: I a + v ×* I v."""
    mass, center, about_center = inertia.mass, ca.SX(inertia.lever), ca.SX(inertia.inertia)

    def momentum(linear: ca.SX, angular: ca.SX) -> tuple[ca.SX, ca.SX]:
        p = mass * (linear + ca.cross(angular, center))
        return p, about_center @ angular + ca.cross(center, p)

    force, moment = momentum(dv, dw)
    p, h = momentum(v, w)
    return force + ca.cross(w, p), moment + ca.cross(w, h) + ca.cross(v, p)


def _rounded(values: np.ndarray) -> np.ndarray:
    values = np.array(values, dtype=float)
    values[np.abs(values) < ROUNDING] = 0.0
    near = np.abs(np.abs(values) - 1.0) < ROUNDING
    values[near] = np.sign(values[near])
    return values
