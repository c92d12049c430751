"""The fastest motion along a path: closed forms, limits that bind and hold, another library; motions scaled to a duration."""

from functools import cache

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt.errors import ProblemError
from energyopt.pathfinding import fastest, rounded, shortest_duration, timed, timed_smoothly

WAY, FORCE, MASS = 1.5, 6.0, 2.0


@cache
def panda_path():
    """Five random configurations of a Panda, its corners rounded."""
    limits = arms.catalogue_robot("panda").limits
    points = np.random.default_rng(5).uniform(0.7 * limits.lower + 0.3 * limits.upper, limits.upper, (5, 7))
    return rounded(points)


def slider(velocity=100.0, **options):
    return arms.sliders(1, (MASS,)).with_limits(velocity=np.array([velocity]), torque=np.array([FORCE]), **options)


def usage(trajectory, robot, count=4000):
    """Share of the limits of velocity and torque in use at even times, shape (count,) each, ends from inside."""
    t = trajectory.duration * (np.arange(count) + 0.5) / count
    torque = robot.torque(trajectory(t), trajectory(t, 1), trajectory(t, 2))
    return np.abs(trajectory(t, 1) / robot.limits.velocity).max(axis=1), np.abs(torque / robot.limits.torque).max(axis=1)


def test_a_mass_pushed_with_the_full_force_takes_the_time_known_in_closed_form():
    """T = 2 √(d m / F): half the way faster, half slower."""
    assert shortest_duration(np.array([[0.0], [WAY]]), slider()) == pytest.approx(2 * np.sqrt(WAY * MASS / FORCE), rel=1e-6)


def test_a_limited_velocity_is_reached_kept_and_left():
    """T = d/v + v m / F."""
    robot = slider(velocity=1.2)
    assert shortest_duration(np.array([[0.0], [WAY]]), robot) == pytest.approx(WAY / 1.2 + 1.2 * MASS / FORCE, rel=1e-3)


def test_a_limited_acceleration_counts_like_a_force():
    robot = slider(acceleration=np.array([0.5]))
    assert shortest_duration(np.array([[0.0], [WAY]]), robot) == pytest.approx(2 * np.sqrt(WAY / 0.5), rel=1e-6)


def test_the_fastest_motion_uses_a_limit_fully_at_all_times_and_breaks_none():
    """Within the error of a grid of 240 intervals: 1 %. Where limits take turns, both may be just below."""
    robot = arms.catalogue_robot("panda")
    velocity, torque = usage(timed(panda_path(), robot), robot)
    most = np.maximum(velocity, torque)
    assert most.max() < 1.01
    assert np.mean(most > 0.98) > 0.9
    assert np.mean(torque > 0.98) > 0.05


def test_the_motion_is_on_the_path_from_rest_to_rest():
    robot, curve = arms.catalogue_robot("panda"), panda_path()
    motion = timed(curve, robot, duration=4.0)
    assert motion.duration == pytest.approx(4.0, rel=1e-12)
    ends = np.array([0.0, motion.duration])
    assert np.allclose(motion(ends), curve(np.array([0.0, curve.duration])), atol=1e-9)
    assert np.allclose(motion(ends, 1), 0.0, atol=1e-9)
    dense = curve(np.linspace(0.0, curve.duration, 20_000))
    apart = [np.min(np.linalg.norm(dense - q, axis=1)) for q in motion(np.linspace(0, 4.0, 200))]
    assert max(apart) < 1e-3


def test_position_velocity_and_acceleration_of_a_motion_belong_together():
    motion = timed(panda_path(), arms.catalogue_robot("panda"), duration=4.0)
    t, h = np.random.default_rng(0).uniform(0.1, 3.9, 200), 1e-6
    for order in (0, 1):
        slope = (motion(t + h, order) - motion(t - h, order)) / (2 * h)
        smooth = np.abs(t[:, None] - motion.breaks).min(axis=1) > 2 * h
        assert np.allclose(slope[smooth], motion(t[smooth], order + 1), atol=1e-4)


def test_a_slower_law_keeps_the_limits_that_the_fastest_keeps():
    robot = arms.catalogue_robot("panda")
    law = fastest(panda_path(), robot)
    for ratio in (1.0, 1.2, 2.0, 10.0):
        velocity, torque = usage(timed(panda_path(), robot, duration=ratio * law.duration), robot)
        assert velocity.max() < 1.01 / ratio and torque.max() < 1.01


def test_friction_takes_time_and_the_limits_hold_with_it():
    plain = arms.catalogue_robot("panda")
    rubbing = eo.load_robot("panda", viscous_friction=4.0, coulomb_friction=3.0)
    least, most = (shortest_duration(panda_path(), robot) for robot in (plain, rubbing))
    assert least < most < 3 * least
    assert usage(timed(panda_path(), rubbing), rubbing)[1].max() < 1.01


def test_a_finer_grid_changes_the_shortest_duration_little(monkeypatch):
    robot = arms.catalogue_robot("panda")
    coarse = shortest_duration(panda_path(), robot)
    monkeypatch.setattr("energyopt.timing.reachability.INTERVALS", 2000)
    assert coarse == pytest.approx(shortest_duration(panda_path(), robot), rel=0.01)


def test_toppra_finds_the_same_shortest_duration():
    toppra = pytest.importorskip("toppra", reason="toppra, the other engine of this comparison, is not installed")
    robot, curve = arms.catalogue_robot("panda"), panda_path()
    s = np.linspace(0.0, curve.duration, 1000)
    path = toppra.SplineInterpolator(s, curve(s))
    limits = [
        toppra.constraint.JointVelocityConstraint(robot.limits.velocity),
        toppra.constraint.JointTorqueConstraint(
            robot.torque, np.stack([-robot.limits.torque, robot.limits.torque], axis=1), np.zeros(7)
        ),
    ]
    found = toppra.algorithm.TOPPRA(limits, path, gridpoints=s).compute_trajectory()
    assert shortest_duration(curve, robot) == pytest.approx(found.duration, rel=0.01)


def test_an_arm_too_weak_for_its_path_is_told_which_joint_and_how_much():
    robot = arms.two_link().with_limits(torque=np.array([20.0, 1.0]))
    with pytest.raises(ProblemError, match=r"joint 'joint2' needs 2\.9\d* N·m to be held .* its torque limit is 1"):
        shortest_duration(np.array([[1.5, 0.0], [0.0, 0.0]]), robot)


def test_without_any_limit_there_is_no_shortest_duration():
    none = np.array([np.inf])
    robot = arms.sliders(1).with_limits(velocity=none, torque=none, acceleration=none)
    with pytest.raises(ProblemError, match="neither velocity nor torque nor acceleration is limited"):
        shortest_duration(np.array([[0.0], [1.0]]), robot)


def test_a_smoothly_timed_straight_way_is_the_quintic():
    path = np.array([[0.0, 1.0], [1.0, -1.0]])
    motion, t = timed_smoothly(path, 2.0), np.linspace(0, 2.0, 41)
    share = 10 * (t / 2) ** 3 - 15 * (t / 2) ** 4 + 6 * (t / 2) ** 5
    assert np.allclose(motion(t), path[0] + share[:, None] * (path[1] - path[0]), atol=1e-12)
    assert np.allclose(motion(np.array([0.0, 2.0]), 1), 0.0, atol=1e-12)
    assert np.allclose(motion(np.array([0.0, 2.0]), 2), 0.0, atol=1e-9)
