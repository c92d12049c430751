"""Refinement: knots go where they pay, spaces stay nested, and the accuracy promised is the accuracy reached."""

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt import refinement
from energyopt.dynamics.kernels import kernels_of
from energyopt.feasibility import kinematic_minimum
from energyopt.parameterizations.bspline import SplineSpace
from energyopt.refinement import bisected, promise, refine, roughly
from energyopt.search import Search
from energyopt.search_state import SearchOptions
from energyopt.transcription import transcribe
from energyopt.verification import objective

T = 0.8


def problem(**options):
    return eo.Problem(arms.two_link(), [-0.4, 0.6], [1.2, -0.8], T, **options)


GRADED = (0.0, 0.001, 0.003, 0.01, 0.03, *np.linspace(0.1, 0.7, 13), 0.77, 0.79, 0.797, 0.799, T)
"""Short spans at the ends, where the optimum starts and stops with an acceleration; coarse ones between."""


def on_knots(request, breaks):
    return eo.plan(request, eo.BSpline(knots=tuple(breaks), accuracy=None), starts=1)


def promised(plan):
    """What the bisected space promises, and that space."""
    space = SplineSpace(plan.trajectory.breaks, plan.trajectory.degree)
    fine = transcribe(plan.problem, bisected(space), kernels_of(plan.problem.robot.dynamics))
    return promise(space, fine, fine.guess(plan.trajectory)), bisected(space)


@pytest.fixture(scope="module")
def coarse():
    """The optimum on coarse knots, no limit near."""
    return on_knots(problem(velocity_limits=100.0), GRADED)


def test_bisection_doubles_the_spans_and_keeps_every_break(coarse):
    space = SplineSpace(coarse.trajectory.breaks, 3)
    fine = bisected(space)
    assert len(fine.breaks) == 2 * len(space.breaks) - 1 and set(space.breaks) < set(fine.breaks)


def test_the_promise_is_what_bisecting_all_spans_really_gains(coarse):
    """J is nearly quadratic over so small a change: a tenth is allowed."""
    ahead, space = promised(coarse)
    assert ahead.convex
    assert ahead.gain == pytest.approx(coarse.objective - on_knots(coarse.problem, space.breaks).objective, rel=0.1)


def test_the_spans_said_to_pay_are_those_that_do(coarse):
    """Cutting the better half of the spans gains most of what cutting all does, and far more than cutting the other half."""
    ahead, _ = promised(coarse)
    breaks, order = coarse.trajectory.breaks, np.argsort(ahead.by_span)[::-1]
    middle, half = 0.5 * (breaks[1:] + breaks[:-1]), len(order) // 2
    gain = lambda spans: coarse.objective - on_knots(coarse.problem, np.union1d(breaks, middle[spans])).objective
    assert gain(order[:half]) > 0.75 * gain(order)
    assert gain(order[:half]) > 3 * gain(order[half:])


def test_the_promise_keeps_to_limits_that_bind():
    """A step that ignores them promises far more. Limits that it breaks without their being active leave a factor of three."""
    request = problem(velocity_limits=[4.0, 6.0])
    plan = on_knots(request, GRADED)
    assert plan.violations.margin["velocity"] < 0.1
    ahead, space = promised(plan)
    assert 1 / 3 < ahead.gain / (plan.objective - on_knots(request, space.breaks).objective) < 3


def test_nothing_is_promised_where_nothing_can_be_gained():
    """The slider's optimum with its own end accelerations is a cubic: no finer spline is better."""
    ends = {"start_acceleration": 6.0, "goal_acceleration": -6.0}
    request = eo.Problem(arms.sliders(), [0.0], [1.0], 1.0, velocity_weight=0.0, **ends)
    ahead, _ = promised(eo.plan(request, eo.BSpline(control_points=9, accuracy=None)))
    assert ahead.convex and ahead.gain < 1e-9 and ahead.quadrature == pytest.approx(12.0, rel=1e-9)
    assert eo.plan(request).options["levels"] == 1, "and no refinement is made"


def test_the_worst_spans_are_cut_and_the_ends_split_near_the_ends():
    space = SplineSpace(np.linspace(0.0, 1.0, 9), 3)
    added = lambda cost, share: sorted(set(refine(space, np.array(cost), share).breaks) - set(space.breaks))
    cost, first, last = [0.0, 0.0, 5.0, 0.1, 0.0, 4.0, 0.0, 0.0], 0.25 / 8, 1 - 0.25 / 8
    np.testing.assert_allclose(added([0.0, 0.0, 5.0, 0.1, 0.0, 1.0, 0.0, 0.0], 0.4), [first, 2.5 / 8, last])
    np.testing.assert_allclose(added(cost, 0.4), [first, 2.5 / 8, 5.5 / 8, last])
    np.testing.assert_allclose(added(cost, 0.1), [first, 2.25 / 8, 2.5 / 8, 2.75 / 8, 5.5 / 8, last])


def test_no_span_becomes_too_short_and_no_spline_too_long(monkeypatch):
    space = SplineSpace(np.linspace(0.0, 1.0, 9), 3)
    for _ in range(30):
        space = refine(space, np.arange(len(space.breaks) - 1) == 2, 0.3)
    assert np.diff(space.breaks).min() >= 0.5 * refinement.LEAST_SPAN
    monkeypatch.setattr("energyopt.search.MOST_SPANS", 20)
    plan = eo.plan(problem(), eo.BSpline(accuracy=1e-6))
    assert plan.solved and len(plan.trajectory.breaks) < 60
    assert plan.discretization_error > 1e-6 and any("refinement stopped" in note for note in plan.notes)


@pytest.mark.parametrize("seed", range(4))
def test_the_default_is_within_one_percent_of_a_three_times_finer_solve(seed):
    """On a Panda, in the same basin: the finer solve has every span of the refined plan cut in three."""
    robot, rng = arms.catalogue_robot("panda"), np.random.default_rng(seed)
    goal = np.clip(robot.home + rng.uniform(-0.8, 0.8, 7), robot.limits.lower + 0.1, robot.limits.upper - 0.1)
    duration = 2.0 * kinematic_minimum(eo.Problem(robot, robot.home, goal, 1.0), robot.home, goal).max()
    request = eo.Problem(robot, robot.home, goal, max(duration, 0.6))
    plan = eo.plan(request)
    breaks = plan.trajectory.breaks
    thirds = np.linspace(breaks[:-1], breaks[1:], 4, axis=1)[:, :-1].ravel()
    fine = eo.plan(request, eo.BSpline(knots=(*thirds, breaks[-1]), accuracy=None))
    error = plan.objective / fine.objective - 1
    assert plan.discretization_error <= 0.01
    assert -1e-6 < error <= 0.01
    assert plan.discretization_error > 0.3 * error, "the estimate is not far too small"


@pytest.mark.parametrize("degree", [3, 4, 5])
def test_more_accuracy_costs_more_knots_and_less_energy(degree):
    plans = [eo.plan(problem(), eo.BSpline(degree=degree, accuracy=accuracy)) for accuracy in (3e-2, 3e-3, 3e-4)]
    assert all(plan.discretization_error <= accuracy for plan, accuracy in zip(plans, (3e-2, 3e-3, 3e-4), strict=True))
    spans, costs = [len(plan.trajectory.breaks) for plan in plans], [plan.objective for plan in plans]
    assert spans == sorted(spans) and spans[0] < spans[-1]
    assert costs == sorted(costs, reverse=True) and costs[0] > costs[-1]


def test_knots_gather_where_a_long_hold_meets_a_short_swing():
    """Eight seconds for a motion of less than one: the knots stand where the arm moves, not where it hangs."""
    robot = arms.two_link()
    plan = eo.plan(eo.Problem(robot, [-0.4, 0.6], [1.2, -0.8], 8.0), eo.BSpline(accuracy=3e-3), starts=3)
    t = np.linspace(0.0, 8.0, 801)
    speed = np.abs(plan.trajectory(t, 1)).max(axis=1)
    still = t[speed < 0.05 * speed.max()]
    middle = 0.5 * (plan.trajectory.breaks[1:] + plan.trajectory.breaks[:-1])
    resting = np.interp(middle, t, speed) < 0.05 * speed.max()
    assert len(still) > 0.4 * len(t), "most of the time the arm hangs"
    width = np.diff(plan.trajectory.breaks)
    assert width[resting].mean() > 2.0 * width[~resting].mean()


def random_move(name, seed, **limits):
    """A random rest-to-rest move; each limit is given as a multiple of what the quintic needs of every joint."""
    robot, rng = arms.catalogue_robot(name), np.random.default_rng(seed)
    low, high = np.maximum(robot.limits.lower, -2.5), np.minimum(robot.limits.upper, 2.5)
    start, goal = rng.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low), (2, robot.nv))
    duration = 1.4 * np.max(1.875 * np.abs(goal - start) / robot.limits.velocity)
    free = eo.Problem(robot, start, goal, duration)
    motion, t = eo.baseline(free), np.linspace(0.0, duration, 1001)
    orders = {"velocity_limits": 1, "acceleration_limits": 2, "jerk_limits": 3}
    needed = {key: factor * np.abs(motion(t, orders[key])).max(axis=0) for key, factor in limits.items()}
    return eo.Problem(robot, start, goal, duration, **needed)


@pytest.mark.parametrize("factor", [3, 10, 100, 1000])
@pytest.mark.parametrize("name", ["panda", "ur5", "xarm7"])
def test_with_jerk_limits_the_refinement_reaches_the_accuracy_too(name, factor):
    """From limits that bind everywhere to ones that bind only in the shortest spans, at the ends."""
    for seed in (1, 2):
        plan = eo.plan(random_move(name, seed, jerk_limits=factor))
        assert plan.solved
        assert plan.discretization_error <= 0.01
        assert not any("refinement stopped" in note for note in plan.notes)


def test_with_coulomb_friction_the_accuracy_is_reached_by_even_refinement():
    """Against three times finer knots, from the plan's own motion: such problems have many optima."""
    request = eo.Problem(arms.rubbing_two_link(), [-0.4, 0.6], [1.0, -0.8], 1.0)
    plan = eo.plan(request)
    breaks = plan.trajectory.breaks
    thirds = np.linspace(breaks[:-1], breaks[1:], 4, axis=1)[:, :-1].ravel()
    space = SplineSpace(np.append(thirds, breaks[-1]), 3, 10)
    finer = Search(request, space, kernels_of(request.robot.dynamics), plan.trajectory, SearchOptions(), levels=1)
    assert finer.advance()
    assert plan.discretization_error <= 0.01 and plan.options["levels"] >= 2
    assert plan.objective / objective(request, finer.trajectory) - 1 <= 0.01


def test_before_a_refinement_nothing_is_claimed_where_there_is_coulomb_friction():
    request = eo.Problem(arms.rubbing_two_link(), [-0.4, 0.6], [1.0, -0.8], 2.0)
    space = eo.BSpline().space(request.duration)
    fine = transcribe(request, bisected(space), kernels_of(request.robot.dynamics))
    ahead = roughly(space, fine, fine.guess(eo.baseline(request)))
    assert ahead.gain is None and ahead.error(1.0, None) is None and ahead.error(ahead.quadrature, 0.5) == pytest.approx(0.6)
