"""Pendulum and planar two-link arm against the optimality conditions, solved as boundary-value problems (see `extremals`).

There is more than one extremal: arms swing with or against gravity. The plan of several guesses has to be the cheapest one.
"""

import arms
import numpy as np
import pytest
from extremals import extremals, pendulum_torque, two_link_torque

import energyopt as eo

SAME_OPTIMUM = 1e-6
"""Relative; both discretisations are an order of magnitude finer."""
UNLIMITED = {"velocity_limits": 1e6, "torque_limits": 1e6, "position_limits": (-20.0, 20.0)}
TWO_LINK = two_link_torque((0.5, 0.4), (2.0, 1.5))
UP = np.pi / 2
SWINGS = [[0.0, 0.0], [1.5, 1.5], [-1.5, -1.5]]

CASES = {  # robot, torque in closed form, start, goal, duration, λ, bends of the guesses
    "pendulum, quick": (arms.pendulum, pendulum_torque(1.0, 1.0), [-1.5], [1.2], 1.5, 0.1, [[0.0], [2.0]]),
    "pendulum, hanging to upright": (arms.pendulum, pendulum_torque(1.0, 1.0), [-UP], [UP], 3.0, 0.1, [[0.0], [3.0], [-3.0]]),
    "two links, from a swing": (arms.two_link, TWO_LINK, [-0.4, 0.6], [1.2, -0.8], 0.5, 0.1, SWINGS),
    "two links, lifting": (arms.two_link, TWO_LINK, [-1.0, 0.5], [0.6, 0.8], 0.6, 1.0, SWINGS[:2]),
    "two links, dear velocity": (arms.two_link, TWO_LINK, [-1.5, 0.2], [0.0, 1.0], 0.7, 5.0, SWINGS[:1]),
}


@pytest.fixture(scope="module", params=CASES)
def case(request):
    """The problem, its extremals, cheapest first."""
    robot, torque, start, goal, duration, weight, bends = CASES[request.param]
    found = extremals(torque, np.array(start), np.array(goal), duration, weight, np.array(bends))
    return (robot(), start, goal, duration), weight, found


def test_the_refined_plan_is_the_cheapest_extremal(case):
    """The oracle's end accelerations are given to the plan, whose ends are otherwise at rest."""
    arguments, weight, found = case
    best = found[0]
    problem = eo.Problem(
        *arguments, velocity_weight=weight, start_acceleration=best.first, goal_acceleration=best.last, **UNLIMITED
    )
    plan = eo.plan(problem, eo.BSpline(degree=5, accuracy=1e-6), starts=3)
    assert plan.objective == pytest.approx(best.cost, rel=SAME_OPTIMUM)
    t = np.linspace(0.0, plan.duration, 200)
    np.testing.assert_allclose(plan.trajectory(t), best.position(t), atol=2e-3)  # J is flat: its error is the square of this


def test_with_ends_at_rest_the_plan_comes_down_to_the_extremal_from_above(case):
    arguments, weight, found = case
    for method in (eo.BSpline(accuracy=1e-3), eo.HermiteSimpson(100)):
        plan = eo.plan(eo.Problem(*arguments, velocity_weight=weight, **UNLIMITED), method, starts=3)
        assert 0.0 < plan.objective / found[0].cost - 1.0 < 2e-3
