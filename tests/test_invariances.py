"""What physics and mathematics promise of every optimum: energy balance, symmetries, scaling, and order among motions."""

import arms
import numpy as np
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.feasibility import kinematic_minimum
from energyopt.parameterizations import PolynomialTrajectory
from energyopt.verification import limits_hold, objective, verify

QUADRATURE = 1e-9
"""Relative: six Gauss points a span, of integrands that are smooth there."""
SAME_OPTIMUM = 1e-6
"""Relative: two runs of the solver that are mirror images of each other."""
FIXED = eo.BSpline(control_points=18, accuracy=None)


def integral(trajectory, function):
    """∫ of a function of (q, v, a, t), by Gauss quadrature on every span."""
    t, w = trajectory.quadrature(8)
    return w @ function(*(trajectory(t, order) for order in range(3)))


def two_link_problem(robot=None, **options):
    return eo.Problem(robot or arms.two_link(), [-0.4, 0.6], [0.8, -0.5], **{"duration": 0.7, **options})


def panda_problem(**options):
    robot = arms.catalogue_robot("panda")
    return eo.Problem(robot, robot.home, robot.home + 0.3 * np.array([1, -1, 1, 1, -1, 1, -1]), **{"duration": 1.2, **options})


@pytest.fixture(scope="module")
def panda_plan():
    return eo.plan(panda_problem(), FIXED)


@pytest.fixture(scope="module")
def two_link_plan():
    return eo.plan(two_link_problem(), FIXED)


@pytest.mark.parametrize("ends", ["panda_plan", "two_link_plan", "moving"])
def test_without_friction_the_work_of_the_joints_is_the_energy_gained(ends, request):
    if ends == "moving":
        plan = eo.plan(two_link_problem(start_velocity=[0.5, -0.3], goal_velocity=[0.1, 0.8]), FIXED)
    else:
        plan = request.getfixturevalue(ends)
    robot, motion, ends = plan.problem.robot, plan.trajectory, [0.0, plan.duration]
    work = integral(motion, lambda q, v, a: np.sum(robot.torque(q, v, a) * v, axis=1))
    energy = robot.dynamics.energy(motion(ends), motion(ends, 1))
    spent = integral(motion, lambda q, v, a: np.sum(np.abs(robot.torque(q, v, a) * v), axis=1))
    assert work == pytest.approx(energy[1] - energy[0], abs=QUADRATURE * spent)


def test_with_friction_the_work_is_the_energy_gained_plus_what_friction_took():
    robot = arms.rubbing_chain()
    plan = eo.plan(eo.Problem(robot, [0.0, 0.1, 0.2], [0.9, 0.5, -0.6], 0.8), FIXED)
    motion, ends = plan.trajectory, [0.0, plan.duration]
    work = integral(motion, lambda q, v, a: np.sum(robot.torque(q, v, a) * v, axis=1))
    lost = integral(motion, lambda q, v, a: np.sum(robot.dynamics.friction(v) * v, axis=1))
    energy = robot.dynamics.energy(motion(ends), motion(ends, 1))
    assert lost > 0.01 * work
    assert work - lost == pytest.approx(energy[1] - energy[0], abs=1e-6 * work)  # tanh(q̇/0.05) is steep where q̇ turns


def reversed_motion(motion):
    """q(T − t) of a spline."""
    breaks, pieces = motion.polynomial_pieces()
    width = np.diff(breaks)[::-1]
    at_end = [motion(np.nextafter(breaks[1:], 0.0), order) * (-1) ** order for order in range(pieces.shape[1])]
    factorial = np.array([1.0, 1.0, 2.0, 6.0])
    return PolynomialTrajectory(np.concatenate([[0.0], np.cumsum(width)]), np.stack(at_end, axis=1)[::-1] / factorial[:, None])


@pytest.mark.parametrize("fixture", ["panda_plan", "two_link_plan"])
def test_a_motion_and_its_reverse_cost_the_same_without_friction(fixture, request):
    plan = request.getfixturevalue(fixture)
    problem = plan.problem
    back = eo.Problem(problem.robot, problem.goal, problem.start, problem.duration)
    assert objective(back, reversed_motion(plan.trajectory)) == pytest.approx(plan.objective, rel=1e-9)
    assert eo.plan(back, FIXED).objective == pytest.approx(plan.objective, rel=SAME_OPTIMUM)


def test_turning_the_task_about_the_vertical_changes_nothing(panda_plan):
    """The first axis of the Panda is vertical: its zero does not matter."""
    problem, turn = panda_plan.problem, np.array([0.7, 0, 0, 0, 0, 0, 0])
    turned = eo.plan(eo.Problem(problem.robot, problem.start + turn, problem.goal + turn, problem.duration), FIXED)
    assert turned.objective == pytest.approx(panda_plan.objective, rel=SAME_OPTIMUM)


def test_turning_the_base_about_the_vertical_changes_nothing(two_link_plan):
    text = factory.chain(
        axes=[(0, -1, 0)] * 2, origins=[(0, 0, 0), (0.5, 0, 0)], rpys=[(0, 0, 0.9), (0, 0, 0)], masses=[2.0, 1.5],
        centers=[(0.25, 0, 0), (0.2, 0, 0)], inertias=[np.diag([0.0, i, i]) for i in (2.0 * 0.5**2 / 12, 1.5 * 0.4**2 / 12)],
        velocity=10.0, effort=100.0,
    )  # fmt: skip
    turned = eo.plan(two_link_problem(arms.from_urdf(text)), FIXED)
    assert turned.objective == pytest.approx(two_link_plan.objective, rel=SAME_OPTIMUM)


def test_without_gravity_the_cost_falls_with_the_third_power_of_the_duration():
    robot = arms.from_urdf(factory.planar_arm([0.5, 0.4], [2.0, 1.5]), gravity=(0, 0, 0))
    free = {"velocity_weight": 0.0, "velocity_limits": 1e6, "torque_limits": 1e9}
    scaled = [eo.plan(two_link_problem(robot, duration=T, **free), FIXED).objective * T**3 for T in (0.1, 0.7, 20.0, 600.0)]
    np.testing.assert_allclose(scaled, scaled[1], rtol=SAME_OPTIMUM)


def test_a_dearer_velocity_never_moves_faster(two_link_plan):
    """∫q̇² falls and ∫τ² grows with λ (add the two optimality inequalities of λ₁ and λ₂)."""
    terms = []
    for weight in (0.0, 1.0, 30.0, 1000.0):
        plan = eo.plan(two_link_problem(velocity_weight=weight), FIXED)
        v = integral(plan.trajectory, lambda q, v, a: np.sum(v**2, axis=1))
        terms.append((plan.cost_terms["torque_squared"], v))
    torque, speed = np.transpose(terms)
    assert np.all(np.diff(torque) > -1e-6 * torque[1:]) and np.all(np.diff(speed) < 1e-6 * speed[1:])
    assert torque[-1] > 1.01 * torque[0] and speed[-1] < 0.99 * speed[0]


@pytest.mark.parametrize("name", ["panda", "ur5", "two links"])
@pytest.mark.parametrize("seed", range(3))
def test_the_optimum_is_never_worse_than_a_baseline_that_holds_the_limits(name, seed):
    robot = arms.two_link() if name == "two links" else arms.catalogue_robot(name)
    rng = np.random.default_rng(seed)
    low, high = np.maximum(robot.limits.lower, -2.0), np.minimum(robot.limits.upper, 2.0)
    start, goal = rng.uniform(np.minimum(low, high), high, (2, robot.nv))
    duration = 2.2 * kinematic_minimum(eo.Problem(robot, start, goal, 1.0), start, goal).max()
    problem = eo.Problem(robot, start, goal, max(duration, 0.5))
    plan, compared = eo.plan(problem), 0
    for kind in ("quintic", "cubic", "cycloid", "trapezoidal"):
        motion = eo.baseline(problem, kind)
        if limits_hold(verify(problem, motion)):
            compared += 1
            assert plan.objective <= objective(problem, motion)
    assert compared >= 2, "the comparison is empty"


@pytest.mark.parametrize("problem", [panda_problem, two_link_problem])
def test_a_longer_spline_is_never_worse(problem):
    """Every knot vector contains the one before, so its space does too."""
    problem = problem()
    breaks, found = eo.BSpline(control_points=10).space(problem.duration).breaks, []
    for _ in range(4):
        found.append(eo.plan(problem, eo.BSpline(knots=tuple(breaks), accuracy=None)).objective)
        breaks = np.union1d(breaks, 0.5 * (breaks[1:] + breaks[:-1]))
    assert np.all(np.diff(found) < 1e-7 * found[0])
    assert found[-1] < 0.98 * found[0]
