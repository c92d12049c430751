"""The claims of a paper about sinusoidal motions, reproduced and judged:  python problems/paper/reproduce.py

S. Hussain, M. Saad, A. Baimagambetov, K. Saeed, "A Robust and Energy-Efficient Trajectory Planning Framework for High-Degree-of-
Freedom Robots", arXiv 2503.11716, 2025, plans 7-joint arms by sinusoidal trajectories with velocity scaling, among dynamic
obstacles, workspace boundaries and collision constraints, and observes four things in plots without numbers. We know its abstract
and introduction only: the problems here (panda.toml, xarm7.toml), the sinusoid and its scaling (motions.py) and what each
observation means in numbers (claims.py) are our own reading. There are no values to compare with.

Five motions of one duration are compared: the sinusoid, as a planner that knows neither dynamics nor obstacles makes it; a
quintic, which knows no more; the best of our sinusoids and of our splines by J = ∫(Στ² + λΣq̇²)dt; and the spline of least
mechanical energy Σ∫|τq̇|dt. Printed are what each costs, what it breaks, and the verdicts; --docs writes them into
docs/validation.md, --figures DIR draws.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from claims import Recording, Verdict, record, verdicts
from matplotlib.figure import Figure
from motions import CYCLES, SLOWEST, scaled, sinusoidal_stroke

import energyopt as eo
from energyopt.costs import MechanicalPower
from energyopt.io.pages import write_block
from energyopt.metrics import metrics
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.plots import look
from energyopt.verification import UNITS, excessive, objective, verify

HERE = Path(__file__).resolve().parent
PROBLEMS = ("panda", "xarm7")
HEURISTIC, QUINTIC = "sinusoid in the paper's style", "quintic (minimum jerk)"
SINUSOID, SPLINE, JOULES = "our sinusoid, least J", "our spline, least J", "our spline, least joules"
PAGE = HERE.parents[1] / "docs" / "validation.md"
BEGIN, END = "<!-- paper: begin -->", "<!-- paper: end -->"
LINES = {
    QUINTIC: {"color": look.BASELINE_COLOURS[2], "linewidth": 1.0, "linestyle": (0, (1, 1)), "zorder": 1},
    HEURISTIC: {"color": look.BASELINE_COLOURS[0], "linewidth": 1.5, "zorder": 2},
    SINUSOID: {"color": look.REPLAYED, "linewidth": 1.2, "zorder": 3},
    SPLINE: {"color": look.PLANNED, "linewidth": 1.2, "zorder": 4},
    JOULES: {"color": look.BASELINE_COLOURS[1], "linewidth": 1.2, "linestyle": (0, (3.5, 2)), "zorder": 5},
}
PANELS = {
    "power": "Mechanical power Σ|τq̇| [W]",
    "acceleration": "Acceleration ‖q̈‖ [rad/s²]",
    "energy": "Mechanical energy so far Σ∫|τq̇|dt [J]",
    "velocity": "Velocity ‖q̇‖ [rad/s]",
}


class _Curves(NamedTuple):
    t: np.ndarray
    power: np.ndarray
    acceleration: np.ndarray
    energy: np.ndarray
    velocity: np.ndarray


@dataclass(frozen=True, eq=False)
class Judged:
    """A stroke, what it costs and breaks, and what becomes of the claims when it is repeated under velocity scaling.

    Attributes:
        stroke: the motion. objective: J [N²·m²·s]. torque_squared: ∫Στ²dt. mechanical_J: Σ∫|τq̇|dt.
        broken: what it breaks, by name, with the amount and its unit. clearance: least distance from anything [m].
        seen: the recording of the repeated stroke. verdicts: four.
    """

    stroke: Trajectory
    objective: float
    torque_squared: float
    mechanical_J: float
    broken: dict[str, str]
    clearance: float
    seen: Recording
    verdicts: tuple[Verdict, ...]


def load(name: str) -> eo.Problem:
    """A problem of this folder."""
    return eo.load_problem(HERE / f"{name}.toml")


def strokes(problem: eo.Problem) -> dict[str, Trajectory]:
    """The motions, by name."""
    plan = lambda asked, way: eo.plan(asked, way).trajectory
    spline = plan(problem, eo.BSpline())
    joules = replace(problem, costs=[MechanicalPower()])
    return {
        HEURISTIC: sinusoidal_stroke(problem),
        QUINTIC: eo.baseline(problem, "quintic"),
        SINUSOID: plan(problem, eo.Sinusoid()),
        SPLINE: spline,
        JOULES: plan(joules, eo.BSpline()),
    }


def judge(problem: eo.Problem, stroke: Trajectory) -> Judged:
    """All there is to know of a stroke."""
    cost, found = metrics(problem, stroke), verify(problem, stroke)
    broken = {name: f"{found.amount[name]:.3g} {UNITS[name]}" for name in excessive(found)}
    seen = record(problem.robot, scaled(stroke))
    J = objective(problem, stroke)
    return Judged(stroke, J, cost.torque_squared, cost.mechanical_abs_J, broken, found.distance, seen, verdicts(seen))


def table(problem: eo.Problem, motions: dict[str, Judged]) -> str:
    """Markdown: a row a motion; in brackets what it saves of the first one's."""
    first = next(iter(motions.values()))
    head = ["J (saved)", "∫Στ²dt (saved)", "Σ∫\\|τq̇\\|dt (saved)", "breaks", *(verdict.claim for verdict in first.verdicts)]
    lines = [f"| {problem.robot.name}, {problem.duration:g} s | {' | '.join(head)} |", "|---|--:|--:|--:|---|---|---|---|---|"]
    for name, motion in motions.items():
        costs = (
            f"{getattr(motion, key):{form}}{unit}" + ("" if motion is first else f" ({_saving(motion, first, key):+.0f} %)")
            for key, form, unit in (("objective", ".0f", ""), ("torque_squared", ".0f", ""), ("mechanical_J", ".1f", " J"))
        )
        passed = ("pass" if verdict.passed else "**fail**" for verdict in motion.verdicts)
        lines.append(f"| {' | '.join([name, *costs, breaks(motion), *passed])} |")
    return "\n".join(lines)


def breaks(motion: Judged) -> str:
    """What a stroke breaks, in words. A start with an acceleration is the sinusoid's nature."""
    words = {"boundary": "rest at its ends (acceleration)", "clearance": f"clearance (hits by {-1e3 * motion.clearance:.0f} mm)"}
    return ", ".join(words.get(name, f"{name} ({amount})") for name, amount in motion.broken.items()) or "nothing"


def slowing(name: str, motion: Judged) -> str:
    """One line: what the last, slowest cycle takes beside the first."""
    seen = motion.seen
    time = seen.by_cycle(seen.rate * 0 + 1.0)
    change = lambda values, per=1.0: 100.0 * ((seen.by_cycle(values) / per)[-1] / (seen.by_cycle(values) / per)[0] - 1.0)
    return (
        f"{name}: from the first cycle to the last mean power {change(seen.power, time):+.0f} %, mechanical energy a cycle "
        f"{change(seen.power):+.0f} %, ∫Στ²dt a cycle {change(seen.torque_squared):+.0f} %"
    )


def figure_of_strokes(problem: eo.Problem, motions: dict[str, Judged]) -> Figure:
    """Power, acceleration, energy and velocity of one stroke of every motion, at the same duration; the quintic left out."""
    curves = {}
    for name, motion in motions.items():
        if name == QUINTIC:
            continue
        s = metrics(problem, motion.stroke).series
        curves[name] = _Curves(s.t, s.power, s.acceleration, s.cumulative_energy, s.velocity)
    return _four_panels(f"{problem.robot.name}: one stroke of {problem.duration:g} s", "All motions take the same time.", curves)


def figure_of_claims(problem: eo.Problem, motions: dict[str, Judged]) -> Figure:
    """The same of strokes repeated under velocity scaling."""
    curves = {}
    for name, motion in motions.items():
        s = motion.seen
        curves[name] = _Curves(s.t, s.power, s.acceleration, s.energy, s.velocity)
    title = f"{problem.robot.name}: strokes of {problem.duration:g} s, to and fro {CYCLES} times"
    return _four_panels(title, f"Velocity scaling: the rate falls evenly from 1 to {SLOWEST:g}.", curves)


def section(names: tuple[str, ...] = PROBLEMS, folder: Path | None = None) -> str:
    """Tables, lines on slowing and verdicts of the problems as Markdown; figures into ``folder``."""
    parts = []
    for name in names:
        problem = load(name)
        motions = {key: judge(problem, stroke) for key, stroke in strokes(problem).items()}
        lines = [f"- {slowing(key, motions[key])}" for key in (HEURISTIC, SPLINE)]
        parts += [table(problem, motions), "\n".join(lines)]
        for key, motion in motions.items():
            print(f"{name}, {key}", *(f"  {verdict}" for verdict in motion.verdicts), sep="\n", flush=True)
        if folder is not None:
            repeated = {key: motions[key] for key in (HEURISTIC, SPLINE)}
            _save(figure_of_strokes(problem, motions), folder / f"paper_{name}.png")
            _save(figure_of_claims(problem, repeated), folder / f"paper_{name}_claims.png")
    return "\n\n".join(parts)


def main() -> int:
    parser = argparse.ArgumentParser(description="the claims of arXiv 2503.11716, reproduced and judged")
    parser.add_argument("--figures", type=Path, metavar="DIR", help="draw paper_panda.png and so on there")
    parser.add_argument("--docs", action="store_true", help="write the tables into docs/validation.md")
    parsed = parser.parse_args()
    if parsed.figures is not None:
        parsed.figures.mkdir(parents=True, exist_ok=True)
    text = section(folder=parsed.figures)
    print(f"\n{text}")
    if parsed.docs:
        write_block(PAGE, (BEGIN, END), text)
    return 0


def _save(drawn: Figure, path: Path) -> None:
    drawn.savefig(path, dpi=1500 / drawn.get_figwidth(), metadata={"Software": None})


def _saving(motion: Judged, first: Judged, key: str) -> float:
    return 100.0 * (1.0 - getattr(motion, key) / getattr(first, key))


def _four_panels(title: str, remark: str, curves: dict[str, _Curves]) -> Figure:
    with look.style():
        drawn, panels = look.panels(2, 2, height=2.2, gap=0.42, labels=0.52, legend_rows=-(-len(curves) // 2))
        for ax, (field, words) in zip(panels.flat, PANELS.items(), strict=True):
            for name, curve in curves.items():
                ax.plot(curve.t, getattr(curve, field), label=name, **LINES[name])
            ax.set(title=words, xlim=(0.0, curve.t[-1]))
            ax.set_ylim(bottom=0.0)
        for ax in panels[1]:
            ax.set_xlabel("time [s]")
        height = drawn.get_figheight()
        drawn.text(0.15 / look.WIDTH, 1 - 0.10 / height, title, va="top", fontsize=11.5, fontweight="bold")
        drawn.text(0.15 / look.WIDTH, 1 - 0.33 / height, remark, va="top", fontsize=9.0, color=look.QUIET)
        look.legend(drawn, panels[0, 0], columns=2)
    return drawn


if __name__ == "__main__":
    sys.exit(main())
