"""Goals given as the place of a frame: reached to a micrometre, redundancy used to save, impossible ones named."""

import arms
import numpy as np
import pinocchio as pin
import pytest

import energyopt as eo
from energyopt.inverse_kinematics import goal_configurations

REACHED = 1e-6
"""[m] and [rad], by numeric Pinocchio."""
QUICK = eo.BSpline(control_points=16, accuracy=None)


def pose_error(plan):
    """Distance [m] and angle [rad] between the frame at the end of a plan and its goal."""
    goal = plan.problem.goal
    pose = plan.problem.robot.placement(goal.frame, plan.trajectory(plan.duration))
    angle = 0.0 if goal.rotation is None else np.linalg.norm(pin.log3(pose.rotation.T @ goal.rotation))
    return np.linalg.norm(pose.translation - goal.position), angle


def reachable(name, change=0.35):
    """A robot, its home, and a pose of its tool at a configuration away from there."""
    robot = arms.catalogue_robot(name)
    start = robot.home
    away = start + change * np.array([1, -1, 1, 1, -1, 1, 1])[: robot.nv]
    return robot, start, away, robot.placement(robot.tool_frame, away)


@pytest.mark.parametrize("what", ["position", "pose"])
@pytest.mark.parametrize(
    "name, method", [("panda", QUICK), ("ur5", QUICK), ("panda", eo.HermiteSimpson(10)), ("ur5", eo.Sinusoid(4))]
)
def test_the_frame_ends_where_it_should_and_the_arm_at_rest(name, method, what):
    robot, start, _, pose = reachable(name)
    goal = eo.FramePose(robot.tool_frame, pose.translation, pose.rotation if what == "pose" else None)
    plan = eo.plan(eo.Problem(robot, start, goal, 1.2), method, starts=1)
    assert max(pose_error(plan)) < REACHED
    np.testing.assert_allclose(plan.trajectory(plan.duration, 1), 0.0, atol=1e-9)
    np.testing.assert_allclose(plan.trajectory(0.0), start, atol=1e-12)
    assert plan.max_violation["goal"] < 2 * REACHED


def test_a_free_goal_is_never_dearer_than_the_same_place_with_the_joints_prescribed():
    """More freedom, less cost: position ≤ pose ≤ joints. The searches start from the prescribed joints' neighbourhood."""
    robot, start, away, pose = reachable("panda")
    place = lambda *rotation: eo.FramePose(robot.tool_frame, pose.translation, *rotation)
    goals = (place(), place(pose.rotation), away)
    costs = [eo.plan(eo.Problem(robot, start, goal, 1.2), QUICK).objective for goal in goals]
    assert costs[0] < costs[1] <= costs[2] * (1 + 1e-6)
    assert costs[0] < 0.99 * costs[2], "the redundancy is used"


def test_a_quaternion_and_its_matrix_are_the_same_goal():
    robot, start, _, pose = reachable("ur5")
    x, y, z, w = pin.Quaternion(pose.rotation).coeffs()
    plans = [
        eo.plan(eo.Problem(robot, start, eo.FramePose(robot.tool_frame, pose.translation, rotation), 1.0), QUICK)
        for rotation in (pose.rotation, [w, x, y, z])
    ]
    assert plans[0].objective == pytest.approx(plans[1].objective, rel=1e-6)


def test_a_goal_half_a_turn_away_is_reached_and_not_mistaken_for_its_opposite():
    """The rows vanish for the opposite orientation too: the result is judged by the true angle."""
    robot, start, _, pose = reachable("panda", 0.1)
    turned = pose.rotation @ pin.exp3(np.array([0.0, 0.0, 3.0]))
    plan = eo.plan(eo.Problem(robot, start, eo.FramePose(robot.tool_frame, pose.translation, turned), 2.0))
    assert max(pose_error(plan)) < REACHED


def test_boundary_velocity_and_waypoints_go_with_a_cartesian_goal():
    robot = arms.two_link()
    q = np.array([0.9, 0.4])
    position = robot.placement("tool", q).translation
    goal, more = eo.FramePose("tool", position), {"waypoints": [([0.1, 0.8], 0.4), [0.5, 0.6]], "goal_velocity": [0.2, -0.1]}
    plan = eo.plan(eo.Problem(robot, [-0.4, 0.6], goal, 0.9, **more), QUICK)
    assert pose_error(plan)[0] < REACHED and plan.max_violation["waypoint"] < 1e-6
    np.testing.assert_allclose(plan.trajectory(0.9, 1), [0.2, -0.1], atol=1e-9)
    np.testing.assert_allclose(plan.trajectory(0.4), [0.1, 0.8], atol=1e-6)


def test_inverse_kinematics_finds_both_elbows_of_a_planar_arm():
    """Cosine law: q₂ = ± arccos((x² + z² − l₁² − l₂²) / 2 l₁l₂)."""
    robot = arms.two_link()
    x, z = 0.55, 0.35
    bend = np.arccos((x**2 + z**2 - 0.5**2 - 0.4**2) / (2 * 0.5 * 0.4))
    problem = eo.Problem(robot, [0.0, 0.3], eo.FramePose("tool", [x, 0.0, z]), 1.0)
    found = goal_configurations(problem)
    assert {round(q[1] % (2 * np.pi), 6) for q in found} == {round(bend, 6), round(2 * np.pi - bend, 6)}
    for q in found:
        assert np.linalg.norm(robot.placement("tool", q).translation - [x, 0.0, z]) < 1e-8
    time = [np.max(np.abs(q - problem.start) / problem.limits.velocity) for q in found]
    assert time == sorted(time)


def test_the_elbow_that_cannot_be_held_is_not_chosen():
    """Elbow up and elbow down need different torques: with a limit between them only one is possible, wherever it lies."""
    robot = arms.two_link()
    x, z = 0.55, 0.35
    goal = eo.FramePose("tool", [x, 0.0, z])
    request = lambda start, **limits: eo.Problem(robot, start, goal, 1.5, **limits)
    ends = [q for q in goal_configurations(request([0.0, 0.3])) if np.all(np.abs(q) < np.pi)]
    held = [np.abs(robot.torque(q, 0 * q, 0 * q)) for q in ends]
    heavy, light = (ends[k] for k in np.argsort([h[0] for h in held])[::-1])
    limit = [0.5 * (max(h[0] for h in held) + min(h[0] for h in held)), 90.0]
    near_heavy = np.array([-np.pi / 2, 0.0]) + 0.3 * (heavy - [-np.pi / 2, 0.0])
    assert np.linalg.norm(near_heavy - heavy) < np.linalg.norm(near_heavy - light)
    plan = eo.plan(request(near_heavy, torque_limits=limit))
    assert np.abs(plan.torque(plan.duration))[0] <= limit[0] * 1.0001
    assert pose_error(plan)[0] < REACHED


@pytest.mark.parametrize(
    "goal, words",
    [
        (
            eo.FramePose("tool", [2.0, 0.0, 0.0]),
            ["goal: out of reach", "frame 'tool'", "within 0.9 m of joint 'joint1'", "2 m away"],
        ),
        (eo.FramePose("tool", [0.0, 0.9, 0.1]), ["goal: out of reach", "the goal is 0.9055 m away", "nearer"]),
        (eo.FramePose("tool", [500.0, 0.0, 200.0]), ["goal: out of reach", "looks like millimetres"]),
        (eo.FramePose("base", [0.5, 0.0, 0.0]), ["goal: frame 'base' stands still", "such as 'tool'"]),
        (
            eo.FramePose("tool", [0.5, 0.3, 0.2]),
            ["goal: no configuration was found", "frame 'tool'", "off by 0.3 m; move the goal"],
        ),
        (
            eo.FramePose("tool", [0.5, 0.0, 0.2], [0.0, 0.0, 0.0, 1.0]),
            [
                "no configuration was found",
                "off by",
                " m and ",
                " rad; move the goal, free its orientation, or widen position_limits",
            ],
        ),
    ],
)
def test_a_place_out_of_reach_is_named_with_how_far_it_is(goal, words):
    """The arm reaches 0.9 m in its plane, and its tool cannot leave the plane."""
    with pytest.raises(eo.InputError) as caught:
        eo.plan(eo.Problem(arms.two_link(), [0.0, 0.3], goal, 1.0))
    assert "\n" not in str(caught.value) and all(word in str(caught.value) for word in words), str(caught.value)


def test_an_unknown_frame_lists_those_that_are_near():
    with pytest.raises(eo.InputError, match=r"no frame named 'tol'; did you mean .*tool"):
        eo.Problem(arms.two_link(), [0.0, 0.3], eo.FramePose("tol", [0.5, 0.0, 0.2]), 1.0)


def test_a_frame_like_no_other_is_answered_with_the_tool_and_the_links_near_it():
    """What Pinocchio calls the universe is nothing a user means."""
    panda = arms.catalogue_robot("panda")
    with pytest.raises(eo.InputError) as caught:
        panda.frame_id("Universal gripper (left)")
    message = str(caught.value)
    assert "the tool is 'panda_hand_tcp'" in message and "panda_hand" in message and "universe" not in message
    with pytest.raises(eo.InputError, match="no frame named 7"):
        panda.placement(7, panda.home)
