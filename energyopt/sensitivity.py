"""How the optimal cost changes with what was asked: dJ/dp for payload, friction, weights, duration, ends and limits.

By the envelope theorem the derivative of an optimum is that of the Lagrangian at the optimum, motion and multipliers held (A. V.
Fiacco, "Introduction to Sensitivity and Stability Analysis in Nonlinear Programming", 1983, ch. 3):

    dJ/dp = ∂L/∂p,    L = f(x; p) + Σ_r y_r (g_r(x; p) − b_r(p)) + Σ_i z_i (x_i − b_i(p)),

b being the bound that holds a row or an unknown, and zero multipliers where none does. The plan's program is made and solved
once more on the plan's own knots, for its multipliers. What acts through the torques needs no more than u = ∂L/∂τ at the samples,

    ∂L/∂p = Σ_k u_kᵀ ∂τ_k/∂p,

and τ is linear in inertias, armature and friction; for ends, limits and duration L is differenced, which solves nothing again.
These are derivatives of one local optimum in one motion space; a limit about to become active has another one on each side.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from energyopt.errors import NoSolutionFound, ProblemError
from energyopt.parameterizations.space import MotionSpace
from energyopt.plans import Plan
from energyopt.problem import FramePose, Problem
from energyopt.problem_values import shown
from energyopt.readable import Readable
from energyopt.robots.payload import Payload
from energyopt.robots.variation import payload_body
from energyopt.search import Search
from energyopt.solvers import SolverOptions, solve
from energyopt.threads import single_thread
from energyopt.transcription import NonlinearProgram, transcribe
from energyopt.whatif import WhatIf

TOLERANCE, BARRIER = 1e-9, 1e-5
"""Optimality to which the program is solved for its multipliers, and the barrier parameter it starts from."""
TIGHT = 1e-5
"""A bound holds something where less than this share of the interval is left."""
STEP = 1e-5
"""Of the differences, as a share of the parameter, or absolute where that is below one."""
LIMITS = {"velocity": "rad/s", "acceleration": "rad/s²", "jerk": "rad/s³", "torque": "N·m", "torque_rate": "N·m/s"}


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivities(Readable):
    """Derivatives of the optimal J.

    Attributes:
        joint_names: of the arm.
        objective: J of the plan.
        values: dJ/dp by name of p: a number, or an array with one a joint (or a coordinate x, y, z).
        units: of p, by name.
    """

    joint_names: tuple[str, ...]
    objective: float
    values: dict[str, np.ndarray]
    units: dict[str, str]

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.values:
            raise ProblemError(f"sensitivities: no parameter is named {shown(name)}: expected one of {', '.join(self.values)}")
        return self.values[name]

    def in_brief(self) -> str:
        return f"at J {self.objective:.6g}, of {', '.join(self.values)}"

    def __str__(self) -> str:
        """A table: a parameter a line, dJ/dp joint by joint."""
        lines = [f"dJ/dp at J = {self.objective:.6g}; joint by joint: {', '.join(self.joint_names)}"]
        for name, value in self.values.items():
            numbers = "  ".join(f"{number:11.4g}" for number in np.atleast_1d(value))
            lines.append(f"{name + ' [' + self.units[name] + ']':32s}{numbers}")
        return "\n".join(lines)


def sensitivities(plan: Plan, payload: Payload | None = None) -> Sensitivities:
    """dJ/dp at a plan, for everything its optimum depends on smoothly.

    Args:
        plan: a solved plan.
        payload: a body that the plan's robot carries: its mass and centre are then parameters. Without one, ``payload_mass`` is
            that of a point added at the tool.

    Returns:
        by name: ``payload_mass``, ``payload_center`` (in its frame); joint by joint ``viscous_friction``, ``coulomb_friction``,
        ``armature``, ``velocity_weight`` and ``torque_weights`` (or ``cost <name>``, the weights of cost terms), ``start``,
        ``goal``, ``position_lower``, ``position_upper`` and the other limits that are set; ``duration``. Zero where a limit holds
        nothing.

    Raises:
        InputError: the plan is not solved.
        NoSolutionFound: the optimum could not be found again.
    """
    if not isinstance(plan, Plan) or not plan.solved:
        raise ProblemError(f"sensitivities: plan is {shown(plan)}: expected a solved energyopt.Plan")
    if payload is not None and not isinstance(payload, Payload):
        raise ProblemError(f"sensitivities: payload is {shown(payload)}: expected an energyopt.Payload")
    with single_thread():
        point = _optimum(plan)
        found = _of_the_arm(point, payload) | _of_weights(point) | _of_the_motion(point) | _of_limits(point)
    names = plan.problem.robot.joint_names
    values, units = ({name: pair[k] for name, pair in found.items()} for k in (0, 1))
    return Sensitivities(names, plan.objective, values, units)


@dataclass(frozen=True, eq=False)
class _Optimum:
    """A program at its optimum: ``y`` and ``z`` are the multipliers of rows and bounds that hold something."""

    search: Search
    space: MotionSpace
    program: NonlinearProgram
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray

    @property
    def problem(self) -> Problem:
        return self.search.problem

    def lagrangian(self, problem: Problem) -> float:
        """L of another problem at this point."""
        factor, search = problem.duration / self.space.duration, self.search
        space = self.space if factor == 1.0 else self.space.stretched(problem.duration)
        kernels = search.kernels
        program = transcribe(problem, space, kernels, search.cuts.stretched(factor), search._clearance_terms)
        g = np.empty(program.rows)
        program.evaluator.move(self.x)
        program.evaluator.constraints(self.x, g)
        rows = _held(self.y, g, program.row_lower, program.row_upper)
        return program.evaluator.objective() + rows + _held(self.z, self.x, program.lower, program.upper)

    def slope(self, change: Callable[[float], Problem], scale: float) -> float:
        """∂L/∂p, p being what ``change`` adds to."""
        step = STEP * max(abs(scale), 1.0)
        return (self.lagrangian(change(step)) - self.lagrangian(change(-step))) / (2.0 * step)


def _held(multipliers: np.ndarray, values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> float:
    """Σ multiplier × (value − the bound that holds it)."""
    up, down = multipliers > 0.0, multipliers < 0.0
    return float(multipliers[up] @ (values - upper)[up] + multipliers[down] @ (values - lower)[down])


def _optimum(plan: Plan) -> _Optimum:
    search = WhatIf(plan).resumed(plan.problem)
    if not search.converged:
        raise NoSolutionFound(replace(plan, message=f"its optimum was not found again: {search.outcome.value}"))
    program = search._transcribe()
    result = solve(program, program.guess(search.trajectory), SolverOptions(tolerance=TOLERANCE, barrier=BARRIER))
    x, y, g = result.x, result.multipliers, np.empty(program.rows)
    gradient, values = np.empty(program.size), np.empty(len(program.jacobian_pattern[1]))
    program.evaluator.move(x)
    program.evaluator.constraints(x, g)
    program.evaluator.gradient(gradient)
    program.evaluator.jacobian(values)
    y = _holding(y, g, program.row_lower, program.row_upper)
    start, row = program.jacobian_pattern
    column = np.repeat(np.arange(program.size), np.diff(start))
    z = -gradient - np.bincount(column, values * y[row], minlength=program.size)
    z = _holding(z, x, program.lower, program.upper)
    return _Optimum(search, search.space, program, x, y, z)


def _holding(multipliers: np.ndarray, values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The multipliers of what a bound holds, zero for the others; equalities are held from both sides."""
    width = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
    up = (multipliers > 0.0) & (upper - values <= TIGHT * width)
    down = (multipliers < 0.0) & (values - lower <= TIGHT * width)
    return np.where(up | down | (lower == upper), multipliers, 0.0)


def _pulls(point: _Optimum) -> np.ndarray:
    """u = ∂L/∂τ at the samples of the program, (N, nv)."""
    program, nv = point.program, point.problem.robot.nv
    evaluator = base_evaluator(program)
    program.evaluator.move(point.x)
    if evaluator.costs is None:
        pulls = 2.0 * evaluator.arrays["weight"][:, None] * evaluator.arrays["torque_weight"] * evaluator.torque
    else:
        pulls = evaluator.costs.first(evaluator.state, evaluator.torque, evaluator.arrays["weight"])[:, :nv]
    own = point.y[: program.layout.rows]
    return pulls + evaluator.at_samples(evaluator.row_multipliers(own))


def base_evaluator(program: NonlinearProgram):
    """The evaluator of samples and torque rows, inside what extends it."""
    evaluator = program.evaluator
    while not hasattr(evaluator, "layout"):
        evaluator = evaluator._base
    return evaluator


def _of_the_arm(point: _Optimum, payload: Payload | None) -> dict:
    robot, u = point.problem.robot, _pulls(point)
    q, v, a = np.split(base_evaluator(point.program).state, 3, axis=1)
    dynamics = robot.dynamics
    found = {
        "viscous_friction": (np.sum(u * v, axis=0), "N·m·s/rad"),
        "coulomb_friction": (np.sum(u * np.tanh(v / dynamics.coulomb_velocity), axis=0), "N·m"),
        "armature": (np.sum(u * a, axis=0), "kg·m²"),
    }

    def felt(joint: int, numbers: np.ndarray) -> float:
        """Σ uᵀ ∂τ for ten inertial numbers added to the body of a joint."""
        if not joint:
            return 0.0
        model = pin.Model(robot.model)
        model.inertias[joint] = pin.Inertia.FromDynamicParameters(model.inertias[joint].toDynamicParameters() + numbers)
        return float(np.sum(u * (replace(dynamics, model=model).torque(q, v, a) - dynamics.torque(q, v, a))))

    held = payload or Payload(1.0)
    center, frame = np.asarray(held.center), held.frame
    joint = payload_body(robot, held)[0]
    numbers = lambda mass, c: payload_body(robot, Payload(mass, c, frame=frame))[1].toDynamicParameters()
    found["payload_mass"] = np.array(felt(joint, numbers(1.0, center))), "kg"
    if payload is not None:
        moves = np.eye(3)  # the ten numbers are quadratic in the centre: central differences are exact
        slopes = [0.5 * (numbers(held.mass, center + e) - numbers(held.mass, center - e)) for e in moves]
        found["payload_center"] = np.array([felt(joint, slope) for slope in slopes]), "m"
    return found


def _of_weights(point: _Optimum) -> dict:
    problem, evaluator = point.problem, base_evaluator(point.program)
    weight, nv = evaluator.arrays["weight"], problem.robot.nv
    if problem.costs is None:
        velocity = evaluator.state[:, nv : 2 * nv]
        return {
            "velocity_weight": (weight @ velocity**2, "N²·m²·s²/rad²"),
            "torque_weights": (weight @ evaluator.torque**2, "1"),
        }
    found = {}
    for k, term in enumerate(problem.costs):
        others = lambda step, k=k: replace(
            problem, costs=tuple(replace(t, weight=t.weight + step * (i == k)) for i, t in enumerate(problem.costs))
        )
        found[f"cost {term.name}"] = np.array(point.slope(others, 0.1 * term.weight)), "weight"
    return found


def _of_the_motion(point: _Optimum) -> dict:
    problem = point.problem
    found = {"duration": (np.array(point.slope(lambda h: problem.lasting(problem.duration + h), problem.duration)), "s")}
    found["start"] = _each(point, problem.start, lambda q: replace(problem, start=q)), "rad"
    if isinstance(problem.goal, FramePose):
        pose = problem.goal
        moved = lambda p: replace(problem, goal=replace(pose, position=p))
        found["goal_position"] = _each(point, pose.position, moved), "m"
    else:
        found["goal"] = _each(point, problem.goal, lambda q: replace(problem, goal=q)), "rad"
    return found


def _of_limits(point: _Optimum) -> dict:
    problem, limits = point.problem, point.problem.limits
    lower, upper = limits.lower, limits.upper
    found = {
        "position_lower": (_each(point, lower, lambda v: replace(problem, position_limits=(v, upper))), "rad"),
        "position_upper": (_each(point, upper, lambda v: replace(problem, position_limits=(lower, v))), "rad"),
    }
    for kind, unit in LIMITS.items():
        values = getattr(limits, kind)
        if np.any(np.isfinite(values)):
            found[f"{kind}_limits"] = _each(point, values, lambda v, kind=kind: replace(problem, **{f"{kind}_limits": v})), unit
    return found


def _each(point: _Optimum, values: np.ndarray, changed: Callable[[np.ndarray], Problem]) -> np.ndarray:
    """∂L/∂ of each entry of ``values``; zero where an entry is infinite."""
    slopes = np.zeros(len(values))
    for k in np.flatnonzero(np.isfinite(values)):
        unit = np.eye(len(values))[k]
        slopes[k] = point.slope(lambda h, unit=unit: changed(np.where(unit > 0, values + h, values)), values[k])
    return slopes
