"""The keys of a problem file that say what a motion costs: [robot.actuators] and [[problem.cost]].

Which parameters a type of cost has follows from the fields of its class in `energyopt.costs`: a new term brings its own, and
only a parameter of a new name needs a line here.
"""

from __future__ import annotations

from dataclasses import fields

from energyopt.costs import COSTS
from energyopt.io.schema import Kind, ListOf, Table, by_joint, choice, either, number, numbers, text


def _per_joint(unit: str, low: float = float("-inf"), positive: bool = False) -> Kind:
    """One number for all joints, a list with one a joint, or a table by joint name."""
    one = number(unit, low=low, positive=positive)
    return either(one, numbers("a list with one number a joint"), by_joint(one))


DRIVE = {
    "gear_ratio": _per_joint("", positive=True),
    "torque_constant": _per_joint("N·m/A", positive=True),
    "resistance": _per_joint("Ω", low=0),
    "efficiency": _per_joint("", positive=True),
    "regeneration": _per_joint("", low=0),
    "brake_power": _per_joint("W", low=0),
}
"""Parameters of the drive of a joint."""

NEEDED = ("gear_ratio", "torque_constant", "resistance")
"""Parameters that every drive has to have."""

ACTUATORS = Table(
    {
        **DRIVE,
        "shared_bus": Kind("true or false", lambda x: isinstance(x, bool)),
        "standby_power": number("W", low=0),
        "source": text("where the numbers come from, one line of at most 1000 characters", 1000),
    },
    required=NEEDED,
)
"""The table [robot.actuators]."""

PARAMETERS = {
    "weights": either(number(low=0), numbers("a list with one number a joint")),
    "smoothing": number("W", positive=True),
}
"""Parameters of cost terms, beside their weight."""
_NOT_IN_FILES = ("weight", "actuators")


def parameters_of(kind: str) -> list[str]:
    """The parameters a type of cost has in a file, beside its weight."""
    return [field.name for field in fields(COSTS[kind]) if field.name not in _NOT_IN_FILES]


COST = ListOf(Table({"type": choice(*COSTS), "weight": number(low=0), **PARAMETERS}, required=("type",)))
"""The tables [[problem.cost]]."""
