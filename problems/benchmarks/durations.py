"""The duration: what it costs to leave it free, and the time of an energy–time curve.

Each random move is planned with a free duration and with the duration that was found, in alternation, on the same fixed knots
and, as `sweep` does, at the default accuracy. The curves are those of catalogue problems, from 0.9 to 2 times their own
durations.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from _shared import Goal, Report, parser, publish, quartiles, random_moves, settings, shown, table

import energyopt as eo

MEASURES = "processor time of plan() with a free duration over that with the duration found, and the time of energy–time curves"
RANGE = (0.4, 3.0)
"""Bounds of a free duration, in units of the duration of the move."""
KNOTS = eo.BSpline(control_points=16, accuracy=None)


def main() -> int:
    made = parser("durations", MEASURES)
    made.add_argument("--robot", default="panda", metavar="NAME")
    made.add_argument("--problems", type=int, default=16, metavar="N", help="moves")
    made.add_argument("--repeats", type=int, default=5, metavar="N", help="of each pair, of which the medians count")
    made.add_argument(
        "--curves", nargs="+", default=["panda_reach", "panda_payload"], metavar="PROBLEM", help="of these problems"
    )
    made.add_argument("--points", type=int, default=20, metavar="N", help="durations of a curve")
    parsed = made.parse_args()
    moves = random_moves(eo.load_robot(parsed.robot), parsed.problems, parsed.seed)
    runs = [run for move in moves if (run := _pair(move, parsed.repeats)) is not None]
    curves = [_curve(name, parsed.points) for name in parsed.curves]
    ratio = quartiles([run["ratio"] for run in runs])
    results = {"ratio": ratio, "curves": curves, "runs": runs}
    goals = [
        Goal("free over fixed duration, median", ratio["median"], 1.5, ""),
        *(Goal(f"curve of {curve['problem']}, {curve['points']} points, wall", curve["wall_s"], 3.0, "s") for curve in curves),
    ]
    return publish(Report("durations", MEASURES, settings(parsed), results, _text(results), goals), parsed.json)


def _pair(move: eo.Problem, repeats: int) -> dict | None:
    free = eo.what_if_problem(move, duration=tuple(share * move.duration for share in RANGE))
    found = eo.plan(free, KNOTS, starts=1, throw=False)
    fixed = free.lasting(found.duration)
    if not (found.solved and eo.plan(fixed, KNOTS, starts=1, throw=False).solved):
        return None
    seconds = {"free": [], "fixed": []}
    for _ in range(repeats):
        for kind, problem in (("free", free), ("fixed", fixed)):
            began = time.process_time()
            eo.plan(problem, KNOTS, starts=1, throw=False)
            seconds[kind].append(time.process_time() - began)
    medians = {f"{kind}_s": float(np.median(times)) for kind, times in seconds.items()}
    return {"name": move.name, "duration_s": found.duration, "ratio": medians["free_s"] / medians["fixed_s"], **medians}


def _curve(name: str, points: int) -> dict:
    problem = eo.load_problem(name)
    eo.plan(problem)  # kernels compiled and loaded
    wall, processor = time.perf_counter(), time.process_time()
    curve = eo.sweep(problem, np.linspace(0.9, 2.0, points) * problem.duration)
    seconds = {"wall_s": time.perf_counter() - wall, "processor_s": time.process_time() - processor}
    return {"problem": name, "points": points, "solved": sum(point.solved for point in curve.points), **seconds}


def _text(results: dict) -> str:
    pairs = [run[f"{kind}_s"] for kind in ("free", "fixed") for run in results["runs"]]
    half = len(pairs) // 2
    rows = [
        ("plan(), free duration [ms]", shown(quartiles(pairs[:half]), ".1f", 1e3)),
        ("plan(), the duration found [ms]", shown(quartiles(pairs[half:]), ".1f", 1e3)),
        ("ratio of each pair", shown(results["ratio"], ".2f")),
    ]
    for curve in results["curves"]:
        name = (
            f"curve of {curve['problem']}, {curve['solved']} of {curve['points']} points solved: wall · processor, this process"
        )
        rows.append((name, f"{curve['wall_s']:.1f} s · {curve['processor_s']:.1f} s"))
    return table(("", "median (quartiles)"), rows)


if __name__ == "__main__":
    sys.exit(main())
