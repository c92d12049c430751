"""The figure of `scaling.py`: time above, memory below, one column an axis, both scales logarithmic."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from energyopt.plots.look import BASELINE_COLOURS, LIMIT, PLANNED, QUIET, RULE, WIDTH, style

GUIDE = {"color": BASELINE_COLOURS[0], "linewidth": 1.0, "linestyle": (0, (4, 3)), "zorder": 1}
GOALS = {"joints": {14: 0.150, 30: 2.0}}


def draw(results: dict, axes: dict[str, str], path: Path) -> None:
    """Write the figure: medians with their quartiles, the slope of a linear law, and the goals."""
    with style():
        figure = Figure(figsize=(WIDTH, 5.6))
        panels = figure.subplots(2, len(results), squeeze=False, height_ratios=[1.5, 1.0])
        for k, (axis, found) in enumerate(results.items()):
            points = [point for point in found["points"] if point["n"] > 0]
            if points:
                _times(panels[0, k], axis, points, found["exponents"])
                _memory(panels[1, k], points)
            panels[1, k].set_xlabel(axes[axis])
        panels[0, 0].set_ylabel("processor time of plan() [ms]")
        panels[1, 0].set_ylabel("memory of a first plan [MB]")
        for panel in panels.flat:
            _scales(panel)
        figure.text(0.01, 0.99, "What a plan costs as problems grow", va="top", fontsize=11.5, fontweight="bold")
        figure.text(0.01, 0.945, _remark(), va="top", fontsize=9.0, color=QUIET)
        figure.subplots_adjust(left=0.075, right=0.985, top=0.855, bottom=0.085, hspace=0.2, wspace=0.22)
        figure.savefig(path, dpi=160, metadata={"Software": None})


def _remark() -> str:
    return "medians and quartiles over random moves on fixed knots; dashed: growth in proportion; crosses: times to reach"


def _times(panel, axis: str, points: list[dict], exponents: dict) -> None:
    n = [point["n"] for point in points]
    spread = [[1e3 * point["seconds"]["plan"][key] for point in points] for key in ("median", "lower", "upper")]
    middle, low, high = spread
    reach = [[m - a for m, a in zip(middle, low, strict=True)], [b - m for m, b in zip(middle, high, strict=True)]]
    panel.errorbar(n, middle, yerr=reach, fmt="o", color=PLANNED, markersize=4.5, elinewidth=1.1, capsize=2.0, zorder=3)
    _guide(panel, n, middle)
    for joints, seconds in GOALS.get(axis, {}).items():
        panel.plot(joints, 1e3 * seconds, "x", color=LIMIT, markersize=7, markeredgewidth=1.6, zorder=4)
    exponent = exponents.get("plan")
    panel.set_title("" if exponent is None else f"time grows with power {exponent:.2f}")


def _memory(panel, points: list[dict]) -> None:
    some = [(point["n"], point["memory_MB"]["median"]) for point in points if point["memory_MB"]["median"] > 0]
    if some:
        n, memory = zip(*some, strict=True)
        panel.plot(n, memory, "o", color=PLANNED, markersize=4.5, zorder=3)
        _guide(panel, n, memory)


def _guide(panel, n, values) -> None:
    """A law in proportion, through the largest size."""
    if min(n) < max(n):
        panel.plot([min(n), max(n)], [values[-1] * min(n) / max(n), values[-1]], **GUIDE)


def _scales(panel) -> None:
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator

    panel.set_xscale("log")
    panel.set_yscale("log")
    places = sorted({float(place) for line in panel.lines for place in line.get_xdata()})
    panel.xaxis.set_major_locator(FixedLocator(_apart(places)))
    panel.xaxis.set_minor_locator(NullLocator())
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panel.yaxis.set_minor_formatter(NullFormatter())
    panel.tick_params(which="both", color=QUIET, labelsize=8.0)
    panel.grid(True, which="major", color=RULE, linewidth=0.6)


def _apart(ticks: list[float]) -> list[float]:
    """Ticks whose labels do not touch."""
    kept: list[float] = []
    for tick in ticks:
        if not kept or tick >= 1.14 * kept[-1]:
            kept.append(tick)
    return kept
