"""The arguments of the command line: commands, options, and what their texts mean."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from energyopt import __version__
from energyopt.exit_codes import BAD_INPUT

if TYPE_CHECKING:
    import numpy as np


class _Parser(argparse.ArgumentParser):
    """Argument errors in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"energyopt: error: {' '.join(message.split())} (see: {self.prog} --help)\n")


def make_parser() -> argparse.ArgumentParser:
    """Of the whole command line; ``command`` of what it parses is a key of `cli_commands.COMMANDS`."""
    parser = _Parser(prog="energyopt", description="Energy-optimal motions for robot arms, planned and proved in simulation.")
    parser.add_argument("--version", action=_Version, help="versions, the dynamics backend and the compiler in use")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    _add_plan(commands)
    _add_batch(commands)
    _add_replay(commands)
    _add_sweep(commands)
    _add_robust(commands)
    _add_scale(commands)
    bench = commands.add_parser("bench", help="run the benchmark scripts")
    bench.add_argument("suite", nargs="?", metavar="SUITE", help="one of the scripts; all of them without it")
    commands.add_parser("robots", help="list the robots known by name")
    check = commands.add_parser("check", help="check a problem (TOML) or a robot (URDF) without solving")
    check.add_argument("file", metavar="FILE", help="a problem file, the name of a catalogue problem, or a URDF file")
    return parser


def _folder(text: str) -> Path:
    """The path of a folder; nothing is none, though Path would take it for the present folder."""
    if not text.strip():
        raise argparse.ArgumentTypeError("an empty name: expected a folder for the results, such as results")
    return Path(text)


_SHARED = {
    "problem": {"metavar": "PROBLEM.toml", "help": "a problem file, or the name of a catalogue problem"},
    "plan": {"metavar": "PLAN.npz", "help": "plan.npz of `energyopt plan`, or its folder"},
    "--out": {"type": _folder, "metavar": "DIR", "help": "folder for the results; without it nothing is written"},
    "--no-replay": {"action": "store_true", "help": "leave out the replay in MuJoCo"},
    "--no-figures": {"action": "store_true", "help": "leave out figures and report page"},
    "--quiet": {"action": "store_true", "help": "no progress on the terminal, no table"},
    "--processes": {"type": int, "metavar": "N", "help": "worker processes; one a core without it"},
    "--step": {"type": float, "metavar": "S", "help": "physics step [s], at most 0.001", "dest": "physics_step"},
    "--collisions": {"action": argparse.BooleanOptionalAction, "help": "insist on looking for contacts, or leave it out"},
}
"""Arguments that several commands have."""


def _share(command: argparse.ArgumentParser, *names: str, **changed: str) -> None:
    """Add arguments of `_SHARED` to a command, with other words where they mean something else there."""
    for name in names:
        command.add_argument(name, **_SHARED[name] | changed)


def _add_plan(commands: argparse._SubParsersAction) -> None:
    plan = commands.add_parser("plan", help="plan a motion, replay it in MuJoCo, write the results")
    _share(plan, "problem", "--out", "--no-replay", "--no-figures", "--quiet")
    _add_overrides(plan)


def _add_batch(commands: argparse._SubParsersAction) -> None:
    batch = commands.add_parser("batch", help="plan many problems in parallel, write the results and a table of them")
    batch.add_argument("problems", nargs="+", metavar="PROBLEM", help="problem files, folders of them, catalogue names")
    _share(batch, "--out", "--processes", "--no-replay", "--quiet")
    _add_overrides(batch)


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
    _share(sweep, "problem")
    given = {"required": True, "metavar": "FROM:TO:COUNT", "help": "durations [s], such as 0.8:4:20"}
    sweep.add_argument("--duration", type=_durations, **given)
    _share(sweep, "--out", help="folder for sweep.csv, sweep.json and sweep.png")
    _share(sweep, "--no-figures", help="leave out the figure")
    _share(sweep, "--processes", help="at most this many; one a core by default")


def _add_scale(commands: argparse._SubParsersAction) -> None:
    scale = commands.add_parser("scale", help="make a saved plan slower or faster as a whole")
    _share(scale, "plan", "--out")
    wanted = scale.add_mutually_exclusive_group(required=True)
    wanted.add_argument("--duration", type=float, metavar="S", help="new duration [s]")
    for name, meaning in (("cheapest", "the duration of least J"), ("fastest", "the shortest duration")):
        words = f"{meaning} at which the limits hold"
        wanted.add_argument(f"--{name}", action="store_const", const=name, dest="chosen", help=words)
    _share(scale, "--no-replay", "--no-figures")


def _add_replay(commands: argparse._SubParsersAction) -> None:
    replay = commands.add_parser("replay", help="replay a saved plan in MuJoCo")
    _share(replay, "plan")
    _share(replay, "--out", help="folder for results with this replay")
    _share(replay, "--no-figures")
    replay.add_argument("--stiffness", type=float, metavar="KP", help="feedback on position [1/s²]")
    replay.add_argument("--damping", type=float, metavar="KD", help="feedback on velocity [1/s]")
    _share(replay, "--step", "--collisions")
    replay.add_argument("--model", metavar="FILE", help="simulate another robot: a URDF, a name, or a problem file's")


def _add_robust(commands: argparse._SubParsersAction) -> None:
    robust = commands.add_parser("robust", help="energy, limits and replays of a saved plan for arms unlike their model")
    _share(robust, "plan")
    _share(robust, "--out", help="folder for robustness.json and robustness.png")
    robust.add_argument("--payload", type=_bounds, metavar="LO:HI", help="mass carried besides [kg], such as 0:2")
    robust.add_argument("--masses", type=float, default=0.0, metavar="PERCENT", help="± on the masses of the arm's bodies")
    robust.add_argument("--friction", type=float, default=0.0, metavar="PERCENT", help="± on the friction of the joints")
    robust.add_argument("--samples", type=int, default=100, metavar="N", help="cases drawn between the bounds")
    robust.add_argument("--trials", type=int, default=50, metavar="N", help="replays in MuJoCo; 0 leaves them out")
    robust.add_argument("--seed", type=int, default=0, metavar="N", help="of all draws")
    robust.add_argument("--delay", type=int, default=0, metavar="STEPS", help="physics steps from measurement to torque")
    robust.add_argument("--position-noise", type=float, default=0.0, metavar="SD", help="of the sensors [rad]")
    robust.add_argument("--velocity-noise", type=float, default=0.0, metavar="SD", help="of the sensors [rad/s]")
    _share(robust, "--step")
    _share(robust, "--collisions", help="insist on contacts, or leave them out")


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
        ends = np.array([first, last], dtype=float)
        if 1 <= int(count) <= 1000 and np.all(ends > 0) and np.all(np.isfinite(ends)):
            return np.linspace(*ends, int(count))
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
        parser.exit()
