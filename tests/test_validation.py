"""Validation: good plans pass, and every kind of bad plan fails for its own reason."""

import json
from dataclasses import replace

import numpy as np
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.parameterizations.trajectory import PolynomialTrajectory
from energyopt.validation import tracking_errors, validate_motion
from energyopt.verification import cost, verify


@pytest.fixture(scope="module")
def slider(tmp_path_factory):
    """A unit mass; with λ = 0 the quintic's J is 120/7·d²/T³, the best rest-to-rest motion's 12 d²/T³."""
    return eo.load_robot(factory.write(tmp_path_factory.mktemp("one"), factory.sliders(1)))


def as_plan(problem, trajectory):
    """What `plan` returns, around a given motion."""
    terms = cost(problem, trajectory)
    return eo.Plan(
        problem=problem, status=eo.Status.SOLVED, message="", trajectory=trajectory, objective=sum(terms.values()),
        cost_terms=terms, violations=verify(problem, trajectory), discretization_error=None, iterations=0,
        time_s={"build": 0.0, "compile": 0.0, "solve": 0.0, "verify": 0.0}, seed=0, options={},
    )  # fmt: skip


def with_middle_shifted(motion, amount):
    """The motion plus amount·s³(1−s)³: ends, velocities and accelerations there unchanged."""
    T = motion.duration
    s3 = np.zeros(7)
    s3[3:] = amount * np.array([1, -3, 3, -1]) / T ** np.arange(3, 7)
    quintic = motion.polynomial_pieces()[1][0]
    both = np.zeros((7, motion.nv))
    both[:6] = quintic
    both += s3[:, None]
    return PolynomialTrajectory(np.array([0.0, T]), both[None])


def failed(report):
    return [check.name for check in report.checks if not check.passed]


def test_what_is_no_plan_or_no_replay_is_named(slider):
    problem = eo.Problem(slider, [0.0], [0.8], 1.0)
    with pytest.raises(eo.InputError, match=r"validate: plan is None: expected an energyopt\.Plan"):
        eo.validate(None)
    with pytest.raises(eo.InputError, match=r"log is 'log': expected what energyopt\.replay gives"):
        eo.validate(as_plan(problem, eo.baseline(problem)), "log")


def test_a_quintic_beside_a_cycloid_passes_and_saves_the_closed_form(slider):
    """J / (d²/T³) is 120/7 for the quintic, 2π² for the cycloid, 12 for the cubic and 13.5 for the trapezoid."""
    problem = eo.Problem(slider, [0.0], [0.8], 1.0, velocity_weight=0.0)
    motion = eo.baseline(problem)
    report = eo.validate(as_plan(problem, motion))
    assert report.passed and failed(report) == []
    assert report.objective == pytest.approx(120 / 7 * 0.8**2, rel=1e-12)
    savings = {name: b.saving_percent for name, b in report.baselines.items()}
    assert savings["quintic"] == pytest.approx(0.0, abs=1e-9)
    assert savings["cycloid"] == pytest.approx(100 * (1 - 120 / 7 / (2 * np.pi**2)), rel=1e-9)
    assert savings["cubic"] == pytest.approx(100 * (1 - 120 / 7 / 12), rel=1e-9)
    assert savings["trapezoidal"] == pytest.approx(100 * (1 - 120 / 7 / 13.5), rel=1e-9)
    energies = {name: b.energy_saving_percent for name, b in report.baselines.items()}
    assert energies["cycloid"] == pytest.approx(100 * (1 - (15 / 8) ** 2 / 4), rel=1e-3)


def test_baselines_that_start_with_an_acceleration_hold_limits_but_are_no_rivals(slider):
    problem = eo.Problem(slider, [0.0], [0.8], 1.0)
    compared = validate_motion(problem, eo.baseline(problem)).baselines
    assert {name: (b.within_limits, b.valid) for name, b in compared.items()} == {
        "quintic": (True, True),
        "cubic": (True, False),
        "cycloid": (True, True),
        "trapezoidal": (True, False),
    }


def test_a_motion_worse_than_a_valid_baseline_fails(slider):
    problem = eo.Problem(slider, [0.0], [0.8], 1.0)
    report = validate_motion(problem, with_middle_shifted(eo.baseline(problem), 20.0))
    assert failed(report) == ["loss to a valid baseline"]
    assert str(report).startswith("NOT valid: loss to a valid baseline")


def test_a_broken_limit_fails_and_is_named(slider):
    problem = eo.Problem(slider, [0.0], [0.8], 1.0, velocity_limits=1.4)
    report = validate_motion(problem, eo.baseline(problem))
    assert "conditions broken" in failed(report)
    assert "NOT valid: velocity of joint1 exceeds its limit by 0.1 rad/s at 0.500 s" in str(report)
    assert not report.baselines["cycloid"].within_limits and "broken: velocity" in str(report)


def test_a_replayed_panda_plan_passes_with_every_number_in_the_table(tmp_path):
    robot = eo.load_robot("panda")
    q = 0.5 * (robot.limits.lower + robot.limits.upper)
    problem = eo.Problem(robot, q - 0.3, q + 0.3, 1.2)
    plan = as_plan(problem, eo.baseline(problem))
    log = eo.replay(plan)
    report = eo.validate(plan, log)
    assert set(failed(report)) <= {"loss to a valid baseline"}
    assert abs(report.energy_gap_percent) < 0.2 and report.tracking.tool_max < 1e-3 and report.saturated_steps == 0
    assert report.inverse_dynamics_error < 1e-6
    text = str(report)
    assert all(word in text for word in ("plan", "replay", "quintic", "trapezoidal", "joint tracking", "energy gap"))
    assert max(map(len, text.splitlines())) < 130
    numbers = report.as_dict()
    json.dumps(numbers, allow_nan=False)
    assert set(numbers["replay"]) >= {"tracking_rms_rad", "tracking_max_rad", "energy_mechanical_abs_J", "energy_gap_percent"}
    assert set(numbers["baseline"]) == {"quintic", "cubic", "cycloid", "trapezoidal"}


def test_a_replay_with_another_payload_fails_on_tracking(slider):
    robot = eo.load_robot("panda")
    q = 0.5 * (robot.limits.lower + robot.limits.upper)
    problem = eo.Problem(robot, q - 0.3, q + 0.3, 1.2)
    plan = as_plan(problem, eo.baseline(problem))
    log = eo.replay(plan, plant=eo.load_robot("panda", payload=eo.Payload(3.0)))
    assert {"joint tracking, largest", "energy gap, replay"} <= set(failed(eo.validate(plan, log)))


def test_tracking_errors_are_those_put_into_the_log():
    """A constant offset of 1 mrad at the last joint turns the tool by 1 mrad and moves nothing on its axis."""
    robot = eo.load_robot("panda")
    q = 0.5 * (robot.limits.lower + robot.limits.upper)
    problem = eo.Problem(robot, q - 0.1, q + 0.1, 0.5)
    log = eo.replay(as_plan(problem, eo.baseline(problem)))
    offset = np.zeros(7)
    offset[6] = 1e-3
    found = tracking_errors(robot, replace(log, q=log.q_ref + offset))
    assert found.joint_max == pytest.approx(1e-3) and found.joint_rms == pytest.approx(1e-3 / np.sqrt(7))
    assert found.tool_turn_max == pytest.approx(1e-3, rel=1e-6)
    same = tracking_errors(robot, replace(log, q=log.q_ref))
    assert (same.joint_max, same.tool_max, same.tool_turn_max) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


def test_holding_still_is_validated_without_dividing_by_nothing(slider):
    problem = eo.Problem(slider, [0.1], [0.1], 0.5)
    plan = as_plan(problem, eo.baseline(problem))
    report = eo.validate(plan, eo.replay(plan))
    assert report.passed and report.baselines["quintic"].saving_percent is None
    json.dumps(report.as_dict(), allow_nan=False)


def test_a_cartesian_goal_compares_baselines_to_the_configuration_reached():
    robot = eo.load_robot("ur5")
    q = np.array([0.0, -1.2, 1.0, -0.5, 0.3, 0.2])
    pose = robot.placement(robot.tool_frame, q + 0.3)
    problem = eo.Problem(robot, q, eo.FramePose(robot.tool_frame, pose.translation, pose.rotation), 1.0)
    motion = eo.baseline(problem, goal=q + 0.3)
    report = validate_motion(problem, motion)
    assert report.baselines["quintic"].saving_percent == pytest.approx(0.0, abs=1e-9)
    assert report.baselines["quintic"].valid


def test_contacts_in_the_replay_fail_and_are_named_and_contacts_not_looked_for_are_no_verdict():
    robot = eo.load_robot("panda")
    start = np.array([0, -0.7, 0, -2.3, 0, 1.6, 0.8])
    hand = robot.placement("panda_hand", start + 0.15).translation
    problem = eo.Problem(robot, start, start + 0.3, 1.2, obstacles=[eo.Box((0.05, 0.05, 0.05), hand, name="brick")])
    plan = as_plan(problem, eo.baseline(problem))
    report = eo.validate(plan, eo.replay(plan))
    assert {"conditions broken", "replay with contact"} <= set(failed(report))
    numbers = report.as_dict()
    touch = next(t for t in numbers["replay"]["contacts"] if t["first"] == "panda_hand")
    assert (
        touch["second"] == "brick" and 0 < touch["begin_s"] < touch["time_s"] < touch["end_s"] < 1.2 and touch["depth_m"] > 0.02
    )
    assert numbers["max_violation"]["clearance_m"] == pytest.approx(-report.violations.distance, abs=1e-6)
    assert numbers["clearance"]["pair"].endswith("brick")
    assert not report.baselines["quintic"].within_limits and "broken: clearance" in str(report)
    blind = eo.validate(plan, eo.replay(plan, collisions=False))
    assert "replay with contact" not in {check.name for check in blind.checks}
    assert blind.as_dict()["replay"]["contacts"] is None


def test_clearance_is_null_where_nothing_was_looked_at(slider):
    """A slider without geometry: neither a distance nor a violation of 0."""
    problem = eo.Problem(slider, [0.0], [0.8], 1.0)
    plan = as_plan(problem, eo.baseline(problem))
    numbers = eo.validate(plan, eo.replay(plan)).as_dict()
    assert numbers["max_violation"]["clearance_m"] is None and numbers["clearance"] is None
    assert numbers["replay"]["contacts"] is None
