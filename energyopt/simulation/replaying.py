"""Closed-loop replay of a planned motion in MuJoCo.

The motors follow the control law of `control`, in the steps of `loop`. Obstacles are there as bodies, those that move at their
planned pose of each step. Contacts are looked for at every step and make no force: a plan that touches something is to be seen
touching it, not bouncing off.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from energyopt.arguments import check_names, check_plan
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.robots.model import RobotModel
from energyopt.simulation.control import Feedback
from energyopt.simulation.disturbance import Disturbance
from energyopt.simulation.log import ReplayLog
from energyopt.simulation.rig import PHYSICS_STEP, make_rig, run

if TYPE_CHECKING:
    from energyopt.plans import Plan


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
    delay: int = 0,
    position_noise: float = 0.0,
    velocity_noise: float = 0.0,
    seed: int = 0,
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
        delay: physics steps between a measurement and the torque that answers it.
        position_noise: standard deviation of measured positions [rad]; velocity_noise: of velocities [rad/s]; seed: of both.

    Returns:
        ReplayLog: one row a step, the last one at the end of the motion.

    Raises:
        InputError: a step, gain, plant or initial error that makes no sense; with ``collisions``, geometry that is not there.
        SimulationError: the simulation diverged; the message says when and what to do.
    """
    disturbance = Disturbance(delay, position_noise, velocity_noise, seed)
    rig = make_rig(problem, trajectory, physics_step, Feedback(stiffness, damping), plant, collisions)
    return run(rig, initial_error, disturbance)
