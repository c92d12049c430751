"""New timings of motions that exist: `retime` a path at least cost, `rescale` a plan as a whole.

The geometry stays what it is, exactly: the result is p(s(t)) for the path p that was given and a law s(t) with ṡ ≥ 0. The law
minimises ∫ (Σ w τ² + Σ λ q̇²) dt within the limits (see `timing.law_program`), and the motion is put to the same
independent dense check as any plan's.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from energyopt.arguments import check_names, check_plan
from energyopt.errors import InputError, NoSolutionFound, ProblemError
from energyopt.parameterizations.path_trajectory import PathTrajectory
from energyopt.parameterizations.trajectory import PolynomialTrajectory, Trajectory
from energyopt.plans import Plan, Status
from energyopt.problem import Problem, Waypoint
from energyopt.problem_values import duration as checked_duration
from energyopt.problem_values import real, shown, whole
from energyopt.robots.model import RobotModel
from energyopt.solvers import Interrupts, Outcome
from energyopt.threads import single_thread
from energyopt.timing.law_search import LawRequest, LawResult, even_law, optimal_law, smooth_law, with_pause
from energyopt.timing.law_space import Ends
from energyopt.timing.paths import as_path, by_length, check_positions, is_still
from energyopt.timing.profile import PathProfile
from energyopt.timing.reachability import fastest
from energyopt.timing.uniform import UniformScaling, uniform_scaling
from energyopt.verification import cost, describe, is_valid, verify

OPTIONS = (
    "velocity_weight", "torque_weights", "position_limits", "velocity_limits", "acceleration_limits", "jerk_limits",
    "torque_limits", "torque_rate_limits", "obstacles", "workspace", "clearance", "self_collision", "attached", "name",
)  # fmt: skip
"""Arguments of `Problem` that `retime` takes too."""
QUICK = 1.15
"""Times the shortest duration that a first law moves for; the rest it waits where the arm is held most cheaply, as optima do."""
LEAST_SPANS, MOST_SPANS = 40, 120
SPANS_PER_LEAST = 30
"""Spans in the shortest duration of the path: what happens fast in a slow motion needs them too."""
TOO_SHORT = 0.97
"""Share of the shortest duration below which none is looked for: the grid it was found on leaves an error."""
TOO_SHORT_WITH_FRICTION = 0.8
"""The same where friction, which is counted on the safe side, has made it longer."""
_STATUS = {
    Outcome.INFEASIBLE: (Status.INFEASIBLE, "no timing of this path inside the limits was found"),
    Outcome.FAILED: (Status.INFEASIBLE, "no timing of this path inside the limits was found"),
    Outcome.ITERATION_LIMIT: (Status.ITERATION_LIMIT, "the solver ran out of iterations"),
    Outcome.TIME_LIMIT: (Status.TIME_LIMIT, "the time limit passed"),
    Outcome.INTERRUPTED: (Status.INTERRUPTED, "interrupted; this is the best timing so far"),
}


@dataclass(frozen=True, eq=False)
class _Task:
    """A path to be timed: the curve, the problem that limits and weights come from, the law's ends, the fastest law."""

    curve: Trajectory
    problem: Problem
    ends: Ends
    fastest: _Fastest | None


@dataclass(frozen=True, eq=False)
class _Fastest:
    """How fast a path can be passed.

    Attributes:
        law: s(t). motion: the motion it gives.
    """

    law: Trajectory
    motion: Trajectory

    @property
    def duration(self) -> float:
        return self.law.duration


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
        options: weights, limits and surroundings, as of `Problem`: see `OPTIONS`. A limit of torque rates is checked, not sought.

    Returns:
        Plan: its trajectory is the path passed by the law; SOLVED only after the dense check.

    Raises:
        InputError: an argument makes no sense, the path leaves the position limits, or the duration is too short for it.
        NoSolutionFound: no valid timing was found; carries the best attempt.
    """
    began = time.perf_counter()
    task, durations = _task(path, robot, duration, (start_speed, goal_speed), smooth_ends, options)
    guess = _guess(task, durations)
    count = _spans(task, guess.duration) if spans is None else whole("spans", spans, 8, 2000)
    problem = task.problem
    request = LawRequest(
        PathProfile(task.curve, robot), problem.limits, (problem.torque_weights, problem.velocity_weight), task.ends,
        durations, count,
    )  # fmt: skip
    built = time.perf_counter()
    with single_thread(), Interrupts() as interrupted:
        found = optimal_law(request, guess, interrupted)
    plan = _plan(task, found, count, {"build": built - began, "compile": 0.0, "solve": time.perf_counter() - built})
    if throw and plan.status not in (Status.SOLVED, Status.INTERRUPTED):
        raise NoSolutionFound(plan)
    return plan


def rescale(plan: Plan, duration: float | Callable[[UniformScaling], float]) -> Plan:
    """A plan made slower or faster as a whole, and checked anew; its geometry and the shape of its timing stay.

    Args:
        plan: what is scaled; velocities and accelerations of its ends, and times of its waypoints, are scaled with it.
        duration: T [s], or what chooses it from the closed form, such as ``lambda scaling: scaling.cheapest()``.

    Raises:
        InputError: no plan, or no such duration.
    """
    check_plan("rescale", plan)
    began, problem = time.perf_counter(), plan.problem
    if callable(duration):
        duration = duration(_scaling(plan))
    T = _one_duration(duration)
    ratio = plan.duration / T
    changed = {f"{end}_{kind}": getattr(problem, f"{end}_{kind}") * ratio**power
               for end in ("start", "goal") for kind, power in (("velocity", 1), ("acceleration", 2))}  # fmt: skip
    stops = [Waypoint(w.position, None if w.time is None else w.time / ratio) for w in problem.waypoints]
    problem = replace(problem, duration=T, waypoints=stops, **changed)
    motion = plan.trajectory.stretched(T)
    terms, violations = cost(problem, motion), verify(problem, motion)
    solved = is_valid(violations)
    message = f"scaled from {plan.duration:.4g} s to {T:.4g} s; {describe(violations)}"
    spent = {"build": 0.0, "compile": 0.0, "solve": 0.0, "verify": time.perf_counter() - began}
    return replace(
        plan, problem=problem, status=Status.SOLVED if solved else Status.LIMITS_VIOLATED, message=message, trajectory=motion,
        objective=sum(terms.values()), cost_terms=terms, violations=violations, discretization_error=None, iterations=0,
        time_s=spent, options=plan.options | {"scaled_from_s": plan.duration},
    )  # fmt: skip


def _scaling(plan: Plan) -> UniformScaling:
    """The closed form of a plan's J; a potential of obstacles at rest costs the same every second, whatever the duration."""
    problem = plan.problem
    if problem.costs is not None:
        raise InputError("rescale: the closed form knows torque_weights and velocity_weight, not costs=[...]; give the duration")
    rate = plan.cost_terms.get("potential", 0.0) / plan.duration
    return uniform_scaling(plan.trajectory, problem.robot, problem.velocity_weight, problem.torque_weights, rate)


def _task(
    path: Trajectory | ArrayLike,
    robot: RobotModel,
    duration: float | tuple[float, float],
    speeds: tuple[float, float],
    smooth_ends: bool,
    options: dict,
) -> tuple[_Task, tuple[float, float]]:
    """The path as a task, and the shortest and longest duration it may get."""
    if not isinstance(robot, RobotModel):
        raise InputError(f"retime: robot is {shown(robot)}: expected what energyopt.load_robot gives")
    check_names("retime", options, OPTIONS)
    if not isinstance(smooth_ends, bool):
        raise InputError(f"smooth_ends is {shown(smooth_ends)}: expected True or False")
    speeds = tuple(real(key, x, lambda v: 0 <= v < np.inf, "a number ≥ 0: a law never runs backwards")
                   for key, x in zip(("start_speed", "goal_speed"), speeds, strict=True))  # fmt: skip
    curve, given = as_path(path, robot), checked_duration(duration)
    problem = Problem(robot, curve(0.0), curve(curve.duration), given, **options)
    check_positions(curve, robot, problem.limits)
    ends = Ends(tuple(None if is_still(curve, end) else v for end, v in zip((0, -1), speeds, strict=True)), smooth_ends)
    law = _fastest(curve, robot, problem, ends.speeds)
    low, high = problem.durations
    if law is not None:
        low = max(low, _shortest(law, robot, high))
    return _Task(curve, problem, ends, law), (low, high)


def _fastest(curve: Trajectory, robot: RobotModel, problem: Problem, speeds: tuple[float | None, ...]) -> _Fastest | None:
    """The fastest law; None where nothing limits it. A path that stands still at an end is passed over its length."""
    limits = problem.limits
    if not any(np.any(np.isfinite(x)) for x in (limits.velocity, limits.acceleration, limits.torque)):
        return None
    if None not in speeds:
        law = fastest(curve, robot, limits, *speeds).places()
        return _Fastest(law, PathTrajectory(curve, law))
    even, u, places = by_length(curve)
    law = fastest(even, robot, limits).places()
    s = np.interp(law(law.breaks)[:, 0], u, places)
    steps = np.stack([s[:-1], np.diff(s) / np.diff(law.breaks)], axis=1)[:, :, None]
    return _Fastest(PolynomialTrajectory(law.breaks, steps), PathTrajectory(even, law))


def _shortest(law: _Fastest, robot: RobotModel, longest: float) -> float:
    """The duration from which a law is looked for, or an error where ``longest`` is below it."""
    dynamics = robot.dynamics
    rubs = np.any(dynamics.viscous_friction) or np.any(dynamics.coulomb_friction)
    least = (TOO_SHORT_WITH_FRICTION if rubs else TOO_SHORT) * law.duration
    if longest < least:
        raise ProblemError(
            f"duration: {longest:g} s is too short for this path: within the limits it takes at least {law.duration:.4g} s; "
            "allow more time, or higher limits"
        )
    return min(least, longest)


def _guess(task: _Task, durations: tuple[float, float]) -> Trajectory:
    """The fastest law made to take the duration asked, or the cheapest that may be, with a pause; a smooth one without limits."""
    if task.fastest is not None:
        law, motion = task.fastest.law, task.fastest.motion
    else:
        shape = even_law if task.ends.speeds == (None, None) else smooth_law
        law = shape(task.curve, float(np.sqrt(durations[0] * durations[1])))
        motion = PathTrajectory(task.curve, law)
    T, problem = durations[0], task.problem
    if durations[0] < durations[1]:
        scaling = uniform_scaling(motion, problem.robot, problem.velocity_weight, problem.torque_weights)
        T = scaling.cheapest(durations)
    moving = QUICK * law.duration
    if task.fastest is None or moving >= T:
        return law.stretched(T)
    places = task.curve.sample_times(20)
    q = task.curve(places)
    held = problem.robot.torque(q, np.zeros_like(q), np.zeros_like(q)) ** 2 @ problem.torque_weights
    if np.ptp(held) <= 1e-9 * np.max(held, initial=1.0):  # it waits nowhere more cheaply than elsewhere
        return law.stretched(T)
    return with_pause(law.stretched(moving), float(places[np.argmin(held)]), T - moving)


def _spans(task: _Task, duration: float) -> int:
    ratio = 1.0 if task.fastest is None else duration / task.fastest.duration
    wanted = max(LEAST_SPANS, SPANS_PER_LEAST * ratio, len(task.curve.breaks) - 1)
    return int(min(wanted, MOST_SPANS))


def _plan(task: _Task, found: LawResult, spans: int, spent: dict[str, float]) -> Plan:
    began = time.perf_counter()
    motion = PathTrajectory(task.curve, found.law)
    problem = replace(task.problem, duration=motion.duration, **_end_rates(task, motion))
    terms, violations = cost(problem, motion), verify(problem, motion)
    broken = (Status.LIMITS_VIOLATED, "a timing was found, but the dense check found a limit exceeded")
    solved = (Status.SOLVED, "the path keeps its geometry; every limit holds on the dense check")
    status, message = _STATUS.get(found.outcome) or (solved if is_valid(violations) else broken)
    if status is not Status.SOLVED:
        message = f"{message} ({describe(violations)}{_known_durations(task)})"
    options = {"method": "retime", "spans": spans, "rounds": found.rounds, "limit_rows": found.rows}
    if task.fastest is not None:
        options["least_duration_s"] = task.fastest.duration
    return Plan(
        problem=problem, status=status, message=message, trajectory=motion, objective=sum(terms.values()), cost_terms=terms,
        violations=violations, discretization_error=None, iterations=found.iterations,
        time_s=spent | {"verify": time.perf_counter() - began}, seed=0, options=options, notes=problem.robot.notes,
    )  # fmt: skip


def _known_durations(task: _Task) -> str:
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


def _end_rates(task: _Task, motion: Trajectory) -> dict[str, np.ndarray]:
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


def _one_duration(given: float) -> float:
    T = checked_duration(given)
    if isinstance(T, tuple):
        raise InputError(f"duration is {shown(given)}: expected one number of seconds")
    return T
