"""`plot_robustness`: energies and torques of a plan over the arms that may be there, and how replays of it spread."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from energyopt.arguments import check_plan
from energyopt.errors import InputError
from energyopt.plots import look
from energyopt.plots.over_causes import short_names
from energyopt.problem_values import shown
from energyopt.robust import Robustness, Trials

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from energyopt.plans import Plan

BINS = 16
ROOM = 8
"""Letters of a joint name that need not be turned."""
BOX = 0.5
"""Width of a box, as a share of the room that a joint has."""


def plot_robustness(plan: Plan, found: Robustness, trials: Trials | None = None) -> Figure:
    """Draw what `energyopt.robustness` and `energyopt.replay_trials` found.

    Args:
        plan: the motion. found: its corners and draws. trials: its replays.

    Returns:
        The figure.

    Raises:
        InputError: something else than these.
    """
    check_plan("plot_robustness", plan)
    for name, value, kind in (("found", found, Robustness), ("trials", trials, Trials)):
        if not isinstance(value, kind) and not (name == "trials" and value is None):
            function = "robustness" if kind is Robustness else "replay_trials"
            raise InputError(f"plot_robustness: {name} is {shown(value)}: expected what energyopt.{function} gives")
    with look.style():
        rows = 1 if trials is None else 2
        figure, panels = look.panels(rows, 2, height=2.4, gap=0.95, labels=0.58, legend_rows=1, share=False)
        _draw_energy(panels[0, 0], found)
        _draw_torque(panels[0, 1], found)
        if trials is not None:
            _draw_tracking(panels[1, 0], trials)
            _draw_replayed(panels[1, 1], trials)
        look.heading(figure, plan, _remark(found, trials))
        look.legend(figure, panels[0, 0], columns=4)
    return figure


def _remark(found: Robustness, trials: Trials | None) -> str:
    holds = "Every" if found.holds else "NOT every"
    words = f"{str(found.uncertainty).capitalize()}. {holds} arm between the bounds holds the limits."
    if trials is None:
        return words
    troubled = f"{trials.diverged} diverged" if trials.watched.startswith("not") else (
        f"{trials.diverged} diverged, {trials.touching} touched something")  # fmt: skip
    return f"{words} {len(trials.trials)} replays: {troubled}."


def _draw_energy(ax: Axes, found: Robustness) -> None:
    """A histogram of the draws, with the arm as modelled and the corners as lines."""
    known = found.nominal.electrical_J is not None
    key, name = ("electrical_J", "Electrical energy") if known else ("mechanical_abs_J", "Mechanical energy Σ∫|τq̇|dt")
    draws = [getattr(result, key) for result in found.samples]
    _histogram(ax, np.array(draws), {"label": "draws"})
    for k, result in enumerate(found.corners):
        label = {"label": "corners of the bounds"} if k == 0 else {}
        ax.axvline(getattr(result, key), color=look.LIMIT, linewidth=1.0, linestyle=(0, (2, 2)), zorder=4, **label)
    ax.axvline(getattr(found.nominal, key), color=look.INK, linewidth=1.9, zorder=5, label="as modelled")
    ax.set(title=f"{name} of {len(draws)} draws", xlabel="[J]", ylabel="arms")


def _draw_torque(ax: Axes, found: Robustness) -> None:
    """Of every joint the share of its torque limit: draws as boxes, the worst corner above them."""
    names = short_names(found.joint_names, 14)
    at = np.arange(len(names))
    worst = np.max([result.torque_share for result in found.corners], axis=0)
    if found.samples:
        draws = np.array([result.torque_share for result in found.samples])
        ax.boxplot(
            draws, positions=at, widths=BOX, whis=(0, 100), patch_artist=True,
            manage_ticks=False, boxprops={"facecolor": look.PLANNED, "alpha": 0.45, "linewidth": 0}, zorder=3,
            medianprops={"color": look.PLANNED, "linewidth": 1.6}, whiskerprops={"color": look.PLANNED, "linewidth": 1.0},
            capprops={"linewidth": 0},
        )  # fmt: skip
    ax.plot(at, worst, linestyle="none", marker="_", color=look.LIMIT, markersize=13.0, markeredgewidth=2.0, zorder=4)
    ax.plot(at, found.nominal.torque_share, linestyle="none", marker="D", color=look.INK, markersize=3.6, zorder=5)
    ax.axhline(100.0, color=look.LIMIT, linewidth=1.0, zorder=2)
    ax.set(title="Largest torque, % of its limit", xlim=(-0.6, len(names) - 0.4), xticks=at, xticklabels=names)
    ax.set_ylim(0.0, max(108.0, 1.08 * float(worst.max())))
    ax.grid(visible=False, axis="x")
    if len(names) > 7 or max(map(len, names)) > ROOM:
        ax.set_xticks(at, names, rotation=30, ha="right", rotation_mode="anchor")


def _draw_tracking(ax: Axes, trials: Trials) -> None:
    _histogram(ax, 1e3 * trials.values("tracking_max"), {})
    spread = trials.distribution("tracking_max")
    if spread is not None:
        ax.axvline(1e3 * spread.median, color=look.REPLAYED, linewidth=1.6, zorder=5)
        words = f"median {1e3 * spread.median:.3g}, worst {1e3 * spread.largest:.3g}"
        ax.annotate(words, (1.0, 1.0), xycoords="axes fraction", xytext=(0, 7), textcoords="offset points", ha="right",
                    va="bottom", fontsize=8.0, color=look.QUIET)  # fmt: skip
    ax.set(title="Largest joint error in replays", xlabel="[mrad]", ylabel="replays")


def _draw_replayed(ax: Axes, trials: Trials) -> None:
    known = trials.nominal.electrical_J is not None
    key, name = ("electrical_J", "Electrical energy") if known else ("mechanical_abs_J", "Mechanical energy Σ∫|τq̇|dt")
    _histogram(ax, trials.values(key), {})
    ax.axvline(getattr(trials.nominal, key), color=look.INK, linewidth=1.9, zorder=5)
    ax.set(title=f"{name} in replays", xlabel="[J]", ylabel="replays")


def _histogram(ax: Axes, values: np.ndarray, label: dict[str, str]) -> None:
    """Bars of `BINS` equal widths; one bar where all values are the same."""
    if not values.size:
        ax.annotate("none went through", (0.5, 0.5), xycoords="axes fraction", ha="center", fontsize=9.0, color=look.QUIET)
        return
    low, high = float(values.min()), float(values.max())
    room = max(0.5 * (high - low) / BINS, 1e-9 * max(abs(high), 1.0), 0.005 * abs(high) if high - low < 1e-9 * abs(high) else 0.0)
    ax.hist(values, bins=BINS if high > low else 1, range=(low - room, high + room) if high <= low else (low, high),
            color=look.PLANNED, alpha=0.75, linewidth=0, zorder=3, **label)  # fmt: skip
    ax.yaxis.get_major_locator().set_params(integer=True)
