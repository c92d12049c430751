"""The duration as an unknown of the plan."""

from dataclasses import replace

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt.costs import Duration, JerkSquared, TorqueSquared
from energyopt.parameterizations import BSpline, HermiteSimpson, Sinusoid

SPACES = [BSpline(), HermiteSimpson(intervals=24), Sinusoid(5)]


@pytest.mark.parametrize("price", [0.5, 20.0])
def test_the_price_of_a_second_sets_the_duration_of_a_slider(price):
    """∫u² = 12 m²d²/T³ is least with μT at T⁴ = 36 m²d²/μ; the spline's ends at zero acceleration cost a little more."""
    slider, distance = arms.sliders(1), 0.8
    problem = eo.Problem(slider, [0.0], [distance], duration=(0.05, 50.0), costs=[TorqueSquared(), price * Duration()])
    plan = eo.plan(problem, BSpline(accuracy=1e-3))
    force = slider.torque(np.zeros(1), np.zeros(1), np.ones(1))[0]
    assert plan.duration == pytest.approx((36 * force**2 * distance**2 / price) ** 0.25, rel=1e-3)
    assert plan.cost_terms["duration"] == pytest.approx(price * plan.duration, rel=1e-9)


def test_least_jerk_with_a_price_of_time():
    """∫jerk² = 720 d²/T⁵ is least with μT at T⁶ = 3600 d²/μ; splines of degree five hold the quintic exactly."""
    problem = eo.Problem(arms.sliders(1), [0.0], [0.5], duration=(0.05, 50.0), costs=[JerkSquared(), 3.0 * Duration()])
    plan = eo.plan(problem, BSpline(degree=5))
    best = (3600 * 0.25 / 3.0) ** (1 / 6)
    assert plan.duration == pytest.approx(best, rel=1e-2)  # J is flat there: 1 % of T is 3e-4 of J
    assert plan.objective == pytest.approx(720 * 0.25 / best**5 + 3.0 * best, rel=1e-4)


@pytest.mark.parametrize("space", SPACES, ids=lambda s: type(s).__name__)
def test_no_duration_near_the_chosen_one_is_cheaper(space):
    problem = eo.Problem(arms.two_link(), [0.3, -0.2], [-0.5, 0.9], duration=(0.3, 6.0), start_velocity=[0.3, -0.2])
    free = eo.plan(problem, space)
    assert free.solved and 0.3 < free.duration < 6.0
    assert free.options["durations"] == (0.3, 6.0) and free.problem.duration == free.duration
    np.testing.assert_allclose(free.trajectory(0.0, 1), [0.3, -0.2], atol=1e-7)
    for factor in (0.97, 1.03):
        near = eo.plan(problem.lasting(factor * free.duration), space, guess=free)
        assert near.objective > free.objective * (1 - 1e-6)


def test_a_bound_of_the_duration_holds_it():
    slide = {"start": [0.0], "goal": [0.8], "costs": [TorqueSquared(), 5.0 * Duration()]}
    best = eo.plan(eo.Problem(arms.sliders(1), duration=(0.05, 50.0), **slide)).duration
    for bounds, bound in (((1.3 * best, 50.0), 1.3 * best), ((0.05, 0.7 * best), 0.7 * best)):
        assert eo.plan(eo.Problem(arms.sliders(1), duration=bounds, **slide)).duration == pytest.approx(bound, rel=1e-6)


def test_limits_hold_where_the_duration_is_free():
    fast = [TorqueSquared(), 1e4 * Duration()]
    limits = {"velocity_limits": 2.0, "acceleration_limits": 8.0, "jerk_limits": 300.0, "torque_limits": 40.0}
    plan = eo.plan(eo.Problem(arms.two_link(), [0.3, -0.2], [-0.5, 0.9], duration=(0.1, 6.0), costs=fast, **limits))
    assert plan.solved and min(plan.violations.margin.values()) < 1.0  # in a hurry, some limit is reached
    assert plan.duration > 1.1 / 2.0


def test_waypoints_choose_their_times_with_the_duration():
    waypoints = [[0.4, 0.4], [-0.2, 0.6]]
    problem = eo.Problem(arms.two_link(), [0.3, -0.2], [-0.5, 0.9], duration=(0.3, 6.0), waypoints=waypoints)
    plan = eo.plan(problem)
    assert plan.solved and plan.max_violation["waypoint"] < 1e-6


def test_a_part_on_a_conveyor_is_passed_in_a_time_that_is_chosen():
    problem = eo.load_problem("xarm7_conveyor")
    pinned = problem.duration
    free = eo.plan(replace(problem, duration=(0.8 * pinned, 1.3 * pinned)), BSpline(accuracy=0.05))
    assert free.solved and free.violations.distance > 0


def test_a_motion_to_start_from_is_taken_up():
    problem = eo.Problem(arms.two_link(), [0.3, -0.2], [-0.5, 0.9], duration=1.0)
    first = eo.plan(problem)
    again = eo.plan(problem, guess=first)
    assert again.options["guess"] == "given" and 0.99 * first.objective < again.objective < first.objective * (1 + 1e-6)
    with pytest.raises(eo.InputError, match="a motion of 2 joints; expected 1"):
        eo.plan(eo.Problem(arms.sliders(1), [0.0], [1.0], 1.0), guess=first)
    with pytest.raises(eo.InputError, match="guess is 3: expected a Trajectory"):
        eo.plan(problem, guess=3)
