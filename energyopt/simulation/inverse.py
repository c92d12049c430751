"""Does another engine want the same torques? MuJoCo's inverse dynamics against the robot's own.

MuJoCo computes M(q)q̈ + C(q,q̇)q̇ + g(q) + armature·q̈ + d q̇ by its own recursion, from its own reading of the URDF; Coulomb
friction f tanh(q̇/v_s), which MuJoCo does not have, is added to it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from energyopt.parameterizations.trajectory import Trajectory
from energyopt.robots.model import RobotModel
from energyopt.simulation.engine import Engine, build_engine

if TYPE_CHECKING:
    from energyopt.plans import Plan


def check_inverse_dynamics(
    subject: Plan | RobotModel, trajectory: Trajectory | None = None, samples: int = 200, seed: int = 0
) -> float:
    """Largest relative difference between MuJoCo's inverse dynamics and `RobotModel.torque`.

    Args:
        subject: a plan, or a robot.
        trajectory: the motion along which torques are compared; for a plan its own. For a robot without one,
            random states inside the limits (infinite ranges cut to ±1 rad, ±1 rad/s) with accelerations up to 5 rad/s².
        samples: number of states.
        seed: of the random states.

    Returns:
        max over joints of max|Δτ| / max|τ| over the states; a joint whose torque stays below a thousandth of the largest
        joint torque is measured against that thousandth.
    """
    robot = subject if isinstance(subject, RobotModel) else subject.problem.robot
    motion = trajectory if isinstance(subject, RobotModel) else trajectory or subject.trajectory
    if motion is None:
        q, v, a = _random_states(robot, samples, seed)
    else:
        q, v, a = (motion(np.linspace(0.0, motion.duration, samples), order) for order in range(3))
    ours = robot.torque(q, v, a)
    theirs = mujoco_torque(build_engine(robot), robot, q, v, a)
    size = np.abs(ours).max(axis=0)
    size = np.maximum(size, max(1e-3 * size.max(), 1e-9))
    return float((np.abs(ours - theirs).max(axis=0) / size).max())


def mujoco_torque(engine: Engine, robot: RobotModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Joint torques by ``mj_inverse`` [N·m]; ``q``, ``v``, ``a`` and the result have shape (N, nv) in the robot's order."""
    model, data, dof = engine.model, engine.data, engine.dof
    model.dof_damping[dof] = robot.dynamics.viscous_friction
    tau = np.empty_like(q)
    for row, (qi, vi, ai) in enumerate(zip(q, v, a, strict=True)):
        data.qpos[engine.qpos], data.qvel[dof], data.qacc[dof] = qi, vi, ai
        mujoco.mj_inverse(model, data)
        tau[row] = data.qfrc_inverse[dof]
    dynamics = robot.dynamics
    return tau + dynamics.coulomb_friction * np.tanh(v / dynamics.coulomb_velocity)


def _random_states(robot: RobotModel, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng, limits = np.random.default_rng(seed), robot.limits
    lower = np.where(np.isfinite(limits.lower), limits.lower, -1.0)
    upper = np.where(np.isfinite(limits.upper), limits.upper, np.maximum(1.0, lower + 1.0))
    velocity = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
    shape = (samples, robot.nv)
    return rng.uniform(lower, upper, shape), rng.uniform(-velocity, velocity, shape), rng.uniform(-5.0, 5.0, shape)
