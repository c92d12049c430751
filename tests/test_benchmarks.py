"""The benchmark scripts run and say what they measured; no time is judged here."""

import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import mbm_files
import numpy as np
import pytest

import energyopt as eo
from energyopt.cli import main

FOLDER = Path(__file__).resolve().parents[1] / "problems" / "benchmarks"
SUITES = sorted(path.stem for path in FOLDER.glob("[!_]*.py"))
SMALL = {
    "accuracy": ["--robot", "twodof", "--problems", "2", "--repeats", "1"],
    "durations": ["--robot", "twodof", "--problems", "2", "--repeats", "1", "--curves", "@swing", "--points", "3"],
    "kernels": ["--robots", "twodof", "--casadi", "twodof", "--repeats", "1", "--no-compilation"],
    "mbm": ["clutter", "--control-points", "16", "--accuracy", "0"],
    "rivals": ["--robots", "twodof", "--moves", "1", "--rivals", "quintic", "energyopt", "hermite_simpson", "textbook"],
    "moves": ["--robot", "twodof", "--problems", "2"],
    "optima": ["--robots", "twodof", "--problems", "2", "--many", "24"],
    "savings": ["--robots", "twodof", "--problems", "2"],
    "solvers": ["--robots", "twodof", "--problems", "2"],
    "speed": ["--robot", "twodof", "--problems", "2", "--repeats", "1", "--rivals", "1"],
    "scaling": ["--robots", "twodof", "--base", "twodof", "--control-points", "8", "16", "--obstacles", "6", "--moves", "2"],
    "what_if": ["--robots", "twodof", "--problems", "1"],
    "startup": ["--robot", "twodof", "--problems", "1", "--repeats", "1", "--no-figures"],
}
"""Settings with which each suite takes a few seconds."""

TWODOF = """name = "swing"
[robot]
name = "twodof"
[problem]
start = [0.2, 0.1]
goal = [0.6, -0.4]
duration = 2.0
"""


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """By suite: what the script printed and what it wrote, run once."""
    folder, found = tmp_path_factory.mktemp("benchmarks"), {}

    def run(suite):
        if suite not in found:
            arguments = list(SMALL[suite])
            arguments = [str(folder / "swing.toml") if word == "@swing" else word for word in arguments]
            if suite == "durations":
                (folder / "swing.toml").write_text(TWODOF)
            if suite == "startup":
                (folder / "swing.toml").write_text(TWODOF)
                arguments += ["--problem", str(folder / "swing.toml")]
            if suite == "mbm":
                mbm_files.small_set(folder / "clutter")
            path = folder / f"{suite}.json"
            command = [sys.executable, str(FOLDER / f"{suite}.py"), *arguments, "--json", str(path)]
            environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(FOLDER.parents[1]), os.environ.get("PYTHONPATH", "")])}
            done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr
            found[suite] = done.stdout, json.loads(path.read_text())
        return found[suite]

    return run


def spread(values):
    return values["lower"] <= values["median"] <= values["upper"] and all(map(math.isfinite, values.values()))


def test_a_profile_takes_a_plan_apart_without_a_remainder(tmp_path):
    command = [sys.executable, str(FOLDER / "speed.py"), "--profile", "--robot", "twodof", "--problems", "2"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(FOLDER.parents[1]), os.environ.get("PYTHONPATH", "")])}
    path = tmp_path / "profile.json"
    done = subprocess.run([*command, "--json", str(path)], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    parts = json.loads(path.read_text())["results"]["parts"]
    assert {"kernels", "assembly", "solver", "python", "plan"} == set(parts) and "IPOPT" in done.stdout
    assert 0 < parts["kernels"]["median"] < parts["plan"]["median"] and parts["python"]["median"] > 0


def test_every_suite_is_tested_small():
    assert sorted(SMALL) == SUITES


@pytest.mark.parametrize("suite", SUITES)
def test_a_suite_states_what_it_measures_on_which_machine(measured, suite):
    printed, written = measured(suite)
    assert written["suite"] == suite and written["measures"] in printed
    assert written["machine"]["cpu"] in printed and written["machine"]["cores"] >= 1
    assert f"energyopt {eo.__version__}" in printed and written["versions"]["casadi"] in printed
    assert "seed" in written["settings"] and "json" not in written["settings"]
    for goal in written["goals"]:
        assert goal["met"] == (goal["measured"] >= goal["bound"] if goal["least"] else goal["measured"] <= goal["bound"])


def test_speed_compares_the_same_optimum(measured):
    results = measured("speed")[1]["results"]
    assert results["share_solved"] == 1.0 and len(results["problems"]) == 2
    for key in ("seconds", "least_seconds"):
        assert all(
            spread(results[key][clock][stage]) for clock in ("wall", "cpu") for stage in ("solve", "build", "verify", "plan")
        )
    first = results["problems"][0]
    for rival in first["textbook"].values():
        assert rival["same"] == (abs(rival["objective"] / first["objective"] - 1.0) <= 1e-4) and rival["success"]
        assert rival["ratio"]["cpu"] == pytest.approx(rival["cpu"] / first["seconds"]["cpu"]["solve"])
    told = results["textbook"]["map_told"]
    assert told["same_optimum"] == told["problems"] == 1 and spread(told["ratio"]["cpu"])
    assert not results["problems"][1]["textbook"]


def test_accuracy_measures_the_true_error(measured):
    results = measured("accuracy")[1]["results"]
    assert results["share_solved"] == 1.0 and results["compared"] == 2
    for run in results["problems"]:
        assert 0.0 < run["estimated_error"] < 0.01 and run["levels"] >= 1 and run["moved"] > 0.0
        assert -1e-6 <= run["true_error"] < 0.05, "a finer motion space holds the coarser: J can only fall"


def test_no_plan_is_better_than_the_best_and_more_guesses_take_longer(measured):
    results = measured("optima")[1]["results"]
    assert len(results["moves"]) == results["all"]["moves"] == 2
    for run in results["moves"]:
        assert min(run["gap"].values()) == 0.0 and run["gap"]["default"] <= run["gap"]["one"]
        assert run["seconds"]["many"] > run["seconds"]["one"] and run["distinct"] >= 1
    assert results["all"]["default"]["within"] >= results["all"]["one"]["within"]


def test_kernel_times_cover_every_kind(measured):
    results = measured("kernels")[1]["results"]["twodof"]
    kinds = {"compiled", "interpreted", "casadi"} if "compiled" in results["us_per_node"] else {"interpreted"}
    assert results["joints"] == 2 and set(results["us_per_node"]) == kinds and results["compilation_s"] is None
    for times in results["us_per_node"].values():
        assert set(times) == {"torque", "adjoint", "jacobian", "hessian"} and min(times.values()) > 0.0


def test_scaling_fits_exponents_to_each_axis(measured):
    results = measured("scaling")[1]["results"]
    assert {axis: [point["n"] for point in found["points"]] for axis, found in results.items()} == {
        "joints": [2], "control_points": [8, 16], "obstacles": [6],
    }  # fmt: skip
    for found in results.values():
        for point in found["points"]:
            assert spread(point["seconds"]["plan"]) and point["share_solved"] == 1.0 and spread(point["memory_MB"])
            assert point["seconds"]["solve"]["median"] < point["seconds"]["plan"]["median"]
    assert results["joints"]["exponents"]["plan"] is None, "one size is no law"


def test_the_exponent_of_a_power_law_is_found(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    from scaling import exponent

    points = [{"n": n, "value": 3.0 * n**1.7} for n in (0, 5, 10, 20, 40, 80)]
    assert exponent(points, lambda point: point["value"]) == pytest.approx(1.7, rel=1e-12)
    assert exponent(points[:2], lambda point: point["value"]) is None


@pytest.mark.skipif(not os.access("/proc/self/clear_refs", os.W_OK), reason="the peak of memory cannot be reset here")
@pytest.mark.parametrize("size", [20_000, 4_000_000])
def test_memory_counts_for_every_plan_anew(monkeypatch, size):
    """32 MB in small blocks or in large ones, to a tenth; the second time though the first has just let go of as much."""
    monkeypatch.syspath_prepend(str(FOLDER))
    import _scaling_case as case

    monkeypatch.setattr(
        case.eo, "plan", lambda *given, **options: [np.ones(size // 8) for _ in range(32_000_000 // size)] and None
    )
    for _ in range(2):
        assert case.grown(None, None) == pytest.approx(32e6 / 2**20, rel=0.1)


def test_the_figure_of_scaling_is_drawn(measured, monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(FOLDER))
    from _scaling_figure import draw

    results = measured("scaling")[1]["results"]
    draw(results, {"joints": "joints", "control_points": "control points", "obstacles": "spheres"}, tmp_path / "scaling.png")
    assert (tmp_path / "scaling.png").read_bytes()[:4] == b"\x89PNG"


def test_startup_begins_with_an_empty_cache_and_a_light_import(measured):
    results = measured("startup")[1]["results"]
    assert not {"mujoco", "matplotlib"} & set(results["import"]["brings"])
    assert results["first_run"]["valid"] and results["second_run"]["valid"]
    assert results["second_run"]["time_s"]["compile"] <= results["first_run"]["time_s"]["compile"]
    assert all(run["share_solved"] == 1.0 and run["wall"] > 0.0 for run in results["interpreted"].values())


def test_savings_name_their_baselines(measured):
    results = measured("savings")[1]["results"]["twodof"]
    assert results["solved"] == results["problems"] == 2
    assert set(results["baselines"]) == {"quintic", "cubic", "cycloid", "trapezoidal"}
    for name, found in results["baselines"].items():
        assert spread(found["objective_percent"]) and spread(found["energy_percent"])
        assert (
            found["least_objective_percent_where_limits_hold"] is None or found["least_objective_percent_where_limits_hold"] > 0
        ), name


def test_random_moves_compare_at_the_asked_multiple_of_the_least_time(measured):
    """The quintic of a move at 1.3 times its least time is too fast in mid-way, whatever limit made that time."""
    printed, written = measured("moves")
    results = written["results"]
    assert results["solved"] == {"planned for J": 2, "planned for joules": 2} and results["compared"] == 2
    assert results["broken"]["quintic"]["any"] == 2 and "breaks something in 2 of 2" in printed
    for move in results["moves"]:
        planned = {key: move[f"planned for {key}"] for key in ("J", "joules")}
        assert not planned["J"]["broken"] and not planned["joules"]["broken"] and move["quintic"]["broken"] == ["velocity"]
        assert all(move[kind]["electrical_J"] > 0.0 for kind in ("quintic", "trapezoidal"))
    together = results["saved_percent"]["planned for J"]["quintic"]["mechanical_J"]["sum"]
    ours, theirs = (sum(move[name]["mechanical_J"] for move in results["moves"]) for name in ("planned for J", "quintic"))
    assert together == pytest.approx(100.0 - 100.0 * ours / theirs)
    for by_kind in results["saved_percent"].values():
        for by_key in by_kind.values():
            assert all(spread(saved["all"]) and saved["sum"] < 100.0 for saved in by_key.values())


def test_the_page_of_random_moves_says_what_its_joules_are(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    import moves

    page = moves.PAGE.read_text(encoding="utf-8").split(moves.BEGIN)[1].split(moves.END)[0]
    text = " ".join(page.split())
    assert "generic example drive, NOT of this arm" in text and all(word in text for word in moves.HEAD if "|" not in word)
    assert page.count("\n| planned for") == 4 and "The quintic motion breaks something in" in text


def test_clutter_is_judged_apart_from_its_planner(measured):
    """Two robots, one of them an arm of two; a goal inside a post counts for nothing."""
    printed, written = measured("mbm")
    results = written["results"]
    total, (left, turn, blocked) = results["total"], results["problems"]
    assert (total["problems"], total["valid_ends"], total["solved_and_valid"], total["false_successes"]) == (3, 2, 2, 0)
    assert set(results["groups"]) == {"baxter made", "ur5 made", "all"} and blocked["status"] == "INVALID_ENDS"
    assert "goal: forearm_link touches post" in blocked["why"] and "ur5_0002: INVALID_ENDS" in printed
    for record in (left, turn):
        assert record["duration_s"] == pytest.approx(1.5 * record["least_duration_s"])
        assert record["judged"]["clearance"] > 0.0 and not record["baseline"]["faults"]
        assert record["judged"]["torque_squared"] == pytest.approx(record["plan"]["torque_squared"], rel=1e-3), "another grid"
        assert record["saving"]["torque_squared"] > 0.0
        for clock in ("wall", "cpu"):
            plan, path, both = (record["seconds"][part][clock] for part in ("plan", "path", "all"))
            assert plan > 0.0 and path > 0.0 and both == plan + path


def test_clutter_that_is_not_there_is_named(tmp_path):
    command = [sys.executable, str(FOLDER / "mbm.py")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(FOLDER.parents[1]), os.environ.get("PYTHONPATH", "")])}
    environment.pop("ENERGYOPT_MBM", None)
    run = lambda *more: subprocess.run([*command, *more], env=environment, capture_output=True, text=True, check=False)
    done = run()
    assert done.returncode == 0 and "set ENERGYOPT_MBM" in done.stdout
    done = run(str(tmp_path))
    assert done.returncode == 2 and "holds no .json file" in done.stderr and "Traceback" not in done.stderr


def test_rivals_are_judged_alike(measured):
    results = measured("rivals")[1]["results"]
    found = results["robots"]["twodof"]
    assert results["notes"] == [] and set(found["rivals"]) == {"quintic", "energyopt", "hermite_simpson", "textbook"}
    runs = {name: entry["moves"][0] for name, entry in found["rivals"].items()}
    for name in ("energyopt", "hermite_simpson"):
        assert runs[name]["converged"] and runs[name]["valid"] and runs[name]["objective"] < runs["quintic"]["objective"]
    assert found["best"]["twodof 0"] == min(run["objective"] for run in runs.values() if run["valid"])
    against = found["against"]["energyopt"]
    assert against["compared"] == 1 and len(against["ratios"]) == against["as_good"]


def test_the_evaluator_of_rivals_agrees_with_the_dense_check(monkeypatch):
    """The quintic's J by the evaluator's midpoint rule and by Gauss quadrature; ∫Σq̇² in closed form, 10 |Δ|²/7T."""
    monkeypatch.syspath_prepend(str(FOLDER))
    from _rivals_judge import judge
    from _shared import random_moves

    from energyopt.verification import cost

    move = random_moves(eo.load_robot("panda"), 1, 3)[0]
    quintic = eo.baseline(move, "quintic")
    found, terms = judge(move, quintic), cost(move, quintic)
    assert found.objective == pytest.approx(sum(terms.values()), rel=1e-5), "midpoint rule, error of second order"
    way = move.goal - move.start
    light = replace(move, torque_weights=0.0, velocity_weight=1.0)
    assert judge(light, quintic).objective == pytest.approx(10 / 7 * way @ way / move.duration, rel=1e-5)
    assert found.valid and found.velocity == found.position == 0.0 and found.miss < 1e-12
    peak = max(15 / 8 * abs(way) / move.duration)
    slow = replace(move, velocity_limits=peak / 1.25)
    assert judge(slow, quintic).velocity == pytest.approx(0.25, rel=1e-4) and not judge(slow, quintic).valid
    elsewhere = replace(move, goal=move.goal + 0.01)
    assert judge(elsewhere, quintic).miss == pytest.approx(0.01) and not judge(elsewhere, quintic).valid


def test_a_missing_rival_is_skipped_with_a_note(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    import argparse

    import _rival_crocoddyl
    from rivals import _robot, text

    monkeypatch.setattr(_rival_crocoddyl.Fddp, "requires", ("no_such_package",))
    parsed = argparse.Namespace(rivals=["crocoddyl"], moves=1, seed=0, most_seconds=60.0)
    found = _robot("twodof", parsed)
    (note,) = found.pop("notes")
    assert "crocoddyl is skipped: no_such_package not installed" in note and found["rivals"] == {}
    assert note in text({"robots": {"twodof": found}, "notes": [note]})


def test_the_fastest_rival_counts_only_where_it_is_as_good(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    from rivals import compare

    run = lambda objective, seconds, valid=True: {
        "move": "m", "objective": objective, "seconds": seconds, "valid": valid, "build": 0.0,
        "converged": True, "violation": 0.0,
    }  # fmt: skip
    found = {name: {"moves": [one]} for name, one in {
        "energyopt": run(100.4, 0.1), "hermite_simpson": run(100.0, 2.0), "crocoddyl": run(100.3, 1.5),
        "textbook": run(103.0, 0.2), "drake": run(90.0, 0.3, valid=False), "quintic": run(99.0, 1e-4),
    }.items()}  # fmt: skip
    assert compare(found)["against"]["energyopt"] == {"compared": 1, "as_good": 1, "ratios": [15.0], "ratio": 15.0}
    found["energyopt"]["moves"][0]["objective"] = 100.6
    assert compare(found)["against"]["energyopt"] == {"compared": 1, "as_good": 0, "ratios": [], "ratio": None}
    found["energyopt_coarse"] = {"moves": [run(101.0, 0.01)]}
    found["energyopt_tighter"] = {"moves": [run(100.2, 0.3)]}
    against = compare(found)["against"]
    assert against["energyopt_coarse"]["as_good"] == 0 and against["one start"]["ratios"] == [5.0]


def test_of_two_runs_the_lesser_time_of_the_same_motion_counts_and_of_other_motions_the_later(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    from rivals import _least

    rows = lambda *moves: {"moves": [{"move": m, "objective": J, "seconds": s} for m, J, s in moves]}
    earlier = {"a": rows(("m 0", 10.0, 1.0), ("m 1", 20.0, 1.0), ("m 2", 5.0, 3.0)), "b": rows(("m 0", 11.0, 4.0))}
    later = {"a": rows(("m 0", 10.0, 2.0), ("m 1", 19.0, 2.0))}
    assert _least(earlier, later) == {"a": rows(("m 0", 10.0, 1.0), ("m 1", 19.0, 2.0), ("m 2", 5.0, 3.0)), "b": earlier["b"]}


def test_the_tables_of_rivals_are_written_between_markers(measured, monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(FOLDER))
    from _rivals_text import BEGIN, END, write_page

    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    write_page(page, measured("rivals")[1]["results"], {"cpu": "some CPU", "cores": 2, "load": 1.0})
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("after\n") and "old" not in text
    assert "some CPU, 2 cores" in text and "At a load of " in text and "| energyopt |" in text


def test_random_moves_are_seeded_and_stay_off_the_limits(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    from _shared import random_moves

    robot = eo.load_robot("twodof")
    moves, again, other = (random_moves(robot, 3, seed) for seed in (5, 5, 6))
    described = [[(*m.start, *m.goal, m.duration) for m in some] for some in (moves, again, other)]
    assert described[0] == described[1] != described[2]
    margin = 0.1 * (robot.limits.upper - robot.limits.lower)
    for q in (end for m in moves for end in (m.start, m.goal)):
        assert (q >= robot.limits.lower + margin).all() and (q <= robot.limits.upper - margin).all() and (abs(q) <= 2.5).all()
    for m in moves:
        assert 1.3 <= m.duration / (15 / 8 * max(abs(m.goal - m.start) / robot.limits.velocity)) <= 1.6


def test_the_command_line_knows_the_suites(capsys):
    assert main(["bench", "nonesuch"]) == 2
    listed = capsys.readouterr().err
    assert all(suite in listed for suite in SUITES) and "_shared" not in listed


def test_what_if_compares_plans_that_are_solved(measured):
    results = measured("what_if")[1]["results"]
    assert results["all"]["runs"] == len(results["runs"]) == results["all"]["solved"] >= 6
    assert spread(results["all"]["ratio"]) and spread(results["all"]["objective_ratio"])
    for run in results["runs"]:
        assert run["ratio"] == pytest.approx(run["seconds"] / run["cold_seconds"])
