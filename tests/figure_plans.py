"""Plans around motions in closed form, for tests of what is drawn and written: nothing is solved."""

from functools import cache

import arms
import numpy as np

import energyopt as eo
from energyopt.verification import cost, verify

DURATIONS = {"ur5": 2.0, "panda": 2.0, "baxter": 2.5}


def around(problem, motion, status=eo.Status.SOLVED, message="solved; every limit holds on the dense check", **fields):
    """The plan that `plan` would return for a motion."""
    terms = cost(problem, motion)
    values = {
        "discretization_error": 0.004,
        "iterations": 12,
        "time_s": {"build": 0.01, "compile": 0.0, "solve": 0.05, "verify": 0.01},
        "seed": 0,
        "options": {"parameterization": "BSpline", "degree": 3},
    } | fields
    violations = verify(problem, motion)
    return eo.Plan(problem, status, message, motion, sum(terms.values()), terms, violations, **values)


@cache
def cycloid_plan(name):
    """A catalogue robot moving by 0.4 rad in every joint, from its home towards the middle of its range."""
    robot = arms.catalogue_robot(name)
    middle = 0.5 * (robot.limits.lower + robot.limits.upper)
    goal = robot.home + np.where(middle > robot.home, 0.4, -0.4)
    problem = eo.Problem(robot, robot.home, goal, DURATIONS[name], name=f"{name}_moves")
    return around(problem, eo.baseline(problem, "cycloid"))


@cache
def replayed(name):
    return eo.replay(cycloid_plan(name))


def slider_plan(folder_robot, distance=0.8, duration=2.0, **fields):
    """A one-joint robot along its quintic."""
    problem = eo.Problem(folder_robot, np.zeros(folder_robot.nv), np.full(folder_robot.nv, distance), duration, name="slide")
    return around(problem, eo.baseline(problem), **fields)
