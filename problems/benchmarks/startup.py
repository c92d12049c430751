"""Waiting before the first result: import, the first ever run, a run after that, and solving without a C compiler.

Each is a fresh process. `import` is the median over several; the first run finds an empty kernel cache and an empty Matplotlib
configuration, as on a new machine (byte code and files may be in the system's caches), and goes from a problem file to a
replayed and validated plan in a folder. Processor time includes that of the compiler.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from _shared import CLOCKS, Goal, Report, parser, publish, settings, table

from energyopt.dynamics.compiler import find_compiler

MEASURES = "seconds of `import energyopt`, of the first ever `energyopt plan`, and of solves without a C compiler"
HEAVY = ("mujoco", "matplotlib", "casadi", "pinocchio", "scipy")
UNWANTED = ("mujoco", "matplotlib")
SUITES = {"speed": "fixed knots", "accuracy": "default accuracy"}
_IMPORT = f"""
import sys, time
began = time.perf_counter()
import energyopt
print(time.perf_counter() - began, *(name for name in {HEAVY} if name in sys.modules))
"""
_HERE = Path(__file__).resolve().parent


def main() -> int:
    made = parser("startup", MEASURES)
    made.add_argument("--problem", default="panda_reach", help="file or catalogue name, for the first run")
    made.add_argument("--robot", default="panda", help="for the random moves without a compiler")
    made.add_argument("--problems", type=int, default=5, metavar="N", help="random moves without a compiler")
    made.add_argument("--repeats", type=int, default=5, metavar="N", help="imports")
    made.add_argument("--no-figures", action="store_true", help="leave figures and report page out of the first run")
    parsed = made.parse_args()
    results = {
        "import": _imports(parsed.repeats),
        **_runs(parsed),
        "interpreted": {suite: _interpreted(suite, parsed) for suite in SUITES},
    }
    return publish(Report("startup", MEASURES, settings(parsed), results, _text(results), _goals(results)), parsed.json)


def _imports(repeats: int) -> dict:
    """Import times [s], and which heavy packages came along."""
    lines = [_python("-c", _IMPORT)[0].split() for _ in range(repeats)]
    brings = {name for line in lines for name in line[1:]}
    return {"seconds": float(np.median([float(line[0]) for line in lines])), "brings": sorted(brings)}


def _runs(parsed) -> dict:
    """`energyopt plan` twice with a cache that is empty at first: wall and processor seconds from process start to end."""
    with tempfile.TemporaryDirectory() as folder:
        fresh = {"ENERGYOPT_CACHE": f"{folder}/cache", "MPLCONFIGDIR": f"{folder}/matplotlib", "MPLBACKEND": "Agg"}
        options = ["--no-figures"] if parsed.no_figures else []
        return {name: _run([parsed.problem, *options], Path(folder) / name, fresh) for name in ("first_run", "second_run")}


def _run(arguments: list[str], out: Path, environment: dict[str, str]) -> dict:
    _, wall, cpu = _python("-m", "energyopt", "plan", *arguments, "--out", str(out), "--quiet", environment=environment)
    summary = json.loads((out / "summary.json").read_text())
    return {"wall": wall, "cpu": cpu, "valid": summary["valid"], "time_s": summary["time_s"]}


def _interpreted(suite: str, parsed) -> dict:
    """A suite of random moves run without a compiler: medians of its `solve` [s] by clock."""
    given = {"robot": parsed.robot, "problems": parsed.problems, "seed": parsed.seed, "repeats": 1}
    arguments = [word for key, value in given.items() for word in (f"--{key}", str(value))]
    arguments += ["--rivals", "0"] if suite == "speed" else ["--no-truth"]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "results.json"
        _python(str(_HERE / f"{suite}.py"), *arguments, "--json", str(path), environment={"ENERGYOPT_CC": "none"})
        results = json.loads(path.read_text())["results"]
    seconds = {clock: by["solve"] if suite == "speed" else by for clock, by in results["seconds"].items()}
    return {"share_solved": results["share_solved"], **{clock: by["median"] for clock, by in seconds.items()}}


def _python(*arguments: str, environment: dict[str, str] | None = None) -> tuple[str, float, float]:
    """Output of a Python process, and its wall and processor seconds, those of its children included."""
    wall, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, **(environment or {})}
    done = subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, text=True, check=False)
    wall, after = time.perf_counter() - wall, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise SystemExit(f"{' '.join(arguments)[:80]}: exit code {done.returncode}: {done.stderr.strip()[-300:]}")
    return done.stdout, wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _text(results: dict) -> str:
    brings = ", ".join(results["import"]["brings"]) or "none"
    rows = [(f"import energyopt (of {', '.join(HEAVY)} it brings: {brings})", f"{results['import']['seconds']:.3f}", "")]
    for name, words in (("first_run", "first ever run"), ("second_run", "second run")):
        run = results[name]
        parts = ", ".join(f"{stage} {seconds:.2g}" for stage, seconds in run["time_s"].items() if seconds is not None)
        rows.append((f"{words}, {'valid' if run['valid'] else 'NOT valid'} ({parts})", f"{run['wall']:.1f}", f"{run['cpu']:.1f}"))
    for suite, run in results["interpreted"].items():
        solved = f"{100 * run['share_solved']:.0f} % solved"
        rows.append((f"solve without a compiler, {SUITES[suite]}, median ({solved})", f"{run['wall']:.2f}", f"{run['cpu']:.2f}"))
    return table(("seconds", "wall", "processor"), rows)


def _goals(results: dict) -> list[Goal]:
    unwanted = set(UNWANTED) & set(results["import"]["brings"])
    goals = [
        Goal("import", results["import"]["seconds"], 1.0, "s"),
        Goal(f"of {', '.join(UNWANTED)} loaded", len(unwanted), 0, ""),
    ]
    if find_compiler():
        goals.append(Goal("first ever run", results["first_run"]["wall"], 30.0, "s"))
    for suite, run in results["interpreted"].items():
        goals += [Goal(f"solve without a compiler, {SUITES[suite]}, {clock} time", run[clock], 1.0, "s") for clock in CLOCKS]
    return goals


if __name__ == "__main__":
    sys.exit(main())
