"""What-if: a re-solve of a changed problem against a plan of it from scratch.

Each random move is planned once, with a payload of 1 kg, as the base of a session (`energyopt.what_if`). Every change is then
solved by the session and by `energyopt.plan`, in alternation, both with the independent check; a re-solve starts from the last
plan of the session. Times are processor time; J is compared because the two may end in different optima.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from _shared import Goal, Report, parser, publish, quartiles, random_moves, settings, shown, table

import energyopt as eo

MEASURES = "processor time of re-solves with other numbers, over that of plans of the same problems from scratch"
SAME = 1e-4
"""Relative difference of J up to which two plans are the same optimum on knots of about the same fineness."""


def main() -> int:
    made = parser("what_if", MEASURES)
    made.add_argument("--robots", nargs="+", default=["panda", "ur5"], metavar="NAME")
    made.add_argument("--problems", type=int, default=5, metavar="N", help="moves a robot")
    parsed = made.parse_args()
    runs = []
    for name in parsed.robots:
        for problem in random_moves(eo.load_robot(name), parsed.problems, parsed.seed):
            runs += _session(problem)
    kinds = {kind: _summary([run for run in runs if run["kind"] == kind]) for kind in dict.fromkeys(run["kind"] for run in runs)}
    results = {"all": _summary(runs), "kinds": kinds, "runs": runs}
    goal = Goal("re-solve over cold solve, median", results["all"]["ratio"]["median"], 0.5, "")
    return publish(Report("what_if", MEASURES, settings(parsed), results, _text(results), [goal]), parsed.json)


def changes(problem: eo.Problem) -> dict[str, list[dict]]:
    """By kind, what is changed of a move with a payload of 1 kg."""
    toward = 0.05 * np.sign(problem.start - problem.goal)
    return {
        "payload ± 0.5 kg": [{"mass": 1.5}, {"mass": 0.5}],
        "duration ± 10 %": [{"duration": 1.1 * problem.duration}, {"duration": 0.9 * problem.duration}],
        "λ × 2": [{"velocity_weight": 2.0 * problem.velocity_weight}],
        "goal 0.05 rad nearer": [{"goal": problem.goal + toward}],
        "start 0.05 rad nearer": [{"start": problem.start - toward}],
        "viscous friction 0.5": [{"viscous_friction": 0.5}],
    }


def _session(problem: eo.Problem) -> list[dict]:
    base = eo.plan(eo.what_if_problem(problem, mass=1.0), starts=1, throw=False)
    if not base.solved:
        return []
    found, session = [], eo.what_if(base)
    for kind, several in changes(problem).items():
        for change in several:
            change = {"mass": 1.0} | change
            try:
                asked = eo.what_if_problem(problem, **change)
                found.append({"name": problem.name, "kind": kind} | _compared(session, asked))
            except eo.InputError:  # too fast, or too heavy, for any motion
                continue
    return found


def _compared(session: eo.WhatIf, asked: eo.Problem) -> dict:
    """A re-solve and a plan from scratch, each once: the session would begin a second time from the optimum it is to find."""
    began = time.process_time()
    again = session.solve_problem(asked, throw=False)
    between = time.process_time()
    cold = eo.plan(asked, starts=1, throw=False)
    seconds, whole = between - began, time.process_time() - between
    return {
        "seconds": seconds, "cold_seconds": whole, "ratio": seconds / whole, "solved": again.solved, "cold_solved": cold.solved,
        "iterations": again.iterations, "cold_iterations": cold.iterations,
        "objective_ratio": again.objective / cold.objective if again.solved and cold.solved else None,
    }  # fmt: skip


def _summary(runs: list[dict]) -> dict:
    compared = [run["objective_ratio"] for run in runs if run["objective_ratio"] is not None]
    return {
        "runs": len(runs),
        "solved": sum(run["solved"] for run in runs),
        "cold_solved": sum(run["cold_solved"] for run in runs),
        "ratio": quartiles([run["ratio"] for run in runs]),
        "seconds": quartiles([run["seconds"] for run in runs]),
        "objective_ratio": quartiles(compared),
        "worst_objective_ratio": max(compared, default=None),
        "better_or_same": sum(ratio <= 1.0 + SAME for ratio in compared),
    }


def _text(results: dict) -> str:
    rows = []
    for kind, found in (results["kinds"] | {"all": results["all"]}).items():
        counts = f"{found['solved']} / {found['cold_solved']} of {found['runs']}"
        times = shown(found["ratio"], ".2f"), shown(found["seconds"], ".0f", 1e3)
        worst = "none" if found["worst_objective_ratio"] is None else f"{found['worst_objective_ratio']:.3f}"
        rows.append((kind, counts, *times, shown(found["objective_ratio"], ".4f"), worst))
    head = ("change", "solved, re-solve / cold", "time over cold", "re-solve [ms]", "J over that of cold", "worst")
    return table(head, rows)


if __name__ == "__main__":
    sys.exit(main())
