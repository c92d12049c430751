"""The part of a report that says where the joules go: the account as a figure and as a table, baselines beside it."""

from __future__ import annotations

import numpy as np

from energyopt.energy import EnergyAccount
from energyopt.plans import Plan
from energyopt.plots.svg import inline_svg
from energyopt.plotting import plot_energy
from energyopt.report_parts import Cell, Markup, escape, percent, section, table
from energyopt.validation import ValidationReport


def energy_sections(plan: Plan, report: ValidationReport) -> list[Markup]:
    """One section: figure, table by joint and cause, and the electrical input of baselines where it is known."""
    account = report.account
    figure = inline_svg(plot_energy(plan), "energy", "Joules by joint and cause, in all, and the power over time.")
    parts = [Markup(figure), _joints(account)]
    if account.electrical_J is not None:
        parts.append(_baselines(account.electrical_J, report))
    return [section("Where the joules go", Markup("\n".join(escape(part) for part in parts)), _text(account))]


def _text(account: EnergyAccount) -> str:
    kinetic, potential = _number(account.kinetic_change_J), _number(account.potential_change_J)
    mechanical = (
        "Work of a joint by the terms of its torque. Kinetic and gravity joules of one joint tell who does the work: arms pass "
        f"energy from joint to joint. Their sums are the changes of kinetic ({kinetic} J) and potential energy ({potential} J), "
        f"which agree to {abs(account.balance_error_J):.0e} J."
    )
    if account.electrical_J is None:
        return f"{mechanical} {account.why[0].upper()}{account.why[1:]}."
    return (
        f"{mechanical} Behind the joints: losses in gears and windings, braking power that is burnt, brakes, and standby. All "
        f"causes add up to the electrical input to {abs(account.unaccounted_J):.0e} J. Braking gives {account.braking_J:.4g} J, "
        f"losses deducted, of which {account.returned_J:.4g} J come back."
    )


def _joints(account: EnergyAccount) -> Markup:
    power, total, whole = account.drive_power, account.supply_power, account.electrical_J
    if whole is None:
        power, total, whole = account.mechanical_power, account.total_mechanical_power, account.mechanical_J
    heads = [f"{cause.capitalize()}|n" for cause in account.joules]
    rows = []
    for k, joint in enumerate(account.joint_names):
        values = [float(joules[k]) for joules in account.joules.values()]
        rows.append([joint, *_cells([*values, sum(values), power.peak[k], power.least[k], power.mean[k]])])
    empty = [""] * len(account.joules)
    rows += [[cause, *empty, *_cells([value]), "", "", ""] for cause, value in account.common.items()]
    sums = [float(joules.sum()) for joules in account.joules.values()]
    rows.append(["all together", *_cells([*sums, whole, total.peak, total.least, total.mean])])
    return table(["Joint", *heads, "Sum [J]|n", "Peak [W]|n", "Least [W]|n", "Mean [W]|n"], rows)


def _baselines(electrical: float, report: ValidationReport) -> Markup:
    rows = [["this plan", *_cells([electrical]), ""]]
    if report.replay_electrical_J is not None:
        rows.append(["its replay", *_cells([report.replay_electrical_J]), ""])
    for name, other in report.baselines.items():
        if other.account is not None:
            saved = Cell(percent(other.electrical_saving_percent), "n")
            rows.append([name, *_cells([other.account.electrical_J]), saved])
    return table(["Motion of the same duration", "Electrical input [J]|n", "Saved|n"], rows)


def _cells(values: list[float]) -> list[Cell]:
    return [Cell(_number(value), "n") for value in values]


def _number(value: float) -> str:
    """Four digits; rounding shows as zero."""
    return f"{0.0 if np.abs(value) < 1e-9 else value:.4g}".replace("-", "−")
