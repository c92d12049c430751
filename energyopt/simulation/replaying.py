"""Closed-loop replay of a planned motion in MuJoCo.

The motors follow the control law of `control`. MuJoCo's Euler rule is kept for velocities; positions advance with the mean of
old and new velocity, exact for a constant acceleration, in place of the new velocity alone. What error is left tells
of the plan and the models, not of the rule: it falls with h², where the plain rule lags by h q̇ / 2.

Obstacles are there as bodies, those that move at their planned pose of each step. Contacts are looked for at every step and
make no force: a plan that touches something is to be seen touching it, not bouncing off.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from energyopt.arguments import check_names, check_plan
from energyopt.errors import GeometryError, InputError, RobotError, SimulationError
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.problem_values import real, shown, vector
from energyopt.robots.model import RobotModel
from energyopt.simulation.contacts import ContactWatch
from energyopt.simulation.control import ComputedTorque, Feedback, Friction
from energyopt.simulation.engine import Engine, build_engine
from energyopt.simulation.log import ReplayLog
from energyopt.simulation.surroundings import surroundings_of

if TYPE_CHECKING:
    from energyopt.plans import Plan

PHYSICS_STEP = 5e-4
"""Time step [s] unless asked otherwise."""
LARGEST_STEP = 1e-3
LARGEST_ERROR = 10.0
"""Of a starting position [rad or m]: farther off, nothing is being followed."""
MOST_STEPS = 2_000_000
"""Longest replay: about a minute and a gigabyte of log."""
RUNAWAY, RUNAWAY_ACCELERATION = 1e4, 1e8
"""Velocity [rad/s] and corrective acceleration [rad/s²] at which a simulation counts as diverged, long before MuJoCo's
own 1e10, at which it writes a log file."""


def replay(plan: Plan, **options) -> ReplayLog:
    """Replay a plan; ``options`` are those of `replay_trajectory`.

    Raises:
        InputError: no plan, or an option that is unknown or makes no sense.
        SimulationError: the simulation diverged.
    """
    check_plan("replay", plan)
    check_names("replay", options, replay_trajectory.__kwdefaults__)
    return replay_trajectory(plan.problem, plan.trajectory, **options)


def replay_trajectory(
    problem: Problem,
    trajectory: Trajectory,
    *,
    physics_step: float = PHYSICS_STEP,
    stiffness: float = 400.0,
    damping: float = 40.0,
    plant: RobotModel | None = None,
    collisions: bool | None = None,
    initial_error: np.ndarray | float = 0.0,
) -> ReplayLog:
    """Simulate the arm following a motion, from the motion's first position and velocity to its end.

    Args:
        problem: robot, torque limits, obstacles, and what is attached.
        trajectory: the motion.
        physics_step: largest time step [s], at most 1 ms; shortened so that a whole number of steps makes the duration.
        stiffness: k_p [1/s²]; damping: k_d [1/s].
        plant: the robot that is simulated where it differs from the one planned for (another payload or friction, say).
        collisions: look for contacts of the arm with obstacles and, unless the problem lets it touch, with itself. By default
            it does where the collision geometry can be loaded; True insists on it, False leaves it out.
        initial_error: added to the starting position [rad].

    Returns:
        ReplayLog: one row a step, the last one at the end of the motion.

    Raises:
        InputError: a step, gain, plant or initial error that makes no sense; with ``collisions``, geometry that is not there.
        SimulationError: the simulation diverged; the message says when and what to do.
    """
    robot = problem.robot
    plant = _plant(robot, plant)
    times, step = _time_grid(trajectory.duration, physics_step)
    gains = Feedback(stiffness, damping)
    law = ComputedTorque.along(robot, trajectory, times, gains, problem.limits.torque)
    start = law.q[0] + _initial_error(initial_error, robot.nv)
    engine, watched = _engine(problem, plant, collisions)
    engine.model.opt.timestep = step
    began = time.perf_counter()
    rows = _simulate(engine, plant, law, start, times)
    return ReplayLog(
        t=times,
        power=rows["tau"] * rows["v"],
        q_ref=law.q,
        v_ref=law.v,
        tau_planned=robot.torque(law.q, law.v, trajectory(times, 2)),
        physics_step=step,
        wall_s=time.perf_counter() - began,
        settings={"stiffness": gains.stiffness, "damping": gains.damping, "plant": plant.name, "contacts": watched},
        **rows,
    )


def _engine(problem: Problem, plant: RobotModel, collisions: bool | None) -> tuple[Engine, str]:
    """The compiled model, and in words what is watched for contact."""
    if not (collisions is None or isinstance(collisions, bool)):
        raise InputError(f"collisions is {shown(collisions)}: expected True, False, or None")
    if collisions is False:
        return build_engine(plant), "not looked for: switched off"
    try:
        surroundings = surroundings_of(problem, plant)
        if not surroundings.bodies:
            raise GeometryError(f"{plant.name}: no link has collision geometry; contacts cannot be looked for")
        return build_engine(plant, surroundings), f"{len(surroundings.pairs)} pairs of solids, at every step"
    except (GeometryError, RobotError, SimulationError) as error:
        if collisions:
            raise
        return build_engine(plant), f"not looked for: {error}"


def _simulate(engine: Engine, plant: RobotModel, law: ComputedTorque, start: np.ndarray, times: np.ndarray) -> dict[str, Any]:
    """Run the closed loop from the position ``start`` and the law's first velocity.

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
    q, v, a, tau = (np.empty((count, plant.nv)) for _ in range(4))
    wanted, scaled = np.empty(plant.nv), np.empty(plant.nv)
    for k in range(count):
        q[k], v[k] = position[qpos], velocity[dof]
        qk, vk = q[k], v[k]
        if rubs:
            slope = model.dof_damping[dof] = friction.slope(vk)
        obstacles.place(k, data)
        mujoco.mj_step1(model, data)
        correction = law.acceleration(k, qk, vk)
        if not (np.abs(correction).max() < RUNAWAY_ACCELERATION and np.abs(vk).max() < RUNAWAY):
            _diverged(plant, times[k], h, correction)
        watch(k, data)
        wanted[dof] = correction
        mujoco.mj_mulM(model, data, scaled, wanted)
        tau[k] = law.torque(k, qk, vk, scaled[dof])
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


def _time_grid(duration: float, physics_step: float) -> tuple[np.ndarray, float]:
    expected = f"seconds, above 0 and at most {LARGEST_STEP:g}"
    physics_step = real("physics_step", physics_step, lambda h: 0.0 < h <= LARGEST_STEP, expected)
    steps = max(2, int(np.ceil(duration / physics_step * (1 - 1e-12))))
    if steps > MOST_STEPS:
        raise InputError(
            f"a replay of {duration:g} s at {physics_step:g} s a step takes {steps} steps: expected at most {MOST_STEPS}; "
            "replay a shorter motion or take a larger physics_step"
        )
    times = np.linspace(0.0, duration, steps + 1)
    return times, duration / steps


def _plant(robot: RobotModel, plant: RobotModel | None) -> RobotModel:
    if plant is None:
        return robot
    if not isinstance(plant, RobotModel) or plant.joint_names != robot.joint_names:
        got = ", ".join(plant.joint_names) if isinstance(plant, RobotModel) else type(plant).__name__
        raise InputError(f"plant: expected a robot with the joints {', '.join(robot.joint_names)}; got {got}")
    return plant


def _initial_error(value: np.ndarray | float, nv: int) -> np.ndarray:
    error = vector("initial_error", value, nv)
    if np.abs(error).max() > LARGEST_ERROR:
        raise InputError(f"initial_error is {shown(value)}: expected none beyond {LARGEST_ERROR:g} rad or m")
    return error
