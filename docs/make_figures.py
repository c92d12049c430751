"""Make the figures and the table of savings that README.md and docs/ show:  python docs/make_figures.py

docs/figures/panda_reach.png, panda_reach_joints.png   from problems/panda_reach.toml
docs/figures/sweep.png                                 cost over the duration of problems/ur5_pick.toml
docs/figures/time.png                                  J over the duration of one straight motion
the table in README.md between the lines "savings: begin" and "savings: end"   from every problem in problems/
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import energyopt as eo
from energyopt.io import catalogue_problems, load_task
from energyopt.io.pages import write_block
from energyopt.validation import ValidationReport

HERE = Path(__file__).resolve().parent
README = HERE.parent / "README.md"
BASELINES = ("quintic", "cubic", "cycloid", "trapezoidal")
BEGIN, END = "<!-- savings: begin -->", "<!-- savings: end -->"
WIDTH_PIXELS = 1500


def draw() -> None:
    """The two figures of the README's problem."""
    plan = eo.plan(eo.load_problem("panda_reach"))
    log = eo.replay(plan)
    (HERE / "figures").mkdir(exist_ok=True)
    for name, figure in (("panda_reach", eo.plot_metrics(plan, log)), ("panda_reach_joints", eo.plot_joints(plan, log))):
        metadata = {"Software": None}
        figure.savefig(HERE / "figures" / f"{name}.png", dpi=WIDTH_PIXELS / figure.get_figwidth(), metadata=metadata)


def draw_time() -> None:
    """J over the duration: the quintic scaled as a whole, and the best timing of the same straight path."""
    problem = eo.load_problem("panda_reach")
    quintic = eo.baseline(problem)
    scaling = eo.uniform_scaling(quintic, problem.robot, problem.velocity_weight)
    path, robot, weight = [problem.start, problem.goal], problem.robot, problem.velocity_weight
    least = eo.minimum_duration(path, robot, problem.limits)
    durations = least * np.geomspace(1.02, 4.0, 12)
    own = {f"{kind}_limits": getattr(problem.limits, kind) for kind in ("velocity", "acceleration", "torque")}
    timed = [eo.retime(path, robot, T, velocity_weight=weight, throw=False, **own) for T in durations]
    T = np.geomspace(least, durations[-1], 300)
    figure, axes = plt.subplots(figsize=(7.5, 4.0), layout="constrained")
    J, valid = np.array([scaling.objective(t) for t in T]), scaling.least_duration(problem.limits)
    (line,) = axes.plot(T[valid <= T], J[valid <= T], label="quintic law, scaled: closed form")
    axes.plot(T[valid >= T], J[valid >= T], ":", color=line.get_color(), label="the same, beyond limits")
    solved = [plan for plan in timed if plan.solved]
    axes.plot([p.duration for p in solved], [p.objective for p in solved], "o-", label="best law on the same path: retime")
    axes.axvline(least, color="0.5", linestyle="--", label=f"shortest duration of the path, {least:.2f} s")
    axes.set(xlabel="duration T [s]", ylabel="J [N²·m²·s]", title="Panda, straight in joint space", ylim=(0, None))
    axes.legend(frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(HERE / "figures" / "time.png", dpi=150, metadata={"Software": None})


def draw_sweep() -> None:
    """The energy–time curve of a pick."""
    curve = eo.sweep(eo.load_problem("ur5_pick"), np.linspace(0.9, 3.0, 20))
    eo.plot_sweep(curve).savefig(HERE / "figures" / "sweep.png", dpi=150, metadata={"Software": None})


def savings_table(names: tuple[str, ...]) -> str:
    """One row a problem: by how many per cent J is below each baseline's, the mechanical energy, whether anything touches."""
    lines = [
        "| problem | robot | T [s] | J | " + " | ".join(BASELINES) + " | Σ∫\\|τq̇\\|dt [J], quintic's in brackets | touches |",
        "|---|---|--:|--:|" + "--:|" * (len(BASELINES) + 1) + "---|",
    ]
    for name in names:
        problem, options = load_task(name)
        plan = eo.plan(problem, **options)
        lines.append(_row(name, plan, eo.validate(plan), eo.replay(plan, collisions=True)))
        print(lines[-1], flush=True)
    return "\n".join(lines)


def _row(name: str, plan: eo.Plan, report: ValidationReport, log: eo.ReplayLog) -> str:
    others = [report.baselines[kind] for kind in BASELINES]
    savings = [f"{other.saving_percent:.1f} %{'' if other.within_limits else ' ✗'}" for other in others]
    energy = f"{report.plan_metrics.mechanical_abs_J:.3g} ({others[0].metrics.mechanical_abs_J:.3g})"
    touches = "yes" if log.contact_steps else "no"
    cells = [f"`{name}`", plan.problem.robot.name, f"{plan.duration:g}", f"{report.objective:.4g}", *savings, energy, touches]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    draw()
    draw_time()
    draw_sweep()
    write_block(README, (BEGIN, END), savings_table(catalogue_problems()))
