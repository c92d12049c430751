"""The account of a motion: joules by joint and by cause, adding up to what the supply delivers.

Joint i works P_i = τ_i q̇_i. By the terms of its torque that is

    kinetic            (M q̈ + C q̇ + I_a q̈)_i q̇_i    summed over joints: the change of kinetic energy (rotors included)
    gravity            g_i q̇_i                       summed over joints: the change of potential energy
    viscous friction   d_i q̇_i²
    coulomb friction   f_i q̇_i tanh(q̇_i / v_s)

and behind the joint, where the drives are known (`energyopt.actuators`): gear, copper, burnt (braking power that does not come
back), brake, and what belongs to no joint: burnt on a shared bus, standby. All together is the energy drawn from the supply.

One joint's kinetic and gravity joules tell who does the work, not where it stays: arms pass energy from joint to joint. Their
sums are compared with the energies of the first and last state, which no quadrature enters: `balance_error_J`. The supply's
energy is integrated apart from its causes: `unaccounted_J`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin

from energyopt.actuators import Actuators, PowerFlow, actuators_of
from energyopt.energy.drawn import flow_of
from energyopt.energy.quadrature import power_grid
from energyopt.errors import InputError
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.plans import Plan
from energyopt.problem import Problem
from energyopt.problem_values import shown
from energyopt.readable import Readable
from energyopt.robots.model import RobotModel
from energyopt.sampling import sample_spans

MECHANICAL = ("kinetic", "gravity", "viscous friction", "coulomb friction")
DRIVE = ("gear", "copper", "burnt", "brake")
UNKNOWN = "no electrical joules: the drives are unknown; give load_robot(..., actuators=...) or [robot.actuators] in the file"


@dataclass(frozen=True, eq=False)
class PowerRange:
    """Largest, least (most negative: braking) and mean power [W]; shape (nv,) for joints, numbers for all together."""

    peak: np.ndarray | float
    least: np.ndarray | float
    mean: np.ndarray | float


@dataclass(frozen=True, eq=False, repr=False)
class PowerSeries(Readable):
    """Powers over time; a break of the motion comes twice.

    Attributes:
        t: times [s], shape (N,). mechanical: Σ τ q̇ [W]. copper, electrical: losses in windings and power drawn from the
            supply [W], None where the drives are unknown.
    """

    t: np.ndarray
    mechanical: np.ndarray
    copper: np.ndarray | None
    electrical: np.ndarray | None

    def in_brief(self) -> str:
        return f"{self.t.size} times, {self.t[0]:g} to {self.t[-1]:.6g} s"


@dataclass(frozen=True, eq=False, repr=False)
class EnergyAccount(Readable):
    """Joules of one motion; ``str()`` is a table.

    Attributes:
        joint_names: nv names. duration_s: of the motion.
        joules: by cause, what each joint takes [J], shape (nv,); `DRIVE` causes only where the drives are known.
        kinetic_change_J, potential_change_J: between the first and the last state, from these states alone.
        mechanical_power: τ q̇ of every joint; total_mechanical_power: of all together. series: over time.
        common: by cause, what belongs to no joint [J]: "burnt on the bus", "standby".
        electrical_J: drawn from the supply.
        braking_J: what the drives (on a shared bus: the bus) would give back; returned_J: what of it the supply takes.
        drive_power: u of every drive; supply_power: what the supply delivers. These are None where the drives are unknown.
    """

    joint_names: tuple[str, ...]
    duration_s: float
    joules: dict[str, np.ndarray]
    kinetic_change_J: float
    potential_change_J: float
    mechanical_power: PowerRange
    total_mechanical_power: PowerRange
    series: PowerSeries
    common: dict[str, float] = field(default_factory=dict)
    electrical_J: float | None = None
    braking_J: float | None = None
    returned_J: float | None = None
    drive_power: PowerRange | None = None
    supply_power: PowerRange | None = None

    @property
    def why(self) -> str:
        """Why there are no electrical joules; "" where there are."""
        return UNKNOWN if self.electrical_J is None else ""

    @property
    def mechanical_J(self) -> float:
        """∫ Σ τ q̇ dt, braking counted as negative [J]."""
        return float(sum(self.joules[cause].sum() for cause in MECHANICAL))

    @property
    def friction_J(self) -> float:
        return float(self.joules["viscous friction"].sum() + self.joules["coulomb friction"].sum())

    @property
    def balance_error_J(self) -> float:
        """Mechanical work less the changes of kinetic and potential energy and friction."""
        return self.mechanical_J - self.kinetic_change_J - self.potential_change_J - self.friction_J

    @property
    def unaccounted_J(self) -> float | None:
        """Electrical energy less the sum of all causes, kinetic and potential energy taken from the states."""
        if self.electrical_J is None:
            return None
        causes = self.kinetic_change_J + self.potential_change_J + self.friction_J + sum(self.common.values())
        return self.electrical_J - causes - float(sum(self.joules[cause].sum() for cause in DRIVE))

    def totals(self) -> dict[str, float]:
        """Joules by cause, all joints together, and of what belongs to none."""
        return {cause: float(values.sum()) for cause, values in self.joules.items()} | self.common

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers for summary.json."""
        from energyopt.energy.text import account_dict

        return account_dict(self)

    def in_brief(self) -> str:
        electrical = "" if self.electrical_J is None else f", electrical input {self.electrical_J:.4g} J"
        return f"{self.duration_s:.6g} s, mechanical work {self.mechanical_J:.4g} J{electrical}"

    def __str__(self) -> str:
        from energyopt.energy.text import account_table

        return account_table(self)


def energy_account(
    motion: Plan | Trajectory, robot: RobotModel | None = None, actuators: Actuators | None = None
) -> EnergyAccount:
    """Where the joules of a motion go.

    Args:
        motion: a plan, or a trajectory.
        robot: whose torques; a plan has its own.
        actuators: the drives; None takes the robot's own.

    Returns:
        EnergyAccount: without actuator data its electrical part is None, and ``why`` says so.

    Raises:
        InputError: no motion, no robot for a trajectory, another number of joints, no drives.
    """
    trajectory, robot = _subject(motion, robot)
    drives = robot.actuators if actuators is None else actuators_of(actuators, robot.joint_names, "energy_account")
    nodes, weights = power_grid(robot, trajectory, drives)
    samples = sample_spans(trajectory)
    at_nodes = _Powers.of(robot, drives, *(trajectory(nodes, order) for order in range(3)))
    seen = _Powers.of(robot, drives, *(samples.flat(order) for order in range(3)))
    joules = {cause: weights @ power for cause, power in at_nodes.causes.items()}
    kinetic, potential = _state_changes(robot, trajectory)
    electrical = {} if drives is None else _electrical(drives, at_nodes.flow, seen.flow, weights)
    return EnergyAccount(
        joint_names=robot.joint_names,
        duration_s=trajectory.duration,
        joules=joules | electrical.pop("joules", {}),
        kinetic_change_J=kinetic,
        potential_change_J=potential,
        mechanical_power=_range(at_nodes.mechanical, seen.mechanical, weights),
        total_mechanical_power=_range(at_nodes.mechanical.sum(axis=1), seen.mechanical.sum(axis=1), weights),
        series=_series(samples.t.ravel(), seen),
        **electrical,
    )


@dataclass(frozen=True, eq=False)
class _Powers:
    """Powers at N times: τ q̇ (N, nv), the same by cause, and what the drives make of it."""

    mechanical: np.ndarray
    causes: dict[str, np.ndarray]
    flow: PowerFlow | None

    @classmethod
    def of(cls, robot: RobotModel, drives: Actuators | None, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> _Powers:
        dynamics, model = robot.dynamics, robot.model
        tau, data = robot.torque(q, v, a), model.createData()
        gravity = np.array([pin.computeGeneralizedGravity(model, data, row) for row in q]) * v
        viscous = dynamics.viscous_friction * v**2
        coulomb = dynamics.friction(v) * v - viscous
        kinetic = tau * v - gravity - viscous - coulomb
        causes = dict(zip(MECHANICAL, (kinetic, gravity, viscous, coulomb), strict=True))
        return cls(tau * v, causes, None if drives is None else flow_of(drives, tau, v))


def _electrical(drives: Actuators, flow: PowerFlow, seen: PowerFlow, weights: np.ndarray) -> dict[str, Any]:
    """What of `EnergyAccount` comes from the drives, by field; their share of ``joules`` is to be added."""
    duration = float(weights.sum())
    common = {"standby": drives.standby_power * duration}
    burnt = weights @ flow.burnt
    if drives.shared_bus:
        common = {"burnt on the bus": float(burnt[0])} | common
        burnt = np.zeros(len(drives))
    behind = flow.electrical.sum(axis=1, keepdims=True) if drives.shared_bus else flow.electrical
    braking = weights @ np.maximum(-behind, 0.0)
    brakes = drives.values("brake_power") * duration
    return {
        "joules": dict(zip(DRIVE, (weights @ flow.gear_loss, weights @ flow.copper_loss, burnt, brakes), strict=True)),
        "common": common,
        "electrical_J": float(weights @ flow.supply),
        "braking_J": float(braking.sum()),
        "returned_J": float(braking.sum() - (weights @ flow.burnt).sum()),
        "drive_power": _range(flow.electrical, seen.electrical, weights),
        "supply_power": _range(flow.supply, seen.supply, weights),
    }


def _state_changes(robot: RobotModel, trajectory: Trajectory) -> tuple[float, float]:
    """Changes of kinetic and potential energy [J] from the first to the last state."""
    ends = np.array([0.0, trajectory.duration])
    q, v = trajectory(ends), trajectory(ends, 1)
    whole = robot.dynamics.energy(q, v)
    potential = robot.dynamics.energy(q, np.zeros_like(v))
    return float(np.diff(whole - potential)[0]), float(np.diff(potential)[0])


def _range(at_nodes: np.ndarray, seen: np.ndarray, weights: np.ndarray) -> PowerRange:
    """Extremes over Gauss nodes and samples, which include the ends of spans; the mean by quadrature."""
    both = np.concatenate([at_nodes, seen])
    return PowerRange(both.max(axis=0), both.min(axis=0), weights @ at_nodes / weights.sum())


def _series(t: np.ndarray, powers: _Powers) -> PowerSeries:
    flow = powers.flow
    copper = None if flow is None else flow.copper_loss.sum(axis=1)
    return PowerSeries(t, powers.mechanical.sum(axis=1), copper, None if flow is None else flow.supply)


def _subject(motion: Plan | Trajectory, robot: RobotModel | None) -> tuple[Trajectory, RobotModel]:
    """The motion and the robot that makes it."""
    if isinstance(motion, Plan):
        motion, robot = motion.trajectory, motion.problem.robot if robot is None else robot
    if not isinstance(motion, Trajectory):
        raise InputError(f"energy_account: motion is {shown(motion)}: expected a plan or a trajectory")
    if isinstance(robot, Problem):
        robot = robot.robot
    if not isinstance(robot, RobotModel):
        raise InputError(
            f"energy_account: robot is {shown(robot)}: expected what energyopt.load_robot gives, to move a trajectory"
        )
    if robot.nv != motion.nv:
        raise InputError(f"energy_account: the motion has {motion.nv} joints and the robot {robot.nv}; expected as many")
    return motion, robot
