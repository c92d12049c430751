"""energyopt batch: a folder a problem, a table of all, and whatever was done is kept."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import energyopt as eo
from energyopt.cli import main

ROOT = Path(__file__).resolve().parents[1]
MOVE = """name = "{name}"
[robot]
name = "twodof"
[problem]
start = [0.2, 0.1]
goal = [0.6, -0.4]
duration = {duration}
self_collision = false
[method]
control_points = 10
accuracy = false
"""


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "problems"
    made.mkdir()
    for name, duration in (("swing", 3.0), ("turn", 4.0), ("hasty", 0.01)):
        (made / f"{name}.toml").write_text(MOVE.format(name=name, duration=duration))
    (made / "broken.toml").write_text("name = \n")
    return made


def test_every_problem_has_a_row_and_every_plan_a_folder(folder, tmp_path, capsys):
    again = tmp_path / "swing.toml"
    again.write_text((folder / "swing.toml").read_text())
    out = tmp_path / "out"
    assert main(["batch", str(folder), str(again), str(folder / "turn.toml"), "--out", str(out), "--processes", "2"]) == 1
    printed = capsys.readouterr().out
    rows = json.loads((out / "results.json").read_text())["results"]
    assert [Path(row["file"]).stem for row in rows] == ["broken", "hasty", "swing", "turn", "swing"], "each file once, in order"
    assert [row["status"] for row in rows] == ["BAD_INPUT", "BAD_INPUT", "SOLVED", "SOLVED", "SOLVED"]
    assert [row["folder"] for row in rows] == ["", "", "swing", "turn", "swing-2"] and [row["valid"] for row in rows].count(
        True
    ) == 3
    assert "broken.toml:1" in rows[0]["message"] and "hasty.toml:7: problem.duration" in rows[1]["message"]
    assert "3 of 5 problems are solved and valid" in printed and printed.count("\n") == 6
    for row in rows[2:]:
        plan = eo.load_plan(out / row["folder"] / "plan.npz")
        summary = json.loads((out / row["folder"] / "summary.json").read_text())
        assert plan.objective == row["objective"] == summary["objective"] and plan.problem.name == row["name"]
        assert summary["replay"]["tracking_rms_rad"] < 0.01 and summary["valid"]
    with (out / "results.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [float(row["objective"]) for row in table[2:]] == [row["objective"] for row in rows[2:]]


def test_options_stand_in_for_what_the_files_say(folder, tmp_path, capsys):
    code = main(
        ["batch", str(folder / "swing.toml"), "--duration", "5", "--no-replay", "--quiet", "--out", str(tmp_path / "out")]
    )
    assert code == 0 and capsys.readouterr().out == ""
    summary = json.loads((tmp_path / "out" / "swing" / "summary.json").read_text())
    assert summary["duration_s"] == 5.0 and "replay" not in summary


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["nonesuch.toml"], "no such problem file"),
        (["."], "no .toml file there"),
        (["twodof.toml", "--processes", "0"], "processes is 0"),
        (["twodof.toml", "--out", "full"], "energyopt did not write"),
    ],
)
def test_mistakes_are_named_before_anything_starts(given, said, tmp_path, capsys, monkeypatch):
    (tmp_path / "work" / "full").mkdir(parents=True)
    (tmp_path / "work" / "full" / "results.csv").write_text("mine")
    (tmp_path / "swing.toml").write_text(MOVE.format(name="swing", duration=3.0))
    monkeypatch.chdir(tmp_path / "work")
    given = [str(tmp_path / "swing.toml") if name == "twodof.toml" else name for name in given]
    assert main(["batch", *given]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert (tmp_path / "work" / "full" / "results.csv").read_text() == "mine"


@pytest.mark.alone
def test_ctrl_c_keeps_what_is_done(folder, tmp_path):
    for k in range(300):
        (folder / f"more{k:03}.toml").write_text(MOVE.format(name=f"more{k}", duration=3.0 + 0.01 * k))
    out = tmp_path / "out"
    command = [sys.executable, "-m", "energyopt", "batch", str(folder), "--out", str(out), "--processes", "2", "--no-replay"]
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    process = subprocess.Popen(
        command, env=os.environ | {"PYTHONPATH": path}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 120.0
    while len(list(out.glob("*/summary.json"))) < 5 and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    began = time.monotonic()
    _, errors = process.communicate(timeout=60.0)
    assert process.returncode == 130 and time.monotonic() - began < 5.0 and "Traceback" not in errors
    rows = json.loads((out / "results.json").read_text())["results"]
    done = [row for row in rows if row["status"] == "SOLVED"]
    assert len(rows) == 304 and 5 <= len(done) < 300 and {row["status"] for row in rows} == {"SOLVED", "BAD_INPUT", "INTERRUPTED"}
    assert {row["folder"] for row in done} == {path.parent.name for path in out.glob("*/summary.json")}
    assert all(eo.load_plan(out / row["folder"] / "plan.npz").objective == row["objective"] for row in done[:10])
    assert not list(out.rglob("*.tmp"))
