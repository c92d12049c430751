"""Another arm of the same shape in a compiled model: masses and inertias of the bodies exchanged, nothing compiled anew.

A body that only became heavier keeps the place and axes of its inertia. One that got a payload has a new centre of mass and
new principal axes; MuJoCo's marks of bodies whose inertia lies in the body's own frame, which let it leave out rotations, are
taken off then.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from energyopt.dynamics.body import Dynamics
from energyopt.simulation.engine import Engine

SAME = 1e-13
"""Relative difference of two inertias that is rounding."""


def with_bodies(engine: Engine, nominal: Dynamics, actual: Dynamics) -> Engine:
    """The same engine with the bodies and rotors of another arm.

    Args:
        engine: compiled for ``nominal``; it stays as it is.
        nominal, actual: dynamics of arms with the same joints.
    """
    model = copy.copy(engine.model)
    for number, dof in enumerate(engine.dof, start=1):
        old, new = nominal.model.inertias[number], actual.model.inertias[number]
        body = int(model.jnt_bodyid[model.dof_jntid[dof]])
        factor = new.mass / old.mass if old.mass > 0 else 1.0
        if not _multiple(old, new, factor):
            _replace(model, body, new)
        elif factor != 1.0:
            model.body_mass[body] *= factor
            model.body_inertia[body] *= factor
    model.dof_armature[engine.dof] = actual.armature
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    return replace(engine, model=model, data=data)


def _multiple(old: pin.Inertia, new: pin.Inertia, factor: float) -> bool:
    """Whether ``new`` is ``factor`` times ``old``."""
    a, b = factor * old.toDynamicParameters(), new.toDynamicParameters()
    return bool(np.allclose(a, b, rtol=SAME, atol=SAME * float(np.abs(b).max())))


def _replace(model: mujoco.MjModel, body: int, inertia: pin.Inertia) -> None:
    moments, axes = np.linalg.eigh(inertia.inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))  # a rotation, no reflection
    x, y, z, w = Rotation.from_matrix(axes).as_quat()
    model.body_mass[body] = inertia.mass
    model.body_inertia[body] = moments
    model.body_ipos[body], model.body_iquat[body] = inertia.lever, (w, x, y, z)
    model.body_sameframe[body] = model.body_simple[body] = 0
    model.dof_simplenum[:] = 0
