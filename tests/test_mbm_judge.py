"""The judge of the clutter benchmark sees what is wrong with a motion, and its shortcut misses nothing."""

import json
import sys
from pathlib import Path

import mbm_files
import numpy as np
import pytest

import energyopt as eo
from energyopt.errors import InputError

FOLDER = Path(__file__).resolve().parents[1] / "problems" / "benchmarks"
sys.path.insert(0, str(FOLDER))
try:
    from _mbm import read_mbm
    from _mbm_judge import TIMES, ProblemJudge
    from _mbm_robot import RobotJudge, distance
    from mbm import _planned
finally:
    sys.path.remove(str(FOLDER))

LONG = 4.0
FAR = {**mbm_files.POST, "xyz": [1.1, 0.6, 0.3]}
"""Near enough to matter, too far to be touched."""


def judged_problem(folder, entry):
    (problem,) = read_mbm(mbm_files.write(folder, entry))
    return problem, ProblemJudge(RobotJudge(problem.robot, entry["joint_names"], entry["fixed_joints"]), entry)


@pytest.fixture(scope="module")
def turn(tmp_path_factory):
    """The UR5 and its post: problem, judge, and which joint of the problem each joint of the robot is."""
    problem, judge = judged_problem(tmp_path_factory.mktemp("ur5"), mbm_files.ur5())
    return problem, judge, [problem.entry["joint_names"].index(name) for name in problem.robot.joint_names]


def quintic(problem, duration, goal=None):
    return eo.baseline(eo.Problem(problem.robot, problem.start, problem.goal if goal is None else goal, duration), "quintic")


@pytest.mark.parametrize("entry", [mbm_files.ur5(obstacles=[FAR]), mbm_files.baxter(obstacles=[FAR])], ids=["ur5", "baxter"])
def test_the_least_distance_is_that_of_all_times(tmp_path, entry):
    """Against every pair at every 20th of the times, and at all times for the pair that was found."""
    _, judge = judged_problem(tmp_path, entry)
    q = np.linspace(judge.start, judge.goal, 400)
    q += 0.1 * np.sin(np.linspace(0, 9.0, 400))[:, None] * np.linspace(-1, 1, q.shape[1])
    found, pairs = judge.closest(q), judge._pairs(judge.robot.placements(q))
    apart = lambda pair, k: distance(pair[0][0], pair[0][1][k], pair[1][0], pair[1][1][k])
    assert 0 < found.distance <= min(apart(pair, k) for pair in pairs for k in range(0, 400, 20))
    named = [pair for pair in pairs if (pair[0][0].link, pair[1][0].link) == (found.first, found.second)]
    assert found.distance == min(apart(pair, k) for pair in named for k in range(400))


def test_torques_are_those_of_the_robot_with_its_joints_locked(turn):
    problem, judge, order = turn
    rng, found = np.random.default_rng(0), np.empty((20, 6))
    q, v, a = rng.uniform(-1, 1, (3, 20, 6))
    states = [np.empty_like(q) for _ in range(3)]
    for state, values in zip(states, (q, v, a), strict=True):
        state[:, order] = values
    found[:] = judge.robot.torques(*states)[:, order]
    assert np.allclose(found, problem.robot.torque(q, v, a), rtol=1e-9, atol=1e-9)


def test_a_motion_through_the_post_is_seen_with_link_and_time(turn):
    problem, judge, order = turn
    verdict = judge.judge(quintic(problem, LONG), order, LONG)
    assert len(verdict.faults) == 1 and "touches post" in verdict.faults[0] and verdict.clearance < -0.01
    assert 0.3 * LONG < verdict.time < 0.7 * LONG


def test_each_broken_condition_is_named(turn):
    problem, judge, order = turn
    said = lambda motion, duration: "; ".join(judge.judge(motion, order, duration).faults)
    assert "velocity by" in said(quintic(problem, 0.6), 0.6)
    assert "torque" in said(quintic(problem, 0.1), 0.1)
    assert "duration by 1" in said(quintic(problem, LONG), LONG - 1.0)
    assert "goal by 0.01" in said(quintic(problem, LONG, problem.goal + 0.01), LONG)
    assert "position by" in said(quintic(problem, 40.0, problem.goal + 7.0), 40.0)


def test_integrals_are_those_of_a_quadrature(turn):
    problem, judge, order = turn
    motion = quintic(problem, LONG)
    verdict = judge.judge(motion, order, LONG)
    t = (np.arange(20_000) + 0.5) * LONG / 20_000
    v = motion(t, 1)
    tau = problem.robot.torque(motion(t), v, motion(t, 2))
    step = LONG / len(t)
    assert verdict.torque_squared == pytest.approx(step * np.sum(tau**2), rel=1e-5)
    assert verdict.energy == pytest.approx(step * np.sum(np.abs(tau * v)), rel=1e-5)
    assert TIMES == 2000


def test_a_plan_that_says_solved_and_touches_is_a_false_success(turn):
    """The planner is not told of a wall between start and goal, the judge is."""
    from types import SimpleNamespace

    problem, judge, _ = turn
    wall = {"name": "wall", "type": "box", "size": [1.0, 0.02, 3.0], "xyz": [0.7, 0.1, 0.0], "quat_wxyz": [1, 0, 0, 0]}
    judge = ProblemJudge(judge.robot, mbm_files.ur5(obstacles=[wall]))
    assert not judge.faults_of_ends()
    blind = problem._replace(obstacles=())
    options = SimpleNamespace(seed=0, control_points=16, accuracy=0.0, time_limit=None)
    record = _planned(blind, judge, options)
    assert record["status"] == "SOLVED" and record["false_success"] and not record["valid"]
    assert "touches wall" in record["why"]


def test_a_robot_by_its_urdf_is_the_same_robot(tmp_path, turn):
    problem, judge, order = turn
    entry = mbm_files.ur5(robot="mine")
    (mine,) = read_mbm(mbm_files.write(tmp_path, entry), {"mine": problem.robot.source})
    own = ProblemJudge(RobotJudge(mine.robot, entry["joint_names"], entry["fixed_joints"]), entry)
    motion = quintic(problem, LONG)
    one, other = (j.judge(motion, order, LONG) for j in (judge, own))
    assert one.clearance == other.clearance and one.torque_squared == pytest.approx(other.torque_squared, rel=1e-12)


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"robot": "fetch"}, "give its URDF: fetch=path"),
        ({"frame": "nowhere"}, "no frame named 'nowhere'"),
        ({"joint_names": ["a"] + mbm_files.UR5[1:]}, "no moving joint matches 'a'"),
        ({"q_goal": [0.0, 1.0]}, "q_goal holds 2 numbers; expected 6"),
        ({"q_goal": [float("nan")] + [0.0] * 5}, "a joint position is nan; expected finite numbers"),
        ({"q_start": ["a"] + [0.0] * 5}, "a joint position is 'a'"),
        ({"fixed_joints": []}, "fixed_joints is []; expected an object"),
        ({"obstacles": "x"}, "obstacles is 'x'; expected a list"),
        ({"obstacles": [{**mbm_files.POST, "type": "mesh"}]}, "'post' is a 'mesh'; expected box, cylinder or sphere"),
        ({"obstacles": [{"name": "post", "type": "box"}]}, "an obstacle has no 'quat_wxyz'"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_in_one_line(tmp_path, changes, said):
    mbm_files.write(tmp_path, mbm_files.ur5())
    (tmp_path / "ur5.json").write_text(json.dumps([mbm_files.ur5(**changes)]))
    with pytest.raises(InputError) as error:
        list(read_mbm(tmp_path))
    assert said in str(error.value) and "\n" not in str(error.value)
