"""How much work plans take, counted: solver iterations, and evaluations of the program's state, gradient, Jacobian and Hessian.

    python tests/make_effort.py      writes tests/data/effort.json, with which tests/test_effort.py compares

Counts depend on no clock, only on the code (and, by a few per cent, on rounding: on the compiler and the CPU). Renew them with a
change that lowers them; a change that raises them has to say why.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import energyopt as eo
from energyopt.io import load_task

FILE = Path(__file__).resolve().parent / "data" / "effort.json"
CATALOGUE = ("panda_reach", "panda_fold", "panda_sinusoid", "panda_collocation", "z1_friction", "ur10_heavy", "panda_clutter")
MOVES = {"panda": 3, "ur5": 2}
"""Random moves a robot."""
GENERAL, SINGLE = 1.12, 2.5
"""Ratios to the reference up to which the middle of all problems, and a single one, may come."""
COUNTS = ("iterations", "state", "gradient", "jacobian", "hessian")


def suite() -> Iterator[tuple[str, eo.Problem, dict]]:
    """Name, problem, and options of `plan`."""
    for name in CATALOGUE:
        problem, options = load_task(name)
        yield name, problem, options | {"path_search": "built-in"} | ({} if problem.obstacles else {"starts": 1})
    for name, count in MOVES.items():
        for k, problem in enumerate(_moves(eo.load_robot(name), count)):
            yield f"{name} move {k}", problem, {"starts": 1}


def _moves(robot: eo.RobotModel, count: int) -> Iterator[eo.Problem]:
    """Random rest-to-rest moves, a little slower than the quintic's velocity limit allows."""
    rng = np.random.default_rng(5)
    low, high = np.maximum(robot.limits.lower, -2.5), np.minimum(robot.limits.upper, 2.5)
    for _ in range(count):
        start, goal = rng.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low), (2, robot.nv))
        stretch = rng.uniform(1.1, 1.6)
        duration = stretch * np.max(1.875 * np.abs(goal - start) / robot.limits.velocity) / 1.3
        yield eo.Problem(robot, start, goal, duration=duration, self_collision=False)


def counted(problem: eo.Problem, options: dict) -> dict[str, int]:
    """The counts of one plan, which has to be solved."""
    plan = eo.plan(problem, **options)
    return {"iterations": plan.iterations, **{name: plan.options["evaluations"][name] for name in COUNTS[1:]}}


def kind() -> str:
    """Whether kernels are compiled here, or interpreted, in which case another solver works too."""
    from energyopt.dynamics.kernels import kernels_of

    return kernels_of(eo.load_robot("panda").dynamics).kind


def more(now: dict[str, dict[str, int]], reference: dict[str, dict[str, int]]) -> list[str]:
    """What takes more work now than it did: each count over the whole suite, and single problems that take far more.

    The middle of all ratios is what the code does to problems in general. Rounding, which sends a single solve another way
    now and then, moves it by a few per cent.
    """
    found = []
    for key in COUNTS:
        ratio = {name: now[name][key] / max(reference[name][key], 1) for name in reference}
        middle = float(np.median(list(ratio.values())))
        if middle > GENERAL:
            found.append(f"{key}: {100 * (middle - 1):.0f} % more than the reference in the middle of {len(ratio)} problems")
        found += [f"{key} of {name}: {value:.1f} times the reference" for name, value in ratio.items() if value > SINGLE]
    return found


def main() -> None:
    if kind() != "compiled":
        raise SystemExit("the reference is that of compiled kernels, and there is no C compiler here")
    reference = {name: counted(problem, options) for name, problem, options in suite()}
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_text(json.dumps(reference, indent=1) + "\n")
    print(FILE.read_text())


if __name__ == "__main__":
    main()
