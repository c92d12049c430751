"""What optimal motions save against ordinary ones of the same duration.

Random rest-to-rest moves of several arms, planned at the default settings, against quintic (minimum jerk), cubic, cycloid and
trapezoidal motions between the same ends in the same time. Compared are the objective J = ∫(Στ² + λΣq̇²)dt, which is what is
minimised, and the mechanical energy Σ∫|τq̇|dt, which is not. The ordinary motions are not held to the limits: how often each
keeps them all by itself is stated beside.
"""

from __future__ import annotations

import sys

import numpy as np
from _shared import Report, parser, publish, quartiles, random_moves, settings, shown, table

import energyopt as eo
from energyopt.baselines import BASELINES
from energyopt.metrics import metrics
from energyopt.verification import limits_hold, objective, verify

MEASURES = "savings of planned motions against ordinary motions of the same duration (objective J, mechanical energy)"


def main() -> int:
    made = parser("savings", MEASURES)
    made.add_argument("--robots", nargs="+", default=["panda", "ur5", "xarm7", "baxter"], metavar="NAME")
    made.add_argument("--problems", type=int, default=20, metavar="N", help="moves a robot")
    parsed = made.parse_args()
    results = {name: _robot(name, parsed.problems, parsed.seed) for name in parsed.robots}
    return publish(Report("savings", MEASURES, settings(parsed), results, _text(results)), parsed.json)


def _robot(name: str, count: int, seed: int) -> dict:
    moves = random_moves(eo.load_robot(name), count, seed, self_collision=True)
    plans = [eo.plan(move, throw=False) for move in moves]
    solved = [plan for plan in plans if plan.solved]
    compared = {kind: [_compare(plan, kind) for plan in solved] for kind in BASELINES}
    return {
        "problems": len(plans),
        "solved": len(solved),
        "duration_s": quartiles([plan.duration for plan in solved]),
        "baselines": {kind: _summary(found) for kind, found in compared.items()},
        "moves": compared,
    }


def _compare(plan: eo.Plan, kind: str) -> dict:
    """Savings of one plan in percent, and whether the ordinary motion keeps the limits."""
    problem, motion = plan.problem, eo.baseline(plan.problem, kind)
    ours, theirs = metrics(problem, plan.trajectory), metrics(problem, motion)
    return {
        "objective_percent": 100.0 * (1.0 - plan.objective / objective(problem, motion)),
        "energy_percent": 100.0 * (1.0 - ours.mechanical_abs_J / theirs.mechanical_abs_J),
        "keeps_limits": limits_hold(verify(problem, motion)),
    }


def _summary(found: list[dict]) -> dict:
    keeping = [one["objective_percent"] for one in found if one["keeps_limits"]]
    return {
        "objective_percent": quartiles([one["objective_percent"] for one in found]),
        "energy_percent": quartiles([one["energy_percent"] for one in found]),
        "share_keeping_limits": float(np.mean([one["keeps_limits"] for one in found])) if found else None,
        "objective_percent_where_limits_hold": quartiles(keeping),
        "least_objective_percent_where_limits_hold": min(keeping, default=None),
    }


def _text(results: dict) -> str:
    rows = []
    for name, found in results.items():
        for kind, summary in found["baselines"].items():
            kept = summary["share_keeping_limits"]
            rows.append((f"{name} ({found['solved']}/{found['problems']} solved, {shown(found['duration_s'], '.1f')} s)", kind,
                         shown(summary["objective_percent"], ".0f"), shown(summary["energy_percent"], ".0f"),
                         "none" if kept is None else f"{100 * kept:.0f} %"))  # fmt: skip
    head = ("robot, durations", "against", "saving of J [%]", "saving of energy [%]", "keeps the limits")
    return table(head, rows) + "  median (quartiles) over the solved moves\n"


if __name__ == "__main__":
    sys.exit(main())
