"""How processor time and memory of a plan grow with joints, control points and obstacles, one of them at a time.

From a base of a Panda with 16 control points and nothing in its way: other arms, up to the 30 joints of a humanoid hung up by
its pelvis; 8 to 200 control points; 0 to 200 spheres, five at random places and the others where they leave the optimum among
those as it is, so that the task stays as hard. The knots are fixed. An exponent p is that of the power law a·nᵖ nearest to the
medians (least squares in logarithms) over the upper half of an axis, where what does not grow with n weighs little. Every setting
runs in processes of its own (`_scaling_case.py`): one for times, one for memory, which gives freed memory back to the system at
once. Otherwise a plan would take its memory from what an earlier one had left, and its peak would tell nothing.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from _scaling_figure import draw
from _shared import Goal, Report, parser, publish, quartiles, settings, shown, table

MEASURES = "processor time and memory of energyopt.plan on fixed knots, against joints, control points and obstacles"
AXES = {"joints": "joints", "control_points": "control points", "obstacles": "spheres"}
BASE = {"robot": "panda", "control_points": 16, "obstacles": None}
STAGES = ("plan", "solve")
JOINT_GOALS = {14: 0.150, 30: 2.0}
"""Seconds of a plan with 16 control points, by joints."""
RETURNED = {"MALLOC_MMAP_THRESHOLD_": "32768", "MALLOC_TRIM_THRESHOLD_": "0", "MALLOC_TOP_PAD_": "0"}
"""Environment in which the GNU C library returns freed memory at once; others do not read it."""
LINEAR = 1.15
"""An exponent up to this is called linear."""


def main() -> int:
    parsed = _arguments()
    cases = {
        "joints": [{**BASE, "robot": name} for name in parsed.robots],
        "control_points": [{**BASE, "robot": parsed.base, "control_points": n} for n in parsed.control_points],
        "obstacles": [{**BASE, "robot": parsed.base, "obstacles": n} for n in parsed.obstacles],
    }
    results = {axis: _axis(axis, some, parsed) for axis, some in cases.items() if some}
    if parsed.figure is not None:
        draw(results, AXES, parsed.figure)
    return publish(Report("scaling", MEASURES, _settings(parsed), results, _text(results), _goals(results)), parsed.json)


def _arguments():
    made = parser("scaling", MEASURES)
    robots = ["ur5", "panda", "xarm7", "baxter", "tiago_dual", "talos_upper", "talos_hung"]
    made.add_argument("--robots", nargs="*", default=robots, metavar="NAME", help="catalogue names, talos_upper, talos_hung")
    made.add_argument("--base", default=BASE["robot"], metavar="NAME", help="robot of the other two axes")
    made.add_argument("--control-points", type=int, nargs="*", default=[8, 12, 16, 25, 35, 50, 70, 100, 140, 200], metavar="N")
    made.add_argument("--obstacles", type=int, nargs="*", default=[0, 5, 10, 25, 50, 100, 200], metavar="N")
    made.add_argument("--moves", type=int, default=8, metavar="N", help="random moves a setting")
    made.add_argument("--repeats", type=int, default=2, metavar="N", help="plans a move, of which the quickest counts")
    made.add_argument("--figure", type=Path, metavar="FILE", help="draw the results there")
    return made.parse_args()


def _settings(parsed) -> dict:
    return {key: value for key, value in settings(parsed).items() if key != "figure"}


def _axis(axis: str, cases: list[dict], parsed) -> dict:
    """All settings of an axis, in turn, and the exponents."""
    points = []
    for case in cases:
        found = _measured({**case, "moves": parsed.moves, "repeats": parsed.repeats, "seed": parsed.seed})
        points.append(_point(axis, case, found))
        print(f"  {axis} {points[-1]['n']}: {points[-1]['seconds']['plan']['median']:.3f} s", file=sys.stderr)
    points.sort(key=lambda point: point["n"])
    keys = {stage: (lambda point, stage=stage: point["seconds"][stage]["median"]) for stage in STAGES}
    keys |= {"iteration": lambda point: point["iteration_s"]["median"], "iterations": lambda point: point["iterations"]["median"]}
    keys |= {"memory": lambda point: point["memory_MB"]["median"]}
    return {"points": points, "exponents": {name: exponent(points, key) for name, key in keys.items()}}


def _measured(case: dict) -> dict:
    """Times and memory, each from a process of its own."""
    return _run({**case, "what": "times"}, {}) | _run({**case, "what": "memory"}, RETURNED)


def _run(case: dict, environment: dict[str, str]) -> dict:
    script = Path(__file__).with_name("_scaling_case.py")
    command = [sys.executable, str(script), json.dumps(case)]
    run = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | environment)
    if run.returncode:
        raise SystemExit(f"scaling: {case} failed: {run.stderr.strip().splitlines()[-1:]}")
    return json.loads(run.stdout)


def _point(axis: str, case: dict, found: dict) -> dict:
    runs = found["runs"]
    return {
        "n": found["joints"] if axis == "joints" else case[axis],
        "robot": case["robot"],
        "seconds": {stage: quartiles([run["seconds"][stage] for run in runs]) for stage in STAGES},
        "iterations": quartiles([run["iterations"] for run in runs]),
        "evaluations": quartiles([run["evaluations"] for run in runs]),
        "iteration_s": quartiles([run["seconds"]["solve"] / max(run["iterations"], 1) for run in runs]),
        "share_solved": float(np.mean([run["status"] == "SOLVED" for run in runs])),
        "memory_MB": quartiles(found["memory_MB"]),
        "runs": runs,
    }


def exponent(points: list[dict], value) -> float | None:
    """Of the power law nearest to the upper half of the axis; None where there are not two sizes, or nothing was measured."""
    upper = [point for point in points if point["n"] > 0]
    upper = [point for point in upper if point["n"] >= np.median([other["n"] for other in upper])]
    n, values = np.array([point["n"] for point in upper], float), np.array([value(point) for point in upper], float)
    if len(set(n)) < 2 or not (values > 0).all():
        return None
    return float(np.polyfit(np.log(n), np.log(values), 1)[0])


def _text(results: dict) -> str:
    text = []
    for axis, found in results.items():
        rows = [_row(point) for point in found["points"]]
        head = (AXES[axis], "robot", "plan [ms]", "solve [ms]", "iterations", "an iteration [ms]", "memory [MB]", "solved")
        text.append(table(head, rows))
        known = [f"{name} {value:.2f}" for name, value in found["exponents"].items() if value is not None]
        text.append(f"  exponents over the upper half: {', '.join(known) or 'none'}\n\n")
    return "".join(text)


def _row(point: dict) -> tuple:
    times = [shown(point["seconds"][stage], ".1f", 1e3) for stage in STAGES]
    each = shown(point["iteration_s"], ".2f", 1e3)
    solved = f"{100 * point['share_solved']:.0f} %"
    memory = shown(point["memory_MB"], ".1f")
    return point["n"], point["robot"], *times, shown(point["iterations"], ".0f"), each, memory, solved


def _goals(results: dict) -> list[Goal]:
    """Times by joints; linear growth of time and memory in points and obstacles."""
    goals = []
    for point in results.get("joints", {}).get("points", []):
        if point["n"] in JOINT_GOALS:
            what = f"{point['robot']}, {point['n']} joints, plan"
            goals.append(Goal(what, 1e3 * point["seconds"]["plan"]["median"], 1e3 * JOINT_GOALS[point["n"]], "ms"))
    for axis in ("control_points", "obstacles"):
        exponents = results.get(axis, {}).get("exponents", {})
        for name in ("plan", "iteration", "memory"):
            if exponents.get(name) is not None:
                goals.append(Goal(f"exponent of {name} in {AXES[axis]}", exponents[name], LINEAR, ""))
    return goals


if __name__ == "__main__":
    sys.exit(main())
