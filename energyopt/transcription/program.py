"""From a problem and a motion space to a nonlinear program: minimise f(x) with bounds on x and on rows g(x)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from energyopt.costs import CostTerm, Samples
from energyopt.costs.cost import SquaredTerm
from energyopt.dynamics.kernels import Kernels
from energyopt.parameterizations.space import BoundaryState, MotionSpace, Unknowns
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import FramePose, Problem
from energyopt.transcription.clearance import ClearanceTerms
from energyopt.transcription.cuts import Cuts
from energyopt.transcription.evaluators import make_evaluator
from energyopt.transcription.extended import ExtendedEvaluator
from energyopt.transcription.extra_costs import JerkCost, TimePrice
from energyopt.transcription.extras import ExtraRows
from energyopt.transcription.frame_goal import FrameGoal
from energyopt.transcription.free_waypoints import FreeWaypoints
from energyopt.transcription.layout import Layout, make_layout
from energyopt.transcription.linear import linear_rows
from energyopt.transcription.stage_costs import StageCosts
from energyopt.transcription.stretch import StretchedEvaluator, offset_parts


@dataclass(frozen=True, eq=False)
class NonlinearProgram:
    """A transcribed problem, ready for a solver (the fields and methods that `solvers.ipopt.solve` uses).

    Attributes:
        space, unknowns: how x makes a motion.
        lower, upper: bounds on x, (n,); row_lower, row_upper: bounds on g, (m,).
        jacobian_pattern, hessian_pattern: column starts and rows; the Hessian's upper triangle.
        evaluator: `move(x)`, then objective, constraints, gradient, jacobian, hessian.
        extras: constraints that are neither linear nor torques. parts: see `stretch.offset_parts`; None where T is given.
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
    parts: np.ndarray | None = None

    @property
    def size(self) -> int:
        return len(self.lower)

    @property
    def rows(self) -> int:
        return len(self.row_lower)

    @property
    def linear_only(self) -> bool:
        """Whether no row is nonlinear (its Jacobian never changes)."""
        return not (len(self.layout.torque.lower) or self.extras or self.stretches)

    @property
    def stretches(self) -> bool:
        """Whether the duration is an unknown, the last one."""
        return self.parts is not None

    def duration(self, x: np.ndarray) -> float:
        """T [s] of the unknowns ``x``."""
        return self.space.duration * float(np.exp(x[-1])) if self.stretches else self.space.duration

    def coefficients(self, x: np.ndarray) -> np.ndarray:
        """Coefficients (size, nv) of the unknowns ``x``."""
        u, nv = self.unknowns, self.layout.nv
        padded = np.concatenate([x[: u.count * nv].reshape(-1, nv), np.zeros((1, nv))])
        offset = np.einsum("p,pji->ji", np.exp(x[-1] * np.arange(3)), self.parts) if self.stretches else u.offset
        return offset + padded[u.block]

    def trajectory(self, x: np.ndarray) -> Trajectory:
        trajectory = self.space.trajectory(self.coefficients(x))
        return trajectory.stretched(self.duration(x)) if self.stretches else trajectory

    def guess(self, trajectory: Trajectory) -> np.ndarray:
        """Unknowns of the motion nearest to ``trajectory``, run through in the space's duration, inside the bounds on x."""
        wanted = self.space.interpolate(trajectory) - self.unknowns.offset
        known = self.unknowns.block >= 0
        x = np.zeros((self.unknowns.count, self.layout.nv))
        x[self.unknowns.block[known]] = wanted[known]
        coefficients = self.unknowns.offset + np.append(x, np.zeros((1, x.shape[1])), axis=0)[self.unknowns.block]
        more = [extra.guess(coefficients) for extra in self.extras]
        return np.clip(np.concatenate([x.ravel(), *more, np.zeros(int(self.stretches))]), self.lower, self.upper)


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
    durations: tuple[float, float] | None = None,
) -> NonlinearProgram:
    """The nonlinear program of a problem in a motion space.

    Args:
        problem: what is asked.
        space: motions to choose from.
        kernels: of the problem's robot.
        cuts: rows added so far.
        clearance: makes the terms of clearance, where there is something to stay clear of.
        durations: where the duration is an unknown, its bounds [s]; otherwise it is that of the space.
    """
    ends = boundary_states(problem)
    squares, costs, jerks, price = split_costs(problem)
    if problem.periodic:
        unknowns = space.closed_unknowns(problem.start)
        parts = np.stack([unknowns.offset, *np.zeros((2, *unknowns.offset.shape))])
    else:
        unknowns = space.unknowns(*ends)
        parts = offset_parts(space, *ends) if jerks or durations is not None else None
    cuts = cuts or Cuts()
    free = None if durations is None else parts
    linear = linear_rows(problem, space, unknowns, cuts.sample_rows(problem.robot.nv), free)
    torque = cuts.torque_rows(problem, len(space.quadrature()[1]))
    layout = make_layout(space, unknowns, linear, torque, squares)
    patterns = (layout.jac_start, layout.jac_row), (layout.hess_start, layout.hess_row)
    base = evaluator = make_evaluator(layout, kernels, costs)
    extras = [*_extra_rows(problem, space, unknowns), *(JerkCost(term, space, unknowns, parts) for term in jerks)]
    if price and free is not None:
        extras.append(TimePrice(price, space))
    if clearance is not None and (terms := clearance(space, unknowns, cuts)) is not None:
        extras.append(terms)
    if extras:
        evaluator = ExtendedEvaluator(evaluator, layout.size, layout.rows, patterns, extras)
        patterns = evaluator.jacobian_pattern, evaluator.hessian_pattern
    every = lambda own, name: np.concatenate([*own, *(getattr(extra, name) for extra in extras)])
    lower, upper = every([linear.x_lower], "lower"), every([linear.x_upper], "upper")
    row_lower, row_upper = every([linear.lower, torque.lower], "row_lower"), every([linear.upper, torque.upper], "row_upper")
    if free is not None:
        theta = np.log(np.asarray(durations) / space.duration)
        evaluator = StretchedEvaluator(base, evaluator, extras, (len(lower), len(row_lower)), patterns, free)
        patterns = evaluator.jacobian_pattern, evaluator.hessian_pattern
        lower, upper = np.append(lower, theta[0]), np.append(upper, theta[1])
    return NonlinearProgram(
        space, unknowns, layout, lower, upper, row_lower, row_upper, *patterns, evaluator, tuple(extras), free
    )


def _extra_rows(problem: Problem, space: MotionSpace, unknowns: Unknowns) -> list[ExtraRows]:
    """The extra constraints a problem needs in a motion space, but for clearance, which depends on the motion so far."""
    nv, extras = problem.robot.nv, []
    if isinstance(problem.goal, FramePose):
        extras.append(FrameGoal(problem.robot, problem.goal, unknowns.goal * nv))
    if any(w.time is None for w in problem.waypoints):
        extras.append(FreeWaypoints(problem.waypoints, space, unknowns, unknowns.count * nv))
    return extras


AT_REST = Samples(*np.zeros((5, 1, 1)))
"""One sample, for terms that depend on nothing."""


@lru_cache(maxsize=8)
def split_costs(problem: Problem) -> tuple[tuple[np.ndarray, np.ndarray], StageCosts | None, list[CostTerm], float]:
    """The problem's cost terms as: weights of τ² (nv,) and of (q², q̇², q̈²) (3 nv,); what is more than squares of these, or None;
    those of the jerk; and the price of a second, which matters where the duration is free."""
    nv, price = problem.robot.nv, 0.0
    torque, state, general, jerks = np.zeros(nv), np.zeros((3, nv)), [], []
    for term in problem.cost_terms:
        if not term.uses:
            price += term.weight * float(term.integrand(AT_REST).value[0])
        elif term.uses == ("jerk",):
            jerks.append(term)
        elif isinstance(term, SquaredTerm):
            place = torque if term.uses == ("tau",) else state["qva".index(term.uses[0])]
            place += term.weight * np.broadcast_to(term.weights, nv)
        else:
            general.append(term)
    if not general:
        return (torque, state.ravel()), None, jerks, price
    kept = tuple(term for term in problem.cost_terms if term.uses and term not in jerks)
    return (torque, state.ravel()), StageCosts(kept), jerks, price
