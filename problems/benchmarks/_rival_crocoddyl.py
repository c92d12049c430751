"""Crocoddyl, and mim_solvers on the same model: shooting methods that exploit the stages.

Control is the acceleration, constant over a step, integrated by Euler's rule (symplectic); torques are a cost by inverse
dynamics. This is quicker and more reliable than torque as control (`DifferentialActionModelFreeFwdDynamics`, which also forgets
gravity unless ``model.armature`` is set anew). Runge and Kutta's rule of order two was tried and cheats: it looks at the middles
of steps only, and light wrists zigzag between at nine times their velocity limit.

- FDDP knows no limits and no goal: both are penalties, raised in turns, each solve starting from the last.
- CSQP of mim_solvers has them as constraints, in a quadratic program solved by ADMM.
"""

from __future__ import annotations

import numpy as np
from _rival import Attempt, Rival, timed

from energyopt import Problem, baseline
from energyopt.parameterizations.trajectory import PolynomialTrajectory

STEPS = 50
PENALTIES = (1.0, 100.0)
"""On half the squared excess of limits, relative to the limit, per second, times the mean squared torque limit; in turns."""
GOAL = 1e6
"""On half the squared distance from the goal state."""
PRECISION = 8.0
"""Of position and velocity, whose limits are told as a range."""
MARGIN = 0.99
"""Share of velocity and torque limits that the penalised problem is told."""
STOP = 0.1
"""FDDP: squared norm of the gradient at which a round ends; J is some hundreds."""
ITERATIONS = 100
QUADRATIC = 30
"""Quadratic programs CSQP may solve, of 100 iterations each."""


class Fddp(Rival):
    says = f"Crocoddyl, FDDP in acceleration controls, {STEPS} steps, limits as penalties in {len(PENALTIES)} rounds"
    requires = ("crocoddyl",)

    def solve(self, problem):
        stages, build = timed(lambda: [_shooting(problem, penalty) for penalty in PENALTIES])
        (xs, us), work = _guess(problem), []

        def rounds():
            states, controls = xs, us
            for shooting in stages:
                solver = _crocoddyl().SolverFDDP(shooting)
                solver.th_stop = STOP
                work.append((solver.solve(states, controls, ITERATIONS, False), solver.iter))
                states, controls = list(solver.xs), list(solver.us)
            return controls

        controls, seconds = timed(rounds)
        return Attempt(_motion(problem, controls), bool(work[-1][0]), sum(count for _, count in work), seconds, build)


class Csqp(Rival):
    says = f"mim_solvers, CSQP on Crocoddyl's model in acceleration controls, {STEPS} steps, limits and goal as constraints"
    requires = ("crocoddyl", "mim_solvers")

    def solve(self, problem):
        import mim_solvers

        def make():
            solver = mim_solvers.SolverCSQP(_shooting(problem, None))
            solver.termination_tolerance, solver.max_qp_iters = 1e-2, 100
            solver.eps_abs = solver.eps_rel = 1e-4
            solver.use_filter_line_search = True
            return solver

        solver, build = timed(make)
        converged, seconds = timed(lambda: solver.solve(*_guess(problem), QUADRATIC, False))
        return Attempt(_motion(problem, list(solver.us)), bool(converged), solver.iter, seconds, build)


def _crocoddyl():
    import crocoddyl

    return crocoddyl


def _shooting(problem: Problem, penalty: float | None):
    """The shooting problem, with limits as penalties, or as constraints where ``penalty`` is None."""
    c = _crocoddyl()
    model = problem.robot.model.copy()
    model.armature = np.array(model.armature)
    state = c.StateMultibody(model)
    actuation = c.ActuationModelFull(state)
    nv, dt = model.nv, problem.duration / STEPS
    costs, constraints = c.CostModelSum(state, nv), c.ConstraintModelManager(state, nv)
    effort = c.ResidualModelJointEffort(state, actuation, np.zeros(nv), nv, False)
    position = c.ResidualModelState(state, np.zeros(2 * nv), nv)
    slow = np.concatenate([np.zeros(nv), problem.velocity_weight])
    costs.addCost("torque", c.CostModelResidual(state, c.ActivationModelWeightedQuad(problem.torque_weights), effort), 2.0)
    costs.addCost("velocity", c.CostModelResidual(state, c.ActivationModelWeightedQuad(slow), position), 2.0)
    (low, high), torque = _state_bounds(problem, MARGIN if penalty else 1.0), problem.limits.torque
    if penalty is None:
        constraints.addConstraint("states", c.ConstraintModelResidual(state, position, low, high, False))
        constraints.addConstraint("torques", c.ConstraintModelResidual(state, effort, -torque, torque, False))
    else:
        span, room = high - low, MARGIN * torque
        bounded = c.ActivationModelWeightedQuadraticBarrier(c.ActivationBounds(low, high), (PRECISION / span) ** 2)
        strong = c.ActivationModelWeightedQuadraticBarrier(c.ActivationBounds(-room, room), 1.0 / torque**2)
        scale = penalty * float(np.mean(torque**2))
        costs.addCost("states", c.CostModelResidual(state, bounded, position), scale)
        costs.addCost("torques", c.CostModelResidual(state, strong, effort), scale)
    running = c.IntegratedActionModelEuler(c.DifferentialActionModelFreeInvDynamics(state, actuation, costs, constraints), dt)
    first = np.concatenate([problem.start, np.zeros(nv)])
    return c.ShootingProblem(first, [running] * STEPS, _end(c, problem, state, actuation, penalty))


def _end(c, problem: Problem, state, actuation, penalty: float | None):
    """The last action: at the goal, at rest."""
    nv = problem.robot.nv
    costs, constraints = c.CostModelSum(state, nv), c.ConstraintModelManager(state, nv)
    goal = c.ResidualModelState(state, np.concatenate([problem.goal_position, np.zeros(nv)]), nv)
    if penalty is None:
        zero = np.zeros(2 * nv)
        constraints.addConstraint("goal", c.ConstraintModelResidual(state, goal, zero, zero))
    else:
        costs.addCost("goal", c.CostModelResidual(state, goal), GOAL)
    return c.IntegratedActionModelEuler(c.DifferentialActionModelFreeInvDynamics(state, actuation, costs, constraints), 0.0)


def _state_bounds(problem: Problem, margin: float) -> tuple[np.ndarray, np.ndarray]:
    limits = problem.limits
    fast = margin * limits.velocity
    return np.concatenate([limits.lower, -fast]), np.concatenate([limits.upper, fast])


def _guess(problem: Problem) -> tuple[list, list]:
    """States and accelerations of the quintic."""
    quintic, t = baseline(problem, "quintic"), np.linspace(0.0, problem.duration, STEPS + 1)
    return list(np.hstack([quintic(t), quintic(t, 1)])), list(np.diff(quintic(t, 1), axis=0) / t[1])


def _motion(problem: Problem, controls: list) -> PolynomialTrajectory:
    """What these accelerations make of the start, exactly; from rest to rest it ends where Euler's rule ends."""
    breaks, a = np.linspace(0.0, problem.duration, STEPS + 1), np.array(controls)
    v = np.vstack([np.zeros(problem.robot.nv), np.cumsum(a * breaks[1], axis=0)])[:-1]
    q = problem.start + np.vstack([np.zeros(problem.robot.nv), np.cumsum(v * breaks[1] + a * breaks[1] ** 2 / 2, axis=0)])[:-1]
    return PolynomialTrajectory(breaks, np.stack([q, v, a / 2], axis=1))
