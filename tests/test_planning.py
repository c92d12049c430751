"""plan(): statuses, limits that bind and hold, waypoints, seeds, durations from very short to very long, arguments."""

import json
import os
import subprocess
import sys

import arms
import numpy as np
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt import rounds
from energyopt.feasibility import kinematic_minimum
from energyopt.solvers import Outcome, SolverResult
from energyopt.verification import is_valid, objective

QUICK = eo.BSpline(control_points=16, accuracy=None)
METHODS = {"spline": QUICK, "collocation": eo.HermiteSimpson(20), "sinusoid": eo.Sinusoid(5)}


def problem(**options):
    return eo.Problem(arms.two_link(), **{"start": [-0.4, 0.6], "goal": [0.8, -0.5], "duration": 0.7, **options})


@pytest.fixture(scope="module")
def free():
    """The plan of `problem` without any limit near."""
    return eo.plan(problem(), QUICK)


def test_a_plan_says_what_it_is(free):
    assert free.solved and free.status is eo.Status.SOLVED and "every limit holds" in free.message
    assert free.duration == 0.7 and free.iterations > 3 and free.seed == 0
    assert free.objective == pytest.approx(sum(free.cost_terms.values()), rel=1e-14)
    assert set(free.cost_terms) == {"torque_squared", "velocity_squared"}
    assert {"guess", "build", "compile", "solve", "verify"} == set(free.time_s) and free.solve_s > 0
    assert free.discretization_error is None, "fixed knots are not refined, so nothing was measured"
    assert free.options["parameterization"] == "BSpline" and free.options["control_points"] == 16
    t = np.linspace(0, 0.7, 5)
    assert free.trajectory(t, 2).shape == free.torque(t).shape == (5, 2) and free.torque(0.3).shape == (2,)


def test_a_refined_plan_states_its_estimated_error():
    plan = eo.plan(problem())
    assert 0 < plan.discretization_error <= 0.01


@pytest.fixture(scope="module")
def free_plans():
    """Plans without any limit near, by method."""
    return {name: eo.plan(problem(), method) for name, method in METHODS.items()}


def peaks(key, motion):
    """What a motion needs of each joint: largest |q̇|, |q̈|, |d³q/dt³|, |τ| or |dτ/dt|."""
    t = np.linspace(0.0, 0.7, 2001)
    order = {"velocity": 1, "acceleration": 2, "jerk": 3}.get(key)
    if order:
        return np.abs(motion(t, order)).max(axis=0)
    torque = problem().robot.torque(*(motion(t, k) for k in range(3)))
    return np.abs(torque if key == "torque" else np.gradient(torque, t, axis=0)).max(axis=0)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize(
    "key, share, motion",
    [
        ("velocity", 0.8, "optimum"),
        ("acceleration", 0.7, "optimum"),
        ("torque", 0.9, "optimum"),
        ("jerk", 1.3, "quintic"),  # the optimum's jerk and torque rate grow without bound with finer knots, at its ends
        ("torque_rate", 1.3, "quintic"),
    ],
)
def test_limits_bind_and_hold_and_cost_something(free_plans, name, key, share, motion):
    """Each limit is a share of what a motion needs that does not know of it."""
    limit = share * peaks(key, free_plans[name].trajectory if motion == "optimum" else eo.baseline(problem()))
    plan = eo.plan(problem(**{f"{key}_limits": limit}), METHODS[name])
    entry = "torque_percent" if key == "torque" else key
    assert plan.max_violation[entry] <= (1e-2 if key == "torque" else 1e-4 * limit.max())
    assert plan.violations.margin[entry] < 3.0, "the limit binds"
    assert np.all(peaks(key, plan.trajectory) <= limit * 1.01), "looked at independently"
    assert plan.objective > free_plans[name].objective * (1 + 1e-6)


def test_position_limits_bind_and_hold():
    low, high = [-0.45, -0.55], [0.85, 0.65]
    wide, narrow = (eo.plan(problem(duration=2.0, position_limits=limits), QUICK) for limits in (None, (low, high)))
    t = np.linspace(0, 2, 500)
    q = wide.trajectory(t)
    assert np.any(q < low) or np.any(q > high), "without the limits the arm swings beyond them"
    q = narrow.trajectory(t)
    assert np.all(q > np.array(low) - 1e-6) and np.all(q < np.array(high) + 1e-6)
    assert narrow.violations.margin["position"] < 0.5 and narrow.objective > wide.objective


def test_all_limits_together_hold_on_a_seven_joint_arm():
    robot = arms.catalogue_robot("panda")
    goal = robot.home + np.array([1.0, 0.5, -0.4, 0.6, 0.5, -0.6, 0.7])
    limits = {"acceleration_limits": 12.0, "jerk_limits": 3000.0, "torque_rate_limits": 900.0}
    plan = eo.plan(eo.Problem(robot, robot.home, goal, 1.1, **limits))
    assert is_valid(plan.violations)
    assert set(plan.max_violation) >= {"position", "velocity", "acceleration", "jerk", "torque_percent", "torque_rate"}


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_waypoints_are_passed_timed_ones_on_time_and_untimed_ones_in_order(method):
    """Two untimed ones around a timed one; where they are passed is found by looking, not by asking the planner."""
    stations = [np.array([-0.1, 0.5]), np.array([0.3, 0.0]), np.array([0.6, -0.4])]
    request = problem(duration=1.0, waypoints=[stations[0], (stations[1], 0.5), eo.Waypoint(stations[2])])
    plan = eo.plan(request, method)
    np.testing.assert_allclose(plan.trajectory(0.5), stations[1], atol=1e-6)
    t = np.linspace(0, 1, 200_001)
    nearest = [np.abs(plan.trajectory(t) - station).max(axis=1) for station in stations]
    passed = [t[np.argmin(distance)] for distance in nearest]
    assert passed == sorted(passed) and passed[1] == pytest.approx(0.5, abs=1e-3)
    assert all(distance.min() < 5e-5 for distance in nearest), "within what 5 µs of motion are"
    assert plan.max_violation["waypoint"] <= 1e-6


def test_a_waypoint_the_optimum_passes_anyway_costs_nothing(free):
    for waypoint in ((free.trajectory(0.3), 0.3), free.trajectory(0.3)):
        plan = eo.plan(problem(waypoints=[waypoint]), QUICK)
        assert plan.objective == pytest.approx(free.objective, rel=1e-5)


def test_an_untimed_waypoint_is_never_dearer_than_the_same_one_timed():
    station = np.array([0.4, 0.5])
    untimed = eo.plan(problem(duration=1.0, waypoints=[station]), QUICK).objective
    for time in (0.3, 0.5, 0.7):
        assert untimed <= eo.plan(problem(duration=1.0, waypoints=[(station, time)]), QUICK).objective * (1 + 1e-6)


def test_boundary_velocities_and_accelerations_are_met():
    ends = {"start_velocity": [0.5, -1.0], "goal_velocity": [-0.3, 0.2]}
    ends |= {"start_acceleration": [3.0, 1.0], "goal_acceleration": [0.0, -4.0]}
    for method in METHODS.values():
        plan = eo.plan(problem(**ends), method)
        for time, end in ((0.0, "start"), (0.7, "goal")):
            np.testing.assert_allclose(plan.trajectory(time, 1), ends[f"{end}_velocity"], atol=1e-9)
            np.testing.assert_allclose(plan.trajectory(time, 2), ends[f"{end}_acceleration"], atol=1e-6)


@pytest.mark.parametrize("factor, weight", [(1.02, 0.0), (1.02, 0.1), (1.2, [0.0, 1e4]), (5.0, 0.0), (500.0, 0.1)])
def test_durations_from_the_kinematic_minimum_to_minutes_with_any_velocity_weight(factor, weight):
    limits = {"velocity_limits": 4.0, "acceleration_limits": 60.0}
    request = problem(**limits)
    duration = factor * kinematic_minimum(request, request.start, request.goal).max()
    plan = eo.plan(problem(duration=duration, velocity_weight=weight, **limits))
    assert plan.solved
    if factor > 2:  # below, the quintic breaks the limits
        assert 0 < plan.objective < quintic_cost(plan.problem)


@pytest.mark.parametrize("duration", [0.45, 60.0])
def test_a_seven_joint_arm_plans_short_and_long(duration):
    robot = arms.catalogue_robot("panda")
    goal = robot.home + 0.4 * np.array([1, 1, -1, 1, 1, -1, 1])
    plan = eo.plan(eo.Problem(robot, robot.home, goal, duration, velocity_weight=0.0))
    assert plan.solved and plan.objective <= 1.0001 * quintic_cost(plan.problem)


def quintic_cost(request):
    return objective(request, eo.baseline(request))


def test_staying_where_one_is_costs_no_more_than_holding_still():
    robot = arms.two_link()
    rest = np.array([0.3, 0.4])
    plan = eo.plan(eo.Problem(robot, rest, rest, 0.4))
    assert plan.objective <= 0.4 * np.sum(robot.torque(rest, 0 * rest, 0 * rest) ** 2) * (1 + 1e-9)


@pytest.mark.parametrize(
    "outcome, status",
    [
        (Outcome.INFEASIBLE, "INFEASIBLE"),
        (Outcome.ITERATION_LIMIT, "ITERATION_LIMIT"),
        (Outcome.TIME_LIMIT, "TIME_LIMIT"),
        (Outcome.INTERRUPTED, "INTERRUPTED"),
        (Outcome.FAILED, "NUMERICAL_ERROR"),
        (Outcome.CONVERGED, "LIMITS_VIOLATED"),
        (Outcome.ACCEPTABLE, "LIMITS_VIOLATED"),
    ],
)
def test_every_outcome_of_the_solver_has_one_status(monkeypatch, outcome, status):
    """A solver that returns its guess. The guess breaks the velocity limit, so the word "converged" does not make it SOLVED."""

    def ends(program, x0, *_):
        return SolverResult(program.guess(eo.baseline(problem())), np.zeros(program.rows), outcome, "said", 1.0, 3)

    monkeypatch.setattr(rounds, "solve", ends)
    request = problem(acceleration_limits=[11.0, 11.0])
    plan = eo.plan(request, eo.Sinusoid(2), throw=False)
    assert plan.status.value == status and not plan.solved
    assert plan.message and "\n" not in plan.message
    np.testing.assert_allclose(plan.trajectory(0.7), request.goal, atol=1e-9)
    if status != "INTERRUPTED":
        with pytest.raises(eo.NoSolutionFound) as caught:
            eo.plan(request, eo.Sinusoid(2))
        assert caught.value.plan.status.value == status and str(caught.value) == caught.value.plan.message


def test_statuses_are_documented_each_in_a_sentence():
    from energyopt.planning import _SENTENCE

    assert set(_SENTENCE) == set(eo.Status) and len(set(_SENTENCE.values())) == len(eo.Status)


def test_out_of_iterations_the_best_motion_is_kept():
    plan = eo.plan(problem(), QUICK, iterations=1, throw=False)
    assert plan.status is eo.Status.ITERATION_LIMIT and "iterations" in plan.message
    np.testing.assert_allclose(plan.trajectory([0.0, 0.7]), [plan.problem.start, plan.problem.goal], atol=1e-9)
    assert np.isfinite(plan.objective)


def test_out_of_time_the_best_motion_is_kept():
    plan = eo.plan(problem(), eo.HermiteSimpson(300), time_limit=0.02, throw=False)
    assert plan.status is eo.Status.TIME_LIMIT and np.isfinite(plan.objective)


def test_a_time_limit_during_refinement_keeps_the_valid_motion_before_it():
    plan = eo.plan(problem(), eo.BSpline(accuracy=1e-7), time_limit=0.1, throw=False)
    assert plan.status in (eo.Status.SOLVED, eo.Status.TIME_LIMIT)
    assert plan.status is eo.Status.TIME_LIMIT or is_valid(plan.violations)


def test_more_starts_are_never_worse(free):
    task = problem(duration=1.5, goal=[1.4, -0.2], start=[-1.2, 0.3])
    costs = [eo.plan(task, QUICK, starts=n).objective for n in (1, 3, 6)]
    assert np.all(np.diff(costs) <= 1e-9 * costs[0]), "but for rounding, where two of them end in the same optimum"


PROGRAM = """
import json, sys, energyopt as eo
robot = eo.load_robot(sys.argv[1])
problem = eo.Problem(robot, [-1.2, 0.3], [1.4, -0.2], 1.5, velocity_limits=8.0)
plan = eo.plan(problem, starts=4, seed=int(sys.argv[2]))
print(json.dumps([plan.objective.hex(), plan.iterations, plan.trajectory.to_arrays()["coefficients"].tobytes().hex()]))
"""


def test_the_same_seed_gives_the_same_bits_in_every_process(tmp_path):
    path = factory.write(tmp_path, factory.planar_arm([0.5, 0.4], [2.0, 1.5], velocity=10.0, effort=100.0))
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", PROGRAM, str(path), "7"]
    processes = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    found = [json.loads(p.communicate(timeout=60)[0]) for p in processes]
    assert found[0] == found[1]


def test_progress_goes_to_the_callback_or_to_standard_error_and_else_nowhere(capfd):
    seen = []
    plan = eo.plan(problem(), starts=1, verbose=lambda *line: seen.append(line))
    phases, iterations, objectives, violations = zip(*seen, strict=True)
    assert list(iterations) == sorted(iterations) and phases[0] == "1.1" and len(set(phases)) >= 2
    assert objectives[-1] == pytest.approx(plan.objective, rel=1e-3) and violations[-1] < 1e-6
    eo.plan(problem())
    assert capfd.readouterr() == ("", "")
    eo.plan(problem(), verbose=True)
    out, err = capfd.readouterr()
    assert out == "" and "iteration" in err and "objective" in err and "violation" in err


@pytest.mark.parametrize(
    "options, words",
    [
        ({"parameterization": "bspline"}, ["parameterization", "BSpline, Sinusoid or HermiteSimpson", "'bspline'"]),
        ({"parameterization": eo.BSpline}, ["parameterization is <class", "energyopt.BSpline()"]),
        ({"parameterization": 0}, ["parameterization is 0"]),
        ({"starts": 0}, ["starts is 0", "guesses, 1 to 100000, or None"]),
        ({"starts": 2.5}, ["starts is 2.5", "whole number"]),
        ({"time_limit": 0.0}, ["time_limit is 0.0", "seconds > 0"]),
        ({"time_limit": float("nan")}, ["time_limit is nan"]),
        ({"time_limit": float("inf")}, ["time_limit is inf", "None for no limit"]),
        ({"time_limit": "x"}, ["time_limit is 'x'"]),
        ({"iterations": 10**12}, ["iterations is 1000000000000"]),
        ({"iterations": "many"}, ["iterations is 'many'"]),
        ({"seed": "a"}, ["seed is 'a'", "0 to 2**63 - 1"]),
        ({"seed": None}, ["seed is None"]),
        ({"seed": 1.5}, ["seed is 1.5", "whole number"]),
        ({"verbose": lambda phase, iteration: None}, ["verbose is <function", "(phase, iteration, objective, violation)"]),
        ({"verbose": "yes"}, ["verbose is 'yes'", "a function of"]),
        ({"throw": "no"}, ["throw is 'no'", "True or False"]),
        ({"iterations": 0}, ["iterations is 0", "a whole number, 1 to"]),
        ({"seed": -1}, ["seed is -1"]),
    ],
)
def test_odd_arguments_are_refused_in_one_line(options, words):
    with pytest.raises(eo.InputError) as caught:
        eo.plan(problem(), **options)
    assert "\n" not in str(caught.value) and all(word in str(caught.value) for word in words)


@pytest.mark.parametrize("given", [None, 5, "panda_reach", []])
def test_what_is_no_problem_is_refused_by_its_value(given):
    with pytest.raises(eo.InputError, match=r"plan: problem is .*: expected one energyopt\.Problem"):
        eo.plan(given)


def test_an_exception_of_the_callback_ends_the_solve_and_reaches_the_caller(capfd):
    """CasADi would swallow it, with a dump on the terminal."""
    heard = []

    def callback(phase, iteration, objective, violation):
        heard.append(iteration)
        if iteration == 2:
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        eo.plan(problem(), verbose=callback)
    assert heard == [0, 1, 2]
    assert capfd.readouterr() == ("", "")
    assert eo.plan(problem()).solved, "nothing is left behind"
