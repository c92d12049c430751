"""From a problem and a motion space to a nonlinear program: minimise f(x) with bounds on x and on rows g(x)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from energyopt.dynamics.kernels import Kernels
from energyopt.parameterizations.space import BoundaryState, MotionSpace, Unknowns
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.transcription.clearance import ClearanceTerms
from energyopt.transcription.cuts import Cuts
from energyopt.transcription.evaluators import make_evaluator
from energyopt.transcription.extras import ExtendedEvaluator, extra_rows
from energyopt.transcription.layout import Layout, make_layout
from energyopt.transcription.linear import linear_rows


@dataclass(frozen=True, eq=False)
class NonlinearProgram:
    """A transcribed problem, ready for a solver (the fields and methods that `solvers.ipopt.solve` uses).

    Attributes:
        space, unknowns: how x makes a motion.
        lower, upper: bounds on x, (n,); row_lower, row_upper: bounds on g, (m,).
        jacobian_pattern, hessian_pattern: column starts and rows; the Hessian's upper triangle.
        evaluator: `move(x)`, then objective, constraints, gradient, jacobian, hessian.
    """

    space: MotionSpace
    unknowns: Unknowns
    layout: Layout
    lower: np.ndarray
    upper: np.ndarray
    row_lower: np.ndarray
    row_upper: np.ndarray
    jacobian_pattern: tuple[np.ndarray, np.ndarray]
    hessian_pattern: tuple[np.ndarray, np.ndarray]
    evaluator: object
    extras: tuple = ()

    @property
    def size(self) -> int:
        return len(self.lower)

    @property
    def rows(self) -> int:
        return len(self.row_lower)

    @property
    def linear_only(self) -> bool:
        """Whether no row is nonlinear (its Jacobian never changes)."""
        return not len(self.layout.torque.lower) and not self.extras

    def coefficients(self, x: np.ndarray) -> np.ndarray:
        """Coefficients (size, nv) of the unknowns ``x``."""
        u, nv = self.unknowns, self.layout.nv
        padded = np.concatenate([x[: u.count * nv].reshape(-1, nv), np.zeros((1, nv))])
        return u.offset + padded[u.block]

    def trajectory(self, x: np.ndarray) -> Trajectory:
        return self.space.trajectory(self.coefficients(x))

    def guess(self, trajectory: Trajectory) -> np.ndarray:
        """Unknowns of the motion nearest to ``trajectory``, moved inside the bounds on x."""
        wanted = self.space.interpolate(trajectory) - self.unknowns.offset
        known = self.unknowns.block >= 0
        x = np.zeros((self.unknowns.count, self.layout.nv))
        x[self.unknowns.block[known]] = wanted[known]
        more = [extra.guess(self.coefficients(x.ravel())) for extra in self.extras]
        return np.clip(np.concatenate([x.ravel(), *more]), self.lower, self.upper)


def boundary_states(problem: Problem) -> tuple[BoundaryState, BoundaryState]:
    """Start and goal as boundary states; the goal's position is None where it is Cartesian."""
    return (
        BoundaryState(problem.start, problem.start_velocity, problem.start_acceleration),
        BoundaryState(problem.goal_position, problem.goal_velocity, problem.goal_acceleration),
    )


def transcribe(
    problem: Problem,
    space: MotionSpace,
    kernels: Kernels,
    cuts: Cuts | None = None,
    clearance: Callable[[MotionSpace, Unknowns, Cuts], ClearanceTerms | None] | None = None,
) -> NonlinearProgram:
    """The nonlinear program of a problem in a motion space.

    Args:
        problem: what is asked.
        space: motions to choose from.
        kernels: of the problem's robot.
        cuts: rows added so far.
        clearance: makes the terms of clearance, where there is something to stay clear of.
    """
    nv = problem.robot.nv
    unknowns = space.unknowns(*boundary_states(problem))
    cuts = cuts or Cuts()
    linear = linear_rows(problem, space, unknowns, cuts.sample_rows(nv))
    torque = cuts.torque_rows(problem, len(space.quadrature()[1]))
    zeros = np.zeros(nv)
    weights = (problem.torque_weights, np.concatenate([zeros, problem.velocity_weight, zeros]))
    layout = make_layout(space, unknowns, linear, torque, weights)
    patterns = (layout.jac_start, layout.jac_row), (layout.hess_start, layout.hess_row)
    evaluator, extras = make_evaluator(layout, kernels), extra_rows(problem, space, unknowns)
    if clearance is not None and (terms := clearance(space, unknowns, cuts)) is not None:
        extras.append(terms)
    if extras:
        evaluator = ExtendedEvaluator(evaluator, layout.size, layout.rows, patterns, extras)
        patterns = evaluator.jacobian_pattern, evaluator.hessian_pattern
    every = lambda own, name: np.concatenate([*own, *(getattr(extra, name) for extra in extras)])
    return NonlinearProgram(
        space=space,
        unknowns=unknowns,
        layout=layout,
        lower=every([linear.x_lower], "lower"),
        upper=every([linear.x_upper], "upper"),
        row_lower=every([linear.lower, layout.torque.lower], "row_lower"),
        row_upper=every([linear.upper, layout.torque.upper], "row_upper"),
        jacobian_pattern=patterns[0],
        hessian_pattern=patterns[1],
        evaluator=evaluator,
        extras=tuple(extras),
    )
