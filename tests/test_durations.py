"""Shortest durations: closed forms, another library, bounds that enclose what the planner can do, and words that say so."""

from dataclasses import replace
from functools import cache

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt.durations import straight
from energyopt.least_times import least_times
from energyopt.timing.paths import as_path
from energyopt.verification import is_valid, verify


@cache
def panda_points(seed):
    """A tame way, so that the spline through it keeps within the limits of position."""
    robot = arms.catalogue_robot("panda")
    return robot.home + 0.6 * np.random.default_rng(seed).uniform(-1, 1, (4, 7))


def test_bang_bang_takes_twice_the_root_of_distance_by_acceleration():
    """T = 2 √(d/a) of the double integrator."""
    robot = arms.sliders(1)
    limits = replace(robot.limits, acceleration=np.array([2.0]))
    assert eo.minimum_duration([[0.0], [0.5]], robot, limits) == pytest.approx(2 * np.sqrt(0.5 / 2.0), rel=1e-6)


def test_speeds_at_the_ends_are_counted():
    """From speed v₀ to rest with constant deceleration a = v₀²/2d, the only law: T = 2d/v₀."""
    robot = arms.sliders(1)
    limits = replace(robot.limits, acceleration=np.array([1.0]))
    assert eo.minimum_duration([[0.0], [0.5]], robot, limits, start_speed=1.0) == pytest.approx(1.0, rel=1e-3)
    with pytest.raises(eo.InputError, match=r"start speed 1\.2 is more than the limits allow there, 1"):
        eo.minimum_duration([[0.0], [0.5]], robot, limits, start_speed=1.2)
    with pytest.raises(eo.InputError, match=r"speed 2 at its end cannot be reached: at most 1"):
        eo.minimum_duration([[0.0], [0.5]], robot, limits, goal_speed=2.0)


@pytest.mark.parametrize("limited", ["velocity", "acceleration", "torque", "all"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_toppra_finds_the_same_shortest_duration(limited, seed):
    """Within 1 %, on grids of 240 and of 1000 intervals."""
    toppra = pytest.importorskip("toppra", reason="toppra, the other engine of this comparison, is not installed")
    robot, points, free = arms.catalogue_robot("panda"), panda_points(seed), np.full(7, np.inf)
    bounds = {"velocity": robot.limits.velocity, "acceleration": np.full(7, 6.0), "torque": 0.9 * robot.limits.torque}
    own = {kind: bound if limited in (kind, "all") else free for kind, bound in bounds.items()}
    curve = as_path(points, robot)
    s = np.linspace(0.0, curve.duration, 1000)
    kinds = {
        "velocity": lambda bound: toppra.constraint.JointVelocityConstraint(bound),
        "acceleration": lambda bound: toppra.constraint.JointAccelerationConstraint(bound),
        "torque": lambda bound: toppra.constraint.JointTorqueConstraint(robot.torque, np.stack([-bound, bound], 1), np.zeros(7)),
    }
    rows = [kinds[kind](bound) for kind, bound in own.items() if np.isfinite(bound).all()]
    found = toppra.algorithm.TOPPRA(rows, toppra.SplineInterpolator(s, curve(s)), gridpoints=s).compute_trajectory()
    assert eo.minimum_duration(points, robot, replace(robot.limits, **own)) == pytest.approx(found.duration, rel=0.01)


@pytest.mark.parametrize("ramp", [0.5, 0.3, 0.06])
def test_a_straight_motion_with_smooth_ramps_goes_from_rest_to_rest_without_jumps(ramp):
    start, goal = np.array([0.1, 0.2]), np.array([1.0, -1.0])
    motion, ends = straight(start, goal, ramp), np.array([0.0, 1.0])
    assert np.allclose(motion(ends), [start, goal], atol=1e-12)
    assert np.allclose(motion(ends, 1), 0, atol=1e-12) and np.allclose(motion(ends, 2), 0, atol=1e-9)
    inner = motion.breaks[1:-1]
    for order in (0, 1, 2):
        assert np.allclose(motion(inner - 1e-9, order), motion(inner + 1e-9, order), atol=1e-5)


LIMITS = {
    "robot's own": {},
    "acceleration": {"acceleration_limits": 6.0},
    "jerk": {"jerk_limits": 80.0},
    "torque": {"torque_limits": [60.0, 60.0, 40.0, 30.0, 10.0, 10.0, 8.0]},
    "torque rate": {"torque_rate_limits": 400.0},
}


@pytest.mark.parametrize("kind", LIMITS)
def test_bounds_of_a_duration_enclose_the_shortest_one(kind):
    """Below the lower one planning refuses; at the upper one the motion that is given is valid."""
    robot = arms.catalogue_robot("panda")
    problem = eo.Problem(robot, robot.home, robot.home + 0.5, 9.0, self_collision=False, **LIMITS[kind])
    bounds = eo.duration_bounds(problem)
    assert 0 < bounds.lower < bounds.upper < 5 * bounds.lower and bounds.reason == ""
    assert is_valid(verify(problem.lasting(bounds.upper), bounds.motion))
    each = least_times(problem.limits, np.full(7, 0.5), np.ones(7, bool), np.ones(7, bool))
    assert bounds.lower == pytest.approx(each.max()) and bounds.joint == robot.joint_names[int(np.argmax(each))]
    with pytest.raises(eo.InputError, match="needs at least"):
        eo.plan(problem.lasting(0.9 * bounds.lower))


def test_a_duration_that_is_too_short_is_told_what_is_least_and_what_is_feasible():
    robot = arms.sliders(1)
    problem = eo.Problem(robot, [0.0], [0.5], 0.4, acceleration_limits=2.0, velocity_limits=10.0, self_collision=False)
    bounds = eo.duration_bounds(problem)
    assert bounds.lower == pytest.approx(1.0) and bounds.upper < 1.3
    words = (
        f"needs at least 1 s from start to goal under its limits, 0.4 s are given; {bounds.upper:.4g} s is known to be feasible"
    )
    with pytest.raises(eo.InputError) as caught:
        eo.plan(problem)
    assert words in str(caught.value) and "\n" not in str(caught.value)
    assert str(bounds) == f"at least 1 s (joint1); {bounds.upper:.4g} s is feasible"


def test_waypoints_add_up_and_are_passed_at_rest():
    robot = arms.sliders(1)
    problem = eo.Problem(robot, [0.0], [0.0], 9.0, waypoints=[[0.5]], acceleration_limits=2.0, self_collision=False)
    bounds = eo.duration_bounds(problem)
    assert bounds.upper == pytest.approx(
        2 * eo.duration_bounds(eo.Problem(robot, [0.0], [0.5], 9.0, acceleration_limits=2.0)).upper
    )
    assert is_valid(verify(problem.lasting(bounds.upper), bounds.motion))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"goal_velocity": 0.1}, "start or goal is no rest"),
        ({"waypoints": [([0.2], 1.0)]}, "waypoints have times"),
        ({"goal": [0.0]}, "nothing moves"),
        ({"obstacles": [eo.Sphere(0.05, (0.25, 0.0, 0.0))]}, "overlap"),
    ],
)
def test_where_no_duration_is_known_the_reason_is(options, said):
    one = {"axes": [(1, 0, 0)], "origins": [(0, 0, 0)], "masses": [1.0], "centers": [(0, 0, 0)], "inertias": [0.01 * np.eye(3)]}
    text = arms.factory.chain(**one, types=["prismatic"])
    robot = arms.from_urdf(text, gravity=(0, 0, 0))
    tool = eo.Attached(eo.Sphere(0.05), robot.frame_names[-1])
    given = {"start": [0.0], "goal": [0.5], "duration": 9.0, "self_collision": False, "attached": [tool]} | options
    bounds = eo.duration_bounds(eo.Problem(robot, **given))
    assert bounds.upper is None and bounds.motion is None and said in bounds.reason and said in str(bounds)


def test_a_free_duration_and_a_goal_in_space_have_bounds_too():
    robot = arms.catalogue_robot("panda")
    free = eo.Problem(robot, robot.home, robot.home + 0.5, (0.5, 9.0), self_collision=False)
    fixed = eo.duration_bounds(free.lasting(3.0))
    assert eo.duration_bounds(free).upper == fixed.upper and eo.duration_bounds(free).lower == fixed.lower
    pose = eo.FramePose("panda_hand", robot.placement("panda_hand", robot.home + 0.3).translation)
    bounds = eo.duration_bounds(eo.Problem(robot, robot.home, pose, 2.0, self_collision=False))
    assert bounds.lower == 0.0 and bounds.reason == "the goal is a pose"


def test_bad_input_is_one_clear_line():
    with pytest.raises(eo.InputError, match=r"expected one energyopt\.Problem"):
        eo.duration_bounds(3.0)
    with pytest.raises(eo.InputError, match="at least two different configurations"):
        eo.minimum_duration([[0.0]], arms.sliders(1))
