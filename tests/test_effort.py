"""How much work a plan takes, counted in solver iterations and torque rows: counts do not depend on the machine's load.

The numbers are those of the day they were written, with a fifth of slack for other compilers and CPUs. A change that lowers
them should lower them here; one that raises them has to say why.
"""

import numpy as np
import pytest

import energyopt as eo

SUITE = {  # seed: iterations, torque rows
    "panda": {0: (92, 9), 1: (76, 8), 2: (43, 0), 3: (91, 27)},
    "ur5": {0: (44, 0), 1: (67, 0), 2: (40, 0), 3: (37, 0)},
}


def moves(robot, count):
    """Random rest-to-rest moves, a little slower than the quintic's velocity limit allows."""
    rng = np.random.default_rng(5)
    low, high = np.maximum(robot.limits.lower, -2.5), np.minimum(robot.limits.upper, 2.5)
    while count:
        start, goal = rng.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low), (2, robot.nv))
        stretch = rng.uniform(1.1, 1.6)
        duration = stretch * np.max(1.875 * np.abs(goal - start) / robot.limits.velocity) / 1.3
        yield eo.Problem(robot, start, goal, duration=duration, self_collision=False)
        count -= 1


@pytest.mark.parametrize("name", SUITE)
def test_plans_take_no_more_iterations_and_rows_than_they_did(name):
    robot = eo.load_robot(name)
    found = [eo.plan(problem) for problem in moves(robot, len(SUITE[name]))]
    allowed = [(1.2 * iterations + 2, 1.2 * rows + 2) for iterations, rows in SUITE[name].values()]
    worse = [
        (plan.iterations, plan.options["torque_rows"], limit)
        for plan, limit in zip(found, allowed, strict=True)
        if plan.iterations > limit[0] or plan.options["torque_rows"] > limit[1]
    ]
    assert not worse
