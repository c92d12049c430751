"""`plot_sweep`: what a motion costs against the time it is given, one panel a measure of energy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from energyopt.plots import look
from energyopt.sweep_text import known_measures

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from energyopt.sweeping import Sweep

_TITLES = {
    "objective": "Objective J",
    "torque_squared": "Squared torque ∫Στ²dt [N²m²s]",
    "mechanical_abs_J": "Mechanical energy Σ∫|τq̇|dt [J]",
    "electrical_J": "Electrical energy [J]",
}
TALL = 3.0
"""Ordinary motions that cost this many times the most of the plans are cut."""


def plot_sweep(sweep: Sweep) -> Figure:
    """Draw the energy–time curve of a problem with ordinary motions of the same durations, and the cheapest duration.

    Args:
        sweep: what `energyopt.sweep` gives.

    Returns:
        The figure; hollow marks are ordinary motions that break a limit.
    """
    names = known_measures(sweep)
    rows, columns = -(-len(names) // 2), min(2, len(names))
    with look.style():
        figure, panels = look.panels(rows, columns, height=2.2, gap=0.42, labels=0.52, legend_rows=1)
        for ax, name in zip(panels.flat, names, strict=False):
            _panel(ax, sweep, name)
        for ax in panels.flat[len(names) :]:
            _savings(ax, sweep)
        for ax in panels[-1]:
            ax.set_xlabel("duration [s]")
        remark = f"Every mark is a motion; hollow ones break a limit. Cheapest: {sweep.best.duration:.3g} s."
        look.heading(figure, sweep.best, remark, f"{sweep.durations[0]:.3g} to {sweep.durations[-1]:.3g} s")
        look.legend(figure, panels.flat[0], columns=4)
    return figure


def _savings(ax: Axes, sweep: Sweep) -> None:
    """By how much J of the plans is below that of ordinary motions."""
    ours, least = sweep.curve(), 0.0
    for kind, colour in zip(sweep.baseline_kinds, look.BASELINE_COLOURS, strict=False):
        saving = 100.0 * (1.0 - ours / sweep.baseline_curve(kind))
        ax.plot(sweep.durations, saving, "o-", color=colour, markersize=3.5, linewidth=1.3, label=kind)
        least = min(least, np.nanmin(saving))
    ax.axvline(sweep.best.duration, color=look.QUIET, linewidth=1.0, linestyle=":", zorder=1)
    ax.set(title="Saving in J against the same duration [%]", ylim=(1.08 * least, 100.0))


def _panel(ax: Axes, sweep: Sweep, name: str) -> None:
    durations, ours = sweep.durations, sweep.curve(name)
    ax.plot(durations, ours, marker="o", markersize=3.5, label="planned", **look.LINES["planned"])
    for kind, colour in zip(sweep.baseline_kinds, look.BASELINE_COLOURS, strict=False):
        theirs = sweep.baseline_curve(kind, name)
        holds = sweep.baseline_curve(kind, "holds") > 0
        ax.plot(durations, theirs, color=colour, linewidth=1.3, zorder=2, label=kind)
        for mask, face in ((holds, colour), (~holds, "white")):
            ax.plot(durations[mask], theirs[mask], "o", markersize=3.5, color=colour, markerfacecolor=face, zorder=3)
    ax.axvline(sweep.best.duration, color=look.QUIET, linewidth=1.0, linestyle=":", zorder=1, label="cheapest J")
    top = np.nanmax(ours)
    everything = np.concatenate([ours, *(sweep.baseline_curve(kind, name) for kind in sweep.baseline_kinds)])
    ax.set(title=_TITLES[name], xlim=(durations[0], durations[-1]))
    ax.set_ylim(0.0, 1.08 * min(np.nanmax(everything), TALL * top))
