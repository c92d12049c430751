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
from energyopt.dynamics.parameters import UPPER, Structure, numbers_of, rounded, structure_of


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
        tau = cpin.rnea(model, model.createData(), q, v, a) + ca.DM(dynamics.viscous_friction) * v
        if np.any(dynamics.coulomb_friction):
            tau = tau + ca.DM(dynamics.coulomb_friction) * ca.tanh(v / ca.DM(dynamics.coulomb_velocity))
    else:
        structure = structure_of(dynamics)
        tau = parametric_torque(structure)(q, v, a, numbers_of(dynamics, structure))
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
    position = position + rotation @ ca.SX(rounded(local.translation))
    rotation = rotation @ ca.SX(rounded(local.rotation))
    return ca.Function("frame_placement", [q], [ca.densify(rotation), ca.densify(position)], ["q"], ["R", "p"])


def parametric_torque(structure: Structure) -> ca.Function:
    """CasADi function (q, v, a, theta) → tau [N·m] of every arm of a structure; theta: see `parameters`."""
    nv = structure.nv
    q, v, a = (ca.SX.sym(name, nv) for name in "qva")
    theta = ca.SX.sym("theta", structure.size)
    part = {name: theta[where] for name, where in structure.slices.items()}
    tau = _newton_euler(structure, q, v, a, part) + part["armature"] * a + part["viscous"] * v
    if structure.coulomb:
        tau = tau + part["coulomb"] * ca.tanh(v * part["sharpness"])
    return ca.Function("inverse_dynamics", [q, v, a, theta], [ca.densify(tau)], ["q", "v", "a", "theta"], ["tau"])


def _newton_euler(structure: Structure, q: ca.SX, v: ca.SX, a: ca.SX, part: dict[str, ca.SX]) -> ca.SX:
    """Torques of the rigid bodies alone, by the recursion of the module docstring."""
    placements, axes, linear, angular = {}, {}, {0: ca.SX(3, 1)}, {0: ca.SX(3, 1)}
    d_linear, d_angular = {0: -_filled(part["gravity"], structure.gravity)}, {0: ca.SX(3, 1)}
    bodies = _bodies(structure, part["inertia"])
    force, moment = {}, {}
    for i in range(1, structure.nv + 1):
        p, k = structure.parents[i], i - 1
        R, r = placements[i] = _placement(structure.rotations[k], structure.translations[k], structure.axes[k], q[k])
        kind, axis = structure.axes[k]
        axis = ca.sparsify(ca.SX(axis))
        axes[i] = slide, turn = (axis, ca.SX(3, 1)) if kind == "prismatic" else (ca.SX(3, 1), axis)
        linear[i] = R.T @ (linear[p] + ca.cross(angular[p], r)) + slide * v[k]
        angular[i] = R.T @ angular[p] + turn * v[k]
        d_linear[i] = (
            R.T @ (d_linear[p] + ca.cross(d_angular[p], r))
            + slide * a[k]
            + ca.cross(angular[i], slide * v[k])
            + ca.cross(linear[i], turn * v[k])
        )
        d_angular[i] = R.T @ d_angular[p] + turn * a[k] + ca.cross(angular[i], turn * v[k])
        force[i], moment[i] = _body_wrench(bodies[k], linear[i], angular[i], d_linear[i], d_angular[i])
    tau = ca.SX(structure.nv, 1)
    for i in range(structure.nv, 0, -1):
        slide, turn = axes[i]
        tau[i - 1] = ca.dot(slide, force[i]) + ca.dot(turn, moment[i])
        p, (R, r) = structure.parents[i], placements[i]
        if p > 0:
            f = R @ force[i]
            force[p] = force[p] + f
            moment[p] = moment[p] + R @ moment[i] + ca.cross(r, f)
    return tau


def _filled(values: ca.SX, there: tuple[bool, ...] | np.ndarray) -> ca.SX:
    """A column with values where ``there``, and nothing elsewhere."""
    filled, used = ca.SX(len(there), 1), 0
    for k in np.flatnonzero(there):
        filled[int(k)], used = values[used], used + 1
    return filled


def _bodies(structure: Structure, inertia: ca.SX) -> list[tuple[ca.SX, ca.SX, ca.SX]]:
    """Mass, h = mc and I_o of each joint's body; what is no input is a structural zero."""
    bodies, used = [], 0
    for kept in structure.kept:
        ten = _filled(inertia[used : used + int(kept.sum())], kept)
        used += int(kept.sum())
        tensor = ca.SX(3, 3)
        for k, (i, j) in enumerate(UPPER):
            if kept[4 + k]:
                tensor[i, j] = tensor[j, i] = ten[4 + k]
        bodies.append((ten[0], ten[1:4], tensor))
    return bodies


def _joint_placement(model: pin.Model, joint: int, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    """parent_T_joint at q: rotation and position."""
    fixed = model.jointPlacements[joint]
    return _placement(fixed.rotation, fixed.translation, joint_axis(model, joint), q[model.joints[joint].idx_q])


def _placement(rotation: np.ndarray, translation: np.ndarray, joint: tuple[str, np.ndarray], q: ca.SX) -> tuple[ca.SX, ca.SX]:
    """The same of a joint with a fixed placement, its kind and its axis; Rodrigues' formula about the axis."""
    R, p = ca.SX(rounded(rotation)), ca.SX(rounded(translation))
    kind, axis = joint
    axis = rounded(axis)
    if kind == "prismatic":
        return ca.sparsify(R), p + R @ (ca.SX(axis) * q)
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    along = rounded(np.outer(axis, axis))
    turn = ca.SX(along) + ca.cos(q) * ca.SX(np.eye(3) - along) + ca.sin(q) * ca.SX(cross)
    return ca.sparsify(R @ ca.sparsify(turn)), p


def _body_wrench(body: tuple[ca.SX, ca.SX, ca.SX], v: ca.SX, w: ca.SX, dv: ca.SX, dw: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Force and moment about the joint origin that give a body its acceleration: I a + v ×* I v."""
    mass, h, about_origin = body

    def momentum(linear: ca.SX, angular: ca.SX) -> tuple[ca.SX, ca.SX]:
        return mass * linear + ca.cross(angular, h), about_origin @ angular + ca.cross(h, linear)

    force, moment = momentum(dv, dw)
    p, L = momentum(v, w)
    return force + ca.cross(w, p), moment + ca.cross(w, L) + ca.cross(v, p)
