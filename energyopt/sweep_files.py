"""The files of a sweep: sweep.csv, sweep.json and sweep.png."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

from energyopt.io import write_atomic
from energyopt.stopping import whole_files
from energyopt.sweep_text import sweep_rows
from energyopt.sweeping import Sweep
from energyopt.versions import versions
from energyopt.workflow import plain, prepare_folder

FILES = ("sweep.csv", "sweep.json", "sweep.png")


def write_sweep(sweep: Sweep, out: Path, figures: bool = True) -> tuple[Path, ...]:
    """Write a sweep; returns the paths.

    Raises:
        FileError: the folder cannot be used, or a file cannot be written.
    """
    prepare_folder(out)
    rows = sweep_rows(sweep)
    with whole_files():
        (out / FILES[2]).unlink(missing_ok=True)  # that of an earlier sweep
        write_atomic(out / FILES[0], _table(rows))
        write_atomic(out / FILES[1], _json(sweep, rows))
    if not figures:
        return tuple(out / name for name in FILES[:2])
    from energyopt.plotting import plot_sweep

    image = io.BytesIO()
    plot_sweep(sweep).savefig(image, format="png", dpi=150)
    with whole_files():
        write_atomic(out / FILES[2], image.getvalue())
    return tuple(out / name for name in FILES)


def _table(rows: list[dict[str, Any]]) -> bytes:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def _json(sweep: Sweep, rows: list[dict[str, Any]]) -> bytes:
    best = {"duration_s": sweep.best.duration, "objective": sweep.best.objective, "status": sweep.best.status.value}
    subject = {"name": sweep.problem.name, "robot": sweep.problem.robot.name}
    content = subject | {"points": rows, "best": best, "interrupted": sweep.interrupted, "versions": versions()}
    return (json.dumps(plain(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()
