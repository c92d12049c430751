"""[robot.actuators] and [[problem.cost]] of a problem file → `Actuators` and cost terms."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from energyopt.actuators import ActuatorModel, Actuators
from energyopt.costs import COSTS, CostTerm, checked_costs
from energyopt.errors import EnergyOptError, ProblemError, RobotError
from energyopt.io.energy_schema import DRIVE, NEEDED, PARAMETERS, parameters_of
from energyopt.io.schema import nearest
from energyopt.io.toml_text import Document, shown
from energyopt.robots import RobotModel

Made = TypeVar("Made")

_ACTUATORS, _COST = "robot.actuators", "problem.cost"
REPLACED = ("velocity_weight", "torque_weights")
"""Keys of [problem] that say what stands in [[problem.cost]] where that is given."""


def actuators_of_file(document: Document, section: Mapping[str, Any], joints: Sequence[str]) -> Actuators:
    """The drives of a validated [robot.actuators] table, for the joints that move.

    Raises:
        ProblemError, RobotError: names file, line, key, value and expectation.
    """
    columns = {key: _column(document, key, section[key], joints) for key in DRIVE if key in section}
    models = []
    for k, joint in enumerate(joints):
        own = {key: column[k] for key, column in columns.items() if column[k] is not None}
        models.append(_made(document, section, lambda own=own: ActuatorModel(**own), f"joint '{joint}': "))
    more = {key: section[key] for key in ("shared_bus", "standby_power", "source") if key in section}
    return _made(document, section, lambda: Actuators(models, **more))


def cost_terms(document: Document, entries: list[Mapping[str, Any]], robot: RobotModel) -> tuple[CostTerm, ...]:
    """The terms of validated [[problem.cost]] tables, fitted to the robot.

    Raises:
        ProblemError: names file, line, key, value and expectation.
    """
    for key in REPLACED:
        if key in document.table["problem"]:
            raise document.error(f"problem.{key}", "stands beside [[problem.cost]]; expected one of them, which says all of J")
    terms = [_term(document, f"{_COST}[{k}]", entry, robot) for k, entry in enumerate(entries)]
    try:
        return checked_costs(terms, robot)
    except ProblemError as error:
        message = str(error)
        said = re.match(r"costs(\[\d+\])?", message)
        key = _COST + (said[1] or "")
        raise ProblemError(f"{document.place(key)}: {key}{message.removeprefix(said[0])}") from None


def _term(document: Document, key: str, entry: Mapping[str, Any], robot: RobotModel) -> CostTerm:
    kind = entry["type"]
    own = parameters_of(kind)
    for name in entry:
        if name in PARAMETERS and name not in own:
            owners = ", ".join(other for other in COSTS if name in parameters_of(other))
            raise document.error(f"{key}.{name}", f"is {shown(entry[name])}; expected only with {owners} (this is {kind})")
    given = {name: value for name, value in entry.items() if name != "type"}
    try:
        return COSTS[kind](**given).fitted(robot)
    except EnergyOptError as error:
        message = str(error).removeprefix(f"{kind}: ")
        word = re.match(r"\w*", message)[0]
        place = f"{key}.{word}" if word in entry else key
        raise ProblemError(f"{document.place(place)}: {key}: {message}") from None


def _column(document: Document, key: str, value: Any, joints: Sequence[str]) -> list[float | None]:
    """One value a joint; None where a table by joint leaves the default."""
    if isinstance(value, Mapping):
        for joint in value:
            if joint not in joints:
                reason = f"is not a joint that moves; {nearest(joint, tuple(joints))}"
                raise document.error(f"{_ACTUATORS}.{key}.{joint}", reason)
        missing = [joint for joint in joints if joint not in value]
        if key in NEEDED and missing:
            raise document.error(f"{_ACTUATORS}.{key}", f"has no number for joint '{missing[0]}'; expected one for every joint")
        return [value.get(joint) for joint in joints]
    if isinstance(value, list):
        if len(value) != len(joints):
            reason = f"has {len(value)} numbers; expected {len(joints)}, for {', '.join(joints)}"
            raise document.error(f"{_ACTUATORS}.{key}", reason)
        return value
    return [value] * len(joints)


def _made(document: Document, section: Mapping[str, Any], make: Callable[[], Made], joint: str = "") -> Made:
    """What ``make`` gives; where it refuses, the line of the value it names."""
    try:
        return make()
    except RobotError as error:
        message = re.sub(r"^actuators?: ", "", str(error))
        word = re.match(r"\w*", message)[0]
        place = f"{_ACTUATORS}.{word}" if word in section else _ACTUATORS
        raise RobotError(f"{document.place(place)}: {_ACTUATORS}: {joint}{message}") from None
