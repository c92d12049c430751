"""A Cartesian goal: the frame of the arm stands where it should at the end."""

from __future__ import annotations

import casadi as ca
import numpy as np

from energyopt.problem import FramePose
from energyopt.robots.model import RobotModel
from energyopt.transcription.extras import Priceless


class FrameGoal(Priceless):
    """The frame of a `FramePose` stands where it should: p(q) − p* = 0 and, where asked, ½ (R*ᵀR − RᵀR*)^∨ = 0.

    The second is sin θ times the axis of the remaining rotation; it also vanishes at θ = π, which seeds avoid and the
    check of the result excludes.
    """

    variables = 0

    def __init__(self, robot: RobotModel, goal: FramePose, first: int):
        q = ca.SX.sym("q", robot.nv)
        R, p = robot.frame_placement(goal.frame)(q)
        residual = p - ca.DM(goal.position)
        if goal.rotation is not None:
            turn = ca.DM(goal.rotation).T @ R
            residual = ca.vertcat(residual, 0.5 * ca.inv_skew(turn - turn.T))
        multipliers = ca.SX.sym("multipliers", residual.numel())
        curvature = ca.densify(ca.triu(ca.hessian(ca.dot(multipliers, residual), q)[0]))
        self._columns = first + np.arange(robot.nv)
        self._rows = residual.numel()
        self._values = ca.Function("goal", [q], [residual, ca.densify(ca.jacobian(residual, q))])
        self._curvature = ca.Function("goal_curvature", [q, multipliers], [curvature])
        self._upper = np.triu_indices(robot.nv)
        self.lower = self.upper = np.zeros(0)
        self.row_lower = self.row_upper = np.zeros(self._rows)

    def guess(self, coefficients):
        return np.zeros(0)

    def jacobian_pattern(self):
        rows, columns = np.indices((self._rows, len(self._columns)))
        return rows.ravel(), self._columns[columns.ravel()]

    def hessian_pattern(self):
        i, j = self._upper
        return self._columns[i], self._columns[j]

    def evaluate(self, x):
        residual, jacobian = self._values(x[self._columns])
        return np.array(residual).ravel(), np.array(jacobian).ravel()

    def curvature(self, x, sigma, multipliers):
        return np.array(self._curvature(x[self._columns], multipliers))[self._upper]
