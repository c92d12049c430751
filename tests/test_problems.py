"""Every catalogue problem is solved, replayed without contact and found valid; those among obstacles need to know of them."""

from dataclasses import replace

import pytest

import energyopt as eo
from energyopt.io import catalogue_problems, load_task, problems_folder
from energyopt.verification import verify
from energyopt.workflow import run

OBSTACLES = {
    "panda_clutter": "static clutter",
    "ur5_slot": "a narrow gap",
    "xarm7_conveyor": "a moving part",
    "z1_cell": "workspace walls",
    "panda_fold": "self-collision",
    "baxter_table": "two arms",
}
"""Problems in which something is in the way."""
HIT = 5e-3
"""Depth [m] from which a motion that knows of no obstacle is said to hit it: not a graze that the next release might miss."""


@pytest.mark.parametrize("name", catalogue_problems())
def test_catalogue_problem_is_solved_and_survives_its_replay(name):
    problem, options = load_task(name)
    outcome = run(problem, options)
    assert outcome.plan.solved, outcome.plan.message
    assert outcome.valid, [check for check in outcome.report.checks if not check.passed]
    assert outcome.log.contacts is not None and outcome.log.contact_steps == 0
    assert outcome.report.tracking.joint_max < 5e-3  # rad; the threshold of the validation, met with a wide margin
    valid_baselines = [b for b in outcome.report.baselines.values() if b.valid]
    assert all(outcome.plan.objective <= b.objective * (1 + 1e-3) for b in valid_baselines)


def test_the_catalogue_shows_ten_problems_on_five_robots():
    tasks = [load_task(name) for name in catalogue_problems()]
    assert len(tasks) >= 10
    assert len({problem.robot.name for problem, _ in tasks}) >= 5
    kinds = {type(options.get("parameterization")).__name__ for _, options in tasks}
    assert {"Sinusoid", "HermiteSimpson"} <= kinds


@pytest.mark.parametrize("name", OBSTACLES)
def test_without_its_obstacles_the_optimum_would_hit_them(name):
    """The obstacles and walls are taken away; where the arm itself is the obstacle, it may touch itself. One guess, the straight
    one, as the problems with obstacles begin with."""
    problem, _ = load_task(name)
    around = bool(problem.obstacles or problem.workspace)
    gone = {"obstacles": (), "workspace": None, "potential": None} if around else {"self_collision": False}
    bare = eo.plan(replace(problem, clearance=0.0, **gone), eo.BSpline(accuracy=None), starts=1)
    found = verify(problem, bare.trajectory)
    assert bare.solved and found.distance < -HIT
    kinds = {shape.name for shape in problem.obstacles} | {f"cell {side}{axis}" for side in "+-" for axis in "xyz"} | {"tray"}
    assert (found.worst["clearance"][0].split("–")[1] in kinds) == around


def test_the_problems_among_obstacles_show_every_kind_on_five_robots():
    problems = {name: load_task(name)[0] for name in OBSTACLES}
    assert len({problem.robot.name for problem in problems.values()}) >= 5
    assert sum(len(problem.obstacles) > 3 for problem in problems.values()) >= 1
    assert any(shape.moves for shape in problems["xarm7_conveyor"].obstacles)
    assert {bool(wall.frames) for wall in problems["z1_cell"].workspace} == {True, False}
    assert not problems["panda_fold"].obstacles and problems["panda_fold"].self_collision
    assert problems["baxter_table"].robot.nv == 14
    assert any(problem.potential for problem in problems.values())


@pytest.mark.parametrize("name", catalogue_problems())
def test_catalogue_problem_has_its_own_name_and_says_what_it_shows(name):
    path = problems_folder() / f"{name}.toml"
    assert path.read_text(encoding="utf-8").startswith("# ")
    assert load_task(path)[0].name == name
