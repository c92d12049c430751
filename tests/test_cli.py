"""The command line: exit codes, files, and errors of one line."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import energyopt as eo
from energyopt.cli import main

PENDULUM = """
[robot]
name = "double_pendulum"
[problem]
start = [0.0, 0.0]
goal = [1.0, -0.5]
duration = 1.5
[method]
control_points = 12
accuracy = false
"""


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    path = tmp_path_factory.mktemp("task") / "swing.toml"
    path.write_text(PENDULUM)
    return path


@pytest.fixture(scope="module")
def results(task, tmp_path_factory):
    """A folder with the results of one run."""
    out = tmp_path_factory.mktemp("results") / "deep" / "swing"
    assert main(["plan", str(task), "--out", str(out), "--no-figures"]) == 0
    return out


def test_plan_writes_its_files_and_says_so(task, tmp_path, capsys):
    out = tmp_path / "new" / "folder"
    assert main(["plan", str(task), "--out", str(out), "--no-figures"]) == 0
    shown = capsys.readouterr()
    assert "SOLVED" in shown.out and "plan.npz" in shown.out and "quintic" in shown.out
    assert shown.err == ""
    assert {p.name for p in out.iterdir()} == {
        ".energyopt",
        "plan.npz",
        "summary.json",
        "trajectory.csv",
        "joint_trajectory.json",
    }


def test_plan_draws_figures_and_a_page_that_belong_to_the_numbers(task, tmp_path):
    out = tmp_path / "o"
    assert main(["plan", str(task), "--out", str(out), "--quiet"]) == 0
    for name in ("metrics.png", "joints.png", "energy.png"):
        data = (out / name).read_bytes()
        assert data.startswith(b"\x89PNG") and len(data) > 10_000
    assert "<html" in (out / "report.html").read_text(encoding="utf-8")[:200].lower()
    assert main(["plan", str(task), "--out", str(out), "--quiet", "--no-figures"]) == 0
    assert not (out / "metrics.png").exists()  # a figure of an earlier run would not belong to these numbers


def test_the_summary_holds_what_the_plan_holds(results):
    text = (results / "summary.json").read_text(encoding="utf-8")
    summary = json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    plan = eo.load_plan(results / "plan.npz")
    assert summary["status"] == "SOLVED" and summary["valid"] is True
    assert summary["robot"] == "double_pendulum" and summary["joint_names"] == list(plan.problem.robot.joint_names)
    assert summary["duration_s"] == 1.5 and summary["iterations"] == plan.iterations
    assert summary["objective"] == pytest.approx(plan.objective, rel=1e-12)
    assert summary["objective"] == pytest.approx(summary["torque_squared"] + 0.1 * summary["velocity_squared"], rel=1e-9)
    assert {"mechanical_abs_J", "mechanical_positive_J", "electrical_J"} <= set(summary["energy"])
    assert {"position", "velocity", "acceleration", "torque_percent", "clearance_m"} <= set(summary["max_violation"])
    assert {"build", "compile", "solve", "replay"} <= set(summary["time_s"])
    assert {"tracking_rms_rad", "tracking_max_rad", "energy_mechanical_abs_J", "energy_gap_percent"} <= set(summary["replay"])
    assert {"objective", "saving_percent"} <= set(summary["baseline"]["quintic"])
    assert summary["versions"]["energyopt"] == eo.__version__
    assert isinstance(summary["smoothness"], dict) and isinstance(summary["options"], dict)


def test_a_second_run_replaces_its_own_results_and_gives_the_same_motion(task, results):
    before = eo.load_plan(results / "plan.npz").trajectory(np.linspace(0, 1.5, 50))
    assert main(["plan", str(task), "--out", str(results), "--no-figures", "--quiet"]) == 0
    np.testing.assert_array_equal(eo.load_plan(results / "plan.npz").trajectory(np.linspace(0, 1.5, 50)), before)


def test_files_of_others_are_not_replaced(task, tmp_path, capsys):
    (tmp_path / "summary.json").write_text("mine")
    assert main(["plan", str(task), "--out", str(tmp_path)]) == 2
    assert "holds summary.json that energyopt did not write" in capsys.readouterr().err
    assert (tmp_path / "summary.json").read_text() == "mine"
    assert [p.name for p in tmp_path.iterdir()] == ["summary.json"]


def test_options_replace_what_the_file_says(task, tmp_path, capsys):
    options = ["--duration", "2", "--parameterization", "sinusoid", "--harmonics", "3", "--seed", "4", "--velocity-weight", "0"]
    assert main(["plan", str(task), "--out", str(tmp_path / "o"), "--no-figures", "--no-replay", *options]) == 0
    summary = json.loads((tmp_path / "o" / "summary.json").read_text())
    assert summary["duration_s"] == 2 and summary["seed"] == 4
    assert summary["options"]["parameterization"] == "Sinusoid" and summary["options"]["harmonics"] == 3
    assert "replay" not in summary and summary["time_s"]["replay"] is None
    assert "not done" in capsys.readouterr().out


def test_replay_repeats_the_judgement_from_the_file_alone(results, tmp_path, capsys):
    assert main(["replay", str(results / "plan.npz"), "--out", str(tmp_path / "again"), "--no-figures"]) == 0
    first, second = (json.loads((p / "summary.json").read_text()) for p in (results, tmp_path / "again"))
    assert second["replay"]["tracking_max_rad"] == first["replay"]["tracking_max_rad"]
    assert main(["replay", str(results), "--stiffness", "900", "--damping", "60", "--step", "0.001", "--collisions"]) == 0
    assert "tracking error" in capsys.readouterr().out


def test_replay_on_another_robot_is_judged_invalid(results, tmp_path, capsys):
    heavy = tmp_path / "heavy.toml"
    heavy.write_text(PENDULUM.replace('name = "double_pendulum"', 'name = "double_pendulum"\npayload = {mass = 0.5}'))
    assert main(["replay", str(results), "--model", str(heavy)]) == 1
    assert "FAILED" in capsys.readouterr().out


BAD = {
    "no command": ([], "the following arguments are required: COMMAND"),
    "unknown command": (["dance"], "invalid choice: 'dance'"),
    "no problem": (["plan"], "the following arguments are required: PROBLEM.toml"),
    "missing file": (["plan", "none.toml"], "none.toml: no such problem file"),
    "near name": (["plan", "panda_rech"], "did you mean panda_reach"),
    "odd number": (["plan", "panda_reach", "--duration", "fast"], "argument --duration: invalid float value: 'fast'"),
    "negative number": (["plan", "panda_reach", "--duration", "-1"], "problem.duration is -1.0; expected a number > 0 [s]"),
    "nan": (["plan", "panda_reach", "--duration", "nan"], "problem.duration is nan; expected"),
    "option of another kind": (["plan", "panda_reach", "--harmonics", "3"], "method.harmonics is 3; expected only with sinusoid"),
    "impossible duration": (["plan", "panda_reach", "--duration", "0.05"], "panda_joint"),
    "accuracy of words": (["plan", "panda_reach", "--accuracy", "foo"], "argument --accuracy: 'foo': expected a relative error"),
    "accuracy of two": (["plan", "panda_reach", "--accuracy", "2"], "method.accuracy is 2.0; expected a relative error between"),
    "empty folder": (["plan", "panda_reach", "--out", ""], "argument --out: an empty name: expected a folder"),
    "blank folder": (["replay", "none.npz", "--out", " "], "argument --out: an empty name"),
    "missing plan": (["replay", "none.npz"], "none.npz: no such file"),
    "folder without a plan": (["replay", "."], "plan.npz: no such file"),
    "missing urdf": (["check", "none.urdf"], "none.urdf: no such file"),
    "unknown suite": (["bench", "nonesuch"], "bench"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_exit_code_2_and_one_line(case, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments, expected = BAD[case]
    try:
        code = main(arguments)
    except SystemExit as leave:
        code = leave.code
    shown = capsys.readouterr()
    assert code == 2
    assert shown.err.startswith("energyopt: error: ") and shown.err.count("\n") == 1
    assert expected in shown.err
    assert list(tmp_path.iterdir()) == []


def test_an_out_that_is_a_file_is_bad_input(task, tmp_path, capsys):
    (tmp_path / "f").write_text("x")
    assert main(["plan", str(task), "--out", str(tmp_path / "f")]) == 2
    assert "is a file; expected a folder" in capsys.readouterr().err


def test_a_plan_that_is_not_solved_is_exit_code_1_and_its_best_attempt_is_written(task, tmp_path):
    out = tmp_path / "o"
    code = main(["plan", str(task), "--out", str(out), "--no-figures", "--time-limit", "1e-6"])
    summary = json.loads((out / "summary.json").read_text())
    assert code == 1 and summary["status"] == "TIME_LIMIT" and summary["valid"] is False
    assert eo.load_plan(out / "plan.npz").status is eo.Status.TIME_LIMIT


def test_check_and_robots_print_what_they_found(task, tmp_path, capsys):
    assert main(["check", str(task)]) == 0
    assert "no reason was found" in capsys.readouterr().out
    (tmp_path / "arm.urdf").write_text(eo.load_robot("ur5").urdf)
    assert main(["check", str(tmp_path / "arm.urdf")]) == 0
    assert "6 joints" in capsys.readouterr().out
    assert main(["robots"]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in ("panda", "ur5", "baxter", "kinova", "N·m"))


def test_check_names_what_makes_a_problem_impossible(tmp_path, capsys):
    (tmp_path / "p.toml").write_text(PENDULUM.replace("duration = 1.5", "duration = 0.05"))
    assert main(["check", str(tmp_path / "p.toml")]) == 2
    error = capsys.readouterr().err
    assert "duration" in error and "joint" in error


def test_version_names_backend_and_compiler(capsys):
    with pytest.raises(SystemExit) as leave:
        main(["--version"])
    shown = capsys.readouterr().out
    assert leave.value.code == 0
    assert shown.startswith(f"energyopt {eo.__version__}") and "dynamics:" in shown and "compiler:" in shown and "mujoco" in shown


def command(*arguments, **options):
    return subprocess.Popen([sys.executable, "-m", "energyopt", *arguments], stderr=subprocess.PIPE, text=True, **options)


def test_a_reader_that_leaves_early_causes_no_traceback():
    process = command("robots", stdout=subprocess.PIPE, env={**os.environ, "PYTHONUNBUFFERED": "1"})
    process.stdout.close()
    error = process.communicate(timeout=60)[1]
    assert process.returncode == 141 and error == ""


def test_a_terminal_without_greek_letters_gets_a_table_all_the_same(task):
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    process = command("plan", str(task), "--no-figures", stdout=subprocess.PIPE, env=environment)
    shown, error = process.communicate(timeout=120)
    assert process.returncode == 0 and error == "" and "SOLVED" in shown


@pytest.mark.skipif(sys.platform == "win32", reason="signals are a Unix thing")
def test_ctrl_c_ends_with_130_and_keeps_the_best_motion(tmp_path):
    out = tmp_path / "o"
    starts = ["--starts", "10000", "--accuracy", "none"]
    process = command("plan", "panda_reach", "--out", str(out), "--no-figures", *starts, stdout=subprocess.PIPE)
    time.sleep(6.0)  # well inside the ten thousand solves
    process.send_signal(signal.SIGINT)
    error = process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert "Traceback" not in error and error.splitlines()[-1].startswith("energyopt: interrupted")
    if (out / "plan.npz").exists():
        assert error.splitlines()[-1].endswith(f"the best motion so far is {out / 'plan.npz'}")
    if (out / "summary.json").exists():  # not where Ctrl-C came while kernels were still compiled
        assert json.loads((out / "summary.json").read_text())["status"] == "INTERRUPTED"


def test_a_sweep_refuses_its_folder_before_it_begins(tmp_path, capsys, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr("energyopt.sweeping.sweep", lambda *_, **__: pytest.fail("it has begun"))
    assert main(["sweep", "ur5_pick", "--duration", "1:2:3", "--out", str(tmp_path / "file")]) == 2
    assert "is a file" in capsys.readouterr().err


@pytest.mark.parametrize("durations", ["1:inf:3", "1:nan:3", "0:2:3", "1:2:0", "1:2:1001", "1:2"])
def test_durations_that_make_no_sense_are_one_line(durations, capsys, recwarn):
    with pytest.raises(SystemExit) as ended:
        main(["sweep", "ur5_pick", "--duration", durations])
    assert ended.value.code == 2 and capsys.readouterr().err.count("\n") <= 3 and not recwarn.list


def test_options_that_are_wrong_for_every_file_of_a_batch_end_it_before_it_begins(task, tmp_path, capsys):
    out = tmp_path / "o"
    assert main(["batch", str(task), "--starts", "0", "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert "starts is 0" in error and error.count("\n") == 1 and not out.exists()


def test_robust_prints_cases_and_replays_and_writes_them(results, tmp_path, capsys):
    out = tmp_path / "robust"
    options = ["--payload", "0:0.5", "--masses", "10", "--samples", "20", "--trials", "3", "--step", "0.001"]
    code = main(["robust", str(results), *options, "--out", str(out)])
    shown = capsys.readouterr().out
    assert "0.5 kg more, masses +10 %" in shown and "3 replays in MuJoCo" in shown
    found = json.loads((out / "robustness.json").read_text())
    assert code == (0 if found["cases"]["holds"] else 1)
    assert len(found["replays"]["trials"]) == 3 and len(found["cases"]["samples"]) == 20
    assert (out / "robustness.png").read_bytes().startswith(b"\x89PNG")
    again = tmp_path / "again"
    main(["robust", str(results / "plan.npz"), *options, "--out", str(again)])
    assert json.loads((again / "robustness.json").read_text()) == found


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--payload", "2:x"], "expected two numbers with a colon between"),
        (["--payload", "2:1"], "the least mass is above the largest"),
        (["--friction", "20"], "has no friction to vary"),
        (["--trials", "-1"], "trials is -1"),
        (["--delay", "-1", "--trials", "1"], "delay is -1"),
    ],
)
def test_robust_refuses_what_makes_no_sense_in_one_line(results, capsys, arguments, words):
    try:
        code = main(["robust", str(results), *arguments])
    except SystemExit as stop:
        code = stop.code
    error = capsys.readouterr().err
    assert code == 2 and words in error and error.count("\n") == 1
