"""Planning in published clutter: problems of MotionBenchMaker (C. Chamzas et al., IEEE Robotics and Automation Letters 7, 2022).

Each is planned from rest to rest in 1.5 times the least duration that the limits of velocity and torque allow on a path found by
sampling (RRT-Connect, shortened, corners rounded). That path, timed at the same duration by the same law, is the baseline. Plans
are judged by `_mbm_judge`, which shares no check with energyopt; a false success is a plan that says SOLVED and fails there.

Times, by wall and by processor clock: ``plan`` is one call of `energyopt.plan` with all it does: feasibility, its own search for
guesses, optimisation, exact check. ``all`` adds the search and the timing of the path that gives the duration. Neither has what a
process does once for a robot (reading it, compiling or loading kernels, covering it with spheres), which is stated apart.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from _mbm import MbmProblem, read_mbm
from _mbm_judge import ProblemJudge
from _mbm_robot import RobotJudge
from _mbm_text import goals, summary, text
from _shared import CLOCKS, Report, parser, publish, settings

import energyopt as eo
from energyopt.dynamics.kernels import kernels_of
from energyopt.errors import EnergyOptError, InputError
from energyopt.geometry.robot_spheres import robot_spheres
from energyopt.geometry.self_collision import self_collision_pairs
from energyopt.pathfinding import Budget, FreeSpace, find_path, rounded, shortest_duration, timed

MEASURES = "plans among published obstacles: how many are solved and valid, how soon, what they save against their seed path"
SLOWER = 1.5
"""Duration over the least on the path."""
SEARCHES, SEARCH_SECONDS = 3, 20.0
"""Paths looked for, one after another, and the time for each [s]."""
ROUNDING = 1e-6
"""Starts and goals so little outside a position limit [rad] are put on it: files hold few digits."""
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
VARIABLE = "ENERGYOPT_MBM"


def main() -> int:
    made = parser("mbm", MEASURES)
    made.add_argument(
        "folder", nargs="?", type=Path, default=os.environ.get(VARIABLE), help=f"of the problems; {VARIABLE} if left out"
    )
    made.add_argument("--limit", type=int, metavar="N", help="problems at most")
    made.add_argument("--every", type=int, default=1, metavar="K", help="only every K-th problem")
    made.add_argument("--processes", type=int, default=2, metavar="N", help="problems planned at a time, each in one thread")
    made.add_argument("--robot-urdf", type=_named_path, action="append", default=[], metavar="NAME=PATH", help="URDF of a robot")
    made.add_argument("--control-points", type=int, metavar="N", help="a joint, to begin with")
    made.add_argument("--accuracy", type=float, default=0.01, help="of J; 0 keeps the first knots")
    made.add_argument("--time-limit", type=float, default=60.0, metavar="S", help="for the searches of one plan")
    parsed = made.parse_args()
    if parsed.folder is None:
        print(f"mbm: no problems: give the folder of MotionBenchMaker's JSON files, or set {VARIABLE} to it")
        return 0
    if min(parsed.every, parsed.processes, parsed.limit or 1) < 1:
        made.error("--every, --processes and --limit: expected at least 1")
    try:
        found = _measured(parsed)
    except InputError as error:
        print(f"mbm: {error}", file=sys.stderr)
        return 2
    results = {"problems": found, **summary(found)}
    given = {key: str(value) if isinstance(value, Path) else value for key, value in settings(parsed).items()}
    return publish(Report("mbm", MEASURES, given, results, text(results), goals(results)), parsed.json)


def _named_path(given: str) -> tuple[str, str]:
    name, sign, path = given.partition("=")
    if not (name and sign and path):
        raise argparse.ArgumentTypeError(f"'{given}': expected NAME=PATH, such as fetch=fetch.urdf")
    return name, path


def _measured(parsed: argparse.Namespace) -> list[dict]:
    """A record for every problem, in their order; a line on standard error as each ends."""
    os.environ.update(dict.fromkeys(THREADS, "1"))
    count = sum(1 for _ in _problems(parsed))
    if parsed.processes == 1 or count == 1:
        return [_shown(_run(parsed, k), count) for k in range(count)]
    found: dict[int, dict] = {}
    with ProcessPoolExecutor(parsed.processes, get_context("spawn")) as executor:
        tasks = {executor.submit(_run, parsed, k): k for k in range(count)}
        for done in as_completed(tasks):
            found[tasks[done]] = _shown(done.result(), count)
    return [found[k] for k in range(count)]


def _problems(parsed: argparse.Namespace) -> Iterator[MbmProblem]:
    return islice(read_mbm(parsed.folder, dict(parsed.robot_urdf)), 0, parsed.limit and parsed.limit * parsed.every, parsed.every)


def _shown(record: dict, count: int) -> dict:
    said = record["status"] + ("" if record["valid"] else f" {record['why']}")
    seconds = record["seconds"]["plan"]["wall"] if record["seconds"] else 0.0
    print(f"  {record['number'] + 1}/{count} {record['id']}: {said}, {seconds:.2f} s", file=sys.stderr, flush=True)
    return record


_read: list[MbmProblem] = []
_judges: dict[Any, RobotJudge] = {}
_prepared: dict[int, float] = {}


def _run(parsed: argparse.Namespace, number: int) -> dict:
    """One problem from the path to the verdict."""
    if not _read:
        _read.extend(_problems(parsed))
    problem = _read[number]
    entry, robot = problem.entry, problem.robot
    record = {"id": problem.id, "number": number, "group": f"{entry['robot']} {entry.get('scene', '')}".strip()}
    record |= {"status": "", "why": "", "valid": False, "false_success": False, "ends": [], "seconds": None, "preparation_s": 0.0}
    if id(robot) not in _prepared:
        began = time.perf_counter()
        kernels_of(robot.dynamics), robot_spheres(robot), self_collision_pairs(robot)
        _prepared[id(robot)] = record["preparation_s"] = time.perf_counter() - began
        _judges[id(robot)] = RobotJudge(robot, entry["joint_names"], entry["fixed_joints"])
    judge = ProblemJudge(_judges[id(robot)], entry)
    record["ends"] = judge.faults_of_ends()
    if record["ends"]:
        return record | {"status": "INVALID_ENDS", "why": "; ".join(record["ends"])}
    return record | _planned(problem, judge, parsed)


def _planned(problem: MbmProblem, judge: ProblemJudge, parsed: argparse.Namespace) -> dict:
    """Path, duration, baseline, plan, verdicts."""
    robot, read = problem.robot, _readings()
    start, goal = (_on_limits(q, robot.limits) for q in (problem.start, problem.goal))
    order = [problem.entry["joint_names"].index(name) for name in robot.joint_names]
    try:
        curve, tries = _path(problem, start, goal, parsed.seed)
        least = shortest_duration(curve, robot)
        duration, searched = SLOWER * least, read()
        task = eo.Problem(robot, start, goal, duration, obstacles=problem.obstacles, name=problem.id)
        spline = eo.BSpline(control_points=parsed.control_points, accuracy=parsed.accuracy or None)
        read = _readings()
        plan = eo.plan(task, spline, seed=parsed.seed, time_limit=parsed.time_limit, throw=False)
    except EnergyOptError as error:
        return {"status": "REFUSED", "why": str(error), "seconds": {key: read() for key in ("plan", "all")}}
    spent = read()
    seconds = {"path": searched, "plan": spent, "all": {clock: searched[clock] + spent[clock] for clock in CLOCKS}}
    verdict = judge.judge(plan.trajectory, order, duration)
    baseline = judge.judge(timed(curve, robot, duration=duration), order, duration)
    saving = {key: 1.0 - getattr(verdict, key) / getattr(baseline, key) for key in ("torque_squared", "energy")}
    return {
        "status": plan.status.value,
        "why": "; ".join(verdict.faults) if plan.solved else plan.message,
        "valid": plan.solved and verdict.valid,
        "false_success": plan.solved and not verdict.valid,
        "seconds": seconds,
        "paths": tries,
        "least_duration_s": least,
        "duration_s": duration,
        "judged": _plain(asdict(verdict)),
        "baseline": _plain(asdict(baseline)),
        "saving": {key: float(value) if np.isfinite(value) else None for key, value in saving.items()},
        "plan": _told(plan),
    }


def _path(problem: MbmProblem, start: np.ndarray, goal: np.ndarray, seed: int) -> tuple[Any, int]:
    """The curve that gives the duration, and how many searches it took."""
    free = FreeSpace.of(problem.robot, problem.obstacles)
    for k in range(SEARCHES):
        found = find_path(free, [start, goal], np.random.default_rng([seed, k]), Budget(SEARCH_SECONDS))
        if found.found:
            return rounded(found.path, free), k + 1
    raise eo.EnergyOptError(f"no path in {SEARCHES} searches: {found.reason}")


def _told(plan: eo.Plan) -> dict:
    """What the plan says of itself."""
    worst = {name: [joint, float(t)] for name, (joint, t) in plan.violations.worst.items()}
    amount = {name: float(value) for name, value in plan.max_violation.items() if np.isfinite(value)}
    counts = {key: plan.options[key] for key in ("guess", "tried", "levels", "torque_rows", "clearance_rows")}
    told = {
        "torque_squared": float(plan.cost_terms["torque_squared"]),
        "iterations": plan.iterations,
        "time_s": plan.time_s,
        **counts,
    }
    return told | {"message": plan.message, "violation": amount, "worst": worst, "distance": plan.violations.distance}


def _readings():
    """A function that gives seconds since now, by every clock."""
    began = {clock: now() for clock, now in CLOCKS.items()}
    return lambda: {clock: now() - began[clock] for clock, now in CLOCKS.items()}


def _on_limits(q: np.ndarray, limits: Any) -> np.ndarray:
    put = np.clip(q, limits.lower, limits.upper)
    return np.where(np.abs(put - q) <= ROUNDING, put, q)


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """Without numbers that JSON does not have."""
    return {key: None if isinstance(value, float) and not np.isfinite(value) else value for key, value in values.items()}


if __name__ == "__main__":
    sys.exit(main())
