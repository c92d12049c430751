"""`plot_clearance`: how far the arm stays from each obstacle, and from itself, over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from energyopt.arguments import check_log, check_plan
from energyopt.avoidance import arm_obstacles, checked_pairs
from energyopt.errors import InputError
from energyopt.geometry.exact import CollisionScene, obstacle_names
from energyopt.plots import look

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from energyopt.plans import Plan
    from energyopt.simulation.log import ReplayLog

SAMPLES = 241
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#a6761d", "#56b4e9")
"""Of the nearest ones, one each; all others are drawn in grey."""
ITSELF = "the arm itself"
LEAST_TOP, TIMES_LEAST = 0.25, 4.0
"""The scale ends at this distance [m], or at so many times the least one where that is more: what is far does not matter."""


def plot_clearance(plan: Plan, log: ReplayLog | None = None) -> Figure:
    """Draw the exact distance between the arm and everything it has to keep clear of.

    Args:
        plan: the motion.
        log: its replay; contacts that MuJoCo found are marked below.

    Returns:
        The figure.

    Raises:
        InputError: no plan, a log of another arm, or nothing to keep clear of.
    """
    check_plan("plot_clearance", plan)
    check_log(plan, log)
    t = np.linspace(0.0, plan.duration, SAMPLES)
    curves = _curves(plan, t)
    if not curves:
        raise InputError("plot_clearance: nothing to keep clear of; expected obstacles, a workspace, or links with geometry")
    names = sorted(curves, key=lambda name: curves[name][0].min())
    low, top = _scale(plan, {name: distance for name, (distance, _) in curves.items()})
    seen = [name for name in names if curves[name][0].min() < top]
    with look.style():
        entries = min(len(seen), len(COLOURS) + 1) + bool(log is not None and log.touches)
        figure, panels = look.panels(1, 1, height=3.0, gap=0.0, labels=0.62, legend_rows=-(-entries // 3))
        ax = panels[0, 0]
        ax.set(title="Distance [mm]", xlabel="time [s]", xlim=(0.0, plan.duration), ylim=(1e3 * low, 1e3 * top))
        _draw(ax, t, curves, seen)
        _mark_asked(ax, plan)
        _mark_least(ax, t, *curves[names[0]], names[0])
        _mark_contacts(ax, log)
        _say_far(ax, [name for name in names if name not in seen])
        look.heading(figure, plan, _remark(log))
        look.legend(figure, ax, columns=3)
    return figure


def _curves(plan: Plan, t: np.ndarray) -> dict[str, tuple[np.ndarray, list[str]]]:
    """By obstacle, the least distance [m] at each time and the link that has it."""
    problem, q = plan.problem, plan.trajectory(t)
    obstacles, pairs = arm_obstacles(problem), checked_pairs(problem)
    scenes = {
        name: CollisionScene(problem.robot, [obstacle], (), problem.attached)
        for name, obstacle in zip(obstacle_names(obstacles), obstacles, strict=True)
    }
    if pairs:
        scenes[ITSELF] = CollisionScene(problem.robot, (), pairs, problem.attached)
    curves = {}
    for name, scene in scenes.items():
        if scene.pairs:
            found = scene.closest(q, t)
            who = [c.first if name != ITSELF else f"{c.first} – {c.second}" for c in found]
            curves[name] = (np.array([c.distance for c in found]), who)
    return curves


def _scale(plan: Plan, distances: dict[str, np.ndarray]) -> tuple[float, float]:
    """Ends of the vertical axis [m]."""
    least = min(float(d.min()) for d in distances.values())
    top = max(LEAST_TOP, TIMES_LEAST * least, 1.3 * plan.problem.clearance)
    top = min(top, max(1.05 * max(float(d.max()) for d in distances.values()), 1.3 * plan.problem.clearance))
    return min(1.25 * least, -0.06 * top), top


def _draw(ax: Axes, t: np.ndarray, curves: dict, names: list[str]) -> None:
    """The nearest in colour, the others in grey with one entry in the legend."""
    for k, name in enumerate(names):
        line = {"color": look.BASELINE_COLOURS[0], "linewidth": 0.9, "zorder": 2, "alpha": 0.7}
        label = f"{len(names) - len(COLOURS)} more" if k == len(COLOURS) else None
        if k < len(COLOURS):
            line = {"color": COLOURS[k], "linewidth": 2.0 if k == 0 else 1.4, "zorder": 4 - 0.1 * k}
            label = name if name == ITSELF else look.fitted(name, 30)
        ax.plot(t, 1e3 * curves[name][0], label=label, **line)


def _mark_asked(ax: Axes, plan: Plan) -> None:
    """What is not allowed, shaded: too close, and darker, inside of something."""
    asked, low = 1e3 * plan.problem.clearance, ax.get_ylim()[0]
    for height, words, above in ((0.0, "contact", False), (asked, f"clearance asked for: {asked:g} mm", True)):
        if height or not above:
            ax.axhspan(low, height, color=look.LIMIT, alpha=0.10, linewidth=0, zorder=1)
            ax.axhline(height, color=look.LIMIT, linewidth=1.0, zorder=2.5)
            ax.annotate(
                words, (1.0, height), xycoords=("axes fraction", "data"), xytext=(-4, 2 if above else -2), zorder=6,
                textcoords="offset points", ha="right", va="bottom" if above else "top", fontsize=8.0, color=look.LIMIT,
            )  # fmt: skip


def _mark_least(ax: Axes, t: np.ndarray, distance: np.ndarray, who: list[str], name: str) -> None:
    k = int(np.argmin(distance))
    against = "" if name == ITSELF else f" – {look.fitted(name, 30)}"
    ax.plot(t[k], 1e3 * distance[k], "o", color=COLOURS[0], markersize=6.0, markeredgecolor=look.PAPER, zorder=6)
    value = f"{1e3 * distance[k]:.1f}".replace("-", "−")
    words = f"{value} mm at {t[k]:.2f} s\n{look.fitted(who[k], 60)}{against}"
    box = {"boxstyle": "round,pad=0.25", "facecolor": look.PAPER, "edgecolor": "none", "alpha": 0.85}
    side = "right" if t[k] > 0.7 * t[-1] else "left" if t[k] < 0.3 * t[-1] else "center"
    below = 1e3 * distance[k] > 0.75 * ax.get_ylim()[1]
    ax.annotate(
        words, (t[k], 1e3 * max(distance[k], 0.0)), xytext=({"right": -8, "left": 8}.get(side, 0), -14 if below else 14), ha=side,
        va="top" if below else "bottom", textcoords="offset points", fontsize=8.5, color=look.INK, zorder=7, bbox=box,
    )  # fmt: skip


def _mark_contacts(ax: Axes, log: ReplayLog | None) -> None:
    for k, touch in enumerate(() if log is None else log.touches):
        span = (touch.begin, max(touch.end, touch.begin + 0.002 * log.t[-1]))
        label = {"label": "contact in the replay"} if k == 0 else {}
        ax.plot(span, [0.0, 0.0], color=look.LIMIT, linewidth=4.0, solid_capstyle="butt", zorder=5, **label)


def _say_far(ax: Axes, names: list[str]) -> None:
    """Above the panel: what stays beyond its upper edge."""
    if names:
        more = f" and {len(names) - 4} more" if len(names) > 4 else ""
        listed = ", ".join(look.fitted(name, 30) for name in names[:4]) + more
        place = {"xycoords": "axes fraction", "xytext": (0, 7), "textcoords": "offset points", "ha": "right", "va": "bottom"}
        ax.annotate(f"always farther: {listed}", (1.0, 1.0), fontsize=8.0, color=look.QUIET, **place)


def _remark(log: ReplayLog | None) -> str:
    exact = "Exact distances between the solids of the arm and each obstacle."
    if log is None or log.contacts is None:
        return exact
    return f"{exact} Replayed in MuJoCo: {len(log.touches) or 'no'} contact{'s' if len(log.touches) > 1 else ''}."
