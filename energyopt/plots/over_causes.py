"""`plot_energy`: joules by joint and cause as stacked bars, the power over time, and what becomes of the whole."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from energyopt.actuators import Actuators
from energyopt.arguments import check_plan
from energyopt.energy import EnergyAccount, energy_account
from energyopt.plots import look

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from energyopt.plans import Plan

COLOURS = {
    "kinetic": look.KINETIC,
    "gravity": look.PLANNED,
    "viscous friction": look.VISCOUS,
    "coulomb friction": look.COULOMB,
    "gear": look.GEAR,
    "copper": look.REPLAYED,
    "burnt": look.LIMIT,
    "burnt on the bus": look.LIMIT,
    "brake": look.BASELINE_COLOURS[0],
    "standby": look.STANDBY,
}
"""Of every cause; mechanical ones blue and green, losses of the drives warm, what runs at all times grey."""
WIDTH = 0.62
"""Of a bar, as a share of the room that a joint or cause has."""
LEAST = 1e-4
"""Causes below this share of the largest have no entry in the legend."""


def plot_energy(plan: Plan, actuators: Actuators | None = None) -> Figure:
    """Draw where the joules of a plan go.

    Args:
        plan: the motion.
        actuators: the drives; None takes those of the plan's robot. Where they are unknown only mechanical work is drawn.

    Returns:
        The figure.

    Raises:
        InputError: no plan, or no drives.
    """
    check_plan("plot_energy", plan)
    account = energy_account(plan, actuators=actuators)
    with look.style():
        figure, panels = look.panels(3, 1, height=1.9, gap=0.72, labels=0.62, legend_rows=2, share=False)
        bars, steps, power = panels[:, 0]
        _draw_joints(bars, account)
        _draw_steps(steps, account)
        _draw_power(power, account)
        look.heading(figure, plan, _remark(account))
        look.legend(figure, bars, columns=7)
    return figure


def _remark(account: EnergyAccount) -> str:
    if account.electrical_J is None:
        return "Mechanical work by the terms of the torque. The drives are unknown: nothing is said of electrical joules."
    return (
        f"Electrical input {account.electrical_J:.4g} J; braking gives {account.braking_J:.3g} J, losses deducted, of which "
        f"{account.returned_J:.3g} J come back."
    )


def _draw_joints(ax: Axes, account: EnergyAccount) -> None:
    """One stacked bar a joint, what is delivered above zero and what is taken up below."""
    names = short_names(account.joint_names)
    top, bottom = np.zeros(len(names)), np.zeros(len(names))
    largest = max((np.abs(values).max() for values in account.joules.values()), default=0.0)
    for cause, values in account.joules.items():
        up, down = np.maximum(values, 0.0), np.minimum(values, 0.0)
        style = {"width": WIDTH, "color": COLOURS[cause], "linewidth": 0, "zorder": 3}
        label = {"label": cause} if np.abs(values).max() > LEAST * largest else {}
        ax.bar(range(len(names)), up, bottom=top, **style, **label)
        ax.bar(range(len(names)), down, bottom=bottom, **style)
        top, bottom = top + up, bottom + down
    sums = top + bottom
    ax.plot(range(len(names)), sums, "D", color=look.INK, markersize=4.0, markeredgecolor=look.PAPER, zorder=5, label="sum")
    ax.axhline(0.0, color=look.QUIET, linewidth=0.8, zorder=4)
    ax.set(title="Energy by joint and cause [J]", xlim=(-0.6, len(names) - 0.4), xticks=range(len(names)), xticklabels=names)
    ax.margins(y=0.1)
    ax.grid(visible=False, axis="x")
    ax.use_sticky_edges = False


def _draw_steps(ax: Axes, account: EnergyAccount) -> None:
    """From nothing to the whole, cause by cause, all joints together."""
    totals = {cause: value for cause, value in account.totals().items() if value or cause in ("kinetic", "gravity")}
    level = 0.0
    whole = account.mechanical_J if account.electrical_J is None else account.electrical_J
    name = "mechanical work" if account.electrical_J is None else "electrical input"
    reach = max(1e-9, *(abs(value) for value in totals.values()), abs(whole))
    for k, (cause, value) in enumerate([*totals.items(), (name, whole)]):
        last = cause == name
        base = 0.0 if last else level
        ax.bar(k, value, bottom=base, width=WIDTH, color=look.INK if last else COLOURS[cause], linewidth=0, zorder=3)
        words = f"{0.0 if abs(value) < 1e-6 * reach else value:.3g}".replace("-", "−")
        box = {"boxstyle": "square,pad=0.1", "facecolor": look.PAPER, "edgecolor": "none", "alpha": 0.8}
        place = {"xytext": (0, 3), "textcoords": "offset points", "ha": "center", "va": "bottom"}
        ax.annotate(words, (k, max(base, base + value)), fontsize=8.0, bbox=box, zorder=6, **place)
        level = base + value
        if not last:
            ax.plot((k, k + 1), (level, level), color=look.QUIET, linewidth=0.7, zorder=2)
    ax.axhline(0.0, color=look.QUIET, linewidth=0.8, zorder=4)
    labels = [*totals, name]
    ax.set(title="All joints together, cause by cause [J]", xlim=(-0.6, len(labels) - 0.4))
    ax.set_xticks(range(len(labels)), [label.replace(" ", "\n", 1) for label in labels])
    ax.margins(y=0.18)
    ax.grid(visible=False, axis="x")
    ax.use_sticky_edges = False


def _draw_power(ax: Axes, account: EnergyAccount) -> None:
    series = account.series
    curves = {"mechanical Στq̇": (series.mechanical, {"color": look.PLANNED, "linewidth": 1.6})}
    if series.electrical is not None and series.copper is not None:
        curves["electrical input"] = (series.electrical, {"color": look.INK, "linewidth": 1.9})
        curves["copper losses"] = (series.copper, {"color": look.REPLAYED, "linewidth": 1.4, "linestyle": (0, (3.5, 3.5))})
    for label, (values, line) in curves.items():
        ax.plot(*look.thinned(series.t, values), label=label, zorder=3, **line)
    ax.axhline(0.0, color=look.QUIET, linewidth=0.8, zorder=2)
    ax.set(title="Power over time [W]", xlabel="time [s]", xlim=(0.0, account.duration_s))
    ax.margins(y=0.12)
    if len(curves) > 1:
        ax.legend(loc="upper right", ncols=len(curves), bbox_to_anchor=(1.0, 1.14), borderaxespad=0.0, fontsize=8.0)


def short_names(names: tuple[str, ...], most: int = 15) -> list[str]:
    """Joint names without the words that all of them begin or end with, as they can stand below a bar."""
    start, end = _shared(names, "_/-"), _shared([name[::-1] for name in names], "_/-")
    cut = [name[start : len(name) - end] for name in names]
    room = max(6, most - max(0, len(names) - 7))
    return [look.fitted(short or name, room) for short, name in zip(cut, names, strict=True)]


def _shared(names: Sequence[str], marks: str) -> int:
    """Characters that all names begin with, up to and with the last mark among them."""
    first, last = min(names), max(names)  # what these two share, all share
    same = next((k for k, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), 0)
    return max(first.rfind(mark, 0, same) for mark in marks) + 1
