"""Motions that nobody has planned here are judged as plans are."""

import arms
import numpy as np
import pytest

import energyopt as eo

T = 1.5


@pytest.fixture(scope="module")
def reach():
    robot = arms.catalogue_robot("ur5")
    return eo.Problem(robot, robot.home, robot.home + 0.6, T, velocity_limits=2.0)


def test_a_plan_is_judged_as_it_is_validated(reach):
    plan = eo.plan(reach, eo.BSpline(accuracy=None), starts=1)
    validated = eo.validate(plan)
    for given in (plan, plan.trajectory):
        report = eo.judge(given, reach.robot, velocity_limits=2.0)
        assert report.passed and report.objective == validated.objective
        assert report.violations.margin == validated.violations.margin
        assert report.baselines["quintic"].objective == validated.baselines["quintic"].objective


def test_the_quintic_costs_what_its_closed_form_says_and_more_than_a_plan():
    """J of a slider is m² ∫q̈² = 120/7 d²/T³; that less would do is no fault."""
    robot = arms.sliders(1)
    motion = eo.baseline(eo.Problem(robot, [0.0], [1.0], 1.0), "quintic")
    report = eo.judge(motion, robot, velocity_weight=0.0)
    mass = float(robot.torque([0.0], [0.0], [1.0])[0])
    assert report.objective == pytest.approx(120 / 7 * mass**2, rel=1e-9) and report.passed
    assert "loss to a valid baseline" not in {check.name for check in report.checks}
    assert report.baselines["cubic"].objective < report.objective


def test_samples_are_judged_as_the_motion_they_were_taken_from(reach):
    motion = eo.baseline(reach, "quintic")
    t = np.linspace(0.0, T, 200)
    sampled, exact = eo.judge((t, motion(t)), reach.robot), eo.judge(motion, reach.robot)
    assert sampled.objective == pytest.approx(exact.objective, rel=1e-4)
    assert sampled.plan_metrics.mechanical_abs_J == pytest.approx(exact.plan_metrics.mechanical_abs_J, rel=1e-4)


def test_what_a_motion_breaks_is_named(reach):
    motion = eo.baseline(reach, "quintic")
    peak = 15 / 8 * 0.6 / T
    report = eo.judge(motion, reach.robot, velocity_limits=0.8 * peak)
    assert not report.passed and "NOT valid: velocity of" in str(report)
    assert report.violations.amount["velocity"] == pytest.approx(0.2 * peak, rel=1e-6)
    tool = reach.robot.placement("tool0", motion(T / 2)).translation
    ball = eo.Sphere(0.05, tool, name="ball")
    touched = eo.judge(motion, reach.robot, [ball])
    assert not touched.passed and "ball" in str(touched).splitlines()[0]
    assert eo.judge(motion, reach.robot, [eo.Sphere(0.05, tool + [0, 0, 3.0])]).passed


def test_a_motion_need_not_rest_at_its_ends():
    robot = arms.sliders(1)
    t = np.linspace(0.0, 1.0, 50)
    report = eo.judge((t, 0.3 * t[:, None]), robot, velocity_weight=1.0)
    assert report.passed and report.objective == pytest.approx(0.09, rel=1e-6), "no acceleration, and 0.3 rad/s for a second"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"trajectory": None}, "judge: trajectory is None: expected a Trajectory"),
        ({"trajectory": ([0.0, 1.0], [[0.0], [1.0]])}, "more than 3 times in seconds, rising from 0"),
        ({"trajectory": ([0.0, 1.0, 1.0, 2.0], np.zeros((4, 1)))}, "rising from 0"),
        ({"trajectory": (np.arange(5.0), np.zeros((5, 2)))}, r"positions has the shape \(5, 2\): expected \(5, 1\)"),
        ({"trajectory": (np.arange(5.0), np.full((5, 1), np.nan))}, "expected .*finite"),
        ({"robot": "panda"}, "judge: robot is 'panda': expected what energyopt.load_robot gives"),
        ({"velocity_limit": 1.0}, "judge: no option 'velocity_limit'; nearest: velocity_limits"),
        ({"goal": [1.0]}, "judge: no option 'goal'"),
        ({"obstacles": 5}, "obstacles is 5"),
        ({"velocity_limits": -1.0}, "velocity_limits"),
    ],
)
def test_what_makes_no_sense_is_named(change, said):
    robot = arms.sliders(1)
    usual = {"trajectory": eo.baseline(eo.Problem(robot, [0.0], [1.0], 1.0), "quintic"), "robot": robot}
    with pytest.raises(eo.InputError, match=said):
        eo.judge(**usual | change)


def test_a_motion_of_another_arm_is_refused(reach):
    with pytest.raises(eo.InputError, match="the motion has 6 joints"):
        eo.judge(eo.baseline(reach, "quintic"), arms.sliders(1))
