"""Guesses for the optimiser: their order, that they are what they claim to be, and published problems."""

import os
import re
import sys
import time
from functools import cache
from pathlib import Path

import arms
import numpy as np
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.errors import FileError, ProblemError, RobotError
from energyopt.geometry.bodies import Attached
from energyopt.geometry.exact import CollisionScene
from energyopt.geometry.moving import Moving
from energyopt.geometry.self_collision import self_collision_pairs
from energyopt.geometry.shapes import Box, Capsule, Cylinder, Sphere
from energyopt.pathfinding import Budget, FreeSpace, find_guess, find_path, guesses, rrt_connect, shortest_duration, via_points
from energyopt.pathfinding.guesses import SEARCHERS

ROOT = Path(__file__).resolve().parents[1]
MBM = Path(os.environ.get("ENERGYOPT_MBM") or ROOT.parent / "shared" / "mbm")
sys.path.insert(0, str(ROOT / "problems" / "benchmarks"))
from _mbm import mbm_robot, read_mbm  # noqa: E402

published = pytest.mark.skipif(
    not any(MBM.glob("*.json")), reason="no MotionBenchMaker problems: set ENERGYOPT_MBM to the folder of their JSON files"
)


@cache
def rods():
    """Two links of 0.5 and 0.4 m that turn about z, each a capsule of radius 0.04 m."""
    return arms.from_urdf(factory.planar_arm([0.5, 0.4], [2.0, 1.5], axis=(0, 0, 1), lower=-3.0, upper=3.0))


def rod(long, link):
    along_x = np.array([[0, 0, 1, 0.5 * long], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1.0]])
    return Attached(Capsule(0.04, long, along_x), link, f"rod of {link}")


def rods_among(*obstacles):
    return FreeSpace.of(rods(), obstacles, self_pairs=(), attached=(rod(0.5, "link1"), rod(0.4, "link2")))


def board():
    """In the way of the straight motion of `task`; folded, the arm passes it."""
    return Box((0.4, 0.02, 0.5), (0.8, 0.0, 0.0), "board")


def task(**options):
    return eo.Problem(rods(), [-0.6, 0.0], [0.6, 0.0], 2.0, **options)


def least_distance(free, trajectory):
    """Exactly, at 2000 times."""
    t = np.linspace(0.0, trajectory.duration, 2000)
    return free.scene.distances(trajectory(t), t, cutoff=0.05).min()


def test_guesses_come_in_order_of_cost_and_the_same_for_the_same_seed():
    free = rods_among(board())
    found, again = (list(guesses(task(), free, seed=1, bent=1, searches=2)) for _ in range(2))
    names = [guess.name for guess in found]
    assert names[0] == "straight" and names[-2:] == ["rrt 1", "rrt 2"]
    assert names[1:-2] in ([], ["bent 1"])
    t = np.linspace(0, 2.0, 50)
    for first, second in zip(found, again, strict=True):
        assert np.array_equal(first.trajectory(t), second.trajectory(t))
    other = list(guesses(task(), free, seed=2, bent=1, searches=2))[-1]
    assert not np.allclose(other.trajectory(t), found[-1].trajectory(t))


def test_guesses_keep_ends_and_duration_and_are_free_where_they_say_so():
    free, problem = rods_among(board()), task()
    for guess in guesses(problem, free, searches=3):
        motion = guess.trajectory
        assert motion.duration == pytest.approx(2.0, rel=1e-12)
        assert np.allclose(motion(np.array([0.0, 2.0])), [problem.start, problem.goal], atol=1e-9)
        assert np.allclose(motion(np.array([0.0, 2.0]), 1), 0.0, atol=1e-9)
        assert free.inside(motion(np.linspace(0, 2, 100))).all()
        assert guess.free == (least_distance(free, motion) > 0)
        assert guess.free == (guess.name != "straight")


def test_where_nothing_is_in_the_way_the_straight_guess_is_taken():
    assert find_guess(task(), rods_among()).name == "straight"


def test_where_the_way_is_blocked_a_free_guess_is_found():
    guess = find_guess(task(), rods_among(board()))
    assert guess.free and guess.name != "straight"


def test_where_there_is_no_way_there_is_no_guess():
    ball = (Attached(Sphere(0.1), name="ball"),)
    free = FreeSpace.of(arms.sliders(1), [Box((0.1, 2.0, 2.0), (0.5, 0, 0))], self_pairs=(), attached=ball)
    problem = eo.Problem(arms.sliders(1), [0.0], [1.0], 2.0)
    assert find_guess(problem, free, seconds=0.3) is None


def ball_behind_a_wall():
    ball = (Attached(Sphere(0.1), name="ball"),)
    robot = arms.sliders(1)
    free = FreeSpace.of(robot, [Box((0.1, 2.0, 2.0), (0.5, 0, 0), "wall")], self_pairs=(), attached=ball)
    return eo.Problem(robot, [0.0], [1.0], 2.0), free


@pytest.mark.parametrize(
    ("installed", "path_search", "names"),
    [
        (False, "auto", ["rrt 1", "rrt 2", "rrt 3"]),
        (True, "auto", ["rrt 1", "ompl 2", "rrt 3"]),
        (True, "built-in", ["rrt 1", "rrt 2", "rrt 3"]),
        (True, "ompl", ["ompl 1", "ompl 2", "ompl 3"]),
    ],
)
def test_searches_that_find_nothing_are_told_and_the_next_is_anothers_turn(monkeypatch, installed, path_search, names):
    """OMPL, which need not be there, is stood in for by our own search."""
    monkeypatch.setattr(sys.modules["energyopt.pathfinding.guesses"], "ompl_installed", lambda: installed)
    monkeypatch.setitem(SEARCHERS, "ompl", rrt_connect)
    told, (problem, free) = [], ball_behind_a_wall()
    found = list(guesses(problem, free, searches=3, budget=Budget(0.1), path_search=path_search, missed=told.append))
    assert [guess.name for guess in found] == ["straight"]
    assert [text.split(":")[0] for text in told] == names
    assert all(re.search(r"no path in \d+\.\d s, with \d+ nodes", text) for text in told)


@pytest.mark.alone
def test_all_searches_together_end_with_the_time_they_have():
    told, (problem, free) = [], ball_behind_a_wall()
    began = time.monotonic()
    list(guesses(problem, free, searches=100, budget=Budget(0.2, until=began + 0.5), missed=told.append))
    assert 2 <= len(told) <= 3 and time.monotonic() - began < 0.8


def test_ompl_gives_guesses_of_its_own_the_same_for_the_same_seed():
    pytest.importorskip("ompl", reason="OMPL is an optional extra: pip install energyopt[ompl]")
    found, again = (list(guesses(task(), rods_among(board()), seed=1, bent=0, searches=2, path_search="ompl")) for _ in range(2))
    t = np.linspace(0, 2.0, 50)
    assert [guess.name for guess in found] == ["straight", "ompl 1", "ompl 2"] and found[1].free
    for first, second in zip(found, again, strict=True):
        assert np.array_equal(first.trajectory(t), second.trajectory(t))


def test_a_goal_in_collision_is_named_when_a_path_is_looked_for():
    free = rods_among(Sphere(0.05, (0.7 * np.cos(0.6), 0.7 * np.sin(0.6), 0.0), "can"))
    with pytest.raises(ProblemError, match=r"^goal: 'rod of link2' and 'can' are 90.00 mm inside"):
        list(guesses(task(), free, searches=1, budget=Budget(1.0)))


def test_paths_pass_the_waypoints():
    via = np.array([-0.3, 2.2])
    problem = task(waypoints=[via])
    for guess in guesses(problem, rods_among(board()), searches=1, bent=0):
        t = np.linspace(0, 2.0, 4001)
        near = 1e-3 if guess.name == "straight" else 0.2  # the corners of paths are rounded
        assert np.min(np.linalg.norm(guess.trajectory(t) - via, axis=1)) < near


def test_a_weak_arm_is_led_where_it_can_stand_still():
    """The straight way would stretch it out sideways, which its first joint cannot hold; folded or upright, it can."""
    robot = arms.two_link()
    free = FreeSpace.of(robot.with_limits(torque=np.array([13.0, 100.0])), self_pairs=())
    ends = np.array([[0.2, 2.8], [0.2, -2.8]])
    assert free.holding(ends).hold == 0.9 and free.load(np.array([[0.0, 0.0]])) > 1.1
    found = find_path(free, ends, np.random.default_rng(0))
    assert shortest_duration(found.path, free.robot) > 0
    with pytest.raises(ProblemError, match="torque limit"):
        shortest_duration(ends, free.robot)
    strong = FreeSpace.of(robot, self_pairs=())
    assert strong.holding(ends) is strong and len(find_path(strong, ends, np.random.default_rng(0)).path) == 2
    with pytest.raises(ProblemError, match=r"start: standing still takes 1\d\d% of a torque limit"):
        rrt_connect(free.holding(ends), np.zeros(2), ends[0], np.random.default_rng(0))


def test_via_points_bend_the_quintic_inside_the_limits():
    problem, rng = task(), np.random.default_rng(0)
    bent = [via_points(problem, rng) for _ in range(10)]
    straight = np.array([-0.6, 0.0]) + np.linspace(0, 1, 101)[:, None] * np.array([1.2, 0.0])
    for motion in bent:
        q = motion(np.linspace(0, 2.0, 101))
        assert np.allclose(q[[0, -1]], [problem.start, problem.goal], atol=1e-9)
        assert np.abs(q - straight).max() > 0.05


def test_a_ball_that_has_passed_when_the_arm_comes_is_not_in_the_way():
    """It crosses the arm's way before the arm gets there; the same ball at rest on that way blocks it."""
    place = np.array([0.7 * np.cos(0.5), 0.7 * np.sin(0.5), 0.0])
    passing = rods_among(Sphere(0.06, Moving(place, velocity=(2.0, 0.0, 0.0)), "passing"))
    assert find_guess(task(), passing).name == "straight"
    resting = rods_among(Sphere(0.06, place - (0, 0.2, 0), "resting"))
    assert not next(guesses(task(), resting)).free


def test_a_path_around_a_moving_ball_is_free_at_its_own_times():
    """The ball comes towards the base and meets the arm in the middle of the straight motion."""
    free = rods_among(Sphere(0.1, Moving((1.2, 0.0, 0.0), velocity=(-0.25, 0.0, 0.0)), "coming"))
    found = list(guesses(task(), free, searches=4, bent=0))
    assert not found[0].free
    assert any(guess.free for guess in found[1:])
    for guess in found:
        assert guess.free == (least_distance(free, guess.trajectory) > 0)


@published
def test_every_published_start_and_goal_is_clear_of_everything():
    """Exact geometry; one goal is outside the limits of this Panda, as its README says."""
    problems = list(read_mbm(MBM))
    pairs = self_collision_pairs(problems[0].robot).checked
    for problem in problems:
        ends = np.stack([problem.start, problem.goal])
        scene = CollisionScene(problem.robot, problem.obstacles, pairs)
        assert scene.distances(ends, cutoff=0.0).min() > 0, problem.id
        inside = np.all((ends >= problem.robot.limits.lower - 1e-6) & (ends <= problem.robot.limits.upper + 1e-6), axis=1)
        assert inside.tolist() == [True, problem.id != "panda_table_pick_0031"]


@published
def test_published_problems_get_paths_that_are_free():
    """Six of them; the exact distances along them, ten times as dense, miss at most half of the resolution."""
    for problem in list(read_mbm(MBM))[5::20]:
        free = FreeSpace.of(problem.robot, problem.obstacles)
        found = rrt_connect(free, problem.start, problem.goal, np.random.default_rng(0), Budget(20.0))
        assert found.found, problem.id
        for a, b in zip(found.path[:-1], found.path[1:], strict=True):
            fine = a + np.linspace(0, 1, 10 * len(free.way(a, b)))[:, None] * (b - a)
            assert free.scene.distances(fine, cutoff=0.0).min() > -0.5 * free.resolution


def entry(**changes):
    given = {
        "id": "x_0001", "robot": "ur5", "frame": "base_link", "joint_names": list(arms.catalogue_robot("ur5").joint_names)[::-1],
        "q_start": [0.6, 0.5, 0.4, 0.3, 0.2, 0.1], "q_goal": [0.0] * 6, "fixed_joints": {"finger": 0.1},
        "obstacles": [
            {"name": "can", "type": "cylinder", "radius": 0.1, "length": 0.3, "xyz": [1, 2, 3], "quat_wxyz": [1, 0, 0, 0]},
            {"name": "ball", "type": "sphere", "radius": 0.1, "xyz": [1, 2, 3], "quat_wxyz": [1, 0, 0, 0]},
        ],
    }  # fmt: skip
    return {**given, **changes}


def written(folder, *entries):
    import json

    (folder / "problems.json").write_text(json.dumps(list(entries)))
    return folder


def test_problems_of_another_robot_are_read_in_the_order_of_its_joints(tmp_path):
    (problem,) = read_mbm(written(tmp_path, entry()))
    assert problem.robot.name == "ur5" and problem.start.tolist() == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    can, ball = problem.obstacles
    assert isinstance(can, Cylinder) and isinstance(ball, Sphere) and np.allclose(can.pose[:3, 3], [1, 2, 3])
    assert "finger" in problem.robot.notes[-1]


def test_obstacles_are_placed_from_the_frame_they_are_written_in(tmp_path):
    """Baxter's arms are mounted high on its torso: what is written there is elsewhere in the base."""
    names = [f"left_{j}" for j in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")]
    robot = mbm_robot("baxter", names, {}, {})
    frame = "left_arm_mount"
    changes = {"robot": "baxter", "frame": frame, "joint_names": names, "q_start": [0.0] * 7, "q_goal": [0.0] * 7}
    (problem,) = read_mbm(written(tmp_path, entry(**changes)))
    expected = robot.placement(frame, robot.home).act(np.array([1.0, 2.0, 3.0]))
    assert np.linalg.norm(expected - [1, 2, 3]) > 0.1
    assert np.allclose(problem.obstacles[0].pose[:3, 3], expected)


def test_fingers_stay_where_the_problem_has_them():
    """0.065 m, where the joint of this Panda ends at 0.04 m."""
    names = [f"panda_joint{k}" for k in range(1, 8)]
    robot = mbm_robot("panda", names, {"panda_finger_joint1": 0.065, "panda_finger_joint2": 0.065}, {})
    left, right = (robot.placement(f"panda_{side}finger", robot.home).translation for side in ("left", "right"))
    assert np.linalg.norm(left - right) == pytest.approx(0.13, abs=1e-9)
    assert robot.name == "panda" and robot.srdf == arms.catalogue_robot("panda").srdf


@pytest.mark.parametrize(
    ("changes", "kind", "said"),
    [
        ({"robot": "fetch"}, RobotError, "robot 'fetch' is not in the catalogue .* give its URDF: fetch=path.urdf"),
        ({"frame": "wrist_1_link"}, FileError, "moves with a joint"),
        ({"obstacles": [{"name": "x", "type": "torus", "xyz": [0] * 3, "quat_wxyz": [1, 0, 0, 0]}]}, FileError, "is a 'torus'"),
        ({"obstacles": [{"type": "box"}]}, FileError, "problem 1: an obstacle has no 'quat_wxyz'"),
        ({"q_goal": [0.0] * 5}, FileError, "problem 1: .*q_goal holds 5 numbers; expected 6"),
    ],
)
def test_malformed_problems_are_named(tmp_path, changes, kind, said):
    with pytest.raises(kind, match=said):
        list(read_mbm(written(tmp_path, entry(**changes))))


def test_a_folder_without_problems_is_named(tmp_path):
    with pytest.raises(FileError, match=r"holds no \.json file"):
        list(read_mbm(tmp_path))
    (tmp_path / "x.json").write_text("{}")
    with pytest.raises(FileError, match="holds no list"):
        list(read_mbm(tmp_path))
