"""What is uncertain about an arm, within which bounds, and cases of it: the corners of the bounds, and seeded draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from energyopt.errors import InputError
from energyopt.problem_values import real, shown
from energyopt.robots.model import RobotModel
from energyopt.robots.payload import Payload
from energyopt.robots.variation import Variation

MOST_PAYLOAD = 1e4
"""[kg]"""


@dataclass(frozen=True)
class Case:
    """One arm that may be there: payload added [kg], and deviations of all masses and all friction [%]."""

    payload: float = 0.0
    masses: float = 0.0
    friction: float = 0.0

    def __str__(self) -> str:
        words = [f"{self.payload:g} kg more"] if self.payload else []
        shares = {"masses": self.masses, "friction": self.friction}
        words += [f"{key} {value:+g} %".replace("-", "−") for key, value in shares.items() if value]
        return ", ".join(words) or "as modelled"


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Bounds of what is uncertain. Nothing is by default.

    Attributes:
        payload: least and largest mass carried besides [kg], a pair, or one number for a known one.
        masses: ± share of mass and inertia of the arm's bodies [%]. friction: ± share of viscous and Coulomb friction [%].
        load: how a payload is spread, a `Payload` whose inertia is scaled with its mass; a point at the tool by default.

    Raises:
        InputError: a bound makes no sense.
    """

    payload: float | tuple[float, float] | None = None
    masses: float = 0.0
    friction: float = 0.0
    load: Payload | None = None

    def __post_init__(self):
        object.__setattr__(self, "payload", _pair(self.payload))
        for key in ("masses", "friction"):
            share = real(key, getattr(self, key), lambda x: 0 <= x < 100, "a share of ± per cent, 0 or more and below 100")
            object.__setattr__(self, key, share)
        if self.load is not None and not isinstance(self.load, Payload):
            raise InputError(f"load is {shown(self.load)}: expected an energyopt.Payload, whose mass is scaled, or None")

    def check(self, robot: RobotModel) -> None:
        """Refuse what this robot cannot have.

        Raises:
            InputError: uncertain friction of a robot that states none; a load at an unknown frame.
        """
        dynamics = robot.dynamics
        if self.friction and not (np.any(dynamics.viscous_friction) or np.any(dynamics.coulomb_friction)):
            remedy = "give load_robot viscous_friction or coulomb_friction, or leave it out"
            raise InputError(f"friction is ±{self.friction:g} %: {robot.name} has no friction to vary; {remedy}")
        if self.load is not None:
            robot.frame_id(self.load.frame or robot.tool_frame)

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Least and largest value of each field of a `Case`."""
        return {
            "payload": self.payload,
            "masses": (0.0 - self.masses, self.masses),
            "friction": (0.0 - self.friction, self.friction),
        }

    def corners(self) -> tuple[Case, ...]:
        """All combinations of least and largest values; a quantity that is certain has one value."""
        return tuple(Case(*values) for values in product(*(sorted(set(bounds)) for bounds in self.ranges.values())))

    def draw(self, count: int, seed: int) -> tuple[Case, ...]:
        """Cases drawn evenly between the bounds; the first ones do not depend on ``count``."""
        shares = np.random.default_rng(seed).uniform(size=(count, len(self.ranges)))
        low, high = np.array(list(self.ranges.values())).T
        return tuple(Case(*row) for row in (low + (high - low) * shares).tolist())

    def body(self, mass: float) -> Payload | None:
        """The payload of the given mass [kg]; None for none."""
        if mass == 0:
            return None
        if self.load is None:
            return Payload(mass)
        return replace(self.load, mass=mass, inertia=self.load.inertia * (mass / self.load.mass))

    def variation(self, case: Case) -> Variation:
        """The case as a change of a robot."""
        return Variation(self.body(case.payload), 1.0 + case.masses / 100.0, 1.0 + case.friction / 100.0)

    def __str__(self) -> str:
        low, high = self.payload
        words = [f"payload {low:g} to {high:g} kg" if low < high else f"payload {low:g} kg"] if high else []
        words += [f"{key} ±{value:g} %" for key, value in (("masses", self.masses), ("friction", self.friction)) if value]
        return ", ".join(words) or "nothing uncertain"


def _pair(given: Any) -> tuple[float, float]:
    expected = f"masses in kg, 0 to {MOST_PAYLOAD:g}, such as (0, 2)"
    values = (0.0, 0.0) if given is None else given
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if not isinstance(values, Sequence) or isinstance(values, str):
        values = (values, values)
    if len(values) != 2:
        raise InputError(f"payload is {shown(given)}: expected a pair of {expected}")
    low, high = (real("payload", value, lambda m: 0 <= m <= MOST_PAYLOAD, expected) for value in values)
    if low > high:
        raise InputError(f"payload is {shown(given)}: the least mass is above the largest; expected a pair of {expected}")
    return low, high
