"""An account as a table for people and as plain numbers for files."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from energyopt.energy.account import EnergyAccount, PowerRange

HEADS = {"viscous friction": "viscous", "coulomb friction": "coulomb"}
WIDTH = 10
SHOWN = ("kinetic", "gravity")
"""Causes that are named where they are zero too."""


def account_table(account: EnergyAccount) -> str:
    """One row a joint, one column a cause, and what it adds up to [J]; powers beside [W]."""
    causes = list(account.joules)
    drive = account.electrical_J is not None
    power, total = (account.drive_power, account.supply_power) if drive else (
        account.mechanical_power, account.total_mechanical_power)  # fmt: skip
    name = max(16, *(len(joint) for joint in account.joint_names))
    head = [f"{'energy [J]':{name}}", *(f"{HEADS.get(cause, cause):>{WIDTH}}" for cause in causes)]
    lines = ["".join([*head, f"{'sum':>{WIDTH}}", f"{'peak W':>{WIDTH}}", f"{'least W':>{WIDTH}}", f"{'mean W':>{WIDTH}}"])]
    for k, joint in enumerate(account.joint_names):
        values = [account.joules[cause][k] for cause in causes]
        watts = [power.peak[k], power.least[k], power.mean[k]]
        lines.append(f"{joint:{name}}" + _row([*values, sum(values), *watts]))
    blank = " " * (WIDTH * len(causes))
    lines += [f"{label:{name}}{blank}{value:{WIDTH}.4g}" for label, value in account.common.items()]
    sums = [account.joules[cause].sum() for cause in causes]
    whole = account.electrical_J if drive else account.mechanical_J
    lines.append(f"{'all together':{name}}" + _row([*sums, whole, total.peak, total.least, total.mean]))
    return "\n".join([*lines, "", *_remarks(account)])


def _row(values: list[float]) -> str:
    return "".join(f"{_clean(value):{WIDTH}.4g}" for value in values)


def _clean(value: float) -> float:
    """Rounding shows as zero."""
    return 0.0 if abs(value) < 1e-9 else value


def _remarks(account: EnergyAccount) -> list[str]:
    kinetic, potential = _clean(account.kinetic_change_J), _clean(account.potential_change_J)
    lines = [
        f"mechanical work {account.mechanical_J:.5g} J = kinetic {kinetic:.4g} + potential {potential:.4g} + friction "
        f"{account.friction_J:.4g} J (differs by {abs(account.balance_error_J):.1e} J)"
    ]
    if account.electrical_J is None:
        return [*lines, account.why]
    lines.append(f"electrical input {account.electrical_J:.5g} J (its causes differ by {abs(account.unaccounted_J):.1e} J)")
    lines.append(f"braking gives {account.braking_J:.4g} J, losses deducted, of which {account.returned_J:.4g} J come back")
    return lines


def account_dict(account: EnergyAccount) -> dict[str, Any]:
    """Plain numbers; lists follow ``joint_names``."""
    return {
        "joint_names": list(account.joint_names),
        "joules": {cause: values.tolist() for cause, values in account.joules.items()},
        "common": dict(account.common),
        "totals": account.totals(),
        "mechanical_J": account.mechanical_J,
        "kinetic_change_J": account.kinetic_change_J,
        "potential_change_J": account.potential_change_J,
        "friction_J": account.friction_J,
        "balance_error_J": account.balance_error_J,
        "electrical_J": account.electrical_J,
        "unaccounted_J": account.unaccounted_J,
        "why": account.why or None,
        "braking_J": account.braking_J,
        "returned_J": account.returned_J,
        "power_W": {
            "mechanical": _power(account.mechanical_power),
            "mechanical_total": _power(account.total_mechanical_power),
            "drive": _power(account.drive_power),
            "supply": _power(account.supply_power),
        },
    }


def _power(power: PowerRange | None) -> dict[str, Any] | None:
    return None if power is None else {key: np.asarray(value).tolist() for key, value in asdict(power).items()}


def cause_lines(account: EnergyAccount, width: int = 100) -> list[str]:
    """Joules by cause, all joints together, in lines that are not long; the reason where there is nothing electrical."""
    whole = f"mechanical work {account.mechanical_J:.4g} J"
    if account.electrical_J is not None:
        whole = f"electrical {account.electrical_J:.4g} J"
    parts = [f"{cause} {_clean(value):.4g}" for cause, value in account.totals().items() if cause in SHOWN or value]
    lines = [f"{whole} ="]
    for k, part in enumerate(parts):
        word = f" {part}" + (" +" if k + 1 < len(parts) else "")
        if len(lines[-1]) + len(word) > width:
            lines.append("   ")
        lines[-1] += word
    return [*lines, account.why] if account.why else lines
