"""What each command of the command line does: parsed arguments in, exit code out. Modules are loaded when they are needed."""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from energyopt.errors import FileError
from energyopt.exit_codes import INTERRUPTED, INVALID, VALID
from energyopt.stopping import say_at_the_end

if TYPE_CHECKING:
    from energyopt.plans import Plan


def _plan(parsed: argparse.Namespace) -> int:
    """Plan, replay, write, print."""
    from energyopt.io import load_task
    from energyopt.plans import Status
    from energyopt.workflow import run

    problem, options = load_task(parsed.problem, _overrides(parsed))
    verbose = sys.stderr.isatty() and not parsed.quiet
    outcome = run(problem, options, parsed.out, replay=not parsed.no_replay, figures=not parsed.no_figures, verbose=verbose)
    code = _shown(outcome, parsed.quiet)
    return INTERRUPTED if outcome.plan.status is Status.INTERRUPTED else code


def _batch(parsed: argparse.Namespace) -> int:
    """Plan many problem files and print a line for each."""
    from energyopt.batch_files import check_overrides, plan_files, problem_files
    from energyopt.tables import batch_line, batch_total

    paths, overrides = problem_files(parsed.problems), _overrides(parsed)
    check_overrides(paths, overrides)
    show = (lambda row: None) if parsed.quiet else (lambda row: print(batch_line(row), flush=True))
    options = {"processes": parsed.processes, "replay": not parsed.no_replay, "progress": not parsed.quiet}
    rows = plan_files(paths, parsed.out, overrides=overrides, show=show, **options)
    if not parsed.quiet:
        print(batch_total(rows, parsed.out))
    return VALID if all(row.valid for row in rows) else INVALID


def _overrides(parsed: argparse.Namespace) -> dict:
    return {key: value for key, value in vars(parsed).items() if "." in key and value is not None}


def _sweep(parsed: argparse.Namespace) -> int:
    """Print the energy–time curve, and write it."""
    from energyopt.io import load_task
    from energyopt.planning import DEFAULTS
    from energyopt.sweep_files import write_sweep
    from energyopt.sweeping import sweep
    from energyopt.workflow import prepare_folder

    problem, options = load_task(parsed.problem)
    known = {key: value for key, value in options.items() if key in (*DEFAULTS, "parameterization")}
    if parsed.out is not None:
        prepare_folder(parsed.out)  # before hours of work
    curve = sweep(problem, parsed.duration, processes=parsed.processes, **known)
    figures = not (parsed.no_figures or curve.interrupted)  # whoever interrupts wants an end
    files = () if parsed.out is None else write_sweep(curve, parsed.out, figures)
    if curve.interrupted and files:
        say_at_the_end(f"energyopt: interrupted; what there is of the curve is in {parsed.out}")
    print(curve)
    if files:
        print("files: " + ", ".join(map(str, files)))
    if curve.interrupted:
        return INTERRUPTED
    return VALID if any(point.solved for point in curve.points) else INVALID


def _scale(parsed: argparse.Namespace) -> int:
    """Make a saved plan slower or faster."""
    from energyopt.rescaling import rescale
    from energyopt.workflow import judge_and_write, prepare_folder

    plan = _saved(parsed)
    if parsed.out is not None:
        prepare_folder(parsed.out)
    limits = plan.problem.limits
    chosen = {"cheapest": lambda s: s.cheapest(limits=limits), "fastest": lambda s: s.least_duration(limits)}
    scaled = rescale(plan, chosen.get(parsed.chosen, parsed.duration))
    replay = scaled.solved and not parsed.no_replay
    return _shown(judge_and_write(scaled, parsed.out, replay=replay, figures=not parsed.no_figures))


def _replay(parsed: argparse.Namespace) -> int:
    """Replay a saved plan."""
    from energyopt.workflow import judge_and_write, prepare_folder

    plan = _saved(parsed)
    if parsed.out is not None:
        prepare_folder(parsed.out)
    names = ("stiffness", "damping", "physics_step", "collisions")
    options = {name: getattr(parsed, name) for name in names if getattr(parsed, name) is not None}
    if parsed.model is not None:
        options["plant"] = _model(parsed.model)
    outcome = judge_and_write(plan, parsed.out, figures=not parsed.no_figures, **options)
    return _shown(outcome)


def _robust(parsed: argparse.Namespace) -> int:
    """Judge a saved plan for arms unlike their model."""
    from energyopt.robust_workflow import run

    plan = _saved(parsed)
    bounds = {key: getattr(parsed, key) for key in ("payload", "masses", "friction")}
    names = ("delay", "position_noise", "velocity_noise", "physics_step", "collisions")
    replay = {name: getattr(parsed, name) for name in names if getattr(parsed, name) is not None}
    found = run(plan, bounds, parsed.samples, parsed.trials, parsed.seed, replay, parsed.out)
    print(found)
    return VALID if found.holds else INVALID


def _saved(parsed: argparse.Namespace) -> Plan:
    """The plan in a file, or in the folder it was written to."""
    from energyopt.io import load_plan

    path = Path(parsed.plan)
    return load_plan(path / "plan.npz" if path.is_dir() else path)


def _shown(outcome, quiet: bool = False) -> int:
    from energyopt.tables import outcome_table

    if not quiet:
        print(outcome_table(outcome))
    return VALID if outcome.summary["valid"] else INVALID


def _model(given: str):
    from energyopt.io import load_problem
    from energyopt.robots import load_robot

    return load_problem(given).robot if given.endswith(".toml") else load_robot(given)


def _bench(parsed: argparse.Namespace) -> int:
    """Run benchmark scripts, each in a process of its own."""
    from energyopt.io import problems_folder

    folder = problems_folder() / "benchmarks"
    scripts = {path.stem: path for path in sorted(folder.glob("*.py")) if not path.stem.startswith("_")}
    if not scripts:
        raise FileError(f"{folder}: no benchmark scripts there")
    if parsed.suite and parsed.suite not in scripts:
        raise FileError(f"no benchmark suite '{parsed.suite[:80]}'; expected one of {', '.join(scripts)}")
    for name in [parsed.suite] if parsed.suite else scripts:
        code = subprocess.run([sys.executable, str(scripts[name])], check=False).returncode
        if code:
            return INVALID if code > 0 else 128 - code
    return VALID


def _robots(parsed: argparse.Namespace) -> int:
    """List the catalogue."""
    from energyopt.robots import catalogue, load_robot
    from energyopt.robots.text import robots_table

    print(robots_table(catalogue(), load_robot))
    return VALID


def _check(parsed: argparse.Namespace) -> int:
    """Check a problem or a robot."""
    from energyopt.clearance_checks import check_ends
    from energyopt.feasibility import check_feasibility
    from energyopt.io import load_task
    from energyopt.robots import load_robot

    if Path(parsed.file).suffix.lower() in (".urdf", ".xml"):
        print(load_robot(Path(parsed.file)))
        return VALID
    problem, _ = load_task(parsed.file)
    print(problem.robot)
    longest = problem.lasting(problem.durations[1])
    check_feasibility(longest)
    check_ends(longest, longest.goal_position)
    span = " to ".join(f"{t:g}" for t in dict.fromkeys(problem.durations))
    print(f"{problem.name}: a well-formed problem of {span} s; no reason was found why it could not be solved")
    return VALID


COMMANDS = {
    "plan": _plan,
    "batch": _batch,
    "sweep": _sweep,
    "scale": _scale,
    "replay": _replay,
    "robust": _robust,
    "bench": _bench,
    "robots": _robots,
    "check": _check,
}
