"""A replay made ready: controller, compiled arm, surroundings, times. Made once, it can be run with many arms."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace

import numpy as np

from energyopt.dynamics.body import Dynamics
from energyopt.errors import GeometryError, InputError, RobotError, SimulationError
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.problem_values import real, shown, vector
from energyopt.robots.model import RobotModel
from energyopt.simulation.bodies import with_bodies
from energyopt.simulation.control import ComputedTorque, Feedback
from energyopt.simulation.disturbance import Disturbance
from energyopt.simulation.engine import Engine, build_engine
from energyopt.simulation.log import ReplayLog
from energyopt.simulation.loop import simulate
from energyopt.simulation.surroundings import surroundings_of

PHYSICS_STEP = 5e-4
"""Time step [s] unless asked otherwise."""
LARGEST_STEP = 1e-3
LARGEST_ERROR = 10.0
"""Of a starting position [rad or m]: farther off, nothing is being followed."""
MOST_STEPS = 2_000_000
"""Longest replay: about a minute and a gigabyte of log."""


@dataclass(frozen=True, eq=False)
class Rig:
    """A replay made ready, to be run once or, with other arms, many times.

    Attributes:
        law: the controller. plant: the arm that is simulated; its dynamics count, its URDF is in ``engine`` already.
        engine: compiled. times: of the steps [s], shape (N,). tau_planned: planned torque there [N·m], shape (N, nv).
        watched: in words, what is watched for contact.
    """

    law: ComputedTorque
    plant: RobotModel
    engine: Engine
    times: np.ndarray
    tau_planned: np.ndarray
    watched: str

    def with_arm(self, dynamics: Dynamics) -> Rig:
        """The same with another arm of the same joints; the controller does not know of it."""
        engine = with_bodies(self.engine, self.plant.dynamics, dynamics)
        return replace(self, plant=replace(self.plant, dynamics=dynamics), engine=engine)


def make_rig(
    problem: Problem,
    trajectory: Trajectory,
    physics_step: float = PHYSICS_STEP,
    gains: Feedback | None = None,
    plant: RobotModel | None = None,
    collisions: bool | None = None,
) -> Rig:
    """Everything of a replay that comes before its first step; arguments and errors as those of `replay_trajectory`."""
    robot = problem.robot
    plant = _plant(robot, plant)
    times, step = _time_grid(trajectory.duration, physics_step)
    law = ComputedTorque.along(robot, trajectory, times, gains or Feedback(), problem.limits.torque)
    engine, watched = _engine(problem, plant, collisions)
    engine.model.opt.timestep = step
    return Rig(law, plant, engine, times, robot.torque(law.q, law.v, trajectory(times, 2)), watched)


def run(rig: Rig, initial_error: np.ndarray | float = 0.0, disturbance: Disturbance | None = None) -> ReplayLog:
    """Simulate; arguments and errors as those of `replay_trajectory`."""
    disturbance, law = disturbance or Disturbance(), rig.law
    start = law.q[0] + _initial_error(initial_error, rig.plant.nv)
    began = time.perf_counter()
    rows = simulate(rig.engine, rig.plant, law, start, rig.times, disturbance)
    settings = {"stiffness": law.gains.stiffness, "damping": law.gains.damping}
    settings |= {"plant": rig.plant.name, "contacts": rig.watched}
    if disturbance != Disturbance():
        settings |= {key: value for key, value in asdict(disturbance).items() if key != "seed" or disturbance.noisy}
    return ReplayLog(
        t=rig.times,
        power=rows["tau"] * rows["v"],
        q_ref=law.q,
        v_ref=law.v,
        tau_planned=rig.tau_planned,
        physics_step=rig.engine.model.opt.timestep,
        wall_s=time.perf_counter() - began,
        settings=settings,
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
