"""Electric drives of the joints: from what a joint has to do to what its drive draws.

A joint with torque τ and velocity q̇ takes the mechanical power P = τ q̇. Rotor inertia is the robot's ``armature``, friction its
``viscous_friction`` and ``coulomb_friction``: both are in τ already. What is left between joint and supply, joint by joint:

    gear     τ_m = (τ/N) η^(−sign P)      the motor pays for the losses when it drives (P > 0: τ/(ηN)) and is spared them
             P_m = P η^(−sign P)          when the joint drives it (P < 0: τη/N); at rest (P = 0) it holds τ/N
    motor    i = τ_m / k_t,   u = P_m + R i²      electrical power, negative where braking gives more than the copper burns
    supply   each drive for itself:   Σ ( max(u, 0) − ρ max(−u, 0) )
             one shared DC bus:       max(U, 0) − ρ max(−U, 0),  U = Σ u      a braking joint feeds the driving ones first
             and always + P₀ + Σ P_brake

Losses in windings and power electronics beyond R i², and the inertia of the gear itself, are not modelled. That η acts on all
of τ, on the part that accelerates the rotor too, is the usual simplification (it matters where η is far from 1).

Sources: B. Siciliano, L. Sciavicco, L. Villani, G. Oriolo, "Robotics: Modelling, Planning and Control", Springer 2009, ch. 5
(motor and gear); M. Pellicciari, G. Berselli, F. Leali, A. Vergnano, "A method for reducing the energy consumption of
pick-and-place industrial robots", Mechatronics 23, 2013 (copper, regeneration, shared bus, constant consumers).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from energyopt.errors import RobotError

LARGEST = 1e9
"""No parameter of a drive is as large in SI units."""


@dataclass(frozen=True)
class ActuatorModel:
    """The electric drive of one joint. A prismatic joint has N in rad/m.

    Attributes:
        gear_ratio: N, turns of the motor a turn of the joint.
        torque_constant: k_t of the motor [N·m/A].
        resistance: R of the winding that carries i = τ_m/k_t [Ω]; 0 leaves copper losses out.
        efficiency: η of the gear, above 0 and at most 1.
        regeneration: ρ, the share of braking power that comes back: 0 burns it in a resistor, 1 returns all of it.
        brake_power: power that holds the brake open while the robot moves [W].

    Raises:
        RobotError: a number is missing, not finite, or impossible.
    """

    gear_ratio: float
    torque_constant: float
    resistance: float
    efficiency: float = 1.0
    regeneration: float = 0.0
    brake_power: float = 0.0

    def __post_init__(self):
        for key, (unit, low, high, open_end) in _RANGES.items():
            value = number(f"actuator: {key}", getattr(self, key), unit, low, high, open_end)
            object.__setattr__(self, key, value)


PARAMETERS = tuple(field.name for field in fields(ActuatorModel))
"""Names of the parameters of a drive."""

_RANGES = {
    "gear_ratio": ("", 0.0, LARGEST, True),
    "torque_constant": ("N·m/A", 0.0, LARGEST, True),
    "resistance": ("Ω", 0.0, LARGEST, False),
    "efficiency": ("", 0.0, 1.0, True),
    "regeneration": ("", 0.0, 1.0, False),
    "brake_power": ("W", 0.0, LARGEST, False),
}
"""Of every parameter: unit, least and largest value, and whether the least one is excluded."""


@dataclass(frozen=True, eq=False)
class PowerFlow:
    """Where the power goes at N times; exact, not smoothed. Σ electrical + constant + Σ burnt = supply.

    Attributes:
        mechanical: P = τ q̇ [W], shape (N, nv); gear_loss: P_m − P ≥ 0; copper_loss: R i²; electrical: u, their sum.
        burnt: braking power that does not come back, shape (N, nv), or (N, 1) where the bus is shared.
        constant: P₀ + Σ P_brake [W].
        supply: what the supply delivers [W], negative where it takes power back, shape (N,).
    """

    mechanical: np.ndarray
    gear_loss: np.ndarray
    copper_loss: np.ndarray
    electrical: np.ndarray
    burnt: np.ndarray
    constant: float
    supply: np.ndarray


@dataclass(frozen=True, eq=False)
class Actuators:
    """The drives of all joints of a robot, in the order of its joints.

    Attributes:
        models: one `ActuatorModel` a joint.
        shared_bus: whether the drives share one DC bus; then all have the same ``regeneration``, that of the bus.
        standby_power: P₀, of controller and drives, drawn at all times [W].
        source: where the numbers come from, one line.

    Raises:
        RobotError: no model, something else than models, drives of one bus that differ in ``regeneration``.
    """

    models: Sequence[ActuatorModel]
    shared_bus: bool = False
    standby_power: float = 0.0
    source: str = ""

    def __post_init__(self):
        given = self.models
        models = tuple(given) if isinstance(given, Sequence) and not isinstance(given, str) else (given,)
        for k, model in enumerate(models):
            if not isinstance(model, ActuatorModel):
                raise RobotError(f"actuators: entry {k} is {_shown(model)}; expected an ActuatorModel for each joint")
        if not models:
            raise RobotError("actuators: there is none; expected an ActuatorModel for each joint")
        object.__setattr__(self, "models", models)
        if not isinstance(self.shared_bus, (bool, np.bool_)):
            raise RobotError(f"actuators: shared_bus is {_shown(self.shared_bus)}; expected True or False")
        power = number("actuators: standby_power", self.standby_power, "W", 0.0, LARGEST, False)
        object.__setattr__(self, "standby_power", power)
        if not isinstance(self.source, str) or len(self.source) > 1000:
            raise RobotError(f"actuators: source is {_shown(self.source)}; expected text of at most 1000 characters")
        shares = sorted({model.regeneration for model in models})
        if self.shared_bus and len(shares) > 1:
            listed = ", ".join(f"{share:g}" for share in shares)
            raise RobotError(f"actuators: regeneration is {listed} on one shared bus; expected one value, that of the bus")

    def __len__(self) -> int:
        return len(self.models)

    def values(self, key: str) -> np.ndarray:
        """One parameter of all joints, such as ``values("efficiency")``, shape (nv,). Read-only."""
        return self._columns[key]

    @cached_property
    def _columns(self) -> dict[str, np.ndarray]:
        columns = {key: np.array([getattr(model, key) for model in self.models]) for key in PARAMETERS}
        for column in columns.values():
            column.flags.writeable = False
        return columns

    @cached_property
    def copper(self) -> np.ndarray:
        """κ = R/(N k_t)²: copper loss of a unit of joint torque behind an ideal gear [W/(N·m)²], shape (nv,)."""
        return self.values("resistance") / (self.values("gear_ratio") * self.values("torque_constant")) ** 2

    @cached_property
    def constant_power(self) -> float:
        """P₀ + Σ P_brake [W]."""
        return self.standby_power + float(self.values("brake_power").sum())

    def motor_torque(self, tau: ArrayLike, v: ArrayLike) -> np.ndarray:
        """τ_m [N·m] of joint torques ``tau`` [N·m] and velocities ``v`` [rad/s], shape (N, nv) or (nv,)."""
        tau, v = np.asarray(tau, dtype=float), np.asarray(v, dtype=float)
        return tau / self.values("gear_ratio") * self.values("efficiency") ** -np.sign(tau * v)

    def current(self, tau: ArrayLike, v: ArrayLike) -> np.ndarray:
        """i = τ_m/k_t [A], same shape as ``tau``."""
        return self.motor_torque(tau, v) / self.values("torque_constant")

    def flow(self, tau: ArrayLike, v: ArrayLike) -> PowerFlow:
        """Where the power goes, for joint torques [N·m] and velocities [rad/s], shape (N, nv)."""
        tau, v = np.atleast_2d(np.asarray(tau, dtype=float)), np.atleast_2d(np.asarray(v, dtype=float))
        mechanical = tau * v
        gear = mechanical * (self.values("efficiency") ** -np.sign(mechanical) - 1.0)
        copper = self.values("resistance") * self.current(tau, v) ** 2
        electrical = mechanical + gear + copper
        at_supply = electrical.sum(axis=1, keepdims=True) if self.shared_bus else electrical
        share = self.values("regeneration")[:1] if self.shared_bus else self.values("regeneration")
        burnt = (1.0 - share) * np.maximum(-at_supply, 0.0)
        supply = (at_supply + burnt).sum(axis=1) + self.constant_power
        return PowerFlow(mechanical, gear, copper, electrical, burnt, self.constant_power, supply)


def actuators_of(given: Any, names: Sequence[str], where: str) -> Actuators | None:
    """What a caller may give for the drives of a robot, as `Actuators` with one model a joint; None where there are none.

    Args:
        given: None, `Actuators`, one `ActuatorModel` for all joints, one for each in order, or a dict of them by joint name.
        names: joint names, in order. where: begins messages.

    Raises:
        RobotError: another count, an unknown or missing joint, something else.
    """
    if given is None:
        return None
    try:
        if isinstance(given, Mapping):
            given = _by_name(given, names)
        elif isinstance(given, ActuatorModel):
            given = [given] * len(names)
        made = given if isinstance(given, Actuators) else Actuators(given)
    except RobotError as error:
        raise RobotError(f"{where}: {error}") from None
    if len(made) != len(names):
        raise RobotError(f"{where}: actuators has {len(made)} models; expected {len(names)}, for {', '.join(names)}")
    return made


def _by_name(given: Mapping, names: Sequence[str]) -> list[ActuatorModel]:
    for name in given:
        if name not in names:
            raise RobotError(f"actuators: no moving joint named '{name}'; expected {', '.join(names)}")
    for name in names:
        if name not in given:
            raise RobotError(f"actuators: joint '{name}' has none; expected an ActuatorModel for each of {', '.join(names)}")
    return [given[name] for name in names]


def number(key: str, value: Any, unit: str, low: float, high: float, above: bool) -> float:
    """One number from ``low`` (or ``above`` it) to ``high``.

    Raises:
        RobotError: something else.
    """
    good = isinstance(value, Real) and not isinstance(value, (bool, np.bool_)) and low <= value <= high
    if not good or (above and value == low):
        span = f"above {low:g}" if above else f"from {low:g}"
        until = f", at most {high:g}" if above else f" to {high:g}"
        raise RobotError(f"{key} is {_shown(value)}; expected a number {span}{until}{f' [{unit}]' if unit else ''}")
    return float(value)


def _shown(value: Any) -> str:
    return " ".join(repr(value).split())[:100]
