"""Results show themselves in one line, and tell themselves in a few: what a user reads at a prompt or in a notebook."""

import dataclasses
import importlib
import inspect
import pkgutil

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt.readable import Readable, counted


@pytest.fixture(scope="module")
def shown():
    robot = arms.pendulum()
    problem = eo.Problem(robot, [-1.2], [1.0], 1.5, name="swing", waypoints=[[0.2]])
    plan = eo.plan(problem)
    log = eo.replay(plan)
    report = eo.validate(plan, log)
    account = eo.energy_account(plan)
    return {
        "robot": robot, "problem": problem, "plan": plan, "motion": plan.trajectory, "log": log, "report": report,
        "quintic": report.baselines["quintic"], "metrics": report.plan_metrics, "series": report.plan_metrics.series,
        "account": account, "powers": account.series, "bounds": eo.duration_bounds(eo.Problem(robot, [-1.2], [1.0], 1.5)),
        "curve": eo.sweep(eo.Problem(robot, [-1.2], [1.0], 1.5), [1.2, 1.5]),
        "moves": eo.plan_sequence([eo.Problem(robot, [-1.2], [1.0], 1.5)], 2.0),
        "slopes": eo.sensitivities(eo.plan(eo.Problem(robot, [-1.2], [1.0], 1.5))),
        "cases": eo.robustness(plan, payload=(0, 0.1), samples=2), "trials": eo.replay_trials(plan, payload=(0, 0.1), trials=1),
        "session": eo.what_if(eo.Problem(robot, [-1.2], [1.0], 1.5)),
    }  # fmt: skip


def test_every_result_is_one_short_line(shown):
    for name, result in shown.items():
        line = repr(result)
        assert line.startswith(f"<{type(result).__name__}: ") and line.endswith(">"), (name, line)
        assert "\n" not in line and len(line) < 250 and "0x" not in line, (name, line)


def test_the_lines_say_what_it_is(shown):
    plan = shown["plan"]
    assert repr(plan) == f"<Plan: SOLVED, {plan.problem.robot.name}, 1.5 s, J {plan.objective:.6g}>"
    assert repr(shown["problem"]) == f"<Problem: swing, {plan.problem.robot.name}, 1.5 s, 1 waypoint>"
    assert repr(shown["robot"]) == f"<RobotModel: {plan.problem.robot.name}, 1 joint>"
    assert repr([plan, plan]) == f"[{plan!r}, {plan!r}]"
    assert repr(eo.Problem(shown["robot"], [0.0], [1.0], (0.5, 2.0))).endswith(", 0.5 to 2 s>")


def test_a_plan_tells_status_cost_limits_and_optima(shown):
    plan = shown["plan"]
    told = str(plan)
    for words in (plan.message, f"{plan.objective:.6g} = ", "torque_squared", "tightest: ", "from ", "solve "):
        assert words in told
    assert sum(plan.cost_terms.values()) == pytest.approx(plan.objective)


def test_a_plan_that_failed_tells_why():
    robot = arms.pendulum()
    plan = eo.plan(eo.Problem(robot, [-1.2], [1.0], 1.5), eo.BSpline(accuracy=None), iterations=1, starts=1, throw=False)
    assert not plan.solved and plan.status.value in repr(plan) and plan.message in str(plan)


def test_a_notebook_shows_all_of_one_result_and_a_line_for_each_in_a_list(shown):
    pretty = pytest.importorskip("IPython.lib.pretty").pretty
    plan = shown["plan"]
    assert pretty(plan) == str(plan) and pretty(shown["report"]) == str(shown["report"])
    assert pretty([plan]) == f"[{plan!r}]"


def test_no_result_prints_pages_of_numbers():
    """Each dataclass of the package that holds another result or a robot's model has a line of its own."""
    for module in pkgutil.walk_packages(eo.__path__, "energyopt."):
        if module.name.split(".")[-1].startswith("_"):
            continue
        for kind in vars(importlib.import_module(module.name)).values():
            if inspect.isclass(kind) and kind.__module__ == module.name and issubclass(kind, Readable):
                assert kind.in_brief is not Readable.in_brief or kind is Readable, kind
                if dataclasses.is_dataclass(kind):
                    assert "__repr__" not in vars(kind), f"{kind}: repr=False is missing, and Python's own repr is used"


@pytest.mark.parametrize("number, words", [(0, "0 joints"), (1, "1 joint"), (7, "7 joints")])
def test_counted(number, words):
    assert counted(number, "joint") == words


def test_the_table_of_a_robot_names_every_joint_and_limit():
    robot = eo.load_robot("panda")
    told = str(robot)
    for name, torque in zip(robot.joint_names, robot.limits.torque, strict=True):
        line = next(line for line in told.splitlines() if line.split()[0] == name)
        assert np.isclose(float(line.split()[-1]), torque)
