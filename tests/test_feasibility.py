"""Impossible requests are found before anything is solved, and the message says which joint, how much, and what would help."""

import pickle
import re
from dataclasses import replace

import arms
import numpy as np
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.feasibility import check_feasibility, kinematic_minimum

START, GOAL = [-0.4, 0.6], [0.8, -0.5]


def problem(**options):
    """The two-link arm moves joint 1 by 1.2 rad and joint 2 by 1.1 rad in 1 s; position limits ±6 rad, velocity 10 rad/s."""
    return eo.Problem(arms.two_link(), **{"start": START, "goal": GOAL, "duration": 1.0, **options})


HOLD_START, HOLD_GOAL = (arms.two_link().torque(np.array(q), np.zeros(2), np.zeros(2))[0] for q in (START, GOAL))

IMPOSSIBLE = {  # request, (the joint, the amount, the remedy)
    "start above a position limit": ({"start": [6.5, 0.0]}, ("start", "joint1", "0.5 above", "6", "widen position_limits")),
    "goal below a position limit": ({"goal": [0.0, -6.25]}, ("goal", "joint2", "0.25 below", "-6", "widen position_limits")),
    "goal outside the problem's own limits": ({"position_limits": (-1.0, [0.7, 2.0])}, ("goal", "joint1", "0.1 above", "0.7")),
    "waypoint outside": ({"waypoints": [[0.0, 0.0], [0.0, 7.0]]}, ("waypoints[1]", "joint2", "1 above", "position_limits")),
    "start too fast": ({"start_velocity": [0.0, -11.0]}, ("start_velocity", "joint2", "-11", "10", "raise velocity_limits")),
    "goal accelerates too much": (
        {"goal_acceleration": [9.0, 0.0], "acceleration_limits": 8.0},
        ("goal_acceleration", "joint1", "9", "8", "raise acceleration_limits"),
    ),
    "too weak to hold the start": (
        {"torque_limits": [10.0, 90.0]},
        ("start", "joint1", f"{HOLD_START:.4g} N·m", "10", "payload"),
    ),
    "too weak to hold the goal": (
        {"start": [-1.5, 0.0], "torque_limits": [0.9 * HOLD_GOAL, 90.0]},
        ("goal", "joint1", f"at least {HOLD_GOAL:.4g}", "torque_limits"),
    ),
    "slower than the velocity limits": (
        {"velocity_limits": [1.0, 10.0]},
        ("duration", "joint1", "1.2 s", "1 s are given", "more time"),
    ),
    "slower than the accelerations allow": (
        {"acceleration_limits": [4.0, 99.0]},
        ("duration", "joint1", "1.095 s", "higher limits"),
    ),
    "slower than velocity and acceleration allow": (
        {"velocity_limits": [1.5, 9.0], "acceleration_limits": [4.0, 99.0]},
        ("duration", "joint1", f"{1.2 / 1.5 + 1.5 / 4:.4g} s"),
    ),
    "slower than the jerk allows": ({"jerk_limits": [1e6, 25.0]}, ("duration", "joint2", f"{np.cbrt(32 * 1.1 / 25):.4g} s")),
    "waypoints too near in time": (
        {"waypoints": [([0.0, 0.0], 0.9), ([1.5, 0.0], 0.95)]},
        ("waypoints[1]", "joint1", "from waypoints[0] to waypoints[1]", "0.15 s", "0.05 s are given"),
    ),
}


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_an_impossible_request_is_named_before_solving(name):
    options, words = IMPOSSIBLE[name]
    with pytest.raises(eo.InputError) as caught:
        eo.plan(problem(**options))
    message = str(caught.value)
    assert "\n" not in message and len(message) < 260
    missing = [word for word in words if word not in message]
    assert not missing, message


def test_the_torque_that_holds_an_end_counts_its_acceleration():
    robot = arms.sliders(1)
    with pytest.raises(eo.InputError, match=r"goal: joint 'joint1' needs 7 N there, its torque limit is 5"):
        check_feasibility(eo.Problem(robot, [0.0], [0.1], 1.0, torque_limits=5.0, goal_acceleration=-7.0))


def test_a_payload_too_heavy_to_hold_is_named():
    robot = eo.load_robot("panda", payload=eo.Payload(40.0, (0, 0, 0.1)))
    with pytest.raises(eo.InputError, match=r"panda_joint\d' needs .* N·m there, its torque limit is \d+; .*lighter payload"):
        eo.plan(eo.Problem(robot, robot.home, robot.home + 0.1, 2.0))


@pytest.mark.parametrize(
    "limits, least",
    [
        ({"velocity_limits": 0.8}, 1.5),
        ({"velocity_limits": 9.0, "acceleration_limits": 4.8}, 1.0),
        ({"velocity_limits": 1.2, "acceleration_limits": 4.8}, 1.25),
        ({"velocity_limits": 9.0, "jerk_limits": 38.4}, 1.0),
    ],
)
def test_the_kinematic_minimum_is_the_time_of_the_fastest_profile(limits, least):
    """For d = 1.2: d/v; 2√(d/a), full speed never reached; d/v + v/a; (32 d/j)^⅓, four equal phases of jerk."""
    robot = arms.sliders(1)
    request = eo.Problem(robot, [0.0], [1.2], 2.0, **limits)
    assert kinematic_minimum(request, request.start, request.goal)[0] == pytest.approx(least, rel=1e-12)


PROFILES = [{"velocity_limits": 0.8}, {"velocity_limits": 1.2, "acceleration_limits": 4.8}, {"jerk_limits": 38.4}]


@pytest.mark.parametrize("limits", PROFILES)
def test_just_above_the_kinematic_minimum_there_is_a_motion_and_below_there_is_none(limits):
    """The remedy in the message is true: with 6 % more time than it says a motion is found."""
    robot = arms.sliders(1)
    with pytest.raises(eo.InputError) as caught:
        eo.plan(eo.Problem(robot, [0.0], [1.2], 0.5, **limits))
    least = float(re.search(r"at least ([\d.]+) s", str(caught.value)).group(1))
    possible = eo.Problem(robot, [0.0], [1.2], 1.06 * least, **limits)
    assert all(eo.plan(possible, eo.BSpline(control_points=n, accuracy=None)).solved for n in (40, 60))


def test_a_moving_start_is_not_held_to_the_times_of_rest():
    """From 1.9 rad/s the way of 1.2 rad takes less time than from rest: no false alarm."""
    robot = arms.sliders(1)
    ends = {"start_velocity": 1.9, "goal_velocity": 1.9}
    assert eo.plan(eo.Problem(robot, [0.0], [1.2], 0.64, velocity_limits=2.0, acceleration_limits=4.0, **ends)).solved


def test_rounding_in_the_input_is_forgiven():
    robot = arms.from_urdf(factory.sliders(1), position_limits=(-1.0, 1.0))
    check_feasibility(eo.Problem(robot, [-1.0 - 1e-9], [1.0 + 1e-9], 1.0))
    with pytest.raises(eo.InputError):
        check_feasibility(eo.Problem(robot, [-1.0 - 1e-5], [1.0], 1.0))


def test_positions_that_make_sense_as_degrees_get_the_hint():
    for station, request in (
        ("start", {"start": [30.0, -45.0]}),
        ("goal", {"goal": [0.0, 90.0]}),
        ("waypoints[0]", {"waypoints": [[20.0, 10.0]]}),
    ):
        with pytest.raises(eo.InputError, match=r"looks like degrees, expected radians: numpy\.deg2rad") as caught:
            check_feasibility(problem(**request))
        assert str(caught.value).startswith(f"{station}: joint 'joint")
    for no_degrees in ([6.5, 0.0], [9.0, 0.0], [400.0, 0.0]):  # too small for degrees; outside as degrees too
        with pytest.raises(eo.InputError, match="widen position_limits"):
            check_feasibility(problem(start=no_degrees))


TASK = """[robot]
name = "panda"
[robot.limits]
jerk = 5000
[problem]
start = "home"
goal = [0.4, -0.4, 0.4, -2.0, 0.4, 2.0, 1.2]
duration = 1.5
[limits]
acceleration = 10
"""

IN_FILES = {  # change of the file, line, words
    "start": (('"home"', "[9, 0, 0, -2, 0, 2, 0]"), 6, "problem.start: joint 'panda_joint1' is 9 rad"),
    "the remedy": (('"home"', "[9, 0, 0, -2, 0, 2, 0]"), 6, "move it inside or widen limits.position"),
    "degrees": (('"home"', "[0, -45, 0, -135, 0, 90, 45]"), 6, 'looks like degrees, expected radians: angles = "deg"'),
    "duration": (("1.5", "0.2"), 8, "problem.duration: joint 'panda_joint"),
    "limits of the problem": (
        ("duration = 1.5", "duration = 1.5\ngoal_acceleration = [11, 0, 0, 0, 0, 0, 0]"),
        9,
        "joint 'panda_joint1' has 11 rad/s², beyond its limit 10; lower it or raise limits.acceleration",
    ),
    "limits of the robot": (
        ("duration = 1.5\n", "duration = 1.5\ngoal_acceleration = [-9, 0, 0, 0, 0, 0, 0]\nstart_acceleration = 9\n"),
        4,
        "robot.limits.jerk: joint 'panda_joint1' has to change its acceleration from 9",
    ),
    "a waypoint": (
        (
            "[limits]",
            "[[waypoints]]\nposition = [0, 0, 0, -2, 0, 2, 0]\n[[waypoints]]\nposition = [0, 0, 0, 9, 0, 2, 0]\n[limits]",
        ),
        11,
        "waypoints[1]: joint 'panda_joint4' is 9 rad",
    ),
    "reach": (("goal = [0.4, -0.4, 0.4, -2.0, 0.4, 2.0, 1.2]", "goal = {position = [500, 0, 400]}"), 7, "looks like millimetres"),
}


@pytest.mark.parametrize("case", IN_FILES)
def test_a_problem_from_a_file_is_answered_in_the_words_of_the_file(case, tmp_path):
    (old, new), line, words = IN_FILES[case]
    path = tmp_path / "task.toml"
    text = TASK.replace(old, new).replace("jerk = 5000", "jerk = 8" if case == "limits of the robot" else "jerk = 5000")
    path.write_text(text)
    with pytest.raises(eo.InputError) as caught:
        eo.plan(eo.load_problem(path))
    message = str(caught.value)
    assert message.startswith(f"{path}:{line}: ") and words in message, message
    assert "\n" not in message and "_limits" not in message


def test_a_problem_from_a_file_can_be_pickled_and_changed_like_any_other(tmp_path):
    path = tmp_path / "task.toml"
    path.write_text(TASK)
    loaded = pickle.loads(pickle.dumps(replace(eo.load_problem(path), duration=0.2)))
    with pytest.raises(eo.InputError, match=r"task\.toml:\d+: problem\.duration"):
        check_feasibility(loaded)
