"""Plans made slower or faster as a whole: `rescale`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from energyopt.arguments import check_plan
from energyopt.clock import now
from energyopt.errors import InputError
from energyopt.plans import Plan, Status
from energyopt.problem import Waypoint
from energyopt.problem_values import duration as checked_duration
from energyopt.problem_values import shown
from energyopt.timing.uniform import UniformScaling, uniform_scaling
from energyopt.verification import cost, describe, is_valid, verify


def rescale(plan: Plan, duration: float | Callable[[UniformScaling], float]) -> Plan:
    """A plan made slower or faster as a whole, and checked anew; its geometry and the shape of its timing stay.

    Args:
        plan: what is scaled; velocities and accelerations of its ends, and times of its waypoints, are scaled with it.
        duration: T [s], or what chooses it from the closed form, such as ``lambda scaling: scaling.cheapest()``.

    Raises:
        InputError: no plan, or no such duration.
    """
    check_plan("rescale", plan)
    began, problem = now(), plan.problem
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
    spent = dict.fromkeys(plan.time_s, 0.0) | {"verify": now() - began}
    return replace(
        plan, problem=problem, status=Status.SOLVED if solved else Status.LIMITS_VIOLATED, message=message, trajectory=motion,
        objective=sum(terms.values()), cost_terms=terms, violations=violations, discretization_error=None, iterations=0,
        time_s=spent, options=plan.options | {"scaled_from_s": plan.duration}, notes=problem.robot.notes, optima=(),
    )  # fmt: skip


def _scaling(plan: Plan) -> UniformScaling:
    """The closed form of a plan's J; a potential of obstacles at rest costs the same every second, whatever the duration."""
    problem = plan.problem
    if problem.costs is not None:
        raise InputError("rescale: the closed form knows torque_weights and velocity_weight, not costs=[...]; give the duration")
    rate = plan.cost_terms.get("potential", 0.0) / plan.duration
    return uniform_scaling(plan.trajectory, problem.robot, problem.velocity_weight, problem.torque_weights, rate)


def _one_duration(given: float) -> float:
    T = checked_duration(given)
    if isinstance(T, tuple):
        raise InputError(f"duration is {shown(given)}: expected one number of seconds")
    return T
