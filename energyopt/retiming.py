"""`retime`: the timing of least cost on a path that is given.

The geometry stays what it is, exactly: the result is p(s(t)) for the path p that was given and a law s(t) with ṡ ≥ 0. The law
minimises ∫ (Σ w τ² + Σ λ q̇²) dt within the limits (see `timing.law_program`), and the motion is put to the same
independent dense check as any plan's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from energyopt.clock import now
from energyopt.errors import InputError, NoSolutionFound
from energyopt.parameterizations.path_trajectory import PathTrajectory
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.plans import Plan, Status
from energyopt.problem_values import whole
from energyopt.robots.model import RobotModel
from energyopt.solvers import Interrupts, Outcome
from energyopt.threads import single_thread
from energyopt.timing.law_search import LawRequest, LawResult, optimal_law, smooth_law
from energyopt.timing.profile import PathProfile
from energyopt.timing.task import PathTask, first_law, path_task, span_count
from energyopt.timing.uniform import uniform_scaling
from energyopt.verification import cost, describe, is_valid, verify

_STATUS = {
    Outcome.INFEASIBLE: (Status.INFEASIBLE, "no timing of this path inside the limits was found"),
    Outcome.FAILED: (Status.INFEASIBLE, "no timing of this path inside the limits was found"),
    Outcome.ITERATION_LIMIT: (Status.ITERATION_LIMIT, "the solver ran out of iterations"),
    Outcome.TIME_LIMIT: (Status.TIME_LIMIT, "the time limit passed"),
    Outcome.INTERRUPTED: (Status.INTERRUPTED, "interrupted; this is the best timing so far"),
}


def retime(
    path: Trajectory | ArrayLike,
    robot: RobotModel,
    duration: float | tuple[float, float],
    *,
    start_speed: float = 0.0,
    goal_speed: float = 0.0,
    smooth_ends: bool = True,
    spans: int | None = None,
    throw: bool = True,
    **options,
) -> Plan:
    """The timing of least ∫ (Σ wτ² + Σ λq̇²) dt on a path, whose geometry is kept exactly.

    Args:
        path: a motion, whose own timing does not count, or configurations (K, nv) [rad], K ≥ 2, through which a natural cubic
            spline is laid over the lengths between them.
        robot: the arm.
        duration: T [s], or (shortest, longest) to choose from.
        start_speed, goal_speed: ds/dt at the ends, s being the path's own time, or length [rad] of configurations.
        smooth_ends: whether the acceleration along the path vanishes at the ends, as in every other plan.
        spans: of the law's spline; by default as many as path and duration ask for.
        throw: raise where no valid timing is found; otherwise return the best attempt with its status.
        options: weights, limits and surroundings, as of `Problem` (`timing.task.OPTIONS` lists them). Limits of torque rates are
            checked, not sought.

    Returns:
        Plan: its trajectory is the path passed by the law; SOLVED only after the dense check.

    Raises:
        InputError: an argument makes no sense, the path leaves the position limits, or the duration is too short for it.
        NoSolutionFound: no valid timing was found; carries the best attempt.
    """
    began = now()
    task, durations = path_task(path, robot, duration, (start_speed, goal_speed), smooth_ends, options)
    guess = first_law(task, durations)
    count = span_count(task, guess.duration) if spans is None else whole("spans", spans, 8, 2000)
    problem = task.problem
    request = LawRequest(
        PathProfile(task.curve, robot), problem.limits, (problem.torque_weights, problem.velocity_weight), task.ends,
        durations, count,
    )  # fmt: skip
    built = now()
    with single_thread(), Interrupts() as interrupted:
        found = optimal_law(request, guess, interrupted)
    plan = _plan(task, found, count, {"compile": 0.0, "guess": 0.0, "build": built - began, "solve": now() - built})
    if throw and plan.status not in (Status.SOLVED, Status.INTERRUPTED):
        raise NoSolutionFound(plan)
    return plan


def _plan(task: PathTask, found: LawResult, spans: int, spent: dict[str, float]) -> Plan:
    began = now()
    motion = PathTrajectory(task.curve, found.law)
    problem = replace(task.problem, duration=motion.duration, **_end_rates(task, motion))
    terms, violations = cost(problem, motion), verify(problem, motion)
    broken = (Status.LIMITS_VIOLATED, "a timing was found, but the dense check found a limit exceeded")
    solved = (Status.SOLVED, "the path keeps its geometry; every limit holds on the dense check")
    valid = is_valid(violations)
    status, message = _STATUS.get(found.outcome) or (solved if valid else broken)
    if valid and status is Status.INFEASIBLE:
        status, message = (
            Status.NUMERICAL_ERROR,
            "a timing inside the limits was found, but the solver could not end with the best",
        )
    if status is not Status.SOLVED:
        message = f"{message} ({describe(violations)}{_known_durations(task)})"
    options = {"method": "retime", "spans": spans, "rounds": found.rounds, "limit_rows": found.rows}
    if task.fastest is not None:
        options["least_duration_s"] = task.fastest.duration
    return Plan(
        problem=problem, status=status, message=message, trajectory=motion, objective=sum(terms.values()), cost_terms=terms,
        violations=violations, discretization_error=None, iterations=found.iterations,
        time_s=spent | {"verify": now() - began}, seed=0, options=options, notes=problem.robot.notes,
    )  # fmt: skip


def _known_durations(task: PathTask) -> str:
    """Which durations are too short and which will do, for messages."""
    words = ""
    if task.fastest is not None:
        words = f"; at least {task.fastest.duration:.4g} s are needed, with accelerations that jump"
    if task.ends.speeds == (0.0, 0.0):
        quintic = PathTrajectory(task.curve, smooth_law(task.curve, 1.0))
        try:
            enough = uniform_scaling(quintic, task.problem.robot).least_duration(task.problem.limits)
        except InputError:
            return words
        words += f"; {enough:.4g} s are enough for a quintic law"
    return words


def _end_rates(task: PathTask, motion: Trajectory) -> dict[str, np.ndarray]:
    """Velocities and accelerations asked of the ends; accelerations that are free are those of the motion."""
    rates = {}
    for name, place, at, speed in (
        ("start", 0.0, 0.0, task.ends.speeds[0]),
        ("goal", task.curve.duration, motion.duration, task.ends.speeds[1]),
    ):
        still, free = speed is None, speed is None or not task.ends.smooth
        rates[f"{name}_velocity"] = 0.0 if still else task.curve(place, 1) * speed
        rates[f"{name}_acceleration"] = motion(at, 2) if free else task.curve(place, 2) * speed**2
    return rates
