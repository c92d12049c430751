"""Time to an optimum on fixed knots: random Panda moves, energyopt against the textbook formulation.

Measured are the stages of `energyopt.plan`: `solve` (from the transcribed program to a motion inside all limits, further
torque rows and re-solves included), `build`, `verify`, and the whole call. The rival (`_textbook.py`) solves the same program:
same spline, nodes, bounds, guess and tolerance; measured is its solver call alone, CasADi's differentiation apart. The two
run in turns on the same machine. Ratios count only where both end in the same optimum (J within 1e-4 by numeric Pinocchio).
`--profile` takes our times further apart instead.
"""

from __future__ import annotations

import sys

import _profile
import numpy as np
from _shared import CLOCKS, Goal, Report, parser, publish, quartiles, random_moves, settings, shown, table
from _textbook import VARIANTS, Textbook

import energyopt as eo
from energyopt.clock import timed_by

MEASURES = "seconds of energyopt.plan with fixed knots on random moves, against the textbook formulation (CasADi map and AD)"
SAME_OPTIMUM = 1e-4
"""Relative difference of J up to which two motions count as the same optimum."""
TEXTBOOK = ("map", "map_tuned")
"""The variants that are the textbook's; of these the faster counts."""
STAGES = ("solve", "build", "verify", "plan")


def main() -> int:
    parsed = _arguments()
    robot = eo.load_robot(parsed.robot)
    options = {} if parsed.acceleration is None else {"acceleration_limits": parsed.acceleration}
    moves = random_moves(robot, parsed.problems, parsed.seed, parsed.self_collision, **options)
    spline = eo.BSpline(degree=parsed.degree, control_points=parsed.control_points, accuracy=None)
    timed_plan(moves[0], spline, "wall")  # loads or compiles the kernels
    if parsed.profile:
        found = _profile.profile(moves, spline)
        return publish(
            Report("profile", _profile.MEASURES, settings(parsed), found, _profile.text(found), _profile.goals(found, parsed)),
            parsed.json,
        )
    runs = [_run(move, spline, parsed, parsed.variants if k < parsed.rivals else []) for k, move in enumerate(moves)]
    results = _summary(runs, parsed.variants)
    return publish(Report("speed", MEASURES, settings(parsed), results, _text(results), _goals(results, parsed)), parsed.json)


def _arguments():
    made = parser("speed", MEASURES)
    made.add_argument("--robot", default="panda")
    made.add_argument("--problems", type=int, default=20, metavar="N")
    made.add_argument("--self-collision", action="store_true", help="keep the links of the arm apart")
    made.add_argument("--profile", action="store_true", help="where the time of a plan goes, and IPOPT beside our solver")
    made.add_argument("--repeats", type=int, default=5, metavar="N", help="timed plans a problem, by either clock")
    made.add_argument("--rivals", type=int, default=10, metavar="N", help="problems on which the textbook runs too")
    made.add_argument("--variants", nargs="*", choices=VARIANTS, default=[v for v in VARIANTS if v != "map_jit"], metavar="NAME",
                      help=f"of the textbook: {', '.join(VARIANTS)} (the last needs a C compiler and minutes)")  # fmt: skip
    made.add_argument("--control-points", type=int, default=16, metavar="N")
    made.add_argument("--degree", type=int, default=3, metavar="N")
    made.add_argument("--acceleration", type=float, nargs="*", metavar="A", help="add acceleration limits [rad/s²], one a joint")
    return made.parse_args()


def timed_plan(problem: eo.Problem, spline: eo.BSpline, clock: str) -> tuple[eo.Plan, dict[str, float]]:
    """A plan and the seconds of its stages by one clock."""
    read = CLOCKS[clock]
    with timed_by(read):
        began = read()
        plan = eo.plan(problem, spline, starts=1, throw=False)
        total = read() - began
    return plan, {**{stage: plan.time_s[stage] for stage in STAGES[:-1]}, "plan": total}


def _run(problem: eo.Problem, spline: eo.BSpline, parsed, variants: list[str]) -> dict:
    """One problem: timed plans, and between them the textbook in each variant."""
    times, rivals, queue = {clock: [] for clock in CLOCKS}, {}, list(variants)
    while len(times["wall"]) < parsed.repeats or queue:
        for clock, rows in times.items():
            plan, seconds = timed_plan(problem, spline, clock)
            rows.append(seconds)
        if queue:
            name = queue.pop(0)
            rivals[name] = _rival(problem, spline, name)
    median, least = (_over_repeats(times, combine) for combine in (np.median, np.min))
    run = {
        "duration_s": problem.duration,
        "status": plan.status.value,
        "objective": plan.objective,
        "iterations": plan.iterations,
        "torque_rows": plan.options["torque_rows"],
        "seconds": median,
        "least_seconds": least,
        "textbook": rivals,
    }
    for rival in rivals.values():
        rival["same"] = plan.solved and rival["success"] and abs(rival["objective"] / plan.objective - 1.0) <= SAME_OPTIMUM
        rival["ratio"] = {clock: rival[clock] / median[clock]["solve"] for clock in CLOCKS}
    return run


def _over_repeats(times: dict[str, list[dict]], combine) -> dict[str, dict[str, float]]:
    return {clock: {stage: float(combine([row[stage] for row in rows])) for stage in STAGES} for clock, rows in times.items()}


def _rival(problem: eo.Problem, spline: eo.BSpline, name: str) -> dict:
    textbook = Textbook(problem, spline.space(problem.duration), VARIANTS[name])
    solved = textbook.solve()
    print(f"  {problem.name}: textbook '{name}' {solved.wall:.1f} s", file=sys.stderr)
    return {**vars(solved), "build": textbook.build_s}


def _summary(runs: list[dict], variants: list[str]) -> dict:
    spread = lambda key: {c: {s: quartiles([run[key][c][s] for run in runs]) for s in STAGES} for c in CLOCKS}
    per_iteration = [run["seconds"]["cpu"]["solve"] / max(run["iterations"], 1) for run in runs]
    return {
        "seconds": spread("seconds"),
        "least_seconds": spread("least_seconds"),
        "iterations": quartiles([run["iterations"] for run in runs]),
        "cpu_per_iteration": quartiles(per_iteration),
        "share_solved": float(np.mean([run["status"] == "SOLVED" for run in runs])),
        "textbook": {name: _rival_summary([run for run in runs if name in run["textbook"]], name) for name in variants},
        "problems": runs,
    }


def _rival_summary(runs: list[dict], name: str) -> dict:
    """Over the problems on which a variant ran: spreads where the optimum is the same, counts, and who is lower elsewhere."""
    rivals = [run["textbook"][name] for run in runs]
    same = [rival for rival in rivals if rival["same"]]
    solved = [rival for rival in rivals if rival["success"]]
    other = [(run, rival) for run, rival in zip(runs, rivals, strict=True) if rival["success"] and not rival["same"]]
    return {
        "says": VARIANTS[name].says,
        "problems": len(rivals),
        "failed": len(rivals) - len(solved),
        "same_optimum": len(same),
        "other_and_better": sum(rival["objective"] < run["objective"] for run, rival in other),
        "other_and_worse": sum(rival["objective"] >= run["objective"] for run, rival in other),
        "iterations": quartiles([rival["iterations"] for rival in same]),
        "seconds": {clock: quartiles([rival[clock] for rival in same]) for clock in (*CLOCKS, "build")},
        "ratio": {clock: quartiles([rival["ratio"][clock] for rival in same]) for clock in CLOCKS},
        "ratio_any_optimum": {clock: quartiles([rival["ratio"][clock] for rival in solved]) for clock in CLOCKS},
    }


def _text(results: dict) -> str:
    keys = ("seconds", "least_seconds")
    rows = [(s, *(shown(results[key][c][s], ".1f", 1e3) for key in keys for c in CLOCKS)) for s in STAGES]
    head = ("stage: median (quartiles) over the problems of", "median, wall [ms]", "processor", "least, wall", "processor")
    solved = f"{100 * results['share_solved']:.0f} % of {len(results['problems'])}"
    iterations, each = shown(results["iterations"], ".0f"), shown(results["cpu_per_iteration"], ".2f", 1e3)
    text = [table(head, rows), f"  solved {solved}; iterations {iterations}; processor time an iteration {each} ms\n\n"]
    if any(rival["problems"] for rival in results["textbook"].values()):
        text.append(_rival_text(results["textbook"]))
    return "".join(text)


def _rival_text(textbook: dict) -> str:
    rows = []
    for name, rival in textbook.items():
        better, worse, failed = (rival[key] for key in ("other_and_better", "other_and_worse", "failed"))
        counts = f"{rival['same_optimum']}/{rival['problems']} (+{better} −{worse} !{failed})"
        seconds = shown(rival["seconds"]["build"], ".1f"), shown(rival["seconds"]["cpu"], ".2f")
        ratios = rival["ratio"]["cpu"], rival["ratio"]["wall"], rival["ratio_any_optimum"]["cpu"]
        rows.append((name, *seconds, shown(rival["iterations"], ".0f"), *(shown(ratio, ".0f") for ratio in ratios), counts))
    head = ("textbook", "build [s]", "solve [s]", "iterations", "ratio, cpu", "ratio, wall", "any optimum", "same optimum")
    legend = [
        *(f"  {name}: {rival['says']}\n" for name, rival in textbook.items()),
        "  ratio: textbook solve over energyopt solve where both end in the same optimum; any optimum: wherever it solved\n",
        "  same optimum: of the problems tried (+ another with lower J, − another with higher J, ! failed)\n",
    ]
    return table(head, rows) + "".join(legend)


def _goals(results: dict, parsed) -> list[Goal]:
    """Stated for the Panda on 12 to 16 even control points."""
    if parsed.robot != "panda" or not 12 <= parsed.control_points <= 16:
        return []
    goals = [Goal(f"solve, {c} time", 1e3 * results["seconds"][c]["solve"]["median"], 20.0, "ms") for c in CLOCKS]
    fair = [rival for name, rival in results["textbook"].items() if name in TEXTBOOK]
    for clock in CLOCKS:
        ratios = [rival["ratio"][clock]["median"] for rival in fair if rival["same_optimum"]]
        if ratios:
            goals.append(Goal(f"times faster than the fastest mapped textbook, {clock} time", min(ratios), 80.0, "×", least=True))
    return goals


if __name__ == "__main__":
    sys.exit(main())
