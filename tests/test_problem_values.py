"""Values that cannot be meant are refused when they are given: one line, with the name, the value and what was expected."""

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt.costs import TorqueSquared
from energyopt.errors import ProblemError
from energyopt.problem_values import configuration, numbers, real, seconds, shown, text, vector, whole

NAN = float("nan")


def problem(**options):
    return eo.Problem(arms.two_link(), **{"start": [0.0, 0.1], "goal": [0.5, 0.2], "duration": 1.0, **options})


class NoArray:
    """Such as a tensor that refuses to become an array."""

    def __array__(self, *_, **__):
        raise RuntimeError("not on this device")

    def __repr__(self):
        return "a tensor on another device"


BAD_PROBLEMS = {
    "robot by name": ({"robot": "panda"}, "robot is 'panda'", "load_robot"),
    "no start": ({"start": None}, "start is None", "2 numbers"),
    "one number as start": ({"start": 0.0}, "start: expected 2 numbers, one for each of joint1, joint2, got one number"),
    "text as start": ({"start": "home"}, "start is 'home'", "2 numbers"),
    "texts that look like numbers": ({"start": ["0", "1"]}, "start is ['0', '1']", "2 numbers"),
    "ragged start": ({"start": [[0.0], [0.0, 1.0]]}, "start is [[0.0], [0.0, 1.0]]"),
    "complex start": ({"start": [0.0, 1j]}, "start is [0.0, 1j]"),
    "truth values": ({"start": [True, False]}, "start is [True, False]"),
    "a matrix as goal": ({"goal": np.eye(2)}, "goal: expected 2 numbers", "got an array of shape (2, 2)"),
    "three numbers": ({"goal": [0, 1, 2]}, "goal: expected 2 numbers", "got 3 numbers"),
    "a frame as a pair": ({"goal": ("tool", [0.5, 0.0, 0.2])}, "goal is ('tool', [0.5, 0.0, 0.2])", "or an energyopt.FramePose"),
    "infinite goal": ({"goal": [0, np.inf]}, "goal[1] (joint 'joint2') is inf", "finite"),
    "no duration": ({"duration": None}, "duration is None", "seconds"),
    "text as duration": ({"duration": "1"}, "duration is '1'", "one number of seconds, 0.001 to 10000"),
    "durations in the wrong order": ({"duration": [2.0, 1.0]}, "duration is (2, 1)", "the least below the most"),
    "three durations": ({"duration": [1.0, 2.0, 3.0]}, "duration is [1.0, 2.0, 3.0]"),
    "a free duration and a time": ({"duration": (1.0, 2.0), "waypoints": [([0.1, 0.1], 0.5)]}, "leave its time out"),
    "costs twice": ({"costs": TorqueSquared(), "velocity_weight": 2.0}, "expected one or the other"),
    "a duration of hundreds of digits": ({"duration": 10**400}, "duration is 1000000", "0.001 to 10000"),
    "an array that is none": ({"start": NoArray()}, "start is a tensor on another device", "2 numbers"),
    "nan duration": ({"duration": NAN}, "duration is nan"),
    "too long": ({"duration": 1e9}, "duration is 1000000000.0", "0.001 to 10000"),
    "no weight": ({"velocity_weight": None}, "velocity_weight is None", "one number or 2 numbers"),
    "negative weight": ({"velocity_weight": [0.1, -1.0]}, "velocity_weight[1] (joint 'joint2') is -1", "≥ 0"),
    "no weights at all": ({"velocity_weight": 0, "torque_weights": 0}, "all zero"),
    "limit of zero": ({"torque_limits": 0.0}, "torque_limits[0] (joint 'joint1') is 0", "> 0"),
    "text as limit": ({"jerk_limits": "none"}, "jerk_limits is 'none'"),
    "one position limit": ({"position_limits": 3.0}, "position_limits", "pair (lower, upper)"),
    "inverted position limits": ({"position_limits": ([0, 1], [1, 1])}, "position_limits[1] (joint 'joint2')", "not below"),
    "position limits by joint": ({"position_limits": {"joint1": 1, "joint2": 2}}, "position_limits is {", "pair (lower, upper)"),
    "a number as waypoints": ({"waypoints": 5}, "waypoints is 5: expected a list", "2 numbers"),
    "a waypoint that is a number": ({"waypoints": [5]}, "waypoints[0]: expected 2 numbers", "got one number"),
    "a waypoint of text": ({"waypoints": ["middle"]}, "waypoints[0] is 'middle'"),
    "a waypoint of three": ({"waypoints": [[0, 0, 0]]}, "waypoints[0]: expected 2 numbers"),
    "time that is text": ({"waypoints": [([0.0, 0.0], "noon")]}, "waypoints[0].time is 'noon'", "seconds"),
    "time after the end": ({"waypoints": [([0.0, 0.0], 1.5)]}, "waypoints[0]: time 1.5 s is not between"),
    "times that fall": ({"waypoints": [([0.0, 0.0], 0.5), ([0.0, 0.0], 0.4)]}, "waypoints[1]: time 0.4 s", "0.5 s"),
    "a number as name": ({"name": 5}, "name is 5"),
}


@pytest.mark.parametrize("case", BAD_PROBLEMS)
def test_a_value_that_cannot_be_meant_is_named(case):
    options, *words = BAD_PROBLEMS[case]
    given = {"robot": arms.two_link(), "start": [0.0, 0.1], "goal": [0.5, 0.2], "duration": 1.0, **options}
    with pytest.raises(ProblemError) as caught:
        eo.Problem(**given)
    message = str(caught.value)
    assert "\n" not in message and len(message) < 200
    assert all(word in message for word in words), message


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: eo.Waypoint([0.0], "x"), ["waypoint time is 'x'", "seconds"]),
        (lambda: eo.Waypoint([0.0], NAN), ["waypoint time is nan"]),
        (lambda: eo.Waypoint("there"), ["waypoint position is 'there'", "joint positions"]),
        (lambda: eo.Waypoint([0.0, NAN]), ["waypoint position[1] is nan"]),
        (lambda: eo.FramePose(5, [0, 0, 0]), ["goal frame is 5", "link or joint"]),
        (lambda: eo.FramePose("tool", 0.5), ["goal position", "3 numbers", "one number"]),
        (lambda: eo.FramePose("tool", [0, 0, 0], "down"), ["goal rotation is 'down'", "quaternion"]),
        (lambda: eo.FramePose("tool", [0, 0, 0], [1, 1, 0, 0]), ["quaternion", "norm 1.41421"]),
        (lambda: eo.FramePose("tool", [0, 0, 0], -np.eye(3)), ["3×3 rotation matrix"]),
        (lambda: eo.FramePose("tool", [0, 0, 0], np.full((3, 3), NAN)), ["3×3 rotation matrix"]),
        (lambda: problem(goal=eo.FramePose("hand", [0, 0, 0])), ["no frame named 'hand'"]),
    ],
)
def test_parts_of_a_problem_are_checked_when_they_are_made(make, words):
    with pytest.raises(eo.InputError) as caught:
        make()
    assert "\n" not in str(caught.value) and all(word in str(caught.value) for word in words), str(caught.value)


def test_every_way_to_write_a_number_is_the_same_problem():
    """Lists, tuples, arrays of any number type, NumPy scalars."""
    plain = problem(waypoints=[eo.Waypoint([0.3, 0.1], 0.5)], velocity_weight=[1.0, 1.0])
    for start in ((0, 0.1), np.array([0, 0.1], np.float32), np.array([0.0, 0.1])):
        other = problem(
            start=start, duration=np.float64(1), velocity_weight=1, waypoints=[(np.array([0.3, 0.1]), np.float32(0.5))]
        )
        assert np.allclose(other.start, plain.start) and other.duration == plain.duration
        assert np.array_equal(other.velocity_weight, plain.velocity_weight)
        assert other.waypoints[0].time == 0.5 and np.array_equal(other.waypoints[0].position, [0.3, 0.1])
    with pytest.raises(ValueError, match="read-only"):
        plain.start[0] = 1.0


def test_numbers_pass_and_others_do_not():
    assert whole("n", np.int32(4), 1, 5) == 4 and type(whole("n", np.int64(4), 1, 5)) is int
    assert real("x", np.float32(0.5), lambda x: x > 0, "> 0") == 0.5 and seconds("t", 2) == 2.0
    assert numbers("a", [[1, 2]], "numbers").shape == (1, 2)
    assert vector("v", 3, 2).tolist() == [3.0, 3.0] and configuration("q", [1, 2]).tolist() == [1.0, 2.0]
    assert text("name", "Δ arm", "a name") == "Δ arm"
    for wrong in (True, 3.0, "3", None, 6, [3]):
        with pytest.raises(ProblemError, match=r"n is .*: expected a whole number, 1 to 5"):
            whole("n", wrong, 1, 5)
    for wrong in (5, None, "x" * 5000):
        with pytest.raises(ProblemError, match=r"name is .*: expected a name, a text"):
            text("name", wrong, "a name")
    assert len(shown("x" * 5000)) == 80 and "\n" not in shown("a\nb")


BOX = eo.Box(0.1, (2, 2, 2), name="box")
BAD_NAMES = {
    "two obstacles": ({"obstacles": [BOX, eo.Sphere(0.1, name="box")]}, 'obstacles[1].name is "box", as that of obstacles[0]'),
    "a name that an unnamed one gets": ({"obstacles": [eo.Box(0.1), eo.Sphere(0.1, name="box 1")]}, '"box 1", as that of obst'),
    "a link": ({"obstacles": [eo.Sphere(0.1, (2, 2, 2), name="link1")]}, 'obstacles[0].name is "link1", as a frame of the robot'),
    "a tool like a link": ({"attached": [eo.Attached(eo.Sphere(0.1), name="link2")]}, 'attached[0].name is "link2", as a frame'),
    "a tool like an obstacle": (
        {"obstacles": BOX, "attached": eo.Attached(eo.Sphere(0.1), name="box")}, 'attached[0].name is "box", as that of obstacles'
    ),
    "two tools": ({"attached": 2 * [eo.Attached(eo.Sphere(0.1))]}, 'attached[1].name is "attached", as that of attached[0]'),
    "a wall like an obstacle": ({"obstacles": BOX, "workspace": eo.Box(9, name="box")}, 'workspace[0].name is "box", as that of'),
    "a tool nowhere": ({"attached": eo.Attached(eo.Sphere(0.1), "hand")}, "attached[0].frame", "no frame named 'hand'"),
    "a wall for nothing": ({"workspace": eo.Workspace(eo.Box(9), "hand")}, "workspace[0].frames", "no frame named 'hand'"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_NAMES)
def test_names_that_reports_could_not_tell_apart_are_refused(case):
    options, *words = BAD_NAMES[case]
    with pytest.raises(ProblemError) as caught:
        problem(**options)
    assert "\n" not in str(caught.value) and all(word in str(caught.value) for word in words), str(caught.value)


def test_walls_without_a_name_need_none():
    assert len(problem(workspace=[eo.Box(9), eo.Box(8)], obstacles=[BOX, eo.Box(0.1)]).workspace) == 2
