"""The two that need nothing else: energyopt itself, and the quintic that everybody starts from."""

from __future__ import annotations

import time

from _rival import Attempt, Rival, timed

import energyopt as eo
from energyopt.clock import timed_by
from energyopt.dynamics.kernels import kernels_of


class Quintic(Rival):
    says = "the minimum-jerk quintic from start to goal; nothing is optimised, no limit is looked at"

    def solve(self, problem):
        motion, seconds = timed(lambda: eo.baseline(problem, "quintic"))
        return Attempt(motion, True, 0, seconds)


class Ours(Rival):
    says = "energyopt.plan from one start, at its default accuracy (cubic splines refined until J is within 1 %)"
    accuracy = 0.01

    def prepare(self, robot):
        """Compile the kernels, and plan a small move so that all is loaded."""
        kernels_of(robot.dynamics)
        small = eo.Problem(robot, robot.home, robot.home + 0.05, 1.0, self_collision=False, torque_limits=1e4)
        eo.plan(small, eo.BSpline(control_points=8, accuracy=None), throw=False)

    def solve(self, problem):
        """The solve is energyopt's stage of that name (refinement and torque rows included); the rest of `plan` is build."""
        with timed_by(time.process_time):
            plan, total = timed(lambda: eo.plan(problem, eo.BSpline(accuracy=self.accuracy), starts=1, throw=False))
        solve = plan.time_s["solve"]
        return Attempt(plan.trajectory, plan.solved, plan.iterations, solve, total - solve)


class OursByDefault(Ours):
    says = "energyopt.plan as it comes: the best of its default number of guesses, the time of all"

    def solve(self, problem):
        plan, seconds = timed(lambda: eo.plan(problem, throw=False))
        return Attempt(plan.trajectory, plan.solved, plan.iterations, seconds)


class OursCoarser(Ours):
    says = "energyopt.plan from one start, refined until J is within 5 %"
    accuracy = 0.05


class OursTighter(Ours):
    says = "energyopt.plan from one start, refined until J is within 0.3 %"
    accuracy = 0.003
