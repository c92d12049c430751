"""`plan_robust`: one motion that every arm between given bounds can make.

The planner works with the arm as modelled. Where some corner needs more than the torque limit L_i of a joint, at the worst time
t*, the limit that the planner works with is lowered by what that corner adds there, and it plans again:

    L_plan,i ← min( L_i − (1 + ε) ( max_corners |τ_i(t*)| − |τ_nominal,i(t*)| ),  (1 − δ) L_plan,i )

Limits of the torque rate are lowered by the factor by which the worst corner exceeds them. Torque is affine in what is uncertain,
so a motion that holds in all corners holds between them. It is returned only if the dense check passes in every corner. Lower
limits are sufficient, not necessary: a motion of less cost may exist that also holds.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from energyopt.arguments import check_names, check_problem
from energyopt.errors import NoSolutionFound, ProblemError
from energyopt.feasibility import check_feasibility
from energyopt.planning import plan
from energyopt.plans import Plan, Status
from energyopt.problem import Problem
from energyopt.problem_values import whole
from energyopt.robots.payload import Payload
from energyopt.robust.evaluation import Robustness, TorqueFamily, corner_problem, evaluate
from energyopt.robust.uncertainty import Uncertainty
from energyopt.sampling import sample_spans
from energyopt.verification import verify

MARGIN, LEAST_CUT = 0.02, 2e-3
"""ε, so that the next motion ends inside and not on the edge; δ, so that every round changes something."""
PER_SPAN = 40
"""Samples a span at which the worst torques are looked for."""
MOST_ROUNDS = 50


def plan_robust(
    problem: Problem,
    payload: float | tuple[float, float] | None = None,
    masses: float = 0.0,
    friction: float = 0.0,
    *,
    load: Payload | None = None,
    samples: int = 100,
    seed: int = 0,
    rounds: int = 15,
    throw: bool = True,
    **options: Any,
) -> tuple[Plan, Robustness]:
    """Plan a motion whose limits hold for every arm between bounds.

    Args:
        problem: what is asked; its robot is the one whose cost is minimised.
        payload, masses, friction, load: the bounds, see `Uncertainty`.
        samples: draws of the report. seed: of the draws and of the guesses.
        rounds: plans at most.
        throw: raise where no motion holds; otherwise return the last one with its status.
        options: further ones of `energyopt.plan`.

    Returns:
        The plan, judged by the limits of ``problem``, and its robustness.

    Raises:
        InputError: an argument makes no sense, or some corner cannot even hold the arm at start or goal.
        NoSolutionFound: no motion was found that holds in every corner.
    """
    check_problem("plan_robust", problem)
    check_names("plan_robust", options, ("parameterization", *(plan.__kwdefaults__ or {})))
    whole("rounds", rounds, 1, MOST_ROUNDS)
    uncertainty = Uncertainty(payload, masses, friction, load)
    uncertainty.check(problem.robot)
    _check_corners(problem, uncertainty)
    limits = {key: np.array(getattr(problem.limits, key)) for key in ("torque", "torque_rate")}
    for number in range(1, rounds + 1):
        found = _plan(problem, limits, number, options | {"seed": seed, "throw": False})
        report = evaluate(problem, found.trajectory, uncertainty, samples, seed)
        if not found.solved or report.holds:
            break
        limits = _lowered(problem, found, uncertainty, limits)
    judged = _judged(problem, found, report, limits, number)
    if throw and not judged.solved:
        raise NoSolutionFound(judged)
    return judged, report


def _check_corners(problem: Problem, uncertainty: Uncertainty) -> None:
    """No motion helps a corner that cannot hold the arm at start or goal.

    Raises:
        ProblemError: names the corner.
    """
    check_feasibility(problem)
    for case in uncertainty.corners():
        try:
            check_feasibility(corner_problem(problem, uncertainty, case))
        except ProblemError as error:
            raise ProblemError(f"{error} (with {case}, which is within the bounds asked for)") from None


def _plan(problem: Problem, limits: dict[str, np.ndarray], number: int, options: dict[str, Any]) -> Plan:
    """A plan within lowered limits of torque and torque rate.

    Raises:
        ProblemError: the lowered limits leave no motion at all.
    """
    try:
        lowered = replace(problem, torque_limits=limits["torque"], torque_rate_limits=limits["torque_rate"])
        return plan(lowered, **options)
    except ProblemError as error:
        if number == 1:
            raise
        raise ProblemError(f"no motion was found that every arm within the bounds can make: {error}; narrow them") from None


def _lowered(problem: Problem, found: Plan, uncertainty: Uncertainty, limits: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Limits for the next round, each of shape (nv,) [N·m, N·m/s].

    Raises:
        ProblemError: what is uncertain leaves nothing of a limit.
    """
    family = TorqueFamily.along(problem.robot, sample_spans(found.trajectory, PER_SPAN), uncertainty)
    corners = [family.torque(case) for case in uncertainty.corners()]
    worst, joints = np.max(np.abs(corners), axis=0), np.arange(problem.robot.nv)
    row = np.argmax(worst, axis=0)
    added = np.maximum(worst[row, joints] - np.abs(family.base[row, joints]), 0.0)
    asked, share = problem.limits.torque, worst[row, joints] / problem.limits.torque
    # A sample may miss the peak between two: what is within δ of the limit counts as beyond it.
    beyond = share > 1.0 - LEAST_CUT
    torque = np.where(beyond, np.minimum(asked - (1.0 + MARGIN) * added, (1.0 - LEAST_CUT) * limits["torque"]), limits["torque"])
    if np.any(torque <= 0):
        joint = problem.robot.joint_names[int(np.argmin(torque))]
        remedy = "narrow the bounds, or take a longer duration"
        raise ProblemError(f"joint '{joint}': what is uncertain takes more than its whole torque limit; {remedy}")
    return {"torque": torque, "torque_rate": limits["torque_rate"] / _rate_excess(problem, family.t, corners)}


def _rate_excess(problem: Problem, t: np.ndarray, corners: list[np.ndarray]) -> np.ndarray:
    """By which factor the worst corner exceeds each limit of the torque rate, with a margin; 1 where it does not, shape (nv,)."""
    steps = np.diff(t)
    inside = steps > 0  # breaks come twice
    rates = [np.abs(np.diff(tau, axis=0)[inside] / steps[inside, None]).max(axis=0) for tau in corners]
    excess = np.max(rates, axis=0) / problem.limits.torque_rate
    return np.where(excess > 1.0 - MARGIN, np.maximum(excess, 1.0) * (1.0 + MARGIN), 1.0)


def _judged(problem: Problem, found: Plan, report: Robustness, limits: dict[str, np.ndarray], number: int) -> Plan:
    """The plan as one of the problem with its own limits; solved only if every corner holds."""
    lowered = []
    for key, planned in limits.items():
        finite = np.isfinite(planned)
        least = np.min(planned[finite] / getattr(problem.limits, key)[finite], initial=1.0)
        lowered += [f"{key.replace('_', ' ')} limits down to {100 * least:.0f} %"] if least < 1.0 else []
    rounds = f"{number} round{'s' if number > 1 else ''}, {' and '.join(lowered) or 'no limit lowered'}"
    note = f"Made for {report.uncertainty} in {rounds}."
    changes: dict[str, Any] = {"problem": problem, "violations": verify(problem, found.trajectory), "notes": (*found.notes, note)}
    if found.solved and not report.holds:
        name, use = max(report.limits.items(), key=lambda item: item[1].share)
        plain = name.removesuffix("_percent").replace("_", " ")
        broken = f"{plain} of {use.joint} is at {use.share:.1f} % of its limit at {use.time:.3f} s with {use.case}"
        message = f"after {number} rounds some arm within the bounds still exceeds a limit: {broken}"
        changes |= {"status": Status.LIMITS_VIOLATED, "message": message}
    return replace(found, **changes)
