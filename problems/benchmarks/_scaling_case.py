"""One setting of `scaling.py`, measured in a process of its own:  python _scaling_case.py '{"robot": …}'

Prints JSON: for each move, the least processor time of each stage over the repeats, iterations and evaluations; and by how much
memory grew at its peak while the moves were planned, after one plan of the smallest size had loaded all there is to load.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from dataclasses import replace

import numpy as np
from _shared import MOST_DRAWS, random_moves

import energyopt as eo
from energyopt.clearance_checks import check_ends, clearance_of
from energyopt.clock import timed_by
from energyopt.dynamics.kernels import kernels_of
from energyopt.errors import InputError
from energyopt.robots.catalogue import robots_folder

TALOS = "talos_data/robots/talos_reduced.urdf"
BODIES = {"talos_upper": "torso_* arm_* head_*", "talos_hung": "leg_* torso_* arm_* head_*"}
"""Joints of a humanoid bolted to the ground by its pelvis: without its legs, and hung up so that they swing."""
RADIUS = 0.04
"""Of the obstacles [m]."""
REACH = (0.3, 1.1)
"""Distance of their centres from the middle of the arm's base, raised by a third of a metre [m]."""
APART = 0.03
"""Least distance between an obstacle and what it was placed clear of [m]."""
WAYLAYING = 5
"""Obstacles that may be in the way."""
WARM_UP = eo.BSpline(control_points=8, accuracy=None)


def main() -> None:
    case = json.loads(sys.argv[1])
    robot = load(case["robot"])
    moves = random_moves(robot, case["moves"], case["seed"])
    if case["obstacles"] is not None:
        moves = [among(move, case["obstacles"], case["seed"]) for move in moves]
    kernels_of(robot.dynamics)
    eo.plan(moves[0], WARM_UP, starts=1, throw=False)
    spline = eo.BSpline(control_points=case["control_points"], accuracy=None)
    before = memory("VmRSS")
    _forget_peak()
    runs = [measured(move, spline, case["repeats"]) for move in moves]
    print(json.dumps({**case, "joints": robot.nv, "runs": runs, "memory_MB": memory("VmHWM") - before}))


def load(name: str) -> eo.RobotModel:
    """A robot of the catalogue, or one of `BODIES`."""
    return eo.load_robot(robots_folder() / TALOS, joints=BODIES[name].split()) if name in BODIES else eo.load_robot(name)


def among(move: eo.Problem, count: int, seed: int) -> eo.Problem:
    """A move among spheres at random places.

    The first `WAYLAYING` keep clear of start and goal only; the others keep clear of the optimum among those too, so that it is
    one, and the task as hard, however many there are. Fewer are the first of more.
    """
    rng = np.random.default_rng(seed)
    few = _placed(move, [], min(count, WAYLAYING), rng, None)
    if count <= WAYLAYING:
        return replace(move, obstacles=few)
    found = eo.plan(replace(move, obstacles=few), eo.BSpline(control_points=16, accuracy=None), throw=False)
    return replace(move, obstacles=_placed(move, few, count, rng, found.trajectory if found.solved else None))


def _placed(move: eo.Problem, spheres: list, count: int, rng: np.random.Generator, motion) -> list:
    """Spheres, and random ones up to a number, clear of the ends of a move, and of a motion where there is one."""
    spheres = list(spheres)
    for _ in range(MOST_DRAWS * count + 1):
        if len(spheres) == count:
            return spheres
        direction = rng.normal(size=3)
        center = [0.0, 0.0, 0.33] + rng.uniform(*REACH) * direction / np.linalg.norm(direction)
        sphere = eo.Sphere(RADIUS, center)
        alone = replace(move, obstacles=[sphere], clearance=APART)
        try:
            check_ends(alone, alone.goal_position)
        except InputError:
            continue
        if motion is None or clearance_of(alone, motion)[0].amount == 0.0:
            spheres.append(sphere)
    raise SystemExit(f"{move.name}: there is no room for {count} spheres")


def measured(move: eo.Problem, spline: eo.BSpline, repeats: int) -> dict:
    """Plan a move several times; the stages of the quickest."""
    quickest = None
    for _ in range(repeats):
        with timed_by(time.process_time):
            began = time.process_time()
            plan = eo.plan(move, spline, starts=1, throw=False)
            total = time.process_time() - began
        if quickest is None or total < quickest["plan"]:
            quickest = {**plan.time_s, "plan": total}
    counted = {"iterations": plan.iterations, "evaluations": sum(plan.options["evaluations"].values())}
    return {"status": plan.status.value, "objective": plan.objective, "seconds": quickest, **counted}


def memory(key: str) -> float:
    """VmRSS, what this process holds now, or VmHWM, its peak [MB]."""
    try:
        with open("/proc/self/status") as file:
            return next(float(line.split()[1]) for line in file if line.startswith(key)) / 1024
    except OSError:  # macOS tells the peak since the beginning only, in bytes
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def _forget_peak() -> None:
    """Let VmHWM begin anew, where that can be."""
    try:
        with open("/proc/self/clear_refs", "w") as file:
            file.write("5")
    except OSError:
        pass


if __name__ == "__main__":
    main()
