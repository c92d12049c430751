"""Drives and costs in problem files and plans: what they mean, that they come back, and one clear line for every wrong one."""

import json

import numpy as np
import pytest

import energyopt as eo
from energyopt import costs
from energyopt.actuators import ActuatorModel, Actuators
from energyopt.baselines import baseline
from energyopt.cli import main
from energyopt.errors import InputError
from energyopt.io.energy_parts import actuators_from_meta, actuators_meta, costs_from_meta, costs_meta
from energyopt.io.energy_schema import PARAMETERS, parameters_of
from energyopt.io.parts import problem_arrays, problem_from_arrays
from energyopt.plans import Plan, Status, Violations
from energyopt.report_problem import problem_sections
from energyopt.verification import cost

DRIVES = """
[robot.actuators]
gear_ratio = 100
torque_constant = [0.1, 0.1, 0.1, 0.05, 0.05, 0.05]
resistance = 0.3
efficiency = { elbow_joint = 0.8 }
regeneration = 0.25
shared_bus = true
standby_power = 20
source = "a data sheet"
"""
TASK = """
[robot]
name = "ur5"
%s
[problem]
start = [0, -1, 1, 0, 0.5, 0]
goal = [1.0, -1.2, 0.7, 0, 0, 0]
duration = 1
%s
"""
TERMS = """
[[problem.cost]]
type = "torque_squared"
weight = 0.1
weights = [1, 1, 1, 1, 1, 2]

[[problem.cost]]
type = "electrical_energy"
smoothing = 0.2
"""


def load(folder, drives=DRIVES, terms=""):
    path = folder / "task.toml"
    path.write_text(TASK % (drives, terms), encoding="utf-8")
    return eo.load_problem(path)


def test_drives_of_a_file_are_those_of_the_robot(tmp_path):
    drives = load(tmp_path).robot.actuators
    assert drives.models[2] == ActuatorModel(100, 0.1, 0.3, efficiency=0.8, regeneration=0.25)
    assert drives.models[5] == ActuatorModel(100, 0.05, 0.3, regeneration=0.25)
    assert drives.shared_bus and drives.standby_power == 20 and drives.source == "a data sheet"
    assert load(tmp_path, drives="").robot.actuators is None


WRONG_DRIVES = [
    ("resistance = 0.3", "", "3: robot.actuators.resistance is missing; expected"),
    ("resistance = 0.3", "resistance = {elbow_joint=1}", "8: robot.actuators.resistance has no number for joint 'shoulder_pan"),
    ("resistance = 0.3", "resistance = {elbow=1}", "8: robot.actuators.resistance.elbow is not a joint that moves; did you"),
    ("resistance = 0.3", "resistance = [1, 2]", "8: robot.actuators.resistance has 2 numbers; expected 6"),
    ("resistance = 0.3", "resistance = [1, 2, 3, 4, 5, -6]", "8: robot.actuators: joint 'wrist_3_joint': resistance is -6;"),
    ("elbow_joint = 0.8", "elbow_joint = 1.8", "9: robot.actuators: joint 'elbow_joint': efficiency is 1.8; expected"),
    ("power = 20", "power = -20", "12: robot.actuators.standby_power is -20; expected a number ≥ 0 [W]"),
    ("0.25", "[0, 0, 0, 0, 0, 1]", "10: robot.actuators: regeneration is 0, 1 on one shared bus; expected one value"),
    ("shared_bus = true", "shared = true", "11: robot.actuators.shared is not a known key; did you mean shared_bus?"),
]


@pytest.mark.parametrize("old, new, message", WRONG_DRIVES)
def test_wrong_drives_are_named_with_their_line(tmp_path, old, new, message):
    assert DRIVES.count(old) == 1
    if "is missing" in message:
        message = message.replace("3:", "5:", 1)
    with pytest.raises(InputError) as error:
        load(tmp_path, DRIVES.replace(old, new))
    assert str(error.value).startswith(f"{tmp_path / 'task.toml'}:{message}") and "\n" not in str(error.value)


def saved_and_loaded(problem, path):
    motion = baseline(problem, "quintic")
    terms = cost(problem, motion)
    found = Violations({"velocity": 0.0})
    Plan(problem, Status.SOLVED, "fine", motion, sum(terms.values()), terms, found, None, 7, {"solve": 0.1}, 3, {}).save(path)
    return eo.load_plan(path).problem


def test_drives_come_back_from_a_saved_plan_bit_for_bit(tmp_path):
    problem = load(tmp_path, DRIVES.replace("0.3", "0.1234567890123456789"))
    back = saved_and_loaded(problem, tmp_path / "plan.npz").robot.actuators
    assert back.models == problem.robot.actuators.models
    assert (back.shared_bus, back.standby_power, back.source) == (True, 20.0, "a data sheet")
    bare = saved_and_loaded(load(tmp_path, drives=""), tmp_path / "plan.npz")
    assert bare.robot.actuators is None


def fitted_terms():
    """Every exported term, its numbers all different from the defaults, for three joints."""
    drives = Actuators([ActuatorModel(100, 0.1, 0.3, 0.7, 0.2, 1.5)] * 3, shared_bus=True, standby_power=2.0, source="x")
    values = {"weights": np.array([1 / 3, 2.0, 0.1]), "smoothing": 0.1 + 0.2, "actuators": drives}
    for k, kind in enumerate(costs.COSTS.values()):
        own = {key: value for key, value in values.items() if key in kind.__dataclass_fields__}
        yield kind(**own, weight=1.0 / (k + 3))


@pytest.mark.parametrize("term", list(fitted_terms()), ids=lambda term: term.name)
def test_every_term_comes_back_from_json_bit_for_bit(term):
    meta = json.loads(json.dumps(costs_meta([term], None)))
    (back,) = costs_from_meta(meta, None, 3)
    assert type(back) is type(term)
    for key in term.__dataclass_fields__:
        mine, other = getattr(term, key), getattr(back, key)
        if key == "actuators":
            assert actuators_meta(mine) == actuators_meta(other)
        else:
            assert np.array_equal(mine, other)


def test_a_term_with_the_robots_own_drives_gets_them_back_from_the_robot():
    drives = Actuators([ActuatorModel(100, 0.1, 0.3)])
    meta = costs_meta([costs.ElectricalEnergy(drives)], drives)
    assert "actuators" not in meta[0]
    assert costs_from_meta(meta, drives, 1)[0].actuators is drives


def test_every_parameter_of_a_term_can_be_written_in_a_file():
    for kind in costs.COSTS:
        assert set(parameters_of(kind)) <= set(PARAMETERS), kind


DAMAGED = [
    {"type": "heat", "own": {}},
    {"type": "torque_squared", "own": {"weights": [-1.0, 1, 1]}},
    {"type": "torque_squared", "own": {"weigths": [1.0]}},
    {"type": "torque_squared", "own": {"weight": "1"}},
    {"type": "electrical_energy", "own": {"actuators": None}},
    {"type": "electrical_energy", "own": {}, "actuators": {"gear_ratio": [1, 1, 1]}},
    {"own": {}},
    3,
]


@pytest.mark.parametrize("item", DAMAGED, ids=str)
def test_damaged_terms_are_refused(item):
    with pytest.raises((InputError, ValueError, TypeError, KeyError)):
        costs_from_meta([item], None, 3)


def test_damaged_drives_are_refused():
    good = actuators_meta(Actuators([ActuatorModel(100, 0.1, 0.3)] * 3))
    assert actuators_from_meta(good, 3).models[0].resistance == 0.3
    for change in ({"resistance": [1.0]}, {"resistance": 1.0}, {"resistance": [1, 2, "x"]}, {"shared_bus": 1}, {"source": None}):
        with pytest.raises((InputError, ValueError)):
            actuators_from_meta(good | change, 3)
    for key in good:
        with pytest.raises(KeyError):
            actuators_from_meta({k: v for k, v in good.items() if k != key}, 3)


def test_costs_of_a_file_are_those_of_the_problem(tmp_path):
    problem = load(tmp_path, terms=TERMS)
    squared, electrical = problem.costs
    assert isinstance(squared, costs.TorqueSquared) and squared.weight == 0.1 and squared.weights.tolist() == [1, 1, 1, 1, 1, 2]
    assert isinstance(electrical, costs.ElectricalEnergy) and electrical.smoothing == 0.2
    assert electrical.actuators is problem.robot.actuators


def test_costs_come_back_from_a_saved_plan_bit_for_bit(tmp_path):
    problem = load(tmp_path, terms=TERMS.replace("0.1", "0.1234567890123456789"))
    back = saved_and_loaded(problem, tmp_path / "plan.npz")
    assert [type(term) for term in back.costs] == [type(term) for term in problem.costs]
    assert back.costs[0].weight == problem.costs[0].weight and np.array_equal(back.costs[0].weights, problem.costs[0].weights)
    assert back.costs[1].smoothing == 0.2 and back.costs[1].actuators is back.robot.actuators


WRONG_TERMS = [
    ("smoothing = 0.2", "smoothing = 1e-9", "27: problem.cost[1]: smoothing is 1e-09: expected a width [W]"),
    ("smoothing = 0.2", "weights = 0.2", "27: problem.cost[1].weights is 0.2; expected only with torque_squared"),
    ("smoothing = 0.2", "weight = -0.2", "27: problem.cost[1].weight is -0.2; expected a number ≥ 0"),
    ("smoothing = 0.2", "width = 0.2", "27: problem.cost[1].width is not a known key;"),
    ("[1, 1, 1, 1, 1, 2]", "[1, 1, 1, 1, 1]", "23: problem.cost[0]: weights: expected 6 numbers, one for each of shoulder"),
    ("[1, 1, 1, 1, 1, 2]", "[1, 1, 1, 1, 1, -1]", "23: problem.cost[0]: weights is -1: expected a number ≥ 0"),
    ('"torque_squared"', '"torque"', '21: problem.cost[0].type is "torque"; expected one of torque_squared, velocity'),
    ('"torque_squared"', '"electrical_energy"', "23: problem.cost[0].weights is [1, 1, 1, 1, 1, 2]; expected only with"),
    ('"electrical_energy"\nsmoothing = 0.2', '"torque_squared"', "25: problem.cost[1] is a second torque_squared: expected"),
    ('type = "electrical_energy"\n', "", "25: problem.cost[1].type is missing; expected one of"),
]


@pytest.mark.parametrize("old, new, message", WRONG_TERMS)
def test_wrong_costs_are_named_with_their_line(tmp_path, old, new, message):
    assert TERMS.count(old) == 1
    with pytest.raises(InputError) as error:
        load(tmp_path, terms=TERMS.replace(old, new))
    assert str(error.value).startswith(f"{tmp_path / 'task.toml'}:{message}") and "\n" not in str(error.value)


def test_costs_that_contradict_the_rest_of_the_file_are_refused(tmp_path):
    for drives, terms, message in (
        ("", TERMS, "problem.cost[1]: ur5 has no actuator models: give them to load_robot"),
        (
            DRIVES,
            "velocity_weight = 0.1\n" + TERMS,
            "problem.velocity_weight stands beside [[problem.cost]]; expected one of them",
        ),
        (
            DRIVES,
            '[[problem.cost]]\ntype = "torque_squared"\nweight = 0\n',
            "problem.cost: the weights of torque_squared are all zero",
        ),
        (DRIVES, 'cost = "energy"\n', 'problem.cost is "energy"; expected a list of tables, each under [[problem.cost]]'),
    ):
        with pytest.raises(InputError) as error:
            load(tmp_path, drives, terms)
        assert message in str(error.value) and "\n" not in str(error.value)


def test_a_file_may_leave_the_duration_free_and_a_plan_file_gives_the_range_back(tmp_path):
    path = tmp_path / "task.toml"
    text = (TASK % (DRIVES, TERMS)).replace("duration = 1", "duration = [1, 3]")
    path.write_text(text, encoding="utf-8")
    problem = eo.load_problem(path)
    assert problem.durations == (1.0, 3.0) and problem.free_duration
    arrays = {}
    meta = problem_arrays(problem, arrays)
    own = {key.removeprefix("problem."): value for key, value in arrays.items()}
    assert problem_from_arrays(json.loads(json.dumps(meta)), problem.robot, own).duration == (1.0, 3.0)
    for wrong, words in (
        ("[3, 1]", "expected the least below the most"),
        ("[-1, 3]", "expected one number of seconds"),
        ("[1]", "a pair"),
    ):
        path.write_text(text.replace("[1, 3]", wrong), encoding="utf-8")
        with pytest.raises(InputError, match=rf"task.toml:1[0-9]+: .*duration .*{words}"):
            eo.load_problem(path)


def test_check_and_report_say_what_is_minimised_with_which_drives(tmp_path, capsys):
    path = tmp_path / "task.toml"
    path.write_text((TASK % (DRIVES, TERMS)).replace("duration = 1", "duration = [1, 3]"), encoding="utf-8")
    assert main(["check", str(path)]) == 0
    assert "a well-formed problem of 1 to 3 s" in capsys.readouterr().out
    asked = problem_sections(eo.load_problem(path))[0]
    for words in (
        "∫(0.1 Σwτ² + supply power)dt",
        "1, 1, 1, 1, 1, 2",
        "1 to 3 s",
        "one shared bus; 20 W drawn at all times; from a data",
    ):
        assert words in str(asked)
    assert "Weight λ" not in str(asked) and "Weight λ" in str(problem_sections(load(tmp_path))[0])
