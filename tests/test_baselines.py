"""Baselines against the closed forms of their families."""

import numpy as np
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.baselines import BASELINES, trapezoidal
from energyopt.sampling import extrema, sample_spans
from energyopt.verification import verify

EXACT = 1e-9
"""Closed forms evaluated in double precision, numbers of order 1."""

KINDS = tuple(BASELINES)


@pytest.fixture(scope="module")
def slider(tmp_path_factory):
    """Two decoupled unit masses: positions are metres, velocity limit 20 m/s."""
    return eo.load_robot(factory.write(tmp_path_factory.mktemp("slider"), factory.sliders(2)))


def peak(trajectory, order):
    inner = extrema(trajectory, order)[1]
    return np.abs(np.vstack([sample_spans(trajectory).flat(order), inner])).max(axis=0)


@pytest.mark.parametrize(
    ("kind", "speed", "acceleration"),
    [
        ("quintic", 15 / 8, 10 / np.sqrt(3)),
        ("cubic", 3 / 2, 6.0),
        ("cycloid", 2.0, 2 * np.pi),
        ("trapezoidal", 3 / 2, 9 / 2),
    ],
)
def test_peaks_are_the_textbook_multiples_of_the_mean(slider, kind, speed, acceleration):
    move, duration = np.array([1.5, -0.4]), 0.8
    motion = eo.baseline(eo.Problem(slider, [0.2, 0.1], [0.2, 0.1] + move, duration), kind)
    np.testing.assert_allclose(peak(motion, 1), speed * np.abs(move) / duration, rtol=EXACT)
    np.testing.assert_allclose(peak(motion, 2), acceleration * np.abs(move) / duration**2, rtol=EXACT)


@pytest.mark.parametrize("kind", KINDS)
def test_start_goal_and_end_velocities_are_met(slider, kind):
    problem = eo.Problem(slider, [0, 1], [2, -1], 1.3, start_velocity=[0.5, -0.2], goal_velocity=[0.1, 0.7])
    motion = eo.baseline(problem, kind)
    ends = motion(np.array([0.0, 1.3]))
    np.testing.assert_allclose(ends, [[0, 1], [2, -1]], atol=EXACT)
    np.testing.assert_allclose(motion(np.array([0.0, 1.3]), 1), [[0.5, -0.2], [0.1, 0.7]], atol=EXACT)


@pytest.mark.parametrize("kind", ["quintic", "cycloid"])
def test_end_accelerations_are_met_where_the_family_can(slider, kind):
    problem = eo.Problem(slider, [0, 1], [2, -1], 1.3, start_acceleration=[0.3, 2.0], goal_acceleration=-1.0)
    np.testing.assert_allclose(eo.baseline(problem, kind)(np.array([0.0, 1.3]), 2), [[0.3, 2.0], [-1.0, -1.0]], atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_waypoints_are_passed_in_order_and_on_time(slider, kind):
    waypoints = [([0.5, 0.2], 0.4), [1.0, 0.5], [0.7, 0.1]]
    problem = eo.Problem(slider, [0, 0], [1.5, -0.5], 2.0, waypoints=waypoints)
    motion = eo.baseline(problem, kind)
    np.testing.assert_allclose(motion(0.4), [0.5, 0.2], atol=EXACT)
    assert verify(problem, motion).amount["waypoint"] < 1e-6


def test_quintic_through_a_waypoint_has_less_jerk_than_its_neighbours(slider):
    """Among C² quintics through the same points the one that is C⁴ at the waypoint is the minimum of ∫ jerk²."""
    problem = eo.Problem(slider, [0, 0], [1, 1], 2.0, waypoints=[([0.8, 0.1], 0.9)])
    motion = eo.baseline(problem)
    jumps = [motion(0.9 + 1e-9, order) - motion(0.9 - 1e-9, order) for order in (3, 4)]
    np.testing.assert_allclose(jumps, 0.0, atol=1e-4)


def test_trapezoid_covers_its_area_for_every_share(slider):
    problem = eo.Problem(slider, [0, 0], [1.0, -2.0], 2.0)
    for share in (0.1, 0.25, 1 / 3, 0.5):
        motion = trapezoidal(problem, np.array([0.0, 2.0]), np.array([[0, 0], [1.0, -2.0]]), share)
        np.testing.assert_allclose(peak(motion, 1), np.array([1.0, 2.0]) / (2.0 * (1 - share)), rtol=EXACT)
        np.testing.assert_allclose(motion(2.0), [1.0, -2.0], atol=EXACT)


def test_trapezoid_accelerates_shorter_where_a_velocity_limit_asks_and_longer_for_an_acceleration_limit(slider):
    quick = eo.Problem(slider, [0, 0], [1.0, 0.0], 1.0, velocity_limits=1.2)
    assert peak(eo.baseline(quick, "trapezoidal"), 1).max() <= 1.2 * (1 + EXACT)
    gentle = eo.Problem(slider, [0, 0], [1.0, 0.0], 1.0, acceleration_limits=4.1)
    assert peak(eo.baseline(gentle, "trapezoidal"), 2).max() <= 4.1 * (1 + EXACT)


@pytest.mark.parametrize("kind", KINDS)
def test_a_motion_that_stays_put_is_a_constant(slider, kind):
    motion = eo.baseline(eo.Problem(slider, [0.3, 0.4], [0.3, 0.4], 1.0), kind)
    np.testing.assert_allclose(motion(np.linspace(0, 1, 11)), np.tile([0.3, 0.4], (11, 1)), atol=EXACT)


def test_unknown_kind_and_missing_joint_goal_are_refused_by_name(slider):
    with pytest.raises(eo.InputError, match="expected one of quintic, cubic"):
        eo.baseline(eo.Problem(slider, [0, 0], [1, 1], 1.0), "septic")
    cartesian = eo.Problem(slider, [0, 0], eo.FramePose("tool", [0.5, 1.0, 0.0]), 1.0)
    with pytest.raises(eo.InputError, match="Cartesian"):
        eo.baseline(cartesian)
    np.testing.assert_allclose(eo.baseline(cartesian, goal=[0.1, 0.5])(1.0), [0.1, 0.5], atol=EXACT)
