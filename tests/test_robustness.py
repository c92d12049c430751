"""Plans for arms that are not quite as modelled: against direct evaluation, draws, and replays."""

import dataclasses
import json

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt.actuators import ActuatorModel, Actuators
from energyopt.metrics import metrics
from energyopt.robots.variation import vary
from energyopt.robust import Case, Uncertainty
from energyopt.robust.evaluation import ENERGIES, TorqueFamily, corner_problem, evaluate
from energyopt.sampling import Samples
from energyopt.verification import verify

SAME = 1e-10
"""Relative difference of the same numbers computed in another order."""


def task(robot, duration=1.0, **options):
    low, high = np.maximum(robot.limits.lower, -1.0), np.minimum(robot.limits.upper, 1.0)
    return eo.Problem(robot, 0.7 * low + 0.3 * high, 0.3 * low + 0.7 * high, duration, **options)


@pytest.fixture(scope="module")
def driven():
    """A chain with friction, rotors and drives."""
    models = Actuators([ActuatorModel(60.0, 0.1, 0.5, 0.8, 0.4)] * 3, shared_bus=True, standby_power=10.0)
    return dataclasses.replace(arms.rubbing_chain(), actuators=models)


@pytest.fixture(scope="module")
def swing():
    """A plan of a two-link arm with friction."""
    robot = arms.rubbing_two_link()
    return eo.plan(eo.Problem(robot, [-1.2, 0.4], [0.3, -0.8], 1.2), eo.BSpline(control_points=12, accuracy=None))


def test_every_corner_is_what_the_changed_robot_needs(driven):
    problem, load = task(driven, torque_limits=500.0), eo.Payload(1.0, (0.1, 0.0, -0.2), arms.tilted(0.02, 0.03, 0.04))
    motion, bounds = eo.baseline(problem), Uncertainty((0.5, 3.0), 12.0, 30.0, load)
    found = evaluate(problem, motion, bounds, samples=5)
    assert [result.case for result in found.corners] == list(bounds.corners()) and len(found.corners) == 8
    t = np.linspace(0.0, motion.duration, 300)
    family = TorqueFamily.along(driven, Samples(t[None], lambda order: motion(t, order)[None]), bounds)
    for result in (*found.corners, *found.samples):
        case = result.case
        body = eo.Payload(case.payload, load.center, load.inertia * case.payload)
        robot = vary(driven, dataclasses.replace(bounds.variation(case), payload=body))
        assert arms.relative(family.torque(case), robot.torque(*(motion(t, order) for order in range(3)))) < SAME
        direct = metrics(robot, motion, n=200)
        # By 3000 samples here, by finer ones, Gauss nodes, or nodes between sign changes there.
        assert result.mechanical_abs_J == pytest.approx(direct.mechanical_abs_J, rel=1e-4)
        assert result.mechanical_positive_J == pytest.approx(direct.mechanical_positive_J, rel=1e-4)
        assert result.torque_squared == pytest.approx(direct.torque_squared, rel=1e-4)
        account = eo.energy_account(motion, robot)
        assert result.electrical_J == pytest.approx(account.electrical_J, rel=1e-3)


def test_no_arm_between_the_bounds_asks_more_than_the_worst_corner(driven):
    problem = task(driven, torque_limits=500.0)
    found = evaluate(problem, eo.baseline(problem), Uncertainty((0.0, 4.0), 20.0, 50.0), samples=300, seed=1)
    for energy in ENERGIES:
        worst = max(getattr(result, energy) for result in found.corners)
        assert max(getattr(result, energy) for result in found.samples) <= worst * (1 + SAME)
        assert found.spread(energy)[1] == worst
    shares = np.max([result.torque_share for result in found.corners], axis=0)
    assert np.all([result.torque_share <= shares * (1 + SAME) for result in found.samples])


def test_the_worst_use_of_a_limit_is_that_of_the_dense_check_in_its_corner(swing):
    found = eo.robustness(swing, (0.0, 0.8), 10.0, 20.0)
    use = found.limits["torque_percent"]
    worst = verify(corner_problem(swing.problem, found.uncertainty, use.case), swing.trajectory)
    assert use.share == pytest.approx(100.0 - worst.margin["torque_percent"], rel=SAME)
    for case in found.uncertainty.corners():
        margin = verify(corner_problem(swing.problem, found.uncertainty, case), swing.trajectory).margin["torque_percent"]
        assert 100.0 - margin <= use.share * (1 + SAME)
    assert found.limits["velocity"].case is None
    assert found.limits["velocity"].share == pytest.approx(100.0 - swing.violations.margin["velocity"])


def test_holding_a_heavier_pendulum_needs_more_by_the_weight():
    """(m ± 10 % + payload) g l cos q against the limit; a pendulum of 2 kg and 0.5 m held 0.6 rad above the horizontal."""
    problem = eo.Problem(arms.pendulum(2.0, 0.5), [0.6], [0.6], 1.0, torque_limits=20.0)
    load = eo.Payload(1.0, frame="link1", center=(0.5, 0.0, 0.0))
    found = evaluate(problem, eo.baseline(problem), Uncertainty((0.0, 1.5), 10.0, load=load))
    expected = (2.0 * 1.1 + 1.5) * 9.81 * 0.5 * np.cos(0.6) / 20.0 * 100.0
    assert found.limits["torque_percent"].share == pytest.approx(expected, rel=1e-9)
    assert found.limits["torque_percent"].case == Case(1.5, 10.0, 0.0)


def test_draws_repeat_with_their_seed_and_do_not_depend_on_their_number(swing):
    few, many, other = (eo.robustness(swing, 1.0, 5.0, samples=n, seed=s) for n, s in ((4, 2), (9, 2), (4, 3)))
    assert [r.mechanical_abs_J for r in few.samples] == [r.mechanical_abs_J for r in many.samples[:4]]
    assert few.samples[0].mechanical_abs_J != other.samples[0].mechanical_abs_J


def test_a_robust_plan_holds_in_every_corner_where_the_ordinary_one_does_not():
    robot = arms.two_link()
    problem = eo.Problem(robot, [-1.4, 0.3], [0.6, -0.9], 1.0, torque_limits=[28.0, 12.0])
    options = {"parameterization": eo.BSpline(control_points=14, accuracy=None)}
    ordinary = eo.plan(problem, **options)
    bounds = {"payload": (0.0, 0.3), "masses": 5.0}
    assert not eo.robustness(ordinary, **bounds).holds
    plan, found = eo.plan_robust(problem, **bounds, **options)
    assert plan.solved and found.holds and plan.problem is problem
    for case in found.uncertainty.corners():
        assert verify(corner_problem(problem, found.uncertainty, case), plan.trajectory).margin["torque_percent"] > -0.01
    assert ordinary.objective <= plan.objective * (1 + 1e-6)
    assert "torque limits down to" in plan.notes[-1]


def test_a_robust_plan_of_what_is_certain_is_the_ordinary_plan(swing):
    plan, found = eo.plan_robust(swing.problem, parameterization=eo.BSpline(control_points=12, accuracy=None))
    assert plan.objective == pytest.approx(swing.objective, rel=1e-9)
    assert [result.case for result in found.corners] == [Case()]


def test_a_corner_that_cannot_even_stand_is_named():
    problem = eo.Problem(arms.two_link(), [0.0, 0.0], [0.6, -0.9], 1.0)
    with pytest.raises(eo.InputError, match=r"needs .* N·m there.*\(with 30 kg more, which is within the bounds asked for\)"):
        eo.plan_robust(problem, (0.0, 30.0))


def test_a_trial_without_disturbance_is_the_replay_bit_for_bit(swing):
    found, log = eo.replay_trials(swing, trials=2), eo.replay(swing)
    for trial in (found.nominal, *found.trials):
        assert trial.tracking_max == log.tracking_max and trial.tracking_rms == log.tracking_rms
        assert trial.mechanical_abs_J == np.trapezoid(np.abs(log.power), log.t, axis=0).sum()


def test_trials_are_replays_of_changed_arms(swing):
    """One trial made again by a robot with another URDF, compiled anew."""
    found = eo.replay_trials(swing, (0.1, 0.4), 10.0, 20.0, trials=3, seed=5)
    robot = swing.problem.robot
    for trial in found.trials:
        variation = dataclasses.replace(Uncertainty().variation(Case()), payload=eo.Payload(trial.payload))
        variation = dataclasses.replace(variation, masses=trial.masses, friction=trial.friction)
        log = eo.replay(swing, plant=vary(robot, variation))
        assert trial.tracking_max == pytest.approx(log.tracking_max, rel=1e-6)
    assert len({trial.payload for trial in found.trials}) == 3
    assert all(0.1 <= t.payload <= 0.4 and np.all(np.abs(t.masses - 1) <= 0.1) for t in found.trials)


def test_trials_repeat_with_their_seed_and_do_not_depend_on_their_number(swing):
    options = {"masses": 10.0, "delay": 2, "position_noise": 1e-4, "physics_step": 1e-3}
    few, many, other = (eo.replay_trials(swing, **options, trials=n, seed=s) for n, s in ((2, 1), (4, 1), (2, 9)))
    assert [t.tracking_max for t in few.trials] == [t.tracking_max for t in many.trials[:2]]
    assert few.trials[0].tracking_max != other.trials[0].tracking_max
    np.testing.assert_array_equal(few.values("mechanical_abs_J"), many.values("mechanical_abs_J")[:2])


def test_trials_that_diverge_are_counted_and_leave_the_others(swing):
    """A delay of 40 ms is eight times what a loop of 200 rad/s has; motors without limits drive it apart."""
    strong = dataclasses.replace(swing, problem=dataclasses.replace(swing.problem, torque_limits=np.inf))
    found = eo.replay_trials(strong, trials=2, stiffness=40000.0, damping=400.0, delay=40, physics_step=1e-3, masses=5.0)
    assert found.diverged == 2 and all("diverged" in trial.failure for trial in found.trials)
    assert found.distribution("tracking_max") is None and "2 diverged" in str(found)
    json.dumps(found.as_dict(), allow_nan=False)


def test_tables_and_files_say_what_was_found(swing):
    found = eo.robustness(swing, (0.0, 0.5), 10.0, samples=10)
    trials = eo.replay_trials(swing, (0.0, 0.5), trials=4, physics_step=1e-3)
    assert "0.5 kg more, masses +10 %" in str(found) and "torque" in str(found)
    assert f"{1e3 * trials.distribution('tracking_max').median:.4g}" in str(trials)
    numbers = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert numbers["spread"]["mechanical_abs_J"] == list(found.spread("mechanical_abs_J")) and len(numbers["samples"]) == 10
    assert len(json.loads(json.dumps(trials.as_dict(), allow_nan=False))["trials"]) == 4


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"payload": (2.0, 1.0)}, "the least mass is above the largest"),
        ({"payload": -1.0}, "payload is -1.0: expected masses in kg"),
        ({"payload": (0.0, np.nan)}, "payload is nan"),
        ({"payload": "2"}, "payload is '2'"),
        ({"payload": (1, 2, 3)}, r"payload is \(1, 2, 3\): expected a pair"),
        ({"masses": 100.0}, "masses is 100.0: expected a share of ± per cent"),
        ({"masses": None}, "masses is None"),
        ({"friction": "much"}, "friction is 'much'"),
        ({"load": 2.0}, "load is 2.0: expected an energyopt.Payload"),
        ({"load": eo.Payload(1.0, frame="nowhere")}, "no frame named 'nowhere'"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_senseless_bounds_are_refused(swing, options, words):
    for function in (eo.robustness, eo.replay_trials):
        with pytest.raises(eo.InputError, match=words):
            function(swing, **options)
    with pytest.raises(eo.InputError, match=words):
        eo.plan_robust(swing.problem, **options)


def test_what_is_no_plan_and_friction_that_is_not_there_are_refused(swing):
    for function in (eo.robustness, eo.replay_trials):
        with pytest.raises(eo.InputError, match=r"expected an energyopt\.Plan"):
            function(swing.problem)
    smooth = eo.plan(eo.Problem(arms.two_link(), [0.0, 0.0], [0.3, 0.3], 1.0), eo.BSpline(control_points=10, accuracy=None))
    with pytest.raises(eo.InputError, match="has no friction to vary"):
        eo.robustness(smooth, friction=20.0)
    for options, words in (({"samples": -1}, "samples is -1"), ({"samples": 1.5}, "samples is 1.5")):
        with pytest.raises(eo.InputError, match=words):
            eo.robustness(swing, **options)
    with pytest.raises(eo.InputError, match="trials is 0"):
        eo.replay_trials(swing, trials=0)
    with pytest.raises(eo.InputError, match="plan_robust: no option 'start'; nearest: starts"):
        eo.plan_robust(swing.problem, start=3)
    with pytest.raises(eo.InputError, match="plan_robust: problem is"):
        eo.plan_robust(swing)
