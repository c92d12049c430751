"""README and docs/: their code runs, their commands work, their numbers and tables are those of today's code."""

import ast
import importlib.util
import json
import os
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import energyopt as eo
from energyopt.cli import main
from energyopt.cli_parser import make_parser
from energyopt.io import catalogue_problems, load_task
from energyopt.plans import Status
from energyopt.verification import RELATIVE_TOLERANCES, TOLERANCES

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").glob("*.md"))]
TEXT = {page.name: page.read_text(encoding="utf-8") for page in PAGES}


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT[page], flags=re.DOTALL | re.MULTILINE)


def script(name):
    """A script of docs/ as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def panda_reach():
    problem, options = load_task("panda_reach")
    plan = eo.plan(problem, **options)
    return plan, eo.validate(plan)


@pytest.mark.parametrize("page", [name for name in TEXT if blocks(name, "python")])
def test_python_on_the_page_runs_from_top_to_bottom(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    namespace = {}
    for number, code in enumerate(blocks(page, "python"), start=1):
        exec(compile(code, f"{page}, block {number}", "exec"), namespace)
    plans = [value for value in namespace.values() if isinstance(value, eo.Plan)]
    assert plans and all(plan.solved for plan in plans)


def test_the_first_trajectory_takes_five_statements():
    first = blocks("README.md", "python")[0]
    assert len(ast.parse(first).body) <= 5
    namespace = {}
    exec(first, namespace)
    assert namespace["plan"].status is eo.Status.SOLVED
    assert namespace["plan"].trajectory(np.linspace(0, 1.5, 4)).shape == (4, 7)


def commands_on(page):
    """What follows ``energyopt`` in the shell blocks of a page; curves have four points here, however many they have there."""
    lines = [line.split("#")[0].strip() for block in blocks(page, "sh") for line in block.splitlines()]
    found = [shlex.split(line)[1:] for line in lines if line.startswith("energyopt ")]
    assert len(found) >= 4, page
    return [tuple(re.sub(r"^([\d.]+:[\d.]+):\d+$", r"\1:4", word) for word in command) for command in found]


def test_commands_on_the_pages_work(tmp_path, monkeypatch, capsys):
    """One page after the other in one folder; a command that both show is run once."""
    monkeypatch.chdir(tmp_path)
    for command in dict.fromkeys([*commands_on("README.md"), *commands_on("command_line.md")]):
        assert main(list(command)) == 0, (command, capsys.readouterr())
    assert (tmp_path / "results" / "report.html").is_file()


def test_make_targets_on_the_pages_exist():
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE))
    named = {word for text in TEXT.values() for word in re.findall(r"(?:`|^)make ([a-z]+)\b", text, flags=re.MULTILINE)}
    assert {"demo", "test"} <= named <= targets


def test_links_and_pictures_lead_to_files():
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#]+)[^)]*\)", TEXT[page.name]):
            assert target.startswith("https://") or (page.parent / target).exists(), f"{page.name}: {target}"
    listed = set(re.findall(r"\]\(([a-z_]+\.md)\)", TEXT["index.md"]))
    assert listed == {page.name for page in PAGES} - {"README.md", "index.md"}


def test_files_and_names_on_the_pages_exist():
    for name, text in TEXT.items():
        for path in re.findall(r"`((?:docs|problems|tests|notebooks|energyopt)/[\w./]*)`", text):
            assert (ROOT / path).exists(), f"{name}: {path}"
        for attribute in re.findall(r"\beo\.(\w+)", text):
            assert hasattr(eo, attribute), f"{name}: eo.{attribute}"


def test_modules_of_the_concepts_page_are_those_of_the_package():
    layers = TEXT["concepts.md"].split("## The layers")[1].split("## Where")[0]
    rows = re.findall(r"^\| (`.*?) \|", layers, flags=re.MULTILINE)
    named = {name.rstrip("/") for row in rows for name in re.findall(r"`([a-z_]+/?)`", row)}
    package = ROOT / "energyopt"
    assert len(named) > 15 and not [n for n in named if not ((package / f"{n}.py").exists() or (package / n).is_dir())]


def test_every_option_of_the_command_line_is_documented_and_no_other():
    text = TEXT["command_line.md"]
    commands = next(a for a in make_parser()._actions if hasattr(a, "choices") and a.choices).choices
    for name, parser in commands.items():
        assert f"## energyopt {name}" in text
        part = text.split(f"## energyopt {name}")[1].split("\n## ")[0]
        options = {o for action in parser._actions for o in action.option_strings if o.startswith("--")} - {"--help"}
        assert set(re.findall(r"(--[a-z][a-z-]*)", part)) == options, name


def test_the_table_of_keys_is_that_of_the_schema():
    reference = script("make_reference")
    assert reference.renewed("problem_files.md") == TEXT["problem_files.md"], "run: python docs/make_reference.py"


def test_test_files_of_the_validation_page_exist():
    named = re.findall(r"`(test_\w+\.py)`", TEXT["validation.md"])
    assert len(named) > 10 and all((ROOT / "tests" / name).exists() for name in named)


def test_the_problem_file_on_the_page_is_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("carry.toml").write_text(blocks("problem_files.md", "toml")[0], encoding="utf-8")
    problem, options = load_task("carry.toml")
    assert problem.robot.name == "ur5" and problem.limits.torque[2] == 100 and len(problem.waypoints) == 1
    assert problem.limits.acceleration[0] == pytest.approx(np.radians(350))
    assert eo.plan(problem, **options).solved


def test_the_problem_file_on_the_page_of_obstacles_is_one_and_is_solved(tmp_path):
    """It has every section about what to keep clear of."""
    path = tmp_path / "scene.toml"
    path.write_text(blocks("obstacles.md", "toml")[0], encoding="utf-8")
    problem = eo.load_problem(path)
    assert len(problem.obstacles) == 3 and len(problem.workspace) == 2 and problem.attached and problem.potential
    plan = eo.plan(problem, eo.BSpline(accuracy=None))
    assert plan.solved and eo.replay(plan).contact_steps == 0


def entry(summary, key):
    """The value under a dotted key; "…" stands for any name."""
    for part in key.split("."):
        summary = next(iter(summary.values())) if part == "…" else summary[part]
    return summary


def test_keys_of_the_summary_are_documented_and_no_other(tmp_path):
    task = '[robot]\nname = "twodof"\n[problem]\nstart = [0, 0]\ngoal = [0.4, 0.2]\nduration = 2\n[method]\naccuracy = false\n'
    (tmp_path / "task.toml").write_text(task, encoding="utf-8")
    assert main(["plan", str(tmp_path / "task.toml"), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    rows = re.findall(r"^\| (`.*?) \|", TEXT["files.md"].split("## summary.json")[1], flags=re.MULTILINE)
    keys = {key for row in rows for key in re.findall(r"`([^`]+)`", row)} - {"replay_failure"}
    assert {key.split(".")[0] for key in keys} == set(summary)
    assert {key for key in keys if key.startswith("energy.")} == {f"energy.{key}" for key in summary["energy"]}
    for key in keys:
        entry(summary, key)
    files = set(re.findall(r"^\| `([\w.]+)` \|", TEXT["files.md"].split("## summary.json")[0], flags=re.MULTILINE))
    assert files == {path.name for path in (tmp_path / "out").iterdir()}


def test_every_status_is_documented():
    assert all(f"`{status.value}`" in TEXT["files.md"] for status in Status)


def test_the_guarantees_of_the_readme_are_the_tolerances_of_the_check():
    table = TEXT["README.md"].split("### What `SOLVED` guarantees")[1].split("A motion that fails")[0]
    assert {TOLERANCES[name] for name in ("position", "velocity", "acceleration")} == {1e-6}
    assert "1e-6 rad, rad/s, rad/s²" in table
    assert RELATIVE_TOLERANCES["jerk"] == 1e-4 and "1e-4 % of the limit" in table
    assert TOLERANCES["torque_percent"] == RELATIVE_TOLERANCES["torque_rate"] == 1e-2 and table.count("0.01 % of the limit") == 2
    assert TOLERANCES["goal"] == 1e-5 and {TOLERANCES[name] for name in ("boundary", "waypoint")} == {1e-6}


def test_the_figures_of_the_readme_text_are_those_of_the_run(panda_reach):
    """Objectives to 1 %, joules to 1 J: the accuracy of a plan is 1 %."""
    plan, report = panda_reach
    quintic = report.baselines["quintic"]
    words = " ".join(TEXT["README.md"].split())
    before, after = re.search(r"The objective falls from (\d+) .*? to (\d+)\.", words).groups()
    assert float(before) == pytest.approx(quintic.objective, rel=0.01) and float(after) == pytest.approx(plan.objective, rel=0.01)
    theirs, ours = re.search(r"here falls from (\d+) to (\d+) J", words).groups()
    assert float(theirs) == pytest.approx(quintic.metrics.mechanical_abs_J, abs=1)
    assert float(ours) == pytest.approx(report.plan_metrics.mechanical_abs_J, abs=1)


def test_the_table_of_savings_lists_every_problem_and_agrees_with_a_run(panda_reach):
    """Savings of panda_reach to one percentage point."""
    figures = script("make_figures")
    table = TEXT["README.md"].split(figures.BEGIN)[1].split(figures.END)[0]
    assert tuple(re.findall(r"^\| `(\w+)` \|", table, flags=re.MULTILINE)) == catalogue_problems()
    plan, report = panda_reach
    (row,) = [line for line in table.splitlines() if "`panda_reach`" in line]
    fresh = figures._row("panda_reach", plan, report, eo.replay(plan, collisions=True))
    assert row.count("✗") == fresh.count("✗") and row.split("|")[-2] == fresh.split("|")[-2] == " no "
    shown, now = (np.array(re.findall(r"(-?[\d.]+) %", line), float) for line in (row, fresh))
    np.testing.assert_allclose(shown, now, atol=1.0)


def test_the_readme_figure_is_a_picture_of_its_script():
    from matplotlib.image import imread

    for name in ("panda_reach", "panda_reach_joints"):
        image = imread(ROOT / "docs" / "figures" / f"{name}.png")
        assert image.shape[1] == script("make_figures").WIDTH_PIXELS
    assert os.path.getsize(ROOT / "docs" / "figures" / "panda_reach.png") < 400_000
