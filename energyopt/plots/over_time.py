"""`plot_metrics`: power, acceleration, energy so far and velocity over time, 2×2 panels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from energyopt.arguments import check_log, check_plan
from energyopt.baselines import baseline
from energyopt.costs import formula
from energyopt.errors import InputError
from energyopt.metrics import MetricSeries, metrics, metrics_of_log
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.plots import look
from energyopt.problem_values import shown
from energyopt.verification import objective

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from energyopt.plans import Plan
    from energyopt.simulation.log import ReplayLog

SPIKE = 4.0
"""A peak this many times above what a curve stays under for `USUAL` of the time is cut and stated in words."""
USUAL = 0.97

_PANELS = (
    ("power", "Mechanical power Σ|τq̇|", "W"),
    ("acceleration", "Acceleration ‖q̈‖", "{angle}/s²"),
    ("cumulative_energy", "Mechanical energy so far Σ∫|τq̇|dt", "J"),
    ("velocity", "Velocity ‖q̇‖", "{angle}/s"),
)
_Curves = dict[str, tuple[MetricSeries, dict]]


def plot_metrics(plan: Plan, log: ReplayLog | None = None, baselines: Sequence[str] = ("quintic",)) -> Figure:
    """Draw the motion of a plan as planned, as replayed, and beside ordinary motions of the same duration.

    Args:
        plan: the motion.
        log: its replay.
        baselines: kinds of `energyopt.baseline` to compare with, four at most; () for none.

    Returns:
        The figure.

    Raises:
        InputError: no plan, a log of another arm, an unknown baseline, or too many of them.
    """
    check_plan("plot_metrics", plan)
    check_log(plan, log)
    others = _ordinary_motions(plan, baselines)
    curves = _curves(plan, log, others)
    angle = look.unit_words(look.joint_units(plan), 0)
    with look.style():
        figure, panels = look.panels(2, 2, height=2.2, gap=0.42, labels=0.52, legend_rows=-(-len(curves) // 3))
        for ax, (field, title, unit) in zip(panels.flat, _PANELS, strict=True):
            for label, (series, line) in curves.items():
                ax.plot(*look.thinned(series.t, getattr(series, field)), label=label, **line)
            ax.set(title=f"{title} [{unit.format(angle=angle)}]", xlim=(0.0, plan.duration))
            _scale(ax, [(series.t, getattr(series, field)) for series, _ in curves.values()], unit.format(angle=angle))
        for ax in panels[1]:
            ax.set_xlabel("time [s]")
        look.heading(figure, plan, f"Minimised is the objective J = {_minimised(plan)}. All motions take the same time.")
        look.legend(figure, panels[0, 0], columns=3)
    return figure


def _minimised(plan: Plan) -> str:
    costs = plan.problem.costs
    return "∫(Σwτ² + Σλq̇²)dt" if costs is None else formula(costs)


def _ordinary_motions(plan: Plan, baselines: Sequence[str]) -> dict[str, Trajectory]:
    if not isinstance(baselines, Sequence):
        raise InputError(f"baselines is {shown(baselines)}: expected a list of kinds, such as ('quintic',)")
    kinds = (baselines,) if isinstance(baselines, str) else tuple(baselines)
    if len(kinds) > len(look.BASELINE_COLOURS):
        raise InputError(f"baselines: expected {len(look.BASELINE_COLOURS)} kinds at most, got {len(kinds)}")
    return {kind: baseline(plan.problem, kind, goal=plan.trajectory(plan.duration)) for kind in kinds}


def _curves(plan: Plan, log: ReplayLog | None, others: dict[str, Trajectory]) -> _Curves:
    """Series and line style, by legend text."""
    ours = metrics(plan.problem, plan.trajectory).series
    curves = {f"planned: {_totals(plan.objective, ours)}": (ours, look.LINES["planned"])}
    if log is not None:
        series = metrics_of_log(log).series
        curves[f"replayed in MuJoCo: {_totals(None, series)}"] = (series, look.LINES["replayed in MuJoCo"])
    for (kind, motion), colour in zip(others.items(), look.BASELINE_COLOURS, strict=False):
        series = metrics(plan.problem, motion).series
        line = {"color": colour, "linewidth": 1.3, "zorder": 2}
        curves[f"{kind}: {_totals(objective(plan.problem, motion), series)}"] = (series, line)
    return curves


def _totals(cost: float | None, series: MetricSeries) -> str:
    energy = f"energy {_three_digits(float(series.cumulative_energy[-1]))} J"
    return energy if cost is None else f"objective {cost:.4g}, {energy}"


def _scale(ax: Axes, curves: list[tuple[np.ndarray, np.ndarray]], unit: str) -> None:
    """From zero to a little above the curves; short spikes are cut, and a note says how high they are."""
    peaks = [np.max(values[np.isfinite(values)], initial=0.0) for _, values in curves]
    usual = max((_usual(t, values) for t, values in curves), default=0.0)
    peak = max(peaks, default=0.0)
    if not 0 < peak <= SPIKE * usual:
        top = 2.0 * usual or 1.0
        if peak > top:
            t, values = curves[int(np.argmax(peaks))]
            at = t[int(np.nanargmax(values))]
            ax.annotate(
                f"↑ peak {_three_digits(peak)} {unit} at {at:.2f} s", (0.5, 0.97), xycoords="axes fraction",
                ha="center", va="top", fontsize=8.0, color=look.QUIET,
            )  # fmt: skip
        ax.set_ylim(0.0, top)
    else:
        ax.set_ylim(0.0, 1.08 * peak)


def _usual(t: np.ndarray, values: np.ndarray) -> float:
    """The value under which a curve stays for the share `USUAL` of the time."""
    good = np.isfinite(values)
    order = np.argsort(values[good])
    weight = np.gradient(t)[good][order]
    share = np.cumsum(weight) / max(weight.sum(), 1e-300)
    return float(values[good][order][np.searchsorted(share, USUAL)]) if good.any() else 0.0


def _three_digits(value: float) -> str:
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"
