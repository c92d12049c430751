"""Our interior-point method beside IPOPT on the same programs: outcome, optimum, iterations and processor time.

Programs are the first ones of random moves of several arms with position and velocity limits, some with acceleration limits or
with rows for the torque limits, and some in a time in which no motion is inside the limits. Both solvers get the same functions,
start and tolerance, and run in turns. Problems of this kind have many optima; where the two differ, the lower one counts as
better. That ours are optima is checked by IPOPT, started there.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from _shared import Goal, Report, parser, publish, quartiles, random_moves, settings, shown, table

import energyopt as eo
from energyopt.baselines import baseline
from energyopt.dynamics.kernels import kernels_of
from energyopt.parameterizations import BSpline
from energyopt.solvers import Outcome, SolverOptions, ipopt, solve
from energyopt.transcription import Cuts, NonlinearProgram, transcribe

MEASURES = "our interior-point method beside IPOPT on the same programs"
SETS = (
    ("panda", {}),
    ("ur5", {}),
    ("xarm7", {}),
    ("z1", {}),
    ("baxter", {}),
    ("panda", {"acceleration": 15.0}),
    ("ur5", {"acceleration": 10.0}),
    ("panda", {"torque": True}),
    ("xarm7", {"torque": True}),
    ("panda", {"hurry": 0.3}),
    ("ur5", {"hurry": 0.3}),
)
KINDS = ({}, {"acceleration": 15.0}, {"torque": True}, {"hurry": 0.3})
SAME = 1e-5
"""Relative difference of J up to which two optima count as the same."""
STAYS = 2e-6
"""Relative difference of J up to which IPOPT, started at our optimum, counts as staying there."""
TORQUE_TIMES = 20


def main() -> int:
    made = parser("solvers", MEASURES)
    made.add_argument("--problems", type=int, default=8, metavar="N", help="a set; of slow ones half as many")
    made.add_argument("--robots", nargs="*", metavar="NAME", help="these, with each kind of limits, instead of a chosen mixture")
    made.add_argument("--control-points", type=int, default=16, metavar="N")
    parsed = made.parse_args()
    sets = [(robot, options) for robot in parsed.robots for options in KINDS] if parsed.robots else SETS
    runs = [
        {"set": _name(robot, options), **_run(program, x0)}
        for k, (robot, options) in enumerate(sets)
        for program, x0 in _programs(robot, options, parsed, parsed.seed + k)
    ]
    results = {"sets": {name: _summary([r for r in runs if r["set"] == name]) for name in dict.fromkeys(r["set"] for r in runs)}}
    results |= {"all": _summary(runs), "problems": runs}
    return publish(Report("solvers", MEASURES, settings(parsed), results, _text(results), _goals(results["all"])), parsed.json)


def _name(robot: str, options: dict) -> str:
    says = {"acceleration": "acceleration limits", "torque": "torque rows", "hurry": "in too short a time"}
    return ", ".join([robot, *(says[key] for key in options)])


def _programs(name: str, options: dict, parsed, seed: int) -> Iterator[tuple[NonlinearProgram, np.ndarray]]:
    robot = eo.load_robot(name)
    limits = {"acceleration_limits": [options["acceleration"]] * robot.nv} if "acceleration" in options else {}
    count = max(parsed.problems // (2 if name == "baxter" or "hurry" in options else 1), 1)
    for move in random_moves(robot, count, seed, **limits):
        problem = replace(move, duration=move.duration * options.get("hurry", 1.0))
        cuts = Cuts()
        if "torque" in options:
            times = np.linspace(0.0, problem.duration, TORQUE_TIMES)
            cuts.torque.update((float(t), i) for t in times for i in range(robot.nv))
        space = BSpline(control_points=parsed.control_points).space(problem.duration)
        program = transcribe(problem, space, kernels_of(robot.dynamics), cuts)
        yield program, program.guess(baseline(problem))


def _run(program: NonlinearProgram, x0: np.ndarray) -> dict:
    seconds, found = {solve: [], ipopt.solve: []}, {}
    for method in (solve, ipopt.solve) * 2:
        began = time.process_time()
        found[method] = method(program, x0)
        seconds[method].append(time.process_time() - began)
    ours, reference = found.values()
    run = {
        "ours": {"seconds": min(seconds[solve]), "iterations": ours.iterations, "outcome": ours.outcome.name},
        "ipopt": {"seconds": min(seconds[ipopt.solve]), "iterations": reference.iterations, "outcome": reference.outcome.name},
        "fell_back": ours.solver == "ipopt",
        "agree": ours.outcome is reference.outcome,
        "change": None,
        "stays": None,
    }
    if ours.outcome is reference.outcome is Outcome.CONVERGED:
        near = ipopt.solve(program, ours.x, SolverOptions(barrier=1e-7))
        run["change"] = ours.objective / reference.objective - 1.0
        run["stays"] = bool(abs(near.objective / ours.objective - 1.0) <= STAYS)
    return run


def _summary(runs: list[dict]) -> dict:
    change = np.array([run["change"] for run in runs if run["change"] is not None])
    spread = lambda key, what: quartiles([run[key][what] for run in runs])
    return {
        "problems": len(runs),
        "outcomes_agree": sum(run["agree"] for run in runs),
        "fell_back": sum(run["fell_back"] for run in runs),
        "solved": len(change),
        "optima": sum(run["stays"] is True for run in runs),
        "same": int(np.sum(np.abs(change) <= SAME)),
        "better": int(np.sum(change < -SAME)),
        "worse": int(np.sum(change > SAME)),
        "mean_change": float(change.mean()) if len(change) else 0.0,
        "seconds": {key: spread(key, "seconds") for key in ("ours", "ipopt")},
        "iterations": {key: spread(key, "iterations") for key in ("ours", "ipopt")},
        "ratio": quartiles([run["ipopt"]["seconds"] / run["ours"]["seconds"] for run in runs]),
    }


def _text(results: dict) -> str:
    head = (
        "programs",
        "number",
        "agree",
        "fell back",
        "same/better/worse",
        "J",
        "ours [ms]",
        "IPOPT [ms]",
        "iterations",
        "ratio",
    )
    rows = []
    for name, s in [*results["sets"].items(), ("all", results["all"])]:
        iterations = "/".join(f"{s['iterations'][key]['median']:.0f}" for key in ("ours", "ipopt"))
        milliseconds = [shown(s["seconds"][key], ".1f", 1e3) for key in ("ours", "ipopt")]
        change = f"{100 * s['mean_change']:+.2f} %" if s["solved"] else ""
        counts = (s["problems"], s["outcomes_agree"], s["fell_back"], f"{s['same']}/{s['better']}/{s['worse']}")
        rows.append((name, *counts, change, *milliseconds, iterations, shown(s["ratio"], ".1f")))
    legend = [
        "  agree: both end alike; fell back: ours came to no end, and IPOPT took over (its time is counted)\n",
        "  J: mean change against IPOPT's optimum; times and iterations: median (quartiles), ratio: IPOPT's time over ours\n",
    ]
    return table(head, rows) + "".join(legend)


def _goals(found: dict) -> list[Goal]:
    not_worse = (found["same"] + found["better"]) / max(found["solved"], 1)
    return [
        Goal("programs on which both end alike", found["outcomes_agree"] / found["problems"], 1.0, "of all", least=True),
        Goal("solved ones that IPOPT, started there, cannot improve", found["optima"] / max(found["solved"], 1), 1.0, "of them",
             least=True),
        Goal("the same optimum or a better one", not_worse, 0.95, "of them", least=True),
        Goal("IPOPT's time over ours", found["ratio"]["median"], 2.0, "×", least=True),
    ]  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
