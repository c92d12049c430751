"""Closed-loop replay of a planned motion in MuJoCo.

At every step the motors give the planned torque plus a correction whose gains are scaled by the mass matrix,

    τ = τ_plan(t) + M(q) (k_p (q_plan − q) + k_d (q̇_plan − q̇)),   cut to the torque limits,

so that every joint's error obeys ë + k_d ė + k_p e ≈ 0 whatever it carries; constant gains that suit the shoulder make a light
wrist diverge (computed-torque control: Luh, Walker and Paul, IEEE Trans. Automatic Control 25, 1980).

A motor holds its torque for a step, so the feed-forward is the planned torque at the step's start with the step's mean
acceleration (q̇_plan(t + h) − q̇_plan(t)) / h. MuJoCo's Euler rule is kept for velocities; positions advance with the mean of
old and new velocity, exact for a constant acceleration, in place of the new velocity alone. What error is left tells
of the plan and the models, not of the rule: it falls with h², where the plain rule lags by h q̇ / 2.

Friction is the plan's, d q̇ + f tanh(q̇/v_s). MuJoCo's Euler integrator treats damping c q̇ implicitly; with
c = d + f (1 − tanh²(q̇/v_s)) / v_s, the slope at the present velocity, given to it as damping and the rest as an applied torque,
the torque is exact and a steep Coulomb friction cannot make the step unstable.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from energyopt.arguments import check_names, check_plan
from energyopt.errors import InputError, SimulationError
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.problem_values import real, vector
from energyopt.robots.model import RobotModel
from energyopt.simulation.contacts import ContactCounter
from energyopt.simulation.engine import Engine, build_engine
from energyopt.simulation.log import ReplayLog

if TYPE_CHECKING:
    from energyopt.plans import Plan

PHYSICS_STEP = 5e-4
"""Time step [s] unless asked otherwise."""
LARGEST_STEP = 1e-3
MOST_STEPS = 2_000_000
"""Longest replay: about a minute and a gigabyte of log."""
RUNAWAY, RUNAWAY_ACCELERATION = 1e4, 1e8
"""Velocity [rad/s] and corrective acceleration [rad/s²] at which a simulation counts as diverged, long before MuJoCo's
own 1e10, at which it resets its state and writes a log file."""


@dataclass(frozen=True)
class Feedback:
    """Gains of the error dynamics: ``stiffness`` k_p [1/s²], ``damping`` k_d [1/s]; 400 and 40 are critically damped."""

    stiffness: float = 400.0
    damping: float = 40.0


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
    collisions: bool = False,
    initial_error: np.ndarray | float = 0.0,
) -> ReplayLog:
    """Simulate the arm following a motion, from the motion's first position and velocity to its end.

    Args:
        problem: robot and torque limits.
        trajectory: the motion.
        physics_step: largest time step [s], at most 1 ms; shortened so that a whole number of steps makes the duration.
        stiffness: k_p [1/s²]; damping: k_d [1/s].
        plant: the robot that is simulated where it differs from the one planned for (another payload or friction, say).
        collisions: keep the URDF's collision shapes (meshes as their convex hulls) and report contacts; they exert no
            force, and pairs of bodies that touch in the starting position do not count.
        initial_error: added to the starting position [rad].

    Returns:
        ReplayLog: one row a step, the last one at the end of the motion.

    Raises:
        InputError: a step, gain, plant or initial error that makes no sense.
        SimulationError: the simulation diverged; the message says when and what to do.
    """
    robot = problem.robot
    plant = _plant(robot, plant)
    times, step = _time_grid(trajectory.duration, physics_step)
    gains = _feedback(stiffness, damping)
    q, v, a = (trajectory(times, order) for order in range(3))
    held = robot.torque(q, v, np.vstack([np.diff(v, axis=0) / step, a[-1:]]))
    start = q[0] + _initial_error(initial_error, robot.nv)
    engine = build_engine(plant, collisions)
    engine.model.opt.timestep = step
    began = time.perf_counter()
    rows = _simulate(engine, plant, start, (q, v, held), problem.limits.torque, gains)
    settings = {"stiffness": gains.stiffness, "damping": gains.damping, "plant": plant.name, "collisions": str(collisions)}
    return ReplayLog(
        t=times,
        power=rows["tau"] * rows["v"],
        q_ref=q,
        v_ref=v,
        tau_planned=robot.torque(q, v, a),
        physics_step=step,
        wall_s=time.perf_counter() - began,
        settings=settings,
        **rows,
    )


def _simulate(
    engine: Engine, plant: RobotModel, start: np.ndarray, reference: tuple[np.ndarray, ...], limit: np.ndarray, gains: Feedback
) -> dict[str, np.ndarray | None]:
    """Run the closed loop; everything inside is in MuJoCo's joint order.

    Args:
        engine: compiled model with its time step set.
        start: first position in the robot's order; the first velocity is the reference's.
        reference: q [rad], q̇ [rad/s] and feed-forward τ [N·m], each of shape (N, nv), in the robot's order.
        limit: largest |τ| [N·m], robot's order.

    Returns:
        q, v, a, tau (N, nv) in the robot's order, saturated and contacts (N,).
    """
    model, data = engine.model, engine.data
    order = np.argsort(engine.dof)
    q_ref, v_ref, tau_ref = (np.ascontiguousarray(x[:, order]) for x in reference)
    limit, friction = limit[order], _Friction.of(plant, order)
    mujoco.mj_resetData(model, data)
    data.qpos[:], data.qvel[:] = start[order], v_ref[0]
    counter = ContactCounter.starting_from(engine) if model.ngeom else None
    count, nv = q_ref.shape
    q, v, a, tau = (np.empty((count, nv)) for _ in range(4))
    contacts, feedback = np.zeros(count, dtype=int), np.empty(nv)
    for k in range(count):
        q[k], v[k] = data.qpos, data.qvel
        slope = friction.slope(v[k])
        if slope is not None:
            model.dof_damping[:] = slope
        mujoco.mj_step1(model, data)
        wanted = gains.stiffness * (q_ref[k] - q[k]) + gains.damping * (v_ref[k] - v[k])
        if not (np.abs(wanted).max() < RUNAWAY_ACCELERATION and np.abs(v[k]).max() < RUNAWAY):
            _diverged(plant, k * model.opt.timestep, model.opt.timestep, wanted[engine.dof])
        mujoco.mj_mulM(model, data, feedback, wanted)
        tau[k] = np.clip(tau_ref[k] + feedback, -limit, limit)
        data.qfrc_applied[:] = tau[k] if slope is None else tau[k] - friction.torque(v[k]) + slope * v[k]
        if counter is not None:
            contacts[k] = counter(model, data)
        mujoco.mj_step2(model, data)
        a[k] = data.qacc
        data.qpos[:] -= 0.5 * model.opt.timestep * (data.qvel - v[k])
    if not np.all(np.isfinite(a)) or any(warning.number for warning in data.warning):
        _diverged(plant, count * model.opt.timestep, model.opt.timestep, v[-1][engine.dof])
    saturated = np.any(np.abs(tau) >= limit, axis=1)
    back = engine.dof
    return {
        "q": q[:, back], "v": v[:, back], "a": a[:, back], "tau": tau[:, back],
        "saturated": saturated, "contacts": None if counter is None else contacts,
    }  # fmt: skip


@dataclass(frozen=True)
class _Friction:
    """Friction of the plant in MuJoCo's order; see the module's text for its implicit treatment."""

    viscous: np.ndarray
    coulomb: np.ndarray
    smoothing: float

    @classmethod
    def of(cls, plant: RobotModel, order: np.ndarray) -> _Friction:
        dynamics = plant.dynamics
        return cls(dynamics.viscous_friction[order], dynamics.coulomb_friction[order], dynamics.coulomb_velocity)

    def torque(self, v: np.ndarray) -> np.ndarray:
        return self.viscous * v + self.coulomb * np.tanh(v / self.smoothing)

    def slope(self, v: np.ndarray) -> np.ndarray | None:
        """∂torque/∂v, or None where there is no friction at all."""
        if not (self.viscous.any() or self.coulomb.any()):
            return None
        return self.viscous + self.coulomb * (1.0 - np.tanh(v / self.smoothing) ** 2) / self.smoothing


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


def _feedback(stiffness: float, damping: float) -> Feedback:
    gains = {"stiffness": stiffness, "damping": damping}
    return Feedback(**{key: real(key, gain, lambda k: 0.0 <= k < np.inf, "one finite number ≥ 0") for key, gain in gains.items()})


def _plant(robot: RobotModel, plant: RobotModel | None) -> RobotModel:
    if plant is None:
        return robot
    if not isinstance(plant, RobotModel) or plant.joint_names != robot.joint_names:
        got = ", ".join(plant.joint_names) if isinstance(plant, RobotModel) else type(plant).__name__
        raise InputError(f"plant: expected a robot with the joints {', '.join(robot.joint_names)}; got {got}")
    return plant


def _initial_error(value: np.ndarray | float, nv: int) -> np.ndarray:
    return vector("initial_error", value, nv)
