"""Default accuracy: what it costs, and whether its promise holds.

`energyopt.plan` refines the knots until the estimated relative distance of J to the continuous optimum is below 1 %. Measured
are its time on random Panda moves and the true error: every span of the final knots is split in three and the finer problem
solved from the plan's motion, so that both are the same local optimum; J of both by numeric Pinocchio.
"""

from __future__ import annotations

import sys

import numpy as np
from _shared import CLOCKS, Goal, Report, parser, publish, quartiles, random_moves, settings, shown, table

import energyopt as eo
from energyopt.clock import timed_by
from energyopt.dynamics.kernels import kernels_of
from energyopt.parameterizations.bspline import SplineSpace
from energyopt.rounds import ROUNDS
from energyopt.search_state import GOOD
from energyopt.solvers import SolverOptions, solve
from energyopt.transcription import Cuts, transcribe
from energyopt.verification import objective

MEASURES = "seconds and true error of energyopt.plan at its default accuracy, against solves on knots three times as fine"
PARTS = 3
PROMISE = 0.01
BARRIER = 1e-7
"""Initial barrier parameter of the finer solves: with a larger one some leave for another local optimum."""

UNKNOWN = {"true_error": None, "upper_bound": None, "moved": None}


def main() -> int:
    made = parser("accuracy", MEASURES)
    made.add_argument("--robot", default="panda")
    made.add_argument("--problems", type=int, default=20, metavar="N")
    made.add_argument("--self-collision", action="store_true", help="keep the links of the arm apart")
    made.add_argument("--repeats", type=int, default=5, metavar="N", help="timed plans a problem, by either clock")
    made.add_argument("--no-truth", action="store_true", help="leave out the finer solves")
    parsed = made.parse_args()
    moves = random_moves(eo.load_robot(parsed.robot), parsed.problems, parsed.seed, parsed.self_collision)
    kernels_of(moves[0].robot.dynamics)
    runs = [_run(move, parsed) for move in moves]
    results = _summary(runs)
    goals = _goals(results) if parsed.robot == "panda" else []
    return publish(Report("accuracy", MEASURES, settings(parsed), results, _text(results), goals), parsed.json)


def _run(problem: eo.Problem, parsed) -> dict:
    seconds, least = {}, {}
    for clock, read in CLOCKS.items():
        with timed_by(read):
            plans = [eo.plan(problem, starts=1, throw=False) for _ in range(parsed.repeats)]
        seconds[clock] = float(np.median([plan.solve_s for plan in plans]))
        least[clock] = min(plan.solve_s for plan in plans)
    plan = plans[0]
    return {
        "duration_s": problem.duration,
        "status": plan.status.value,
        "seconds": seconds,
        "least_seconds": least,
        "levels": plan.options["levels"],
        "iterations": plan.iterations,
        "spans": len(plan.trajectory.breaks) - 1,
        "objective": plan.objective,
        "estimated_error": plan.discretization_error,
        "stopped_early": any(note.startswith("refinement stopped") for note in plan.notes),
        **(UNKNOWN if parsed.no_truth else _truth(plan)),
    }


def _truth(plan: eo.Plan) -> dict:
    """The plan's J over that of a finer solve that starts from it, less one; None where no finer motion is found.

    Where torque rows are missing in the end (the solver gave up with them), J of the finer motion is too low and the error an
    upper bound.
    """
    problem, breaks, degree = plan.problem, plan.trajectory.breaks, plan.trajectory.degree
    kernels, cuts = kernels_of(problem.robot.dynamics), Cuts()
    parts = np.linspace(0.0, 1.0, PARTS + 1)[:-1]
    space = SplineSpace(np.append((breaks[:-1, None] + np.diff(breaks)[:, None] * parts).ravel(), breaks[-1]), degree)
    motion, rounds, complete = plan.trajectory, 0, False
    while not complete and rounds < ROUNDS:
        program = transcribe(problem, space, kernels, cuts)
        result = solve(program, program.guess(motion), SolverOptions(iterations=1000, barrier=BARRIER))
        if result.outcome not in GOOD:
            break
        motion, rounds = program.trajectory(result.x), rounds + 1
        complete = not cuts.add_violated(problem, motion, kernels, space.everywhere)
    if not rounds:
        return UNKNOWN
    t = np.linspace(0.0, plan.duration, 400)
    moved = float(np.abs(motion(t) - plan.trajectory(t)).max())
    return {"true_error": plan.objective / objective(problem, motion) - 1.0, "upper_bound": not complete, "moved": moved}


def _summary(runs: list[dict]) -> dict:
    known = [run for run in runs if run["true_error"] is not None and run["status"] == "SOLVED"]
    bounds = sum(run["upper_bound"] for run in known)
    truth = np.array([run["true_error"] for run in known])
    estimate = np.array([np.nan if run["estimated_error"] is None else run["estimated_error"] for run in known])
    return {
        **{key: {c: quartiles([run[key][c] for run in runs]) for c in CLOCKS} for key in ("seconds", "least_seconds")},
        **{key: quartiles([run[key] for run in runs]) for key in ("levels", "spans", "iterations")},
        "share_solved": float(np.mean([run["status"] == "SOLVED" for run in runs])),
        "compared": len(known),
        "upper_bounds": bounds,
        "moved": quartiles([run["moved"] for run in known]),
        "estimated_error": quartiles(estimate[np.isfinite(estimate)]),
        "true_error": quartiles(truth),
        "worst_true_error": float(truth.max()) if len(truth) else None,
        "share_within_promise": float(np.mean(truth <= PROMISE)) if len(truth) else None,
        "share_below_estimate": float(np.mean(truth <= estimate)) if len(truth) else None,
        "truth_over_estimate": quartiles((truth / estimate)[np.isfinite(truth / estimate)]),
        "stopped_early": sum(run["stopped_early"] for run in runs),
        "problems": runs,
    }


def _text(results: dict) -> str:
    percent = lambda key: shown(results[key], ".2f", 100.0)
    share = lambda key: "none" if results[key] is None else f"{100 * results[key]:.0f} %"
    worst = results["worst_true_error"]
    rows = [
        *(
            (f"solve, {words} of the repeats, {clock} [ms]", shown(results[key][clock], ".0f", 1e3))
            for key, words in (("seconds", "median"), ("least_seconds", "least"))
            for clock in CLOCKS
        ),
        ("levels", shown(results["levels"], ".0f")),
        ("knot spans at the end", shown(results["spans"], ".0f")),
        ("solver iterations, all levels", shown(results["iterations"], ".0f")),
        ("estimated error of J [%]", percent("estimated_error")),
        (f"true error, against {PARTS} × finer knots [%]", percent("true_error")),
        ("worst true error [%]", "none" if worst is None else f"{100 * worst:.2f}"),
        ("true error over estimate", shown(results["truth_over_estimate"], ".2f")),
        (f"within {100 * PROMISE:g} %", share("share_within_promise")),
        ("true error below its estimate", share("share_below_estimate")),
        ("solved", share("share_solved")),
        ("farthest joint position from the finer motion [rad]", shown(results["moved"], ".2f")),
        ("compared with a finer solve", f"{results['compared']} of {len(results['problems'])}"),
        ("of these true errors, upper bounds", str(results["upper_bounds"])),
        ("refinement stopped early", str(results["stopped_early"])),
    ]
    return table(("default accuracy, median (quartiles)", ""), rows)


def _goals(results: dict) -> list[Goal]:
    median = {clock: 1e3 * results["seconds"][clock]["median"] for clock in CLOCKS}
    goals = [Goal(f"solve at default accuracy, {clock} time", median[clock], 150.0, "ms") for clock in CLOCKS]
    if results["true_error"] is not None:
        goals.append(Goal("median true error", 100 * results["true_error"]["median"], 100 * PROMISE, "%"))
        goals.append(Goal("worst true error", 100 * results["worst_true_error"], 100 * PROMISE, "%"))
    return goals


if __name__ == "__main__":
    sys.exit(main())
