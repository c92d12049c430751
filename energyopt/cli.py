"""The command line: arguments in, exit code out. The work is done by `workflow`, `tables` and `io`.

Exit codes: 0 solved and valid, 1 no valid plan, 2 bad input (one line on stderr says what and where), 130 interrupted.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from energyopt import __version__
from energyopt.errors import EnergyOptError, FileError
from energyopt.stopping import INTERRUPTED

if TYPE_CHECKING:
    import numpy as np

VALID, INVALID, BAD_INPUT, BROKEN_PIPE = 0, 1, 2, 141


class _Parser(argparse.ArgumentParser):
    """Argument errors in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"energyopt: error: {' '.join(message.split())} (see: {self.prog} --help)\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # terminals without Greek letters get a question mark
    try:
        parsed = _parser().parse_args(arguments)
        code = parsed.command(parsed)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader, such as head, has what it wanted
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except KeyboardInterrupt:
        print("energyopt: interrupted", file=sys.stderr)
        return INTERRUPTED
    except EnergyOptError as error:
        print(f"energyopt: error: {' '.join(str(error).split())}", file=sys.stderr)
        return BAD_INPUT


def _parser() -> _Parser:
    parser = _Parser(prog="energyopt", description="Energy-optimal motions for robot arms, planned and proved in simulation.")
    parser.add_argument("--version", action=_Version, help="versions, the dynamics backend and the compiler in use")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    _add_plan(commands)
    _add_batch(commands)
    _add_replay(commands)
    _add_sweep(commands)
    _add_robust(commands)
    _add_scale(commands)
    bench = commands.add_parser("bench", help="run the benchmark scripts")
    bench.add_argument("suite", nargs="?", metavar="SUITE", help="one of the scripts; all of them without it")
    bench.set_defaults(command=_bench)
    robots = commands.add_parser("robots", help="list the robots known by name")
    robots.set_defaults(command=_robots)
    check = commands.add_parser("check", help="check a problem (TOML) or a robot (URDF) without solving")
    check.add_argument("file", metavar="FILE", help="a problem file, the name of a catalogue problem, or a URDF file")
    check.set_defaults(command=_check)
    return parser


def _add_plan(commands: argparse._SubParsersAction) -> None:
    plan = commands.add_parser("plan", help="plan a motion, replay it in MuJoCo, write the results")
    plan.add_argument("problem", metavar="PROBLEM.toml", help="a problem file, or the name of a catalogue problem")
    plan.add_argument("--out", type=_folder, metavar="DIR", help="folder for the results; without it nothing is written")
    plan.add_argument("--no-replay", action="store_true", help="leave out the replay in MuJoCo")
    plan.add_argument("--no-figures", action="store_true", help="leave out figures and report page")
    plan.add_argument("--quiet", action="store_true", help="no progress on the terminal, no table")
    _add_overrides(plan)
    plan.set_defaults(command=_plan)


def _add_batch(commands: argparse._SubParsersAction) -> None:
    batch = commands.add_parser("batch", help="plan many problems in parallel, write the results and a table of them")
    batch.add_argument("problems", nargs="+", metavar="PROBLEM", help="problem files, folders of them, catalogue names")
    batch.add_argument("--out", type=_folder, metavar="DIR", help="folder for the results; without it nothing is written")
    batch.add_argument("--processes", type=int, metavar="N", help="worker processes; one a core without it")
    batch.add_argument("--no-replay", action="store_true", help="leave out the replay in MuJoCo")
    batch.add_argument("--quiet", action="store_true", help="no progress on the terminal, no table")
    _add_overrides(batch)
    batch.set_defaults(command=_batch)


def _add_overrides(command: argparse.ArgumentParser) -> None:
    given = command.add_argument_group("in place of what the file says")
    given.add_argument("--duration", type=float, metavar="S", help="duration [s]", dest="problem.duration")
    given.add_argument("--velocity-weight", type=float, metavar="LAMBDA", help="weight of Σq̇²", dest="problem.velocity_weight")
    given.add_argument(
        "--parameterization", metavar="KIND", help="bspline, sinusoid, hermite_simpson", dest="method.parameterization"
    )
    for key in ("degree", "control_points", "harmonics", "intervals", "seed", "starts"):
        given.add_argument(f"--{key.replace('_', '-')}", type=int, metavar="N", dest=f"method.{key}")
    given.add_argument("--accuracy", type=_accuracy, metavar="E", help="relative error of J, or none", dest="method.accuracy")
    given.add_argument("--time-limit", type=float, metavar="S", help="stop solving after this time", dest="method.time_limit")


def _add_sweep(commands: argparse._SubParsersAction) -> None:
    sweep = commands.add_parser("sweep", help="what a motion costs against the time it is given")
    sweep.add_argument("problem", metavar="PROBLEM.toml", help="a problem file, or the name of a catalogue problem")
    given = {"required": True, "metavar": "FROM:TO:COUNT", "help": "durations [s], such as 0.8:4:20"}
    sweep.add_argument("--duration", type=_durations, **given)
    sweep.add_argument("--out", type=_folder, metavar="DIR", help="folder for sweep.csv, sweep.json and sweep.png")
    sweep.add_argument("--no-figures", action="store_true", help="leave out the figure")
    sweep.add_argument("--processes", type=int, metavar="N", help="at most this many; one a core by default")
    sweep.set_defaults(command=_sweep)


def _add_scale(commands: argparse._SubParsersAction) -> None:
    scale = commands.add_parser("scale", help="make a saved plan slower or faster as a whole")
    scale.add_argument("plan", metavar="PLAN.npz", help="plan.npz of `energyopt plan`, or its folder")
    wanted = scale.add_mutually_exclusive_group(required=True)
    wanted.add_argument("--duration", type=float, metavar="S", help="new duration [s]")
    for name, meaning in (("cheapest", "the duration of least J"), ("fastest", "the shortest duration")):
        words = f"{meaning} at which the limits hold"
        wanted.add_argument(f"--{name}", action="store_const", const=name, dest="chosen", help=words)
    scale.add_argument("--out", type=_folder, metavar="DIR", help="folder for the results; without it nothing is written")
    scale.add_argument("--no-replay", action="store_true", help="leave out the replay in MuJoCo")
    scale.add_argument("--no-figures", action="store_true", help="leave out figures and report page")
    scale.set_defaults(command=_scale)


def _add_replay(commands: argparse._SubParsersAction) -> None:
    replay = commands.add_parser("replay", help="replay a saved plan in MuJoCo")
    replay.add_argument("plan", metavar="PLAN.npz", help="plan.npz of `energyopt plan`, or its folder")
    replay.add_argument("--out", type=_folder, metavar="DIR", help="folder for results with this replay")
    replay.add_argument("--no-figures", action="store_true", help="leave out figures and report page")
    replay.add_argument("--stiffness", type=float, metavar="KP", help="feedback on position [1/s²]")
    replay.add_argument("--damping", type=float, metavar="KD", help="feedback on velocity [1/s]")
    replay.add_argument("--step", type=float, metavar="S", help="physics step [s], at most 0.001", dest="physics_step")
    replay.add_argument(
        "--collisions", action=argparse.BooleanOptionalAction, help="insist on looking for contacts, or leave it out"
    )
    replay.add_argument("--model", metavar="FILE", help="simulate another robot: a URDF, a name, or a problem file's")
    replay.set_defaults(command=_replay)


def _add_robust(commands: argparse._SubParsersAction) -> None:
    robust = commands.add_parser("robust", help="energy, limits and replays of a saved plan for arms unlike their model")
    robust.add_argument("plan", metavar="PLAN.npz", help="plan.npz of `energyopt plan`, or its folder")
    robust.add_argument("--payload", type=_bounds, metavar="LO:HI", help="mass carried besides [kg], such as 0:2")
    robust.add_argument("--masses", type=float, default=0.0, metavar="PERCENT", help="± on the masses of the arm's bodies")
    robust.add_argument("--friction", type=float, default=0.0, metavar="PERCENT", help="± on the friction of the joints")
    robust.add_argument("--samples", type=int, default=100, metavar="N", help="cases drawn between the bounds")
    robust.add_argument("--trials", type=int, default=50, metavar="N", help="replays in MuJoCo; 0 leaves them out")
    robust.add_argument("--seed", type=int, default=0, metavar="N", help="of all draws")
    robust.add_argument("--delay", type=int, default=0, metavar="STEPS", help="physics steps from measurement to torque")
    robust.add_argument("--position-noise", type=float, default=0.0, metavar="SD", help="of the sensors [rad]")
    robust.add_argument("--velocity-noise", type=float, default=0.0, metavar="SD", help="of the sensors [rad/s]")
    robust.add_argument("--step", type=float, metavar="S", help="physics step [s], at most 0.001", dest="physics_step")
    robust.add_argument("--collisions", action=argparse.BooleanOptionalAction, help="insist on contacts, or leave them out")
    robust.add_argument("--out", type=_folder, metavar="DIR", help="folder for robustness.json and robustness.png")
    robust.set_defaults(command=_robust)


def _plan(parsed: argparse.Namespace) -> int:
    from energyopt.io import load_task
    from energyopt.plans import Status
    from energyopt.workflow import run

    problem, options = load_task(parsed.problem, _overrides(parsed))
    verbose = sys.stderr.isatty() and not parsed.quiet
    outcome = run(problem, options, parsed.out, replay=not parsed.no_replay, figures=not parsed.no_figures, verbose=verbose)
    code = _shown(outcome, parsed.quiet)
    return INTERRUPTED if outcome.plan.status is Status.INTERRUPTED else code


def _batch(parsed: argparse.Namespace) -> int:
    from energyopt.batch_files import plan_files, problem_files
    from energyopt.tables import batch_line, batch_total

    show = (lambda row: None) if parsed.quiet else (lambda row: print(batch_line(row), flush=True))
    options = {"processes": parsed.processes, "replay": not parsed.no_replay, "progress": not parsed.quiet}
    rows = plan_files(problem_files(parsed.problems), parsed.out, overrides=_overrides(parsed), show=show, **options)
    if not parsed.quiet:
        print(batch_total(rows, parsed.out))
    return VALID if all(row.valid for row in rows) else INVALID


def _overrides(parsed: argparse.Namespace) -> dict:
    return {key: value for key, value in vars(parsed).items() if "." in key and value is not None}


def _sweep(parsed: argparse.Namespace) -> int:
    from energyopt.io import load_task
    from energyopt.planning import DEFAULTS
    from energyopt.sweeping import sweep

    problem, options = load_task(parsed.problem)
    known = {key: value for key, value in options.items() if key in (*DEFAULTS, "parameterization")}
    curve = sweep(problem, parsed.duration, processes=parsed.processes, **known)
    print(curve)
    if parsed.out is not None:
        from energyopt.sweep_files import write_sweep

        print("files: " + ", ".join(str(path) for path in write_sweep(curve, parsed.out, not parsed.no_figures)))
    return VALID if any(point.solved for point in curve.points) else INVALID


def _scale(parsed: argparse.Namespace) -> int:
    from energyopt.io import load_plan
    from energyopt.rescaling import rescale
    from energyopt.workflow import judge_and_write, prepare_folder

    path = Path(parsed.plan)
    plan = load_plan(path / "plan.npz" if path.is_dir() else path)
    if parsed.out is not None:
        prepare_folder(parsed.out)
    limits = plan.problem.limits
    chosen = {"cheapest": lambda s: s.cheapest(limits=limits), "fastest": lambda s: s.least_duration(limits)}
    scaled = rescale(plan, chosen.get(parsed.chosen, parsed.duration))
    replay = scaled.solved and not parsed.no_replay
    return _shown(judge_and_write(scaled, parsed.out, replay=replay, figures=not parsed.no_figures))


def _replay(parsed: argparse.Namespace) -> int:
    from energyopt.io import load_plan
    from energyopt.workflow import judge_and_write, prepare_folder

    path = Path(parsed.plan)
    plan = load_plan(path / "plan.npz" if path.is_dir() else path)
    if parsed.out is not None:
        prepare_folder(parsed.out)
    names = ("stiffness", "damping", "physics_step", "collisions")
    options = {name: getattr(parsed, name) for name in names if getattr(parsed, name) is not None}
    if parsed.model is not None:
        options["plant"] = _model(parsed.model)
    outcome = judge_and_write(plan, parsed.out, figures=not parsed.no_figures, **options)
    return _shown(outcome)


def _robust(parsed: argparse.Namespace) -> int:
    from energyopt.io import load_plan
    from energyopt.robust_workflow import run

    path = Path(parsed.plan)
    plan = load_plan(path / "plan.npz" if path.is_dir() else path)
    bounds = {key: getattr(parsed, key) for key in ("payload", "masses", "friction")}
    names = ("delay", "position_noise", "velocity_noise", "physics_step", "collisions")
    replay = {name: getattr(parsed, name) for name in names if getattr(parsed, name) is not None}
    found = run(plan, bounds, parsed.samples, parsed.trials, parsed.seed, replay, parsed.out)
    print(found)
    return VALID if found.holds else INVALID


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
    from energyopt.robots import catalogue, load_robot
    from energyopt.tables import robots_table

    print(robots_table(catalogue(), load_robot))
    return VALID


def _check(parsed: argparse.Namespace) -> int:
    from energyopt.clearance_checks import check_ends
    from energyopt.feasibility import check_feasibility
    from energyopt.io import load_task
    from energyopt.robots import load_robot
    from energyopt.tables import robot_lines

    if Path(parsed.file).suffix.lower() in (".urdf", ".xml"):
        print(robot_lines(load_robot(Path(parsed.file))))
        return VALID
    problem, _ = load_task(parsed.file)
    print(robot_lines(problem.robot))
    longest = problem.lasting(problem.durations[1])
    check_feasibility(longest)
    check_ends(longest, longest.goal_position)
    span = " to ".join(f"{t:g}" for t in dict.fromkeys(problem.durations))
    print(f"{problem.name}: a well-formed problem of {span} s; no reason was found why it could not be solved")
    return VALID


def _accuracy(text: str) -> float | bool:
    """A number, or "none" for the knots as they are."""
    if text.lower() in ("none", "off"):
        return False
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text[:80]}': expected a relative error between 0 and 1, or none") from None


def _durations(text: str) -> np.ndarray:
    """Even steps from the first to the last, both included."""
    import numpy as np

    try:
        first, last, count = text.split(":")
        times = np.linspace(float(first), float(last), int(count))
        if 1 <= len(times) <= 1000 and np.all(times > 0) and np.all(np.isfinite(times)):
            return times
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"'{text[:80]}': expected FROM:TO:COUNT in seconds, such as 0.8:4:20, 1000 at most")


def _bounds(text: str) -> tuple[float, float]:
    """Two numbers with a colon between them; one number is both."""
    low, _, high = text.partition(":")
    try:
        return float(low), float(high or low)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text[:80]}': expected two numbers with a colon between, such as 0:2") from None


def _folder(text: str) -> Path:
    """The path of a folder; nothing is none, though Path would take it for the present folder."""
    if not text.strip():
        raise argparse.ArgumentTypeError("an empty name: expected a folder for the results, such as results")
    return Path(text)


class _Version(argparse.Action):
    """Print the versions and leave."""

    def __init__(self, **options):
        super().__init__(nargs=0, **options)

    def __call__(self, parser, namespace, values, option_string=None):
        from energyopt.dynamics import backend
        from energyopt.dynamics.compiler import find_compiler
        from energyopt.versions import versions

        compiler = find_compiler()
        print(f"energyopt {__version__}")
        print(f"dynamics: {backend()}")
        print(f"compiler: {' '.join(compiler)}" if compiler else "compiler: none found; kernels run in CasADi's virtual machine")
        print(", ".join(f"{name} {version}" for name, version in versions().items() if name != "energyopt"))
        parser.exit(VALID)
