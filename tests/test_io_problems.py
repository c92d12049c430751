"""Problem files: what they mean, and that every wrong one is refused in one line that names file, key and expectation."""

import os

import numpy as np
import pytest

import energyopt as eo
from energyopt.errors import FileError, InputError, ProblemError, RobotError
from energyopt.io import catalogue_problems, load_task
from energyopt.io.schema import Kind, ListOf, OneOf, Table

UR5 = """
[robot]
name = "ur5"
[problem]
start = [0, -1, 1, 0, 0.5, 0]
goal = [1.0, -1.2, 0.7, 0, 0, 0]
duration = 1
"""


def written(folder, text, name="task.toml"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_says_what_the_python_call_says(tmp_path):
    text = (
        UR5
        + """
    velocity_weight = [0, 0.1, 0.2, 0.3, 0.4, 0.5]
    torque_weights = 2
    goal_velocity = 0.1
    [limits]
    position = { lower = -3, upper = [3, 3, 3, 3, 3, 2.5] }
    velocity = { elbow_joint = 1.5 }
    jerk = 500
    [[waypoints]]
    position = [0.5, -1.1, 0.9, 0, 0.2, 0]
    time = 0.5
    [[waypoints]]
    position = [0.8, -1.1, 0.9, 0, 0.2, 0]
    """
    )
    problem = eo.load_problem(written(tmp_path, text))
    robot = eo.load_robot("ur5")
    assert problem.name == "task"
    assert problem.duration == 1.0
    np.testing.assert_array_equal(problem.start, [0, -1, 1, 0, 0.5, 0])
    np.testing.assert_array_equal(problem.velocity_weight, [0, 0.1, 0.2, 0.3, 0.4, 0.5])
    np.testing.assert_array_equal(problem.torque_weights, np.full(6, 2.0))
    np.testing.assert_array_equal(problem.goal_velocity, np.full(6, 0.1))
    np.testing.assert_array_equal(problem.limits.upper, [3, 3, 3, 3, 3, 2.5])
    expected = robot.limits.velocity.copy()
    expected[robot.joint_names.index("elbow_joint")] = 1.5
    np.testing.assert_array_equal(problem.limits.velocity, expected)
    np.testing.assert_array_equal(problem.limits.jerk, np.full(6, 500.0))
    assert [w.time for w in problem.waypoints] == [0.5, None]


def test_degrees_mean_the_same_motion_as_radians(tmp_path):
    degrees = """
    angles = "deg"
    [robot]
    name = "panda"
    locked = { panda_joint7 = 45, panda_finger_joint1 = 0.04 }
    limits = { velocity = 90, acceleration = [400, 400, 400, 400, 400, 400], position = { panda_joint1 = [-90, 90] } }
    [problem]
    start = [0, -45, 0, -135, 0, 90]
    goal = { frame = "panda_hand_tcp", position = [0.4, 0.2, 0.5], rpy = [180, 0, 30] }
    duration = 2
    start_velocity = 1
    [limits]
    jerk = 18000
    """
    problem = eo.load_problem(written(tmp_path, degrees))
    limits = problem.limits
    assert problem.robot.nv == 6
    np.testing.assert_allclose(problem.start, np.radians([0, -45, 0, -135, 0, 90]), rtol=1e-15)
    np.testing.assert_allclose(limits.velocity, np.pi / 2, rtol=1e-15)
    np.testing.assert_allclose(limits.acceleration, np.radians(400), rtol=1e-15)
    np.testing.assert_allclose(limits.jerk, np.radians(18000), rtol=1e-15)
    np.testing.assert_allclose([limits.lower[0], limits.upper[0]], [-np.pi / 2, np.pi / 2], rtol=1e-15)
    np.testing.assert_allclose(problem.start_velocity, np.radians(1), rtol=1e-15)
    locked = eo.load_robot("panda", locked={"panda_joint7": np.pi / 4, "panda_finger_joint1": 0.04})
    tool = "panda_hand_tcp"
    expected = locked.placement(tool, problem.start).homogeneous
    np.testing.assert_allclose(problem.robot.placement(tool, problem.start).homogeneous, expected, atol=1e-14)
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)  # yaw 30° after a half turn about x
    np.testing.assert_allclose(problem.goal.rotation, [[c, s, 0], [s, -c, 0], [0, 0, -1]], atol=1e-15)


def test_lengths_of_sliding_joints_stay_metres_in_a_file_in_degrees(tmp_path):
    inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    urdf = f"""<robot name="slider"><link name="base"/><link name="cart"><inertial><mass value="1"/>{inertia}</inertial></link>
    <joint name="rail" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" velocity="2" effort="9"/></joint></robot>"""
    (tmp_path / "slider.urdf").write_text(urdf)
    robot = 'angles = "deg"\n[robot]\nurdf = "slider.urdf"\nlimits = {velocity = 3}\n'
    text = robot + "[problem]\nstart = [0]\ngoal = [0.5]\nduration = 1\n"
    problem = eo.load_problem(written(tmp_path, text))
    assert problem.goal[0] == 0.5
    assert problem.limits.velocity[0] == 3.0


def test_robot_options_reach_the_dynamics(tmp_path):
    text = UR5.replace(
        'name = "ur5"',
        'name = "ur5"\narmature = 0.2\nviscous_friction = [1, 1, 1, 2, 2, 2]\ncoulomb_friction = {elbow_joint = 3}\n'
        "gravity = [0, 0, -1.62]\npayload = {mass = 2, center = [0, 0, 0.1]}\n[robot.limits]\nscale = {velocity = 0.5}",
    )
    robot = eo.load_problem(written(tmp_path, text)).robot
    plain = eo.load_robot("ur5")
    mass = lambda r: sum(i.mass for i in r.model.inertias)
    assert mass(robot) == pytest.approx(mass(plain) + 2, rel=1e-12)
    np.testing.assert_array_equal(robot.dynamics.armature, np.full(6, 0.2))
    np.testing.assert_array_equal(robot.dynamics.viscous_friction, [1, 1, 1, 2, 2, 2])
    assert robot.dynamics.coulomb_friction.sum() == 3
    np.testing.assert_array_equal(robot.model.gravity.linear, [0, 0, -1.62])
    np.testing.assert_allclose(robot.limits.velocity, 0.5 * plain.limits.velocity, rtol=1e-15)


def test_a_urdf_path_counts_from_the_folder_of_the_file(tmp_path, monkeypatch):
    folder = tmp_path / "arm"
    folder.mkdir()
    (folder / "ur5.urdf").write_text(eo.load_robot("ur5").urdf)
    path = written(folder, UR5.replace('name = "ur5"', 'urdf = "ur5.urdf"\npackage_dirs = ["."]'))
    monkeypatch.chdir("/")
    assert eo.load_problem(path).robot.nv == 6


def test_method_options_become_arguments_of_plan(tmp_path):
    text = UR5 + '[method]\nparameterization = "bspline"\ndegree = 5\naccuracy = false\nseed = 3\nstarts = 2\ntime_limit = 9\n'
    options = load_task(written(tmp_path, text))[1]
    assert options == {"seed": 3, "starts": 2, "time_limit": 9, "parameterization": eo.BSpline(degree=5, accuracy=None)}
    assert load_task(written(tmp_path, UR5))[1] == {}
    other = load_task(written(tmp_path, text), {"method.parameterization": "sinusoid", "problem.duration": 2.5})
    assert other[1]["parameterization"] == eo.Sinusoid() and other[1]["seed"] == 3
    assert other[0].duration == 2.5


WRONG = {
    "unknown key": (UR5 + "velocty_weight = 1", "problem.velocty_weight is not a known key; did you mean velocity_weight"),
    "unknown table": (UR5 + "[limit]\n", "limit is not a known key; did you mean limits"),
    "missing key": (UR5.replace("duration = 1", ""), "problem.duration is missing; expected a number > 0 [s]"),
    "missing table": ("[robot]\nname='ur5'", "problem is missing"),
    "text for a number": (
        UR5.replace("duration = 1", 'duration = "fast"'),
        'problem.duration is "fast"; expected a number > 0 [s]',
    ),
    "flag for a number": (UR5.replace("duration = 1", "duration = true"), "problem.duration is true; expected a number"),
    "negative duration": (UR5.replace("duration = 1", "duration = -1"), "problem.duration is -1; expected a number > 0"),
    "nan": (UR5.replace("start = [0,", "start = [nan,"), "problem.start[0] is nan; expected a finite number"),
    "inf": (UR5 + "velocity_weight = inf", "problem.velocity_weight is inf; expected a finite number"),
    "huge whole number": (UR5.replace("duration = 1", "duration = 1" + 400 * "0"), "problem.duration is larger than 1e100"),
    "wrong count": (UR5.replace("start = [0,", "start = [0, 0,"), "wrist_3_joint, got 7 numbers"),
    "nested list": (UR5.replace("start = [0,", "start = [[0],"), "problem.start is [[0], -1"),
    "goal of a wrong kind": (UR5.replace("goal = [1.0, -1.2, 0.7, 0, 0, 0]", 'goal = "hom"'), 'problem.goal is "hom"; expected'),
    "goal frame": (
        UR5.replace("goal = [1.0, -1.2, 0.7, 0, 0, 0]", "goal = {frame='tol0', position=[0,0,0]}"),
        "no frame named 'tol0'",
    ),
    "degrees as rpy": (
        UR5.replace("goal = [1.0, -1.2, 0.7, 0, 0, 0]", "goal = {position=[0,0,0], rpy=[180,0,0]}"),
        "problem.goal.rpy is [180, 0, 0]; looks like degrees",
    ),
    "two rotations": (
        UR5.replace("goal = [1.0, -1.2, 0.7, 0, 0, 0]", "goal = {position=[0,0,0], rpy=[0,0,0], quaternion=[1,0,0,0]}"),
        "has both quaternion and rpy",
    ),
    "negative weight": (UR5 + "velocity_weight = -1", "problem.velocity_weight is -1; expected a number ≥ 0"),
    "all weights zero": (UR5 + "velocity_weight = 0\ntorque_weights = 0", "make one positive"),
    "limit by unknown joint": (
        UR5 + "[limits]\nvelocity = {elbow = 1}",
        "limits.velocity.elbow is not a joint that moves; did you mean",
    ),
    "negative limit": (
        UR5 + "[limits]\ntorque = [1, 1, 1, 1, 1, -1]",
        "limits.torque[5] (joint 'wrist_3_joint') is -1: expected a",
    ),
    "inverted limit": (UR5 + "[limits]\nposition = {lower = 1, upper = -1}", "lower 1 is not below upper -1"),
    "odd position limit": (UR5 + "[limits]\nposition = [1, 2]", "limits.position is [1, 2]; expected {lower"),
    "waypoint without position": (UR5 + "[[waypoints]]\ntime = 0.5", "waypoints[0].position is missing"),
    "waypoint too late": (UR5 + "[[waypoints]]\nposition = [0,0,0,0,0,0]\ntime = 3", "waypoints[0]: time 3 s is not between"),
    "waypoint too short": (UR5 + "[[waypoints]]\nposition = [0,0]", "waypoints[0].position has 2 numbers; expected 6"),
    "waypoint table": (UR5 + "[waypoints]\nposition = [0,0]", "expected a list of tables, each under [[waypoints]]"),
    "no robot named": (UR5.replace('name = "ur5"', ""), "robot has neither name nor urdf"),
    "two robots": (UR5.replace('name = "ur5"', 'name = "ur5"\nurdf = "x"'), "robot has name and urdf"),
    "unknown robot": (UR5.replace('name = "ur5"', 'name = "ur55"'), "no robot named 'ur55'"),
    "floating base": (UR5.replace('name = "ur5"', 'name = "talos"'), "moves freely"),
    "missing urdf": (UR5.replace('name = "ur5"', 'urdf = "none.urdf"'), "no such file"),
    "payload without mass": (
        UR5.replace('name = "ur5"', 'name = "ur5"\npayload = {center = [0,0,0]}'),
        "robot.payload.mass is missing",
    ),
    "impossible payload": (
        UR5.replace('name = "ur5"', 'name = "ur5"\npayload = {mass = 1, inertia = [1,1,9]}'),
        "no body has them",
    ),
    "unknown locked joint": (UR5.replace('name = "ur5"', 'name = "ur5"\nlocked = {elbo = 1}'), "elbo"),
    "other's option": (
        UR5 + "[method]\nparameterization = 'sinusoid'\ndegree = 3",
        "method.degree is 3; expected only with bspline",
    ),
    "option out of range": (UR5 + "[method]\ndegree = 9", "method.degree is 9; expected a whole number from 3 to 5"),
    "too few control points": (UR5 + "[method]\ndegree = 5\ncontrol_points = 7", "control_points is 7: expected 9 to 2000"),
    "unknown method": (UR5 + "[method]\nparameterization = 'spline'", 'is "spline"; expected one of bspline, sinusoid'),
    "a name of two lines": ('name = "a\\nb"' + UR5, 'name is "a b"; expected a name, one line of at most 200 characters'),
    "a date": (UR5.replace("duration = 1", "duration = 2020-01-01"), "problem.duration is 2020-01-01; expected a number"),
    "syntax": (UR5 + "x = = 1", ":8:5: not valid TOML"),
    "double key": (UR5 + "duration = 2", "not valid TOML"),
    "too deep": ("x = " + 5000 * "[", "nested too deeply"),
    "invalid date": ("x = 2020-13-45", "not valid TOML"),
    "empty": ("", "robot is missing; expected a table"),
    "a table as a list": ("robot = []\nproblem = 3", "robot is []; expected a table"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_file_is_refused_in_one_line_that_names_it(case, tmp_path):
    text, expected = WRONG[case]
    path = written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        eo.load_problem(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert expected in message
    assert "\n" not in message and len(message) < 1000


def test_the_line_of_the_offending_key_is_named(tmp_path):
    text = UR5 + "[limits]\n# a comment\nvelocity = 0\n"
    with pytest.raises(ProblemError, match=r"task\.toml:10: limits\.velocity is 0"):
        eo.load_problem(written(tmp_path, text))
    two = UR5 + "[[waypoints]]\nposition = [0,0,0,0,0,0]\n[[waypoints]]\nposition = 1\n"
    with pytest.raises(ProblemError, match=r"task\.toml:11: waypoints\[1\]\.position is 1"):
        eo.load_problem(written(tmp_path, two))
    short = UR5.replace("goal = [1.0, ", "goal = [")
    with pytest.raises(ProblemError, match=r"task\.toml:6: problem\.goal: expected 6 numbers"):
        eo.load_problem(written(tmp_path, short))


@pytest.mark.parametrize("given", [5, None, ["panda_reach"], b"panda_reach"])
def test_what_is_no_path_is_refused(given):
    with pytest.raises(FileError, match=r"load_problem: got .*; expected the path of a TOML file, or a catalogue name"):
        eo.load_problem(given)


def test_files_that_are_no_text_are_refused(tmp_path):
    cases = {"missing": tmp_path / "no.toml", "folder": tmp_path, "binary": tmp_path / "b.toml", "huge": tmp_path / "h.toml"}
    cases["binary"].write_bytes(b"\xff\xfe\x00x")
    cases["huge"].write_text("#" * 1_000_001)
    cases["nul"] = "a\0b.toml"
    cases["long"] = "x" * 5000
    for path in cases.values():
        with pytest.raises(FileError) as caught:
            eo.load_problem(path)
        assert "\n" not in str(caught.value)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes are a Unix thing")
def test_a_named_pipe_is_refused_instead_of_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    with pytest.raises(FileError, match="not a regular file"):
        eo.load_problem(tmp_path / "pipe.toml")


def test_a_catalogue_problem_is_found_by_name_and_a_near_name_is_suggested():
    assert eo.load_problem("panda_reach").robot.name == "panda"
    assert eo.load_problem("panda_reach.toml").name == "panda_reach"
    with pytest.raises(FileError, match="did you mean panda_reach"):
        eo.load_problem("panda_rech")
    assert "panda_reach" in catalogue_problems()


def test_a_file_with_windows_line_ends_and_a_byte_order_mark_is_read(tmp_path):
    path = tmp_path / "dos.toml"
    path.write_bytes(b"\xef\xbb\xbf" + UR5.replace("\n", "\r\n").encode())
    assert eo.load_problem(path).duration == 1.0


def test_an_unknown_robot_is_a_robot_error(tmp_path):
    with pytest.raises(RobotError):
        eo.load_problem(written(tmp_path, UR5.replace("ur5", "ur55")))


def test_every_key_of_the_schema_says_what_it_expects():
    from energyopt.io.problem_schema import PROBLEM_FILE

    def walk(node):
        if isinstance(node, Kind):
            assert node.expected.strip()
        elif isinstance(node, Table):
            assert set(node.required) <= set(node.keys)
            for child in node.keys.values():
                walk(child)
        elif isinstance(node, OneOf):
            walk(node.kind)
            walk(node.table)
        else:
            assert isinstance(node, ListOf)
            walk(node.table)

    walk(PROBLEM_FILE)
