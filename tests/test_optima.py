"""Many guesses: what they are, what they lead to, and what is said of it."""

import itertools
import time
from dataclasses import replace

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt import campaign, diversity
from energyopt.dynamics.kernels import kernels_of
from energyopt.optima import described, distinct
from energyopt.parameterizations import PolynomialTrajectory
from energyopt.verification import objective

FIXED = eo.BSpline(control_points=16, accuracy=None)
COARSE = 5e-3
"""Relative: J by three or six Gauss nodes a span against that by many; torques have kinks where knots are."""


def swing(**options):
    """A move of a UR5 whose straight motion leads to an optimum far above the best."""
    robot = arms.catalogue_robot("ur5")
    start, goal = np.array([-1.86, 0.0, 0.51, -2.36, -1.76, 2.14]), np.array([-2.15, -1.85, 2.24, 0.61, -0.66, 0.06])
    return eo.Problem(robot, start, goal, 2.6, self_collision=False, **options)


def line(offset, duration=1.0):
    return PolynomialTrajectory(np.array([0.0, duration]), np.array([[[offset], [1.0]]]))


@pytest.fixture(scope="module")
def plans():
    return {starts: eo.plan(swing(), FIXED, starts=starts) for starts in (1, 20)}


def test_one_start_is_one_local_search_from_the_straight_motion(plans):
    plan = plans[1]
    assert plan.options["tried"] == ["straight"] and plan.seed == 0
    (only,) = plan.optima
    assert (only.guess, only.guesses) == ("straight", 1) and only.objective == pytest.approx(plan.objective, rel=COARSE)


def test_many_guesses_find_a_far_better_optimum_than_the_straight_one(plans):
    assert plans[20].objective < 0.5 * plans[1].objective
    assert len(plans[20].options["tried"]) == 20 == len(set(plans[20].options["tried"]))


def test_all_distinct_optima_are_kept_best_first_and_the_best_is_returned(plans):
    plan = plans[20]
    values = [optimum.objective for optimum in plan.optima]
    assert values == sorted(values) and len(values) > 1 and sum(optimum.guesses for optimum in plan.optima) <= 20
    best, t = plan.optima[0], np.linspace(0.0, plan.duration, 100)
    assert best.guess == plan.options["guess"] and best.objective == pytest.approx(plan.objective, rel=COARSE)
    assert np.abs(best.trajectory(t) - plan.trajectory(t)).max() < 1e-6
    for optimum in plan.optima:
        assert objective(plan.problem, optimum.trajectory) == pytest.approx(optimum.objective, rel=COARSE)
    straight = plans[1].optima[0]
    assert any(straight.objective == pytest.approx(value, rel=COARSE) for value in values)


def test_the_default_is_so_many_guesses_as_it_takes_to_know_all_optima_and_one_for_other_motions():
    """Here they are three, which are known after 54 guesses; the rest of all, in the same order, lead to no other one."""
    problem = replace(swing(), goal=[-2.0, -0.5, 1.0, -1.5, -1.5, 1.5])
    default, every = eo.plan(problem, FIXED), eo.plan(problem, FIXED, starts=campaign.STARTS)
    tried = default.options["tried"]
    if default.options["kernels"] == "compiled":
        assert 54 <= len(tried) < campaign.STARTS and tried == every.options["tried"][: len(tried)]
        assert default.objective == every.objective and len(default.optima) == len(every.optima) == 3
    else:
        assert tried == ["straight"]
    assert eo.plan(problem, eo.Sinusoid(harmonics=3), throw=False).options["guesses"] == 1
    assert eo.plan(problem, FIXED, guess=default).options["tried"] == ["given"]


def test_the_same_seed_gives_the_same_optima_in_one_process_or_in_several(plans, two_workers):
    first, again = plans[20], eo.plan(swing(), FIXED, starts=20)
    assert two_workers.answers >= 18
    assert again.options["tried"] == first.options["tried"] and again.objective == first.objective
    assert [one.summary for one in again.optima] == [one.summary for one in first.optima]
    other = eo.plan(swing(), FIXED, starts=20, seed=1)
    assert [one.summary for one in other.optima] != [one.summary for one in first.optima]


@pytest.mark.alone
def test_a_time_limit_ends_the_guesses_in_time_to_return_the_best_so_far():
    began = time.monotonic()
    plan = eo.plan(swing(), starts=10_000, time_limit=3.0)
    assert plan.solved and 2 < len(plan.options["tried"]) < 10_000 and time.monotonic() - began < 6.0


def test_motions_are_one_optimum_where_both_j_and_place_agree():
    found = [
        (2.0, "b", line(0.0)),
        (1.0, "a", line(0.0)),
        (0.9995, "c", line(0.05)),
        (1.0002, "d", line(3.0)),
        (2.1, "e", line(0.0)),
    ]
    optima = distinct(found, seed=4)
    assert [(one.objective, one.guess, one.guesses) for one in optima] == [
        (1.0, "a", 2),
        (1.0002, "d", 1),
        (2.0, "b", 1),
        (2.1, "e", 1),
    ]
    assert {one.seed for one in optima} == {4} and distinct([], 0) == ()
    assert (
        described(optima)
        == "4 distinct optima from 5 guesses that converged; J on the first knots (guesses): 1 (2), 1 (1), 2 (1), 2.1 (1)"
    )


@pytest.mark.parametrize("waypoints", [(), (eo.Waypoint([-2.0, -0.8, 1.0, -1.2, -1.0, 1.5], 1.1),)], ids=["free", "waypoint"])
def test_guesses_and_hops_keep_the_ends_and_the_waypoints_and_repeat_with_their_seed(waypoints):
    problem = swing(waypoints=waypoints)
    kernels, goal = kernels_of(problem.robot.dynamics), problem.goal_position
    several = lambda seed: list(itertools.islice(diversity.diverse(problem, [goal], seed, kernels), 11))
    first, again, other = several(0), several(0), several(1)
    hopped = list(itertools.islice(diversity.hops(problem, first[:2], 0), 6))
    stops = [(0.0, problem.start), (problem.duration, goal), *((w.time, w.position) for w in waypoints)]
    for guess, (t, q) in itertools.product([*first, *hopped], stops):
        assert guess.motion(t) == pytest.approx(q, abs=1e-9), guess.name
        assert np.abs(guess.motion(np.array([0.0, problem.duration]), 1)).max() < 1e-9
    place = lambda guess: guess.motion(0.5 * problem.duration)
    assert all(np.array_equal(place(a), place(b)) for a, b in zip(first, again, strict=True))
    assert not any(np.array_equal(place(a), place(b)) for a, b in zip(first[1:], other[1:], strict=True))
    assert {guess.name.split()[0] for guess in first} == {"straight", *diversity.PATTERN}


def test_folds_are_chosen_by_the_j_of_their_motions_and_by_j_at_rest():
    problem = swing()
    kernels = kernels_of(problem.robot.dynamics)
    leg = diversity._Leg(problem, np.array([0.0, problem.duration]), np.array([problem.start, problem.goal_position]))
    drawn = np.random.default_rng(0).uniform(-1.0, 1.0, (6, 6))
    motions = [leg.through(diversity.HOLD, np.stack([fold, fold])) for fold in drawn]
    moving = [objective(problem, motion) for motion in motions]
    assert diversity._costs(leg, kernels, drawn, 1.0) == pytest.approx(moving, rel=COARSE)
    still = []
    for motion in motions:
        t, w = motion.quadrature(20)
        zero = np.zeros((len(t), 6))
        still.append(w @ np.sum(problem.robot.torque(motion(t), zero, zero) ** 2, axis=1))
    assert diversity._costs(leg, kernels, drawn, 0.0) == pytest.approx(still, rel=COARSE)


def test_a_saved_plan_comes_back_with_its_optima(plans, tmp_path):
    plan = plans[20]
    plan.save(tmp_path / "plan.npz")
    loaded = eo.load_plan(tmp_path / "plan.npz")
    assert [one.summary for one in loaded.optima] == [one.summary for one in plan.optima]
    t = np.linspace(0.0, plan.duration, 20)
    assert all(np.array_equal(a.trajectory(t), b.trajectory(t)) for a, b in zip(loaded.optima, plan.optima, strict=True))


def test_a_pose_is_reached_by_several_branches():
    robot = arms.catalogue_robot("ur5")
    start = np.array([0.3, -0.9, 1.2, -1.2, 0.8, 0.1])
    goal = eo.FramePose("tool0", [0.3, 0.3, 0.4])
    plan = eo.plan(eo.Problem(robot, start, goal, 2.0, self_collision=False), FIXED, starts=12)
    ends = np.array([optimum.trajectory(plan.duration) for optimum in plan.optima])
    assert len(plan.options["tried"]) == 12 and np.abs(ends - ends[0]).max() > 0.5
