"""A sweep as a table, and as rows for files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from energyopt.following import LEFT_OUT
from energyopt.plans import Status

if TYPE_CHECKING:
    from energyopt.sweeping import Sweep, SweepPoint

MEASURES = {
    "objective": "J",
    "torque_squared": "∫Στ² [N²m²s]",
    "mechanical_abs_J": "Σ∫|τq̇| [J]",
    "electrical_J": "electrical [J]",
}
"""Measures of energy and their headings."""


def known_measures(sweep: Sweep) -> list[str]:
    """The measures that are known for some duration, in the order of `MEASURES`."""
    return [name for name in MEASURES if np.any(np.isfinite(sweep.curve(name)))]


def sweep_table(sweep: Sweep) -> str:
    """One line a duration: every measure, and the saving in J against ordinary motions of the same duration."""
    names, kinds = known_measures(sweep), sweep.baseline_kinds
    heads = ["T [s]", *(MEASURES[name] for name in names), *(f"J below {kind}" for kind in kinds)]
    rows = [[f"{point.duration:.4g}", *_cells(point, names, kinds)] for point in sweep.points]
    widths = [max(len(row[k]) for row in [heads, *rows] if len(row) == len(heads)) for k in range(len(heads))]
    lines = ["  ".join(text.rjust(width) for text, width in zip(heads, widths, strict=True))]
    for row in rows:
        whole = len(row) == len(heads)
        cells = zip(row, widths, strict=True) if whole else [(row[0], widths[0])]
        lines.append("  ".join(text.rjust(width) for text, width in cells) + ("" if whole else f"  {row[1]}"))
    if any("✗" in cell for row in rows for cell in row[1:]):
        lines.append("✗ this motion breaks a limit that the plan holds")
    return "\n".join([*lines, f"cheapest: {sweep.best.duration:.4g} s, J = {sweep.best.objective:.6g}{_at_end(sweep)}"])


def sweep_rows(sweep: Sweep) -> list[dict[str, Any]]:
    """One flat dictionary a duration; None where something is not known."""
    names, rows = known_measures(sweep), []
    for point in sweep.points:
        row: dict[str, Any] = {"duration_s": point.duration, "status": _status(point)}
        row |= {name: point.energy.get(name) for name in names}
        for kind in sweep.baseline_kinds:
            measured = point.baselines.get(kind, {})
            row |= {f"{kind}_{name}": measured.get(name) for name in names}
            row[f"{kind}_holds"] = bool(measured["holds"]) if measured else None
        rows.append(row)
    return rows


def _cells(point: SweepPoint, names: list[str], kinds: list[str]) -> list[str]:
    if not point.solved:
        return [f"{_status(point)}: {point.why}"]
    cells = [f"{point.energy[name]:.5g}" for name in names]
    for kind in kinds:
        theirs = point.baselines[kind]
        saving = 100.0 * (1.0 - point.energy["objective"] / theirs["objective"])
        cells.append(f"{saving:.1f} %" + ("  " if theirs["holds"] else " ✗"))
    return cells


def _status(point: SweepPoint) -> str:
    if point.plan is None:
        return Status.INTERRUPTED.value if point.why == LEFT_OUT else "IMPOSSIBLE"
    return point.plan.status.value


def _at_end(sweep: Sweep) -> str:
    """A remark where the cheapest duration is the first or the last."""
    if np.isclose(sweep.best.duration, sweep.durations[-1]):
        return ", the longest of these: a longer one may be cheaper still"
    solved = [point.duration for point in sweep.points if point.solved]
    return ", the shortest that is possible here" if np.isclose(sweep.best.duration, solved[0]) else ""
