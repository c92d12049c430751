"""The same problems by all three parameterisations: two transcriptions with nothing in common find the same optimum."""

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt.dynamics.kernels import kernels_of
from energyopt.searcher import ROUGH_NODES
from energyopt.transcription import transcribe
from energyopt.verification import objective

SAME_OPTIMUM = 1e-3
"""Relative; the spline asks for an accuracy of 1e-3, and 80 collocation intervals have about the same."""
HARMONICS = (0, 1, 2, 4, 8)

CASES = {  # robot, start, change, duration
    "panda": (lambda: arms.catalogue_robot("panda"), None, [0.4, -0.4, 0.4, 0.4, -0.4, 0.4, -0.4], 1.0),
    "ur5": (lambda: arms.catalogue_robot("ur5"), [0.0, -1.2, 1.2, 0.0, 0.5, 0.0], [0.8, 0.4, -0.5, 0.4, 0.3, 0.2], 1.0),
    "planar two-link": (arms.two_link, [-0.4, 0.6], [1.0, -0.8], 0.8),
}


@pytest.fixture(scope="module", params=CASES)
def problem(request):
    robot, start, change, duration = CASES[request.param]
    robot = robot()
    start = robot.home if start is None else np.array(start)
    return eo.Problem(robot, start, start + np.array(change), duration)


@pytest.fixture(scope="module")
def spline(problem):
    return eo.plan(problem, eo.BSpline(accuracy=1e-3))


def test_refined_spline_and_collocation_find_the_same_motion(problem, spline):
    collocation = eo.plan(problem, eo.HermiteSimpson(80))
    assert collocation.objective == pytest.approx(spline.objective, rel=SAME_OPTIMUM)
    t = np.linspace(0.0, problem.duration, 101)
    span = np.abs(problem.goal - problem.start).max()
    np.testing.assert_allclose(collocation.trajectory(t), spline.trajectory(t), atol=0.04 * span)  # J is flat


def test_splines_of_every_degree_find_the_same_optimum(problem, spline):
    for degree in (4, 5):
        other = eo.plan(problem, eo.BSpline(degree=degree, accuracy=1e-3))
        assert other.objective == pytest.approx(spline.objective, rel=SAME_OPTIMUM)


def test_the_sinusoid_comes_down_to_them_from_above_with_every_harmonic(problem, spline):
    """The spaces are nested, and none holds the optimum, which starts and ends with an acceleration: the excess falls with H."""
    found = np.array([eo.plan(problem, eo.Sinusoid(h)).objective for h in HARMONICS])
    assert np.all(np.diff(found) < 0)
    excess = found / spline.objective - 1
    assert 0 < excess[-1] < 0.6 * excess[3] and excess[-1] < 0.2 * excess[0]


def test_the_cycloid_alone_is_the_cycloid_baseline(problem):
    plan = eo.plan(problem, eo.Sinusoid(0), throw=False)
    t = np.linspace(0.0, problem.duration, 101)
    np.testing.assert_allclose(plan.trajectory(t), eo.baseline(problem, "cycloid")(t), atol=1e-12)


FRICTION = {
    "spline": eo.BSpline(accuracy=None, control_points=30),
    "collocation": eo.HermiteSimpson(20),
    "sinusoid": eo.Sinusoid(5),
}


@pytest.mark.parametrize("method", FRICTION.values(), ids=FRICTION)
def test_coulomb_friction_is_integrated_where_joints_turn_back(method):
    """The torque steps within a few hundredths of a rad/s, and where nodes are few, motions cheat by turning back between them.

    J by the program's own nodes against J by forty Gauss nodes a span; with the nodes that smooth torques need it is 1 % low.
    """
    robot = arms.rubbing_two_link()
    request = eo.Problem(robot, [-0.4, 0.6], [1.0, -0.8], 2.0)
    plan = eo.plan(request, method)
    space = method.space(request.duration, ROUGH_NODES)
    program = transcribe(request, space, kernels_of(robot.dynamics))
    program.evaluator.move(program.guess(plan.trajectory))
    assert program.evaluator.objective() == pytest.approx(objective(request, plan.trajectory), rel=4e-3)
