"""The common look of all figures: colours, line styles, fonts, margins, heading.

Colours are those of M. Okabe and K. Ito, "Color universal design" (2008), which most kinds of colour vision tell apart;
lines differ in dash and width too, so that the figures also read in grey.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib import font_manager
from matplotlib.figure import Figure

from energyopt.dynamics.body import joint_axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from energyopt.plans import Plan

PAPER, INK, QUIET, RULE = "#ffffff", "#1f2328", "#6a7079", "#d9dce1"
PLANNED, REPLAYED, LIMIT = "#0072b2", "#d55e00", "#96214c"
BASELINE_COLOURS = ("#8c939b", "#009e73", "#cc79a7", "#a6761d")
"""One a baseline, the first one grey: it is there to compare with, not to look at."""
KINETIC, VISCOUS, COULOMB, GEAR, STANDBY = "#56b4e9", "#009e74", "#7fcdb0", "#e69f00", "#c5cad1"
"""Causes of energy that have no colour of the above."""
MOST_POINTS = 1500
"""Points of a replayed curve, at most; more do not show."""
WIDTH = 9.6
"""Of every figure [inch]."""

LINES = {
    "planned": {"color": PLANNED, "linewidth": 1.9, "zorder": 3},
    "replayed in MuJoCo": {"color": REPLAYED, "linewidth": 1.4, "linestyle": (0, (3.5, 3.5)), "zorder": 4},
}
"""How the two curves of a plan are drawn, by their text in the legend."""

_STYLE = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "text.color": INK,
    "text.usetex": False,
    "axes.edgecolor": QUIET,
    "axes.facecolor": PAPER,
    "axes.labelcolor": INK,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titlepad": 6.0,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "figure.facecolor": PAPER,
    "figure.dpi": 100.0,
    "path.simplify": True,
}
_TICKS = {
    "length": 2.5,
    "width": 0.7,
    "color": QUIET,
    "labelcolor": INK,
    "labelsize": 8.0,
    "labelfontfamily": "DejaVu Sans",
    "grid_color": RULE,
    "grid_linewidth": 0.6,
    "grid_linestyle": "-",
}
"""Matplotlib makes ticks when it draws, from the settings at that time: these go to the axes themselves."""


@contextmanager
def style() -> Iterator[None]:
    """The look, for the length of a ``with`` block: Matplotlib's defaults and `_STYLE`; then the caller's settings again."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


def panels(
    rows: int, columns: int, height: float, gap: float, labels: float, legend_rows: int = 1, share: bool = True
) -> tuple[Figure, np.ndarray]:
    """A figure and its panels, placed in inches (much quicker than an automatic layout, and the same every time).

    Args:
        rows, columns: of panels. share: whether all have one time axis.
        height: of a panel; gap: between two rows; labels: room for labels left of each panel [inch].
        legend_rows: lines of the legend below.

    Returns:
        figure; panels, shape (rows, columns).
    """
    top, bottom, right = 0.78, 0.60 + 0.20 * legend_rows, 0.14
    total = top + rows * height + (rows - 1) * gap + bottom
    wide = (WIDTH - right) / columns - labels
    figure = Figure(figsize=(WIDTH, total))
    axes = figure.subplots(rows, columns, sharex=share, squeeze=False)
    figure.subplots_adjust(
        left=labels / WIDTH,
        right=1.0 - right / WIDTH,
        top=1.0 - top / total,
        bottom=bottom / total,
        hspace=gap / height,
        wspace=labels / wide,
    )
    for ax in axes.flat:
        ax.tick_params(which="major", **_TICKS)
        ax.grid(True)
    return figure, axes


def heading(figure: Figure, plan: Plan, remark: str, time: str = "") -> None:
    """Above the panels: what is shown, and a remark in quiet ink. ``time``: in place of the duration."""
    robot, height = plan.problem.robot, figure.get_figheight()
    parts = (fitted(plan.problem.name, 60), fitted(robot.name, 40), time or f"{plan.duration:.4g} s")
    title = " · ".join(part for part in parts if part)
    if not plan.solved:
        title += f" · {plan.status.value}"
    figure.text(0.15 / WIDTH, 1 - 0.10 / height, title, ha="left", va="top", fontsize=11.5, fontweight="bold")
    figure.text(0.15 / WIDTH, 1 - 0.33 / height, remark, ha="left", va="top", fontsize=9.0, color=QUIET)


def legend(figure: Figure, ax: Axes, columns: int = 2) -> None:
    """Below the panels: the curves of one of them."""
    handles, labels = ax.get_legend_handles_labels()
    place = {"loc": "lower center", "bbox_to_anchor": (0.5, 0.04 / figure.get_figheight())}
    figure.legend(handles, labels, ncols=min(columns, len(labels)), columnspacing=2.4, **place)


def fitted(name: str, most: int = 22) -> str:
    """A name as it can be drawn beside a panel: on one line, shortened, characters the font lacks as boxes, no mathematics."""
    known = _drawable_characters()
    name = "".join(c if ord(c) in known else "\N{WHITE SQUARE}" for c in " ".join(name.split()))
    return (name if len(name) <= most else f"{name[: most - 1]}…").replace("$", r"\$")


@cache
def _drawable_characters() -> frozenset[int]:
    path = font_manager.findfont("DejaVu Sans")
    return frozenset(font_manager.get_font(path).get_charmap())


def thinned(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """At most `MOST_POINTS` rows, first and last among them."""
    if len(t) <= MOST_POINTS:
        return t, values
    rows = np.unique(np.linspace(0, len(t) - 1, MOST_POINTS).astype(int))
    return t[rows], values[rows]


def joint_units(plan: Plan) -> list[tuple[str, str, str]]:
    """Units of position, velocity and torque, one entry a joint."""
    model = plan.problem.robot.model
    sliding = [joint_axis(model, i + 1)[0] == "prismatic" for i in range(model.nv)]
    return [("m", "m/s", "N") if slides else ("rad", "rad/s", "N·m") for slides in sliding]


def unit_words(units: list[tuple[str, str, str]], k: int) -> str:
    """The k-th unit of all joints: "rad", or "rad or m" where some slide."""
    return " or ".join(dict.fromkeys(unit[k] for unit in units))
