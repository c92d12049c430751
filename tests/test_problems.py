"""Every catalogue problem is solved, replayed and found valid, at the accuracy its file asks for."""

import pytest

from energyopt.io import catalogue_problems, load_task, problems_folder
from energyopt.workflow import run


@pytest.mark.parametrize("name", catalogue_problems())
def test_catalogue_problem_is_solved_and_survives_its_replay(name):
    problem, options = load_task(name)
    outcome = run(problem, options)
    assert outcome.plan.solved, outcome.plan.message
    assert outcome.valid, [check for check in outcome.report.checks if not check.passed]
    assert outcome.report.tracking.joint_max < 5e-3  # rad; the threshold of the validation, met with a wide margin
    valid_baselines = [b for b in outcome.report.baselines.values() if b.valid]
    assert all(outcome.plan.objective <= b.objective * (1 + 1e-3) for b in valid_baselines)


def test_the_catalogue_shows_ten_problems_on_five_robots():
    tasks = [load_task(name) for name in catalogue_problems()]
    assert len(tasks) >= 10
    assert len({problem.robot.name for problem, _ in tasks}) >= 5
    kinds = {type(options.get("parameterization")).__name__ for _, options in tasks}
    assert {"Sinusoid", "HermiteSimpson"} <= kinds


@pytest.mark.parametrize("name", catalogue_problems())
def test_catalogue_problem_has_its_own_name_and_says_what_it_shows(name):
    path = problems_folder() / f"{name}.toml"
    assert path.read_text(encoding="utf-8").startswith("# ")
    assert load_task(path)[0].name == name
