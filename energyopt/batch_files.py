"""Many problem files at once: what ``energyopt batch`` does. Each is planned, replayed and judged in a worker process.

A folder of its own for every problem, written as soon as it is done, holds the data files that `workflow.run` writes too;
``results.csv`` and ``results.json`` beside those folders have one row a problem. A file that is wrong is a row that says why.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import CancelledError, Executor, Future
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from energyopt.batch import FailureStatus, described
from energyopt.errors import EnergyOptError, FileError
from energyopt.io import load_task, write_atomic
from energyopt.io.find import find_problem
from energyopt.ordered import Interrupted, Job, in_order
from energyopt.parcels import Parcel, noted, packed, unpacked
from energyopt.places import Place
from energyopt.plans import Plan
from energyopt.problem import Problem
from energyopt.progress import told
from energyopt.serving import no_more_processes
from energyopt.solvers.interrupts import Interrupts
from energyopt.stopping import whole_files
from energyopt.versions import versions
from energyopt.workflow import plain, prepare_folder, run, write_results

TABLES = ("results.csv", "results.json")
REFERENCE = "quintic"
_SHARED = ("name", "status", "valid", "message", "robot", "duration_s", "objective", "discretization_error", "iterations")
_STAGES = ("build", "compile", "solve", "verify")


@dataclass(frozen=True)
class Row:
    """One problem of a batch in the tables: names, units and None as in summary.json.

    Attributes:
        file: of the problem; folder: of its results, beside the tables, "" where there are none.
        saving_percent: of J, against the quintic of the same duration. plan_s: seconds of planning.
    """

    file: str
    name: str
    status: str
    valid: bool
    message: str
    folder: str = ""
    robot: str | None = None
    duration_s: float | None = None
    objective: float | None = None
    saving_percent: float | None = None
    mechanical_abs_J: float | None = None
    discretization_error: float | None = None
    iterations: int | None = None
    plan_s: float | None = None


@dataclass(eq=False)
class _Task:
    """A file, the name of its folder, and its problem once it is read."""

    path: Path
    folder: str
    problem: Problem | None = None
    row: Row | None = None


def problem_files(given: Iterable[str]) -> list[Path]:
    """The files of paths, of folders (every .toml in them) and of names of catalogue problems, each once.

    Raises:
        FileError: one of them is not there, or a folder holds no problem file.
    """
    found: list[Path] = []
    for name in given:
        folder = Path(name)
        inside = sorted(folder.glob("*.toml")) if folder.is_dir() else [find_problem(name)]
        if not inside:
            raise FileError(f"{folder}: no .toml file there; expected a folder of problem files")
        found += inside
    return list({path.resolve(): path for path in found}.values())


def check_overrides(files: Iterable[Path], overrides: Mapping[str, Any]) -> None:
    """Refuse, before any work, values that are wrong whatever the file: those that make a good file a bad one.

    Raises:
        EnergyOptError: says which.
    """
    for path in files if overrides else ():
        try:
            load_task(path)
        except EnergyOptError:
            continue  # what is wrong with a file is said in its row
        load_task(path, overrides)
        return


def plan_files(
    files: Iterable[Path],
    out: Path | None = None,
    *,
    processes: int | None = None,
    replay: bool = True,
    overrides: Mapping[str, Any] | None = None,
    progress: bool = False,
    show: Callable[[Row], None] = lambda row: None,
) -> list[Row]:
    """Plan the problems of many files and write the results.

    Args:
        files: problem files.
        out: folder for the tables and the folders of the problems; None writes nothing.
        processes: workers; one a core by default. replay: simulate what is solved.
        overrides: values in place of the files', as for `io.load_task`.
        progress: a bar on standard error, where that is a terminal.
        show: called with each row, in the order of the files.

    Returns:
        a row a file.

    Raises:
        FileError: the folder cannot be written. KeyboardInterrupt: Ctrl-C; what was done is written.
    """
    if out is not None:
        prepare_folder(out, TABLES)
        versions()  # not to be looked up only after Ctrl-C, when the tables are written
    tasks = _tasks(files)
    place = Place.of(None, processes, len(tasks))
    with Interrupts() as interrupted, place.open() as executor, told(progress, len(tasks)) as count:

        def ended(job: Job) -> None:
            with interrupted.held():
                _finish(job, out)
            if interrupted():
                raise KeyboardInterrupt
            count(job.item.row.valid)

        try:
            for job in in_order(tasks, partial(_submit, executor, overrides, replay), place.window, ended):
                _finish(job, out)
                count.clear()
                show(job.item.row)
        except Interrupted as interrupt:
            for job in interrupt.jobs:
                _finish(job, out)
            raise
        finally:  # before the processes end, which may take longer than the command line has after Ctrl-C
            rows = [task.row or _unreached(task) for task in tasks]
            if out is not None:
                _write_tables(rows, out)
    return rows


def _tasks(files: Iterable[Path]) -> list[_Task]:
    """A folder for each, named after the file; a number tells files of one name apart."""
    taken: dict[str, int] = {}
    tasks = []
    for path in files:
        count = taken[path.stem] = taken.get(path.stem, 0) + 1
        tasks.append(_Task(path, path.stem if count == 1 else f"{path.stem}-{count}"))
    return tasks


def _submit(executor: Executor, overrides: Mapping[str, Any] | None, replay: bool, task: _Task) -> Future:
    task.problem, options = load_task(task.path, overrides)
    return executor.submit(judge_parcel, packed(task.problem), options, replay)


def judge_parcel(parcel: Parcel, options: Mapping[str, Any], replay: bool) -> tuple[Plan, dict[str, Any]]:
    """In a worker: plan, replay and judge; the plan goes back without its problem, and with it what summary.json says."""
    with no_more_processes(), noted():
        outcome = run(unpacked(parcel), options, replay=replay, figures=False)
        return replace(outcome.plan, problem=None), outcome.summary


def _finish(job: Job, out: Path | None) -> None:
    """Write what a job gave, and keep nothing of it but its row."""
    task = job.item
    if task.row is not None:
        return
    if not job.future.done():
        task.row = _unreached(task)
        return
    name = task.problem.name if task.problem is not None else task.path.stem
    try:
        plan, summary = job.future.result()
    except (Exception, CancelledError) as error:
        status, message = described(error)
        task.row = Row(str(task.path), name, status.value, False, message)
    else:
        task.row = _row(task, summary, task.folder if out is not None else "")
        if out is not None:
            write_results(replace(plan, problem=task.problem), summary, out / task.folder)
    task.problem = None


def _row(task: _Task, summary: dict[str, Any], folder: str) -> Row:
    own = {name: summary[name] for name in _SHARED}
    saving = summary["baseline"].get(REFERENCE, {}).get("saving_percent")
    energy, seconds = summary["energy"]["mechanical_abs_J"], sum(summary["time_s"][stage] or 0.0 for stage in _STAGES)
    return Row(str(task.path), folder=folder, saving_percent=saving, mechanical_abs_J=energy, plan_s=seconds, **own)


def _unreached(task: _Task) -> Row:
    return Row(str(task.path), task.path.stem, FailureStatus.INTERRUPTED.value, False, "interrupted before it was planned")


def _write_tables(rows: list[Row], out: Path) -> None:
    text = io.StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(Row)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(map(asdict, rows))
    content = {"results": [plain(asdict(row)) for row in rows], "versions": versions()}
    with whole_files():
        write_atomic(out / "results.csv", text.getvalue().encode())
        write_atomic(out / "results.json", (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode())
