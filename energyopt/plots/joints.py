"""`plot_joints`: position, velocity and torque of every joint over time between their limits, one row a joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from energyopt.arguments import check_log, check_plan
from energyopt.plots import look

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from energyopt.plans import Plan
    from energyopt.simulation.log import ReplayLog

OFF_SCALE = 20.0
"""A limit this many times larger than what it limits is stated in words; drawn, it would flatten the curve."""


@dataclass(frozen=True, eq=False)
class _Column:
    """One quantity of all joints: curves by legend text (times, values of shape (N, nv)), limits (nv,), tightest place.

    ``tightest`` is (joint index, time), None where nothing is limited.
    """

    title: str
    curves: dict[str, tuple[np.ndarray, np.ndarray]]
    lower: np.ndarray
    upper: np.ndarray
    tightest: tuple[int, float] | None


def plot_joints(plan: Plan, log: ReplayLog | None = None) -> Figure:
    """Draw every joint of a plan against its limits.

    Limits are lines, what lies beyond them is shaded; a ring marks where each kind of limit is tightest. A limit far away
    from all that a joint does is stated in words, so that the curve keeps its shape.

    Args:
        plan: the motion.
        log: its replay.

    Returns:
        The figure.

    Raises:
        InputError: no plan, or a log of another arm.
    """
    check_plan("plot_joints", plan)
    check_log(plan, log)
    robot, units = plan.problem.robot, look.joint_units(plan)
    columns = _columns(plan, log)
    with look.style():
        figure, panels = look.panels(robot.nv, 3, height=0.98, gap=0.17, labels=0.66)
        for k, column in enumerate(columns):
            for i, ax in enumerate(panels[:, k]):
                _draw(ax, column, i)
            panels[0, k].set_title(f"{column.title} [{look.unit_words(units, k)}]")
            panels[-1, k].set(xlabel="time [s]", xlim=(0.0, plan.duration))
        mixed = len(set(units)) > 1
        for name, unit, ax in zip(robot.joint_names, units, panels[:, 0], strict=True):
            ax.set_ylabel(look.fitted(name, 18) + (f"\n[{', '.join(unit)}]" if mixed else ""), fontsize=8.0)
            ax.yaxis.set_label_coords(-0.47 / (ax.get_position().width * look.WIDTH), 0.5)
        feedback = "" if log is None else " Replayed torques include the feedback."
        look.heading(figure, plan, f"Red lines are limits; a ring is the tightest place of each kind.{feedback}")
        look.legend(figure, panels[0, 0])
    return figure


def _columns(plan: Plan, log: ReplayLog | None) -> list[_Column]:
    limits, motion, violations = plan.problem.limits, plan.trajectory, plan.violations
    t = np.union1d(np.linspace(0.0, plan.duration, 600), motion.breaks)
    names = plan.problem.robot.joint_names
    parts = (
        ("Position q", "position", limits.lower, limits.upper, motion(t), "q"),
        ("Velocity q̇", "velocity", -limits.velocity, limits.velocity, motion(t, 1), "v"),
        ("Torque τ", "torque_percent", -limits.torque, limits.torque, plan.torque(t), "tau"),
    )
    columns = []
    for title, name, lower, upper, planned, field in parts:
        curves = {"planned": (t, planned)}
        if log is not None:
            curves["replayed in MuJoCo"] = look.thinned(log.t, getattr(log, field))
        joint, time = violations.worst.get(name, ("", 0.0)) if name in violations.margin else ("", 0.0)
        columns.append(_Column(title, curves, lower, upper, (names.index(joint), time) if joint in names else None))
    return columns


def _draw(ax: Axes, column: _Column, i: int) -> None:
    """One joint's curves between its limits."""
    for label, (t, values) in column.curves.items():
        ax.plot(t, values[:, i], label=label, **look.LINES[label])
    lower, upper = float(column.lower[i]), float(column.upper[i])
    t, planned = column.curves["planned"][0], column.curves["planned"][1][:, i]
    if _drawable(planned, lower, upper):
        _draw_limits(ax, planned, lower, upper)
    else:
        ax.margins(y=0.25)
        ax.yaxis.set_major_locator(MaxNLocator(4, prune="both"))
        if np.isfinite([lower, upper]).all():
            text = f"limits ±{upper:.4g}" if lower == -upper else f"limits {lower:.4g} to {upper:.4g}"
            ax.annotate(text, (0.99, 0.97), xycoords="axes fraction", ha="right", va="top", fontsize=7.0, color=look.LIMIT)
    if column.tightest is not None and column.tightest[0] == i:
        at = column.tightest[1]
        ring = {"markersize": 7.0, "markerfacecolor": "none", "markeredgecolor": look.INK, "markeredgewidth": 1.1}
        ax.plot([at], [np.interp(at, t, planned)], "o", zorder=5, clip_on=False, **ring)


def _draw_limits(ax: Axes, planned: np.ndarray, lower: float, upper: float) -> None:
    """Lines at the limits, shades beyond; the ticks are the limits themselves, and zero or the middle."""
    edge = 0.10 * (upper - lower)
    # What breaks a limit stays in sight.
    low, high = min(lower, planned.min()) - edge, max(upper, planned.max()) + edge
    for limit, beyond in ((lower, low), (upper, high)):
        ax.axhspan(limit, beyond, color=look.LIMIT, alpha=0.12, linewidth=0, zorder=0)
        ax.axhline(limit, color=look.LIMIT, linewidth=0.9, zorder=1)
    centre = 0.0 if lower + 0.25 * (upper - lower) < 0 < upper - 0.25 * (upper - lower) else 0.5 * (lower + upper)
    ticks = [lower, centre, upper]
    ax.set_yticks(ticks, [_tick(value, upper - lower) for value in ticks])
    ax.set_ylim(low, high)


def _tick(value: float, span: float) -> str:
    """The value to about a hundredth of the span, with a minus sign of the length of a plus."""
    digits = max(0, 2 - int(np.floor(np.log10(span))))
    text = f"{value:.{digits}f}"
    return (text.rstrip("0").rstrip(".") if digits else text).replace("-", "−")


def _drawable(values: np.ndarray, lower: float, upper: float) -> bool:
    """Whether both limits can be drawn without flattening the curve to a line."""
    if not np.isfinite([lower, upper, values.sum()]).all():
        return False
    return 0.5 * (upper - lower) <= OFF_SCALE * max(float(np.abs(values - 0.5 * (lower + upper)).max()), 1e-12)
