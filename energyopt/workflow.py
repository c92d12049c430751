"""From a task to a folder of results: plan → replay → validate → files. What the command line does, as functions.

The folder holds plan.npz, summary.json, trajectory.csv, joint_trajectory.json, metrics.png, joints.png, energy.png and
report.html.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, is_dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from energyopt.errors import FileError, SimulationError
from energyopt.io import save_plan, write_atomic, write_csv, write_joint_trajectory
from energyopt.plans import Plan, Status
from energyopt.problem import Problem
from energyopt.readable import Readable
from energyopt.stopping import say_at_the_end, whole_files
from energyopt.versions import versions

if TYPE_CHECKING:
    from energyopt.simulation.log import ReplayLog
    from energyopt.validation import ValidationReport

MARKER = ".energyopt"
"""File that marks a folder as written by energyopt: only in such a folder are files replaced."""
DATA_FILES = ("plan.npz", "summary.json", "trajectory.csv", "joint_trajectory.json")
FIGURE_FILES = ("metrics.png", "joints.png", "energy.png", "clearance.png", "scene.png", "report.html")
"""The pictures of clearance and scene are drawn where there are obstacles or walls."""


@dataclass(frozen=True, eq=False, repr=False)
class Outcome(Readable):
    """What a run gave.

    Attributes:
        plan: the motion and its status. log: of the replay; None where there was none. report: the verdicts.
        summary: the content of summary.json.
        files: what was written, in order; empty without a folder.
    """

    plan: Plan
    log: ReplayLog | None
    report: ValidationReport
    summary: dict[str, Any]
    files: tuple[Path, ...]

    def in_brief(self) -> str:
        return f"{self.plan.in_brief()}, {self.report.in_brief()}"

    @property
    def valid(self) -> bool:
        """Whether the plan is solved and every check passed."""
        return self.plan.solved and self.report.passed


def run(
    problem: Problem,
    options: Mapping[str, Any],
    out: Path | None = None,
    *,
    replay: bool = True,
    figures: bool = True,
    verbose: bool = False,
) -> Outcome:
    """Plan a problem, replay it in MuJoCo, judge it, and write the results.

    Args:
        problem: what is asked. options: keyword arguments of `energyopt.plan`.
        out: folder for the files, made if needed; None writes nothing.
        replay: simulate a plan that was solved. figures: draw figures and write the report page.
        verbose: show the solver's progress.

    Raises:
        FileError: the folder cannot be used. InputError: the problem is impossible.
    """
    from energyopt.planning import plan as plan_motion

    _load()
    if out is not None:
        prepare_folder(out)
    plan = plan_motion(problem, verbose=verbose, throw=False, **options)
    if out is not None:
        _write_motion(plan, out)  # at once: whatever happens to what follows, the motion is kept
        if plan.status is Status.INTERRUPTED:
            say_at_the_end(f"energyopt: interrupted; the best motion so far is {out / 'plan.npz'}")
    figures = figures and plan.status is not Status.INTERRUPTED  # whoever interrupts wants an end
    outcome = _judged(plan, replay and plan.solved, {})
    return outcome if out is None else _with_files(outcome, out, figures)


def _load() -> None:
    """Import what follows a plan before it starts, so that nothing slow comes after Ctrl-C."""
    for name in ("simulation.inverse", "validation", "tables"):
        import_module(f"energyopt.{name}")


def judge_and_write(plan: Plan, out: Path | None, *, replay: bool = True, figures: bool = True, **replay_options: Any) -> Outcome:
    """The part of `run` after planning; ``replay_options`` are those of `energyopt.replay`.

    Raises:
        FileError: a file cannot be written. InputError: a replay option makes no sense.
    """
    outcome = _judged(plan, replay, replay_options)
    if out is None:
        return outcome
    _write_motion(plan, out)
    return _with_files(outcome, out, figures)


def _judged(plan: Plan, replay: bool, replay_options: Mapping[str, Any]) -> Outcome:
    from energyopt.validation import validate

    log, failure = _replayed(plan, replay_options) if replay else (None, "")
    report = validate(plan, log)
    summary = summarize(plan, log, report)
    if failure:
        summary |= {"replay_failure": failure, "valid": False}
    return Outcome(plan, log, report, summary, ())


def summarize(plan: Plan, log: ReplayLog | None, report: ValidationReport) -> dict[str, Any]:
    """The content of summary.json: SI units, radians, every number finite, None where there is none."""
    robot = plan.problem.robot
    judged = report.as_dict()
    violation = dict.fromkeys(("position", "velocity", "acceleration", "torque_percent"), 0.0)
    summary = {
        "name": plan.problem.name,
        "status": plan.status.value,
        "message": plan.message,
        "valid": plan.solved and report.passed,
        "robot": robot.name,
        "joint_names": list(robot.joint_names),
        "duration_s": plan.duration,
        **judged,
        "max_violation": {**violation, **judged["max_violation"]},
        "discretization_error": plan.discretization_error,
        "iterations": plan.iterations,
        "seed": plan.seed,
        "options": plan.options,
        "optima": [optimum.summary for optimum in plan.optima],
        "time_s": {**plan.time_s, "replay": None if log is None else log.wall_s},
        "notes": plan.notes,
        "versions": versions(),
    }
    return plain(summary)


def plain(value: Any) -> Any:
    """A value as JSON knows it; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(entry) for entry in value]
    if isinstance(value, (bool, np.bool_)) or value is None:
        return None if value is None else bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if is_dataclass(value):
        return {"kind": type(value).__name__, **plain(asdict(value))}
    return str(value)


def write_results(plan: Plan, summary: Mapping[str, Any], out: Path) -> None:
    """Write the data files of a plan that was judged elsewhere.

    Raises:
        FileError: a file cannot be written.
    """
    _write_motion(plan, out)
    _write_summary(summary, out)


def prepare_folder(out: Path, names: tuple[str, ...] = (*DATA_FILES, *FIGURE_FILES)) -> None:
    """Make the folder, or make sure that files of these names in it may be replaced.

    Raises:
        FileError: it cannot be made or written, or holds files of these names that energyopt did not write.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        present = [name for name in names if (out / name).exists()]
        if present and not (out / MARKER).exists():
            raise FileError(f"{out}: holds {present[0]} that energyopt did not write; choose another folder, or move it away")
    except FileExistsError:
        raise FileError(f"{out}: is a file; expected a folder for the results") from None
    except OSError as error:
        raise FileError(f"{out}: cannot be used for the results ({error.strerror or error})") from None
    write_atomic(out / MARKER, b"This folder was written by energyopt; its results are replaced by the next run.\n")


def _replayed(plan: Plan, options: Mapping[str, Any]) -> tuple[ReplayLog | None, str]:
    """The replay, or why there is none."""
    from energyopt.simulation import replay

    try:
        return replay(plan, **options), ""
    except SimulationError as error:
        return None, str(error)


def _with_files(outcome: Outcome, out: Path, figures: bool) -> Outcome:
    """Write what is said of the motion beside the motion."""
    _write_summary(outcome.summary, out)
    if figures:
        _draw(outcome.plan, outcome.log, outcome.report, out)
    names = (*DATA_FILES, *FIGURE_FILES)
    return replace(outcome, files=tuple(out / name for name in names if (out / name).exists()))


def _write_summary(summary: Mapping[str, Any], out: Path) -> None:
    text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False)
    with whole_files():
        write_atomic(out / "summary.json", (text + "\n").encode())


def _write_motion(plan: Plan, out: Path) -> None:
    """Write the motion itself; the files of an earlier run go first, so that what is there belongs together."""
    with whole_files():
        prepare_folder(out)
        for name in (*DATA_FILES, *FIGURE_FILES):
            (out / name).unlink(missing_ok=True)
        save_plan(plan, out / "plan.npz")
        write_csv(plan, out / "trajectory.csv")
        write_joint_trajectory(plan, out / "joint_trajectory.json")


def _draw(plan: Plan, log: ReplayLog | None, report: ValidationReport, out: Path) -> None:
    import io

    from energyopt.plotting import plot_clearance, plot_energy, plot_joints, plot_metrics, plot_scene
    from energyopt.report import report_page
    from energyopt.report_scene import has_surroundings

    figures = {"metrics.png": lambda: plot_metrics(plan, log), "joints.png": lambda: plot_joints(plan, log)}
    figures["energy.png"] = lambda: plot_energy(plan)
    if has_surroundings(plan):
        figures |= {"clearance.png": lambda: plot_clearance(plan, log), "scene.png": lambda: plot_scene(plan)}
    for name, draw in figures.items():
        image = io.BytesIO()
        draw().savefig(image, format="png", dpi=150)
        with whole_files():
            write_atomic(out / name, image.getvalue())
    page = report_page(plan, log, report).encode()
    with whole_files():
        write_atomic(out / "report.html", page)
