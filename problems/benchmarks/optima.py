"""How good the optimum is: the default number of guesses against the best of many.

Random rest-to-rest moves of several arms (self-collision included) are planned from one guess (the straight motion), from the
default number of guesses, and from many with another seed. The least J of all three stands for the global optimum, which nobody
knows; the gap is J over that, less one. Plans are refined as usual, to 1 % of J, and J is that of numeric Pinocchio. Times are
processor times of a whole `energyopt.plan`; plans of one problem follow each other.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from _shared import Goal, Report, parser, publish, quartiles, random_moves, settings, shown, table

import energyopt as eo
from energyopt.io.pages import write_block
from energyopt.serving import no_more_processes

MEASURES = "J and processor time of plans from the default number of guesses and from one, against the best of many guesses"
PAGE = Path(__file__).resolve().parents[2] / "docs" / "benchmarks.md"
BEGIN, END = "<!-- optima: begin -->", "<!-- optima: end -->"
WITHIN = 0.01
SHARE, RATIO = 90.0, 10.0
HEAD = (
    "arm", "moves", "one guess within 1 %", "default within 1 %", "gap of one guess [%]", "gap of the default [%]",
    "time over one guess", "distinct optima",
)  # fmt: skip


def main() -> int:
    made = parser("optima", MEASURES)
    made.add_argument("--robots", nargs="+", default=["panda", "ur5", "xarm7", "z1"], metavar="NAME")
    made.add_argument("--problems", type=int, default=10, metavar="N", help="moves a robot")
    made.add_argument("--many", type=int, default=200, metavar="N", help="guesses the best of which is compared with")
    made.add_argument("--starts", type=int, metavar="N", help="guesses of what is measured, in place of the default")
    made.add_argument("--docs", action="store_true", help="write the table into docs/benchmarks.md")
    parsed = made.parse_args()
    runs = [run for name in parsed.robots for run in _robot(name, parsed)]
    if not runs:
        raise SystemExit("no move was solved")
    results = {name: _summary([run for run in runs if run["robot"] == name]) for name in parsed.robots} | {"all": _summary(runs)}
    if parsed.docs:
        _write(results, parsed)
    goals = [
        Goal("default within 1 % of the best", 100.0 * results["all"]["default"]["within"], SHARE, "% of the moves", least=True),
        Goal("time of the default over that of one guess, median", results["all"]["ratio"]["median"], RATIO, "×"),
    ]
    results["moves"] = runs
    return publish(Report("optima", MEASURES, settings(parsed), results, table(HEAD, _rows(results)), goals), parsed.json)


def _robot(name: str, parsed: argparse.Namespace) -> list[dict]:
    moves = random_moves(eo.load_robot(name), parsed.problems, parsed.seed, self_collision=True)
    eo.plan(moves[0], starts=1, throw=False)  # what is prepared once a robot is not counted
    runs = []
    for number, move in enumerate(moves, start=1):
        runs.append(_run(move, name, parsed))
        print(f"{name}: {number} of {len(moves)} moves", file=sys.stderr)
    return [run for run in runs if run is not None]


def _run(move: eo.Problem, name: str, parsed: argparse.Namespace) -> dict | None:
    """One move; None where nothing is solved."""
    kinds = {"one": {"starts": 1}, "default": {"starts": parsed.starts}, "many": {"starts": parsed.many, "seed": parsed.seed + 1}}
    timed = {kind: _timed(lambda options=options: eo.plan(move, throw=False, **options)) for kind, options in kinds.items()}
    plans = {kind: plan for kind, (plan, _) in timed.items()}
    best = min((plan.objective for plan in plans.values() if plan.solved), default=None)
    if best is None:
        return None
    return {
        "robot": name,
        "best": best,
        "objective": {kind: plan.objective if plan.solved else None for kind, plan in plans.items()},
        "gap": {kind: plan.objective / best - 1.0 if plan.solved else None for kind, plan in plans.items()},
        "seconds": {kind: seconds for kind, (_, seconds) in timed.items()},
        "guess": {kind: plan.options["guess"] for kind, plan in plans.items()},
        "distinct": len(plans["many"].optima),
        "found_by": {kind: _share_of_best(plans[kind]) for kind in ("default", "many")},
    }


def _share_of_best(plan: eo.Plan) -> float:
    """Share of the guesses that led to the best optimum."""
    return plan.optima[0].guesses / len(plan.options["tried"]) if plan.optima else 0.0


def _timed(call: Callable[[], eo.Plan]) -> tuple[eo.Plan, float]:
    """Its processor time too: all of it is this process's own."""
    with no_more_processes():
        began = time.process_time()
        plan = call()
        return plan, time.process_time() - began


def _summary(runs: list[dict]) -> dict | None:
    if not runs:
        return None
    return {
        "moves": len(runs),
        **{kind: _gaps([run["gap"][kind] for run in runs]) for kind in ("one", "default")},
        "ratio": quartiles([run["seconds"]["default"] / run["seconds"]["one"] for run in runs]),
        "distinct": quartiles([run["distinct"] for run in runs]),
        "found_by": quartiles([run["found_by"]["many"] for run in runs]),
    }


def _gaps(gaps: list[float | None]) -> dict:
    """Share within 1 % (of all moves, those not solved included), and median, 95th percentile and worst of the gaps."""
    known = np.array([gap for gap in gaps if gap is not None])
    spread = {"median": np.median, "p95": lambda x: np.percentile(x, 95), "worst": np.max}
    return {
        "within": float(np.sum(known <= WITHIN) / len(gaps)),
        **{key: float(f(known)) if len(known) else None for key, f in spread.items()},
    }


def _rows(results: dict) -> list[tuple[str, ...]]:
    """One row a robot and one of all; gaps as median, 95th percentile, worst."""
    rows = []
    for name, found in results.items():
        if name == "moves" or found is None:
            continue
        gap = lambda kind, found=found: ", ".join(
            "none" if found[kind][key] is None else f"{100 * found[kind][key]:.2g}" for key in ("median", "p95", "worst")
        )
        share = lambda kind, found=found: f"{100 * found[kind]['within']:.0f} %"
        rows.append((name, str(found["moves"]), share("one"), share("default"), gap("one"), gap("default"),
                     shown(found["ratio"], ".2g"), shown(found["distinct"], ".0f")))  # fmt: skip
    return rows


def _write(results: dict, parsed: argparse.Namespace) -> None:
    """The table and its caption into docs/benchmarks.md."""
    guesses = f"{parsed.starts or 'the default number of'} guesses"
    caption = (
        f"Plans from {guesses} and from one, against the least J of these and of {parsed.many} guesses with another seed\n"
        f"(`optima`, seed {parsed.seed}). Gaps: median, 95th percentile, worst; times, numbers of optima: median (quartiles)."
    )
    line = lambda cells: "| " + " | ".join(cells) + " |"
    block = "\n".join([caption, "", line(HEAD), "|---|" + "--:|" * (len(HEAD) - 1), *map(line, _rows(results))])
    write_block(PAGE, (BEGIN, END), block)


if __name__ == "__main__":
    sys.exit(main())
