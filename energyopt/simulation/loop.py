"""One run of the closed loop, step by step.

MuJoCo's Euler rule is kept for velocities; positions advance with the mean of old and new velocity, exact for a constant
acceleration, in place of the new velocity alone. What error is left tells of the plan and the models, not of the rule: it
falls with h², where the plain rule lags by h q̇ / 2.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from energyopt.errors import SimulationError
from energyopt.robots.model import RobotModel
from energyopt.simulation.contacts import ContactWatch
from energyopt.simulation.control import ComputedTorque, Friction
from energyopt.simulation.disturbance import Disturbance
from energyopt.simulation.engine import Engine

RUNAWAY, RUNAWAY_ACCELERATION = 1e4, 1e8
"""Velocity [rad/s] and corrective acceleration [rad/s²] at which a simulation counts as diverged, long before MuJoCo's
own 1e10, at which it writes a log file."""


def simulate(
    engine: Engine, plant: RobotModel, law: ComputedTorque, start: np.ndarray, times: np.ndarray, disturbance: Disturbance
) -> dict[str, Any]:
    """Run the closed loop at ``times`` from the position ``start`` and the law's first velocity.

    Returns:
        q, v, a, tau (N, nv), saturated and contacts (N,), touches; in the robot's joint order.
    """
    model, data, qpos, dof = engine.model, engine.data, engine.qpos, engine.dof
    position, velocity, applied, acceleration = data.qpos, data.qvel, data.qfrc_applied, data.qacc
    friction, obstacles = Friction.of(plant), engine.drive_obstacles(times)
    watch, rubs = ContactWatch(engine.surroundings, engine.solid), friction.present
    mujoco.mj_resetData(model, data)
    position[qpos], velocity[dof] = start, law.v[0]
    count, h = len(times), model.opt.timestep
    q, v, a, command, tau = (np.empty((count, plant.nv)) for _ in range(5))
    delay, noise = disturbance.delay, disturbance.noise(count, plant.nv) if disturbance.noisy else None
    for k in range(count):
        q[k], v[k] = position[qpos], velocity[dof]
        qk, vk = q[k], v[k]
        if rubs:
            slope = model.dof_damping[dof] = friction.slope(vk)
        obstacles.place(k, data)
        mujoco.mj_step1(model, data)
        seen = (qk, vk) if noise is None else (qk + noise[0][k], vk + noise[1][k])
        correction = law.acceleration(k, *seen)
        if not (np.abs(correction).max() < RUNAWAY_ACCELERATION and np.abs(vk).max() < RUNAWAY):
            _diverged(plant, times[k], h, correction)
        watch(k, data)
        command[k] = law.torque(k, *seen, correction)
        tau[k] = command[max(k - delay, 0)]
        applied[dof] = tau[k] - friction.torque(vk) + slope * vk if rubs else tau[k]
        mujoco.mj_step2(model, data)
        a[k] = acceleration[dof]
        position[qpos] -= 0.5 * h * (velocity[dof] - vk)
    if not np.all(np.isfinite(a)) or any(warning.number for warning in data.warning):
        _diverged(plant, times[-1], h, v[-1])
    watched = len(engine.surroundings.bodies) > 0
    return {
        "q": q, "v": v, "a": a, "tau": tau,
        "saturated": np.any(np.abs(tau) >= law.limit, axis=1),
        "contacts": watch.counts(count) if watched else None,
        "touches": watch.contacts(times),
    }  # fmt: skip


def _diverged(plant: RobotModel, when: float, step: float, demand: np.ndarray) -> None:
    fastest = int(np.argmax(np.where(np.isnan(demand), np.inf, np.abs(demand))))
    raise SimulationError(
        f"{plant.name}: the replay diverged at {when:.4f} s (joint '{plant.joint_names[fastest]}' runs away); "
        f"try softer gains than these, or a physics_step below {step:g} s"
    )
