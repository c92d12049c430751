"""Least times: against a linear program that knows no formula, and never above the time of a motion that exists."""

import arms
import numpy as np
import pytest
from scipy.optimize import linprog

import energyopt as eo
from energyopt.least_times import check_changes, check_times, least_times
from energyopt.reach import reach
from energyopt.robots import Limits

INF = np.inf


def limits_of(velocity=INF, acceleration=INF, jerk=INF):
    rest = {"lower": -INF, "upper": INF, "torque": INF, "torque_rate": INF}
    given = rest | {"velocity": velocity, "acceleration": acceleration, "jerk": jerk}
    return Limits(**{key: np.array([value]) for key, value in given.items()})


def least(distance, from_rest=True, to_rest=True, **bounds):
    return least_times(limits_of(**bounds), np.array([distance]), np.array([from_rest]), np.array([to_rest]))[0]


def farthest(T, steps, velocity, acceleration, jerk, to_rest=True):
    """Largest distance in T seconds from rest, over all motions whose jerk is constant on ``steps`` even intervals."""
    h = T / steps
    J = np.eye(steps)
    a = h * np.tril(np.ones((steps, steps)))  # at the end of each interval, linear in the jerks
    a0 = np.vstack([np.zeros(steps), a[:-1]])
    v = np.cumsum(h * a0 + h**2 / 2 * J, axis=0)
    v0 = np.vstack([np.zeros(steps), v[:-1]])
    q = np.sum(h * v0 + h**2 / 2 * a0 + h**3 / 6 * J, axis=0)
    rows = np.vstack([a, -a, v, -v])
    bounds = np.concatenate([np.full(2 * steps, acceleration), np.full(2 * steps, velocity)])
    ends = np.vstack([v[-1], a[-1]]) if to_rest else None
    found = linprog(-q, rows, bounds, ends, np.zeros(2) if to_rest else None, bounds=(-jerk, jerk))
    assert found.success
    return -found.fun


CASES = {  # bounds that are large numbers never act; the switching times lie on the intervals of the program
    "jerk alone": (1.0, {"velocity": 1e3, "acceleration": 1e3, "jerk": 32.0}),
    "acceleration reached": (1.0, {"velocity": 1e3, "acceleration": 5.0, "jerk": 50.0}),
    "velocity reached, acceleration not": (1.0, {"velocity": 0.9, "acceleration": 1e3, "jerk": 40.0}),
    "all three reached": (1.2, {"velocity": 0.8, "acceleration": 4.0, "jerk": 40.0}),
}


@pytest.mark.parametrize("case", CASES)
def test_the_fastest_motion_between_rests_is_that_of_a_linear_program(case):
    """Where the formula says T for d, the farthest motion in T goes d, to the tolerance of the program."""
    T, bounds = CASES[case]
    d = farthest(T, 60, **bounds)
    assert least(d, **bounds) == pytest.approx(T, rel=1e-6)


@pytest.mark.parametrize("case", CASES)
def test_from_a_rest_to_a_point_passed_at_any_speed_the_bound_is_below_and_near(case):
    """The three bounds stand apart, so where several limits act their largest is no more than a bound."""
    T, bounds = CASES[case]
    d = farthest(T, 60, to_rest=False, **bounds)
    for rests in ({"to_rest": False}, {"from_rest": False}):
        found = least(d, **rests, **bounds)
        assert 0.8 * T < found <= T * (1 + 1e-9)
    assert least(d, from_rest=False, to_rest=False, **bounds) == d / bounds["velocity"]
    only = {"jerk": bounds["jerk"]}
    assert least(only["jerk"] / 6 * T**3, to_rest=False, **only) == pytest.approx(T)


def test_infinite_limits_and_no_distance_give_numbers():
    for velocity in (2.0, INF):
        for acceleration in (3.0, INF):
            for jerk in (5.0, INF):
                bounds = {"velocity": velocity, "acceleration": acceleration, "jerk": jerk}
                for rests in ((True, True), (True, False), (False, False)):
                    assert least(0.0, *rests, **bounds) == 0.0
                    assert 0.0 <= least(1.0, *rests, **bounds) < 10.0
    assert least(1.0) == 0.0 and least(1.0, velocity=2.0) == 0.5
    assert least(1.0, velocity=2.0, jerk=1e300) == pytest.approx(0.5)


def problem(robot, start, goal, duration, **options):
    return eo.Problem(robot, start, goal, duration, self_collision=False, **options)


def test_a_way_through_untimed_waypoints_takes_the_sum_of_its_legs():
    """0 → 1 → 0 at 2 rad/s: a second, though start and goal are the same; the slowest joint of each leg counts."""
    robot, way = arms.sliders(2), {"waypoints": [[0.5, 0.1], [0.0, -0.7]], "velocity_limits": 2.0}
    needed = 0.25 + 0.4 + 0.35
    check_times(problem(robot, [0.0, 0.0], [0.0, 0.0], 1.01 * needed, **way), np.zeros(2))
    with pytest.raises(eo.InputError) as caught:
        eo.plan(problem(robot, [0.0, 0.0], [0.0, 0.0], 0.99 * needed, **way))
    message = str(caught.value)
    words = ("waypoints[0]", "from start", "to goal takes at least 1 s", "0.25 s to waypoints[0] (joint 'joint1')")
    assert all(word in message for word in (*words, "0.4 s to waypoints[1] (joint 'joint2')", "0.99 s are given", "more time"))
    assert "\n" not in message


def test_waypoints_between_two_times_have_the_time_between():
    robot = arms.sliders(1)
    limits = {"velocity_limits": 1.0}
    tight = [[0.3], ([0.0], 0.5), [0.2]]
    with pytest.raises(
        eo.InputError, match=r"waypoints\[0\]: the way from start through waypoints\[0\] to waypoints\[1\] .* 0\.6 s"
    ):
        eo.plan(problem(robot, [0.0], [0.1], 2.0, waypoints=tight, **limits))
    check_times(problem(robot, [0.0], [0.1], 2.0, waypoints=[[0.2], ([0.0], 0.5), [0.2]], **limits), np.array([0.1]))


def test_the_first_and_the_last_leg_count_their_ramps():
    """From rest to 0.5 rad and back to rest at 4 rad/s²: twice √(2·0.5/4), though no velocity limit acts."""
    robot = arms.sliders(1)
    needed = 2 * np.sqrt(2 * 0.5 / 4.0)
    ways = {"waypoints": [[0.5]], "acceleration_limits": 4.0}
    check_times(problem(robot, [0.0], [0.0], 1.01 * needed, **ways), np.zeros(1))
    with pytest.raises(eo.InputError, match=r"takes at least 1 s"):
        check_times(problem(robot, [0.0], [0.0], 0.99 * needed, **ways), np.zeros(1))
    moving = problem(robot, [0.0], [0.0], 0.99 * needed, start_velocity=1.0, **ways)
    check_times(moving, np.zeros(1))


def test_a_true_motion_is_never_called_impossible():
    """Quintics through random waypoints, limits set to what each of them reaches: all their own problems pass."""
    rng, robot = np.random.default_rng(3), arms.catalogue_robot("ur5")
    for count in (0, 1, 3):
        free = {"velocity_limits": 1e3, "torque_limits": 1e6}
        ends = robot.home + rng.uniform(-0.5, 0.5, (count + 2, robot.nv))
        motion = eo.baseline(problem(robot, ends[0], ends[-1], 1.3, waypoints=ends[1:-1], **free), "quintic")
        t = np.linspace(0.0, 1.3, 4001)
        peak = [np.abs(motion(t, order)).max(axis=0) * 1.001 for order in (1, 2, 3)]
        tau = robot.torque(motion(t), motion(t, 1), motion(t, 2))
        kinds = ("velocity_limits", "acceleration_limits", "jerk_limits")
        rate = np.abs(np.diff(tau, axis=0)).max(axis=0) / (t[1] - t[0]) * 1.001
        bounds = dict(zip(kinds, peak, strict=True)) | {"torque_rate_limits": rate}
        asked = problem(robot, ends[0], ends[-1], 1.3, waypoints=ends[1:-1], **bounds)
        check_times(asked, asked.goal)
        check_changes(asked, asked.goal)


CHANGES = {
    "torque": ({"torque_rate_limits": [8.0, 99.0]}, "torque_rate_limits", "torque from"),
    "velocity": ({"acceleration_limits": [9.0, 1.0], "goal_velocity": [0.0, 1.5]}, "acceleration_limits", "velocity from 0"),
    "acceleration": ({"jerk_limits": 9.0, "start_acceleration": [10.0, 0.0]}, "jerk_limits", "acceleration from 10"),
}


@pytest.mark.parametrize("what", CHANGES)
def test_ends_that_differ_by_more_than_a_rate_can_change_are_named(what):
    """The remedy is true to the digits printed: with the rate it names the check passes."""
    options, key, words = CHANGES[what]
    robot = arms.two_link()
    goal = np.array([1.2, 0.0])
    make = lambda **more: problem(robot, [0.0, 0.0], goal, 1.0, **options | more)
    with pytest.raises(eo.InputError) as caught:
        check_changes(make(), goal)
    message = str(caught.value)
    assert message.startswith(f"{key}: joint 'joint") and words in message and "1 s are given" in message
    enough = float(message.rpartition("at least ")[2]) * 1.001
    check_changes(make(**{key: enough}), goal)


@pytest.mark.parametrize("name", ["panda", "ur5", "talos_arm", "xarm7"])
def test_no_configuration_brings_a_frame_beyond_its_reach(name):
    robot = arms.catalogue_robot(name)
    frame = robot.tool_frame
    asked = eo.Problem(robot, robot.home, eo.FramePose(frame, [0.1, 0.1, 0.1]), 1.0)
    ball = reach(asked, frame)
    q = np.random.default_rng(0).uniform(robot.limits.lower, robot.limits.upper, (3000, robot.nv))
    away = [np.linalg.norm(robot.placement(frame, row).translation - ball.center) for row in q]
    assert max(away) <= ball.radius < 2.0 * max(away)


def test_the_reach_of_a_sliding_joint_counts_its_travel():
    robot = arms.mixed_chain()
    asked = eo.Problem(robot, robot.home, eo.FramePose("tool", [0.1, 0.1, 0.1]), 1.0)
    ball = reach(asked, "tool")
    q = np.random.default_rng(0).uniform(robot.limits.lower, robot.limits.upper, (3000, robot.nv))
    away = max(np.linalg.norm(robot.placement("tool", row).translation - ball.center) for row in q)
    assert away <= ball.radius < 1.5 * away
