"""Drives and cost terms as plain values, and back: inside a plan file. Numbers in JSON come back bit for bit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from energyopt.actuators import PARAMETERS, ActuatorModel, Actuators
from energyopt.costs import COSTS, CostTerm
from energyopt.errors import FileError

_NOT_STORED = ("actuators",)


def actuators_meta(drives: Actuators | None) -> dict[str, Any] | None:
    """What `actuators_from_meta` reads; None where there are no drives."""
    if drives is None:
        return None
    columns = {key: drives.values(key).tolist() for key in PARAMETERS}
    return {**columns, "shared_bus": bool(drives.shared_bus), "standby_power": drives.standby_power, "source": drives.source}


def actuators_from_meta(meta: Any, nv: int) -> Actuators | None:
    """The drives of `actuators_meta`.

    Raises:
        RobotError: a value makes no sense.
        KeyError, TypeError, ValueError: something is missing or has another shape.
    """
    if meta is None:
        return None
    columns = {key: meta[key] for key in PARAMETERS}
    for key, column in columns.items():
        if not isinstance(column, list) or len(column) != nv:
            raise ValueError(f"its actuators have no {key} for each of {nv} joints")
    models = [ActuatorModel(**{key: column[k] for key, column in columns.items()}) for k in range(nv)]
    return Actuators(models, shared_bus=meta["shared_bus"], standby_power=meta["standby_power"], source=meta["source"])


def costs_meta(terms: Sequence[CostTerm], drives: Actuators | None) -> list[dict[str, Any]]:
    """What `costs_from_meta` reads; the robot's own ``drives`` are stored with the robot.

    Raises:
        FileError: a term of a class that energyopt does not know.
    """
    return [_described(term, drives) for term in terms]


def costs_from_meta(meta: Any, drives: Actuators | None, nv: int) -> list[CostTerm]:
    """The terms of `costs_meta`.

    Raises:
        ProblemError, RobotError: a value makes no sense.
        KeyError, TypeError, ValueError: something is missing or has another shape.
    """
    if not isinstance(meta, list):
        raise ValueError("its costs are no list")
    return [_term(item, drives, nv) for item in meta]


def _described(term: CostTerm, drives: Actuators | None) -> dict[str, Any]:
    if COSTS.get(term.name) is not type(term):
        raise FileError(f"costs: '{term.name}' is a {type(term).__name__}; a file can hold {', '.join(COSTS)}")
    own = {field.name: getattr(term, field.name) for field in fields(term) if field.name not in _NOT_STORED}
    meta = {"type": term.name, "own": {key: np.asarray(value).tolist() for key, value in own.items()}}
    other = getattr(term, "actuators", None)
    return meta if other is None or other is drives else meta | {"actuators": actuators_meta(other)}


def _term(meta: dict[str, Any], drives: Actuators | None, nv: int) -> CostTerm:
    kind = COSTS[str(meta["type"])]
    known = {field.name for field in fields(kind)}
    given = dict(meta["own"])
    if not set(given) <= known - set(_NOT_STORED):
        raise ValueError(f"a {kind.name} has no {', '.join(sorted(set(given) - known))}")
    if "actuators" in known:
        given["actuators"] = actuators_from_meta(meta["actuators"], nv) if "actuators" in meta else drives
    return kind(**given)
