"""Periodic motions: closed in position, velocity and acceleration."""

import arms
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import energyopt as eo
from energyopt.costs import AccelerationSquared
from energyopt.errors import ProblemError
from energyopt.parameterizations import BSpline, HermiteSimpson, Sinusoid

SPACES = [BSpline(), HermiteSimpson(intervals=24), Sinusoid(6)]


def cycle(**more):
    arm = arms.two_link()
    given = {"duration": 1.6, "periodic": True, "costs": AccelerationSquared()}
    waypoints = [([0.5, -0.3], 0.4), ([0.1, 0.4], 0.9), ([-0.3, 0.2], 1.3)]
    return eo.Problem(arm, [0.2, 0.1], [0.2, 0.1], **(given | {"waypoints": waypoints} | more))


def test_a_cycle_of_least_acceleration_is_the_periodic_cubic_spline():
    problem = cycle()
    times = [0.0, *(w.time for w in problem.waypoints), problem.duration]
    points = [problem.start, *(w.position for w in problem.waypoints), problem.start]
    spline = CubicSpline(times, points, bc_type="periodic")
    plan = eo.plan(problem, BSpline(knots=tuple(np.linspace(0.0, 1.6, 17)), accuracy=None))  # the times are knots
    t = np.linspace(0.0, 1.6, 101)
    np.testing.assert_allclose(plan.trajectory(t), spline(t), atol=1e-6)
    np.testing.assert_allclose(plan.trajectory(t, 2), spline(t, 2), atol=1e-4)


@pytest.mark.parametrize("space", SPACES, ids=lambda s: type(s).__name__)
@pytest.mark.parametrize("duration", [1.6, (0.8, 4.0)], ids=["given", "free"])
def test_a_cycle_closes_and_costs_less_than_a_stop(space, duration):
    waypoints = [[0.5, -0.3], [-0.3, 0.2]]
    free = {"costs": None, "duration": duration, "waypoints": waypoints}
    plan = eo.plan(cycle(**free), space)
    for order in range(3):
        ends = plan.trajectory(np.array([0.0, plan.duration]), order)
        np.testing.assert_allclose(ends[1], ends[0], atol=1e-6 * max(1.0, np.abs(ends).max()))
    assert np.linalg.norm(plan.trajectory(0.0, 1)) > 0.05
    stopping = eo.plan(cycle(**free | {"periodic": False, "duration": plan.duration}), space)
    assert plan.objective < stopping.objective


def test_a_cycle_is_saved_loaded_and_replayed(tmp_path):
    plan = eo.plan(cycle(costs=None))
    plan.save(tmp_path / "plan.npz")
    assert eo.load_plan(tmp_path / "plan.npz").problem.periodic
    log = eo.replay(plan)
    assert eo.validate(plan, log).passed


@pytest.mark.parametrize(
    "given, word",
    [
        ({"goal": [0.5, 0.5]}, "goal is not the start"),
        ({"waypoints": ()}, "stands still"),
        ({"start_velocity": 0.5}, "start_velocity is given"),
        ({"periodic": 1}, "expected True or False"),
    ],
)
def test_what_is_no_cycle_is_refused(given, word):
    values = {"start": [0.2, 0.1], "goal": [0.2, 0.1], "duration": 1.0, "waypoints": [[0.4, 0.4]], "periodic": True} | given
    with pytest.raises(ProblemError, match=word):
        eo.Problem(arms.two_link(), **values)
