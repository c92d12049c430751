"""Sensitivities of the optimum: against closed forms, invariances, and differences of optima that are solved again."""

from dataclasses import replace

import arms
import numpy as np
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.threads import single_thread
from energyopt.whatif import WhatIf

DIFFERENCES = 1e-2
"""Relative to the largest of a kind: differences of two optima, each solved to 1e-6, whose steps may change what limits hold."""
CLOSED_FORM = 1e-5
"""Relative: scaling laws that hold on any knots; left are the solver's tolerance and the differences of L."""
FIXED = eo.BSpline(control_points=20, accuracy=None)
HELD = eo.Payload(1.5, center=(0.02, 0.01, 0.05))
STEPS = {
    "start": 1e-4, "goal": 1e-4, "velocity_limits": 1e-3, "torque_limits": 1e-2, "viscous_friction": 1e-2,
    "armature": 1e-3, "velocity_weight": 1e-2, "torque_weights": 1e-3,
}  # fmt: skip


def rods(**options):
    text = factory.planar_arm([0.5, 0.4], [2.0, 1.5], velocity=9.0, effort=200.0)
    return arms.from_urdf(text, viscous_friction=0.5, armature=0.05, **options)


def ur5(**options):
    return eo.load_robot("ur5", viscous_friction=0.5, armature=0.05, **options)


def swing(robot):
    return eo.Problem(robot, [0.2, -0.4], [0.8, 0.3], 0.6, velocity_limits=[3.06, 7.2], torque_limits=[48.0, 25.5])


def reach(robot):
    start, goal = [0.0, -1.2, 1.4, -1.0, 0.3, 0.0], [1.4, -0.6, 0.7, -0.2, 0.8, 0.5]
    limits = 0.75 * robot.limits.torque
    return eo.Problem(robot, start, goal, 0.8, velocity_limits=2.5, torque_limits=limits, self_collision=False)


@pytest.fixture(scope="module", params=[(rods, swing), (ur5, reach)], ids=["two links", "ur5"])
def case(request):
    """How the robot is loaded, a plan with a payload, its sensitivities, and J of the optimum of a changed problem."""
    load, ask = request.param
    plan = eo.plan(ask(load(payload=HELD)), FIXED)
    session = WhatIf(plan)

    def optimum(problem):
        with single_thread():
            search = session.resumed(problem)
        assert search.converged
        return search.objective

    return load, plan, eo.sensitivities(plan, HELD), optimum


def by_differences(value, step):
    return (value(step) - value(-step)) / (2.0 * step)


def values_of(problem, name):
    places = (problem, problem.limits, problem.robot.dynamics)
    fields = {"velocity_limits": "velocity", "torque_limits": "torque"}
    key = fields.get(name, name)
    owner = places[1] if name in fields else next(p for p in places if hasattr(p, key))
    return np.array(getattr(owner, key))


@pytest.mark.parametrize("name", STEPS)
def test_what_belongs_to_joints_agrees_with_optima_solved_again(case, name):
    _, plan, found, optimum = case
    values, nv = values_of(plan.problem, name), plan.problem.robot.nv
    changed = lambda k, h: optimum(eo.what_if_problem(plan.problem, **{name: values + h * np.eye(nv)[k]}))
    expected = np.array([by_differences(lambda h, k=k: changed(k, h), STEPS[name]) for k in range(nv)])
    scale = max(np.abs(expected).max(), 1e-4 * plan.objective)
    assert np.abs(found[name] - expected).max() < DIFFERENCES * scale


def test_duration_payload_and_centre_agree_with_optima_solved_again(case):
    load, plan, found, optimum = case
    T = plan.duration
    expected = by_differences(lambda h: optimum(plan.problem.lasting(T + h)), 1e-3 * T)
    assert abs(found["duration"] / expected - 1.0) < DIFFERENCES
    carrying = lambda payload: optimum(replace(plan.problem, robot=load(payload=payload)))
    expected = by_differences(lambda h: carrying(eo.Payload(HELD.mass + h, HELD.center)), 1e-2)
    assert abs(found["payload_mass"] / expected - 1.0) < DIFFERENCES
    moved = lambda k, h: carrying(eo.Payload(HELD.mass, HELD.center + h * np.eye(3)[k]))
    expected = np.array([by_differences(lambda h, k=k: moved(k, h), 1e-4) for k in range(3)])
    assert np.abs(found["payload_center"] - expected).max() < DIFFERENCES * np.abs(expected).max()


def test_some_limits_hold_the_plan_and_the_others_count_for_nothing(case):
    """The cases are chosen so that velocity and torque limits are active; zero is exact."""
    _, plan, found, _ = case
    assert np.any(found["velocity_limits"] < 0) and np.all(found["velocity_limits"] <= 0)
    assert np.any(found["torque_limits"] < 0)
    assert not np.any(found["position_lower"]) and not np.any(found["position_upper"])
    t = plan.trajectory.sample_times(40)
    share = np.abs(plan.trajectory(t, 1)).max(axis=0) / plan.problem.limits.velocity
    np.testing.assert_array_equal(found["velocity_limits"] != 0.0, share > 1.0 - 1e-4)


def test_a_slider_follows_its_scaling_laws():
    """τ = m q̈ alone: J = m² D² f / T³ on any knots, so dJ/dm = 2J/m, dJ/dD = 2J/D, dJ/dT = −3J/T, and 2J/m for a rotor."""
    plan = eo.plan(eo.Problem(arms.sliders(1, (2.0,)), [0.1], [0.6], 1.5, velocity_weight=0.0), FIXED)
    found, J = eo.sensitivities(plan), plan.objective
    expected = {"payload_mass": J, "armature": J, "goal": 4 * J, "start": -4 * J, "duration": -2 * J, "torque_weights": J}
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=CLOSED_FORM)


def test_turning_start_and_goal_about_the_vertical_changes_nothing():
    """The first joint of the UR5 is vertical: dJ/dstart + dJ/dgoal = 0 there."""
    robot = arms.catalogue_robot("ur5")
    found = eo.sensitivities(eo.plan(reach(robot), FIXED))
    assert abs(found["start"][0]) > 1.0
    assert abs(found["start"][0] + found["goal"][0]) < 1e-4 * abs(found["start"][0])


def test_cost_terms_weigh_what_they_cost():
    """dJ/dw of a term is its integral, and so are those of λ and of the torque weights."""
    from energyopt.costs import MechanicalPower, TorqueSquared

    robot = rods()
    plan = eo.plan(replace(swing(robot), costs=(TorqueSquared(), MechanicalPower(weight=3.0))), FIXED)
    found = eo.sensitivities(plan)
    for name, cost in plan.cost_terms.items():
        weight = {"torque_squared": 1.0}.get(name, 3.0)
        np.testing.assert_allclose(found[f"cost {name}"], cost / weight, rtol=1e-3)  # the program's quadrature is coarser


def test_the_best_duration_is_insensitive():
    plan = eo.plan(eo.Problem(rods(), [0.2, -0.4], [0.8, 0.1], (0.3, 4.0)), FIXED)
    fixed = eo.plan(plan.problem.lasting(0.8 * plan.duration), FIXED)
    slope, other = (eo.sensitivities(p)["duration"] for p in (plan, fixed))
    assert abs(slope) < 1e-3 * abs(other)


def test_a_cartesian_goal_has_a_slope_along_each_axis():
    robot = rods()
    goal = robot.placement(robot.tool_frame, np.array([0.8, 0.1])).translation
    problem = eo.Problem(robot, [0.2, -0.4], eo.FramePose(robot.tool_frame, goal), 0.6)
    plan = eo.plan(problem, FIXED, starts=1)
    found, session = eo.sensitivities(plan), WhatIf(plan)
    moved = lambda k, h: session.resumed(replace(problem, goal=eo.FramePose(robot.tool_frame, goal + h * np.eye(3)[k]))).objective
    expected = np.array([by_differences(lambda h, k=k: moved(k, h), 1e-4) for k in (0, 2)])  # the arm moves in the x–z plane
    np.testing.assert_allclose(found["goal_position"][[0, 2]], expected, rtol=DIFFERENCES)


def test_the_table_names_every_parameter_with_its_unit(case):
    text = str(case[2])
    for name, unit in case[2].units.items():
        assert f"{name} [{unit}]" in text
    assert all(joint in text for joint in case[2].joint_names)


def test_what_is_no_solved_plan_or_no_parameter_is_named(case):
    with pytest.raises(eo.InputError, match="expected a solved"):
        eo.sensitivities(None)
    with pytest.raises(eo.InputError, match=r"expected an energyopt\.Payload"):
        eo.sensitivities(case[1], 1.5)
    with pytest.raises(eo.InputError, match=r"expected one of .*duration"):
        case[2]["durations"]
