"""`replay_trials`: one plan replayed in MuJoCo many times, by arms unlike the planned one and through imperfect sensors.

Every trial draws, from its own stream of random numbers (so that trial k is the same however many there are):

    payload     evenly between its bounds                                masses     each body's factor evenly in 1 ± its share
    friction    each joint's factor evenly in 1 ± its share              noise      at every step (see `simulation.disturbance`)

The controller goes on believing in the planned arm. The model is compiled once; trials exchange its masses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from energyopt.arguments import check_plan
from energyopt.energy import electrical_energy
from energyopt.errors import SimulationError
from energyopt.plans import Plan
from energyopt.problem_values import whole
from energyopt.readable import Readable, counted
from energyopt.robots.model import RobotModel
from energyopt.robots.payload import Payload
from energyopt.robots.variation import Variation, varied_dynamics
from energyopt.robust.uncertainty import Uncertainty
from energyopt.simulation.control import Feedback
from energyopt.simulation.disturbance import Disturbance
from energyopt.simulation.log import ReplayLog
from energyopt.simulation.rig import PHYSICS_STEP, make_rig, run

MOST_TRIALS = 10_000
QUANTITIES = ("tracking_rms", "tracking_max", "end_error", "mechanical_abs_J", "electrical_J")


@dataclass(frozen=True, eq=False)
class Trial:
    """One replay.

    Attributes:
        payload: carried besides [kg]. masses, friction: factors, shape (nv,).
        tracking_rms, tracking_max: joint error over the motion [rad]; end_error: largest at its end.
        mechanical_abs_J: Σ∫|τq̇|dt. electrical_J: None where the drives are unknown.
        saturated_steps, contact_steps: steps with a motor at its limit, with a contact.
        failure: why there are no numbers (they are NaN then); "" where the simulation went through.
    """

    payload: float
    masses: np.ndarray
    friction: np.ndarray
    tracking_rms: float = np.nan
    tracking_max: float = np.nan
    end_error: float = np.nan
    mechanical_abs_J: float = np.nan
    electrical_J: float | None = None
    saturated_steps: int = 0
    contact_steps: int = 0
    failure: str = ""


@dataclass(frozen=True)
class Distribution:
    """Of one quantity over the trials that went through."""

    least: float
    lower_quartile: float
    median: float
    upper_quartile: float
    largest: float


@dataclass(frozen=True, eq=False, repr=False)
class Trials(Readable):
    """What `replay_trials` found; ``str()`` is a table.

    Attributes:
        nominal: the replay without any disturbance. trials: the others.
        uncertainty: bounds of what was drawn. disturbance: delay and noise, its seed that of all draws.
        watched: in words, what was watched for contact.
        steps: physics steps of a replay.
    """

    nominal: Trial
    trials: tuple[Trial, ...]
    uncertainty: Uncertainty
    disturbance: Disturbance
    watched: str
    steps: int

    @property
    def diverged(self) -> int:
        """How many trials the simulation did not survive."""
        return sum(bool(trial.failure) for trial in self.trials)

    @property
    def touching(self) -> int:
        """How many trials touched something."""
        return sum(trial.contact_steps > 0 for trial in self.trials)

    @property
    def saturated(self) -> int:
        """How many trials had a motor at its torque limit."""
        return sum(trial.saturated_steps > 0 for trial in self.trials)

    def values(self, quantity: str) -> np.ndarray:
        """One of `QUANTITIES` of every trial that went through, shape (at most the number of trials,)."""
        found = [getattr(trial, quantity) for trial in self.trials if not trial.failure]
        return np.array([value for value in found if value is not None], dtype=float)

    def distribution(self, quantity: str) -> Distribution | None:
        """Spread of one of `QUANTITIES`; None where no trial has it."""
        values = self.values(quantity)
        return Distribution(*np.percentile(values, (0, 25, 50, 75, 100)).tolist()) if values.size else None

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        from energyopt.robust.text import trials_dict

        return trials_dict(self)

    def in_brief(self) -> str:
        ends = f"{self.diverged} diverged, {self.touching} touched something"
        return f"{self.uncertainty}: {counted(len(self.trials), 'replay')}, {ends}"

    def __str__(self) -> str:
        from energyopt.robust.text import trials_table

        return trials_table(self)


def replay_trials(
    plan: Plan,
    payload: float | tuple[float, float] | None = None,
    masses: float = 0.0,
    friction: float = 0.0,
    *,
    load: Payload | None = None,
    trials: int = 50,
    seed: int = 0,
    delay: int = 0,
    position_noise: float = 0.0,
    velocity_noise: float = 0.0,
    physics_step: float = PHYSICS_STEP,
    stiffness: float = 400.0,
    damping: float = 40.0,
    collisions: bool | None = None,
) -> Trials:
    """Replay a plan many times, each time with another arm.

    Args:
        plan: the motion.
        payload, masses, friction, load: bounds, see `Uncertainty`; masses and friction are drawn joint by joint.
        trials: how many. seed: of all draws; the same seed gives the same numbers.
        delay, position_noise, velocity_noise, physics_step, stiffness, damping, collisions: as of `energyopt.replay`.

    Returns:
        Trials: a simulation that diverges is a trial with a ``failure``, no error.

    Raises:
        InputError: an argument makes no sense.
    """
    check_plan("replay_trials", plan)
    whole("trials", trials, 1, MOST_TRIALS)
    uncertainty, robot = Uncertainty(payload, masses, friction, load), plan.problem.robot
    uncertainty.check(robot)
    disturbance = Disturbance(delay, position_noise, velocity_noise, seed)
    rig = make_rig(plan.problem, plan.trajectory, physics_step, Feedback(stiffness, damping), None, collisions)
    ones = np.ones(robot.nv)
    nominal = _trial(robot, run(rig), {"payload": 0.0, "masses": ones, "friction": ones})
    found = []
    for k in range(trials):
        rng = np.random.default_rng([seed, k])
        arm = draw_arm(uncertainty, robot.nv, rng)
        noise = Disturbance(delay, position_noise, velocity_noise, int(rng.integers(2**62)))
        factors = Variation(uncertainty.body(arm["payload"]), arm["masses"], arm["friction"])
        try:
            log = run(rig.with_arm(varied_dynamics(robot, factors)), disturbance=noise)
            found.append(_trial(robot, log, arm))
        except SimulationError as error:
            found.append(Trial(**arm, failure=str(error)))
    return Trials(nominal, tuple(found), uncertainty, disturbance, rig.watched, len(rig.times))


def draw_arm(uncertainty: Uncertainty, nv: int, rng: np.random.Generator) -> dict[str, Any]:
    """Payload [kg] and factors (nv,) of one trial, as keyword arguments of `Trial`."""
    low, high = uncertainty.payload
    masses, friction = 1.0 + 0.01 * np.array([[uncertainty.masses], [uncertainty.friction]]) * rng.uniform(-1.0, 1.0, (2, nv))
    return {"payload": float(rng.uniform(low, high)), "masses": masses, "friction": friction}


def _trial(robot: RobotModel, log: ReplayLog, arm: dict[str, Any]) -> Trial:
    drives = robot.actuators
    return Trial(
        **arm,
        tracking_rms=log.tracking_rms,
        tracking_max=log.tracking_max,
        end_error=float(np.abs(log.tracking_error[-1]).max()),
        mechanical_abs_J=float(np.trapezoid(np.abs(log.power), log.t, axis=0).sum()),
        electrical_J=None if drives is None else electrical_energy(drives, log.t, log.tau, log.v),
        saturated_steps=log.saturated_steps,
        contact_steps=log.contact_steps,
    )
