"""One rival on one robot, in a process of its own:  python _rivals_case.py '{"rival": …, "robot": …, "moves": …, "seed": …}'

Prints one line of JSON when prepared and one after each move, so that what was finished stands where a process is ended.
"""

from __future__ import annotations

import json
import resource
import sys
from dataclasses import asdict
from importlib import import_module

from _rival import Rival
from _rivals_judge import judge
from _shared import random_moves

import energyopt as eo
from energyopt.threads import single_thread

RIVALS = {
    "quintic": ("_rival_own", "Quintic"),
    "energyopt_coarse": ("_rival_own", "OursCoarser"),
    "energyopt": ("_rival_own", "Ours"),
    "energyopt_tighter": ("_rival_own", "OursTighter"),
    "energyopt_default": ("_rival_own", "OursByDefault"),
    "hermite_simpson": ("_rival_hermite_simpson", "HermiteSimpson"),
    "hermite_simpson_coarse": ("_rival_hermite_simpson", "Coarser"),
    "textbook": ("_rival_textbook", "Splines"),
    "crocoddyl": ("_rival_crocoddyl", "Fddp"),
    "mim_solvers": ("_rival_crocoddyl", "Csqp"),
    "drake": ("_rival_drake", "Kinematic"),
}
"""By name, where each rival is."""


def rival(name: str) -> type[Rival]:
    module, attribute = RIVALS[name]
    return getattr(import_module(module), attribute)


def main() -> None:
    case = json.loads(sys.argv[1])
    robot, planner = eo.load_robot(case["robot"]), rival(case["rival"])()
    moves = random_moves(robot, case["moves"], case["seed"])
    before = _processor_time()
    planner.prepare(robot)
    print(json.dumps({"prepare": _processor_time() - before}), flush=True)
    for move in moves:
        with single_thread():
            attempt = planner.solve(move)
        found = judge(move, attempt.motion)
        line = {"move": move.name, "duration": move.duration, "converged": attempt.converged, "iterations": attempt.iterations}
        line |= {"seconds": attempt.seconds, "build": attempt.build, **asdict(found)}
        print(json.dumps(line | {"violation": found.violation, "valid": found.valid}), flush=True)


def _processor_time() -> float:
    """Of this process and of those it started and that have ended (compilers) [s]."""
    return sum(resource.getrusage(who).ru_utime for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


if __name__ == "__main__":
    main()
