"""plan_sequence(): moves one after another, with waits between them, in a given time altogether, shared out so that J is least.

minimise Σ J_i(T_i) + p w   over the durations T_i and the spare time w ≥ 0,   Σ T_i + w = available time.

p is what the cheapest pose at rest costs a second: another second of a slow move may cost more than that. The curves J_i(T_i)
have several branches (a slow move may fold the arm, a fast one not), so they are no convex functions and the price of a second,
equal for all moves at the optimum, does not find it. They are sampled (see `sweep`), interpolated monotonically between samples
(F. N. Fritsch and R. E. Carlson, SIAM J. Numer. Anal. 17, 1980), and the time is shared out by dynamic programming over steps of
it; then the curves are sampled again around what was found, and the time is shared out in finer steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize

from energyopt.arguments import check_names, check_options, check_problem
from energyopt.costs import Samples
from energyopt.durations import duration_bounds
from energyopt.errors import InputError, NoSolutionFound, ProblemError
from energyopt.following import Follower
from energyopt.parameterizations import BSpline
from energyopt.planning import DEFAULTS, Parameterization, planned
from energyopt.plans import Plan, Status
from energyopt.problem import FramePose, Problem
from energyopt.problem_values import numbers, real, shown
from energyopt.readable import Readable, counted

SAME_PLACE = 1e-9
"""Difference [rad] between the goal of a move and the start of the next that is taken for rounding."""
ROUNDING = 1e-12
SAMPLES, STEPS = 10, 400
"""Durations at which each curve is sampled, and steps into which the time is divided."""
AROUND = np.array([0.85, 0.95, 1.0, 1.05, 1.15])
"""Durations at which the curves are sampled again, in units of those found."""


@dataclass(frozen=True, eq=False, repr=False)
class SequencePlan(Readable):
    """Moves one after another.

    Attributes:
        plans: one a move. waits: seconds at rest after each move, its dwell and, at one pose, the spare time; shape (M,).
        price: what another second would save [unit of J a second]: −dJ/dT, the same for all moves away from their bounds.
        waiting_cost: J of the waits.
    """

    plans: tuple[Plan, ...]
    waits: np.ndarray
    price: float
    waiting_cost: float

    @property
    def durations(self) -> np.ndarray:
        """Of the moves [s], shape (M,)."""
        return np.array([plan.duration for plan in self.plans])

    @property
    def cycle_time(self) -> float:
        """Moves and waits together [s]."""
        return float(self.durations.sum() + self.waits.sum())

    @property
    def objective(self) -> float:
        """J of moves and waits."""
        return sum(plan.objective for plan in self.plans) + self.waiting_cost

    @property
    def solved(self) -> bool:
        return all(plan.solved for plan in self.plans)

    @property
    def starts(self) -> np.ndarray:
        """When each move begins [s], shape (M,)."""
        return np.concatenate([[0.0], np.cumsum(self.durations + self.waits)[:-1]])

    def __call__(self, t: np.ndarray | float, order: int = 0) -> np.ndarray:
        """Position or a derivative at times ``t`` [s] of the whole, shape (N, nv) or (nv,)."""
        times = np.atleast_1d(np.asarray(t, float))
        move = np.clip(np.searchsorted(self.starts, times, side="right") - 1, 0, len(self.plans) - 1)
        values = np.empty((len(times), self.plans[0].problem.robot.nv))
        for k, plan in enumerate(self.plans):
            own = times[move == k] - self.starts[k]
            values[move == k] = plan.trajectory(np.clip(own, 0.0, plan.duration), order)
            if order:
                values[(move == k) & (times - self.starts[k] > plan.duration)] = 0.0
        return values[0] if np.ndim(t) == 0 else values

    def in_brief(self) -> str:
        return f"{counted(len(self.plans), 'move')}, {self.cycle_time:.4g} s, J {self.objective:.6g}"

    def __str__(self) -> str:
        lines = [f"{'move':>5} {'from [s]':>9} {'takes [s]':>9} {'then waits [s]':>14} {'J':>10}"]
        for k, (plan, start, wait) in enumerate(zip(self.plans, self.starts, self.waits, strict=True)):
            lines.append(f"{k + 1:5} {start:9.3f} {plan.duration:9.3f} {wait:14.3f} {plan.objective:10.5g}")
        total = f"{self.cycle_time:.4g} s, J = {self.objective:.6g} ({self.waiting_cost:.4g} of it waiting)"
        return "\n".join([*lines, f"{total}; another second would save {self.price:.4g}"])


def plan_sequence(
    moves: Sequence[Problem],
    cycle_time: float,
    dwells: Sequence[float] | float = 0.0,
    parameterization: Parameterization | None = None,
    **options: Any,
) -> SequencePlan:
    """Plan moves from rest to rest, one after another, so that they take a given time and cost the least altogether.

    Args:
        moves: each ends where the next begins; a move with a free duration is given a share of the time, others keep theirs.
        cycle_time: of all moves and waits together [s].
        dwells: seconds the arm has to rest after each move, one number a move or one for all.
        parameterization, options: as for `plan`, for every move.

    Returns:
        SequencePlan: a plan a move, waits [s], and what another second would save.

    Raises:
        InputError: the moves do not fit each other, or the time is too short. NoSolutionFound: a move has no valid plan.
        KeyboardInterrupt: Ctrl-C; there is no half of a sequence.
    """
    pauses, time = _checked(moves, cycle_time, dwells)
    parameterization = BSpline() if parameterization is None else parameterization
    check_names("plan_sequence", options, DEFAULTS)
    check_options(parameterization, given := DEFAULTS | options)
    holding = np.array([_holding_cost(move) for move in moves])
    idle, curves = float(holding.min()), [_Curve(move, parameterization, given, time) for move in moves]
    free = [curve for curve in curves if curve.move.free_duration]
    left = time - sum(curve.bounds[0] for curve in curves if not curve.move.free_duration)
    for curve in curves:
        curve.sample(np.geomspace(*curve.bounds, SAMPLES))
    lasting = _shared_out(free, left, idle)
    for curve, T in zip(free, lasting, strict=True):
        curve.sample(np.clip(T * AROUND, *curve.bounds))
    durations = iter(_shared_out(free, left, idle))
    plans = tuple(curve.plan(float(next(durations)) if curve in free else curve.bounds[0]) for curve in curves)
    waits = pauses.copy()
    waits[int(np.argmin(holding))] += max(0.0, time - sum(plan.duration for plan in plans))
    price = max((curve.price(plan.duration) for curve, plan in zip(curves, plans, strict=True) if curve in free), default=0.0)
    return SequencePlan(plans, waits, price, float(waits @ holding))


class _Curve:
    """J of a move against its duration.

    Attributes:
        move: the move. bounds: least and most duration that come into question [s].
    """

    def __init__(self, move: Problem, parameterization: Parameterization, given: dict, time: float):
        self.move, self._fine, self._given = move, parameterization, given
        keeps = isinstance(parameterization, BSpline)  # the shape of the curve is wanted here, not its last per cent
        self._coarse = replace(parameterization, accuracy=None) if keeps else parameterization
        least, most = move.durations
        self.bounds = (max(least, duration_bounds(move).lower), min(most, time)) if move.free_duration else move.durations
        self._found: dict[float, Plan] = {}
        self._failed: Plan | None = None

    def sample(self, durations: np.ndarray) -> None:
        """Plan the move for these durations as well.

        Raises:
            NoSolutionFound: no duration so far has a valid plan.
        """
        times, reason = np.setdiff1d(durations, list(self._found)), ""
        follower = Follower(self.move, self._coarse, self._given)
        for found in follower.optima(times) if times.size else ():
            reason = found.why or reason
            if found.plan is not None and found.plan.solved:
                self._found[found.duration] = found.plan
            elif found.plan is not None:
                self._failed = found.plan
        if follower.interrupted:
            raise KeyboardInterrupt  # there is no half of a sequence
        if not self._found:
            raise ProblemError(f"plan_sequence: {reason}") if self._failed is None else NoSolutionFound(self._failed)

    def cost(self, durations: np.ndarray) -> np.ndarray:
        """J at some durations; infinite where none was found."""
        times = sorted(self._found)
        if len(times) == 1:
            return np.where(np.isclose(durations, times[0], rtol=ROUNDING), self._found[times[0]].objective, np.inf)
        inside = (durations >= times[0] * (1 - ROUNDING)) & (durations <= times[-1] * (1 + ROUNDING))
        return np.where(inside, self._interpolant()(np.clip(durations, times[0], times[-1])), np.inf)

    def price(self, duration: float) -> float:
        """−dJ/dT."""
        return -float(self._interpolant().derivative()(duration)) if len(self._found) > 1 else 0.0

    def range(self) -> tuple[float, float]:
        """The least and the most duration for which there is a plan [s]."""
        return min(self._found), max(self._found)

    def plan(self, duration: float) -> Plan:
        """The plan for a duration, from that of the nearest one."""
        nearest = self._found[min(self._found, key=lambda T: abs(T - duration))]
        plan, _ = planned(self.move.lasting(duration), self._fine, self._given, guess=nearest.trajectory)
        if plan.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        if not plan.solved:
            raise NoSolutionFound(plan)
        return plan

    def _interpolant(self) -> PchipInterpolator:
        times = sorted(self._found)
        return PchipInterpolator(times, [self._found[T].objective for T in times])


def _shared_out(curves: list[_Curve], time: float, idle: float) -> np.ndarray:
    """Durations of the moves [s], (M,), whose cost, and that of the time to spare at ``idle`` a second, is least.

    Bellman's recursion F_k(s) = min_T F_{k−1}(s − T) + J_k(T) over even steps, then a descent from there.

    Raises:
        ProblemError: the moves take longer than that at least.
    """
    ranges = np.array([curve.range() for curve in curves]).reshape(-1, 2)
    least = ranges[:, 0].sum()
    if least > time * (1 + ROUNDING):
        words = f"{time:.4g} s are left for moves of free duration, which take {least:.4g} s at least"
        raise ProblemError(f"cycle_time: {words}; allow more time")
    lasting = _by_steps(curves, time, idle, ranges)
    if not len(curves):
        return lasting
    cost = lambda T: float(sum(curve.cost(t) for curve, t in zip(curves, T, strict=True)) + idle * (time - T.sum()))
    slope = lambda T: np.array([-curve.price(t) for curve, t in zip(curves, T, strict=True)]) - idle
    room = {"type": "ineq", "fun": lambda T: time - T.sum(), "jac": lambda T: -np.ones_like(T)}
    better = minimize(cost, lasting, jac=slope, bounds=ranges, constraints=[room], method="SLSQP")
    T = np.clip(better.x, *ranges.T)
    T *= min(1.0, time / T.sum())
    holds = np.all(ranges[:, 0] <= T) and cost(T) <= cost(lasting)
    return T if holds else lasting


def _by_steps(curves: list[_Curve], time: float, idle: float, ranges: np.ndarray) -> np.ndarray:
    """The recursion; every move takes its least duration and a whole number of steps."""
    spare = max(time - ranges[:, 0].sum(), 0.0)
    steps = np.linspace(0.0, spare, STEPS + 1)
    total, picks = np.zeros(STEPS + 1), []
    for curve, (least, most) in zip(curves, ranges, strict=True):
        own = np.where(least + steps <= most * (1 + ROUNDING), curve.cost(np.minimum(least + steps, most)), np.inf)
        table = np.full((STEPS + 1, STEPS + 1), np.inf)
        for n in range(STEPS + 1):
            table[n, : n + 1] = total[n::-1] + own[: n + 1]
        picks.append(table.argmin(axis=1))
        total = table.min(axis=1)
    here, taken = int(np.argmin(total + idle * (spare - steps))), []
    for pick in picks[::-1]:
        taken.append(steps[pick[here]])
        here -= int(pick[here])
    return np.minimum(ranges[:, 0] + np.array(taken[::-1]), ranges[:, 1])


def _holding_cost(move: Problem) -> float:
    """J of a second at rest at the goal of a move."""
    q, rest = move.goal_position[None], np.zeros((1, move.robot.nv))
    samples = Samples(q, rest, rest, rest, move.robot.torque(q, rest, rest))
    return float(sum(term.weight * term.integrand(samples).value[0] for term in move.cost_terms))


def _checked(moves: Sequence[Problem], cycle_time: float, dwells: Sequence[float] | float) -> tuple[np.ndarray, float]:
    """Waits after each move, and the time that is left for moves.

    Raises:
        InputError: says what does not fit.
    """
    if not isinstance(moves, Sequence) or not moves:
        raise InputError(f"plan_sequence: moves is {shown(moves)}: expected a list of problems")
    for k, move in enumerate(moves):
        check_problem("plan_sequence", move)
        if isinstance(move.goal, FramePose):
            raise InputError(f"moves[{k}]: the goal is a pose; expected joint positions, where the next move starts")
        if any(np.any(getattr(move, f"{end}_{rate}") != 0) for end in ("start", "goal") for rate in ("velocity", "acceleration")):
            raise InputError(f"moves[{k}]: starts or ends in motion; expected rest at both ends")
        following = moves[k + 1] if k + 1 < len(moves) else None
        if following is not None and not np.allclose(move.goal, following.start, rtol=0.0, atol=SAME_PLACE):
            i = int(np.argmax(np.abs(move.goal - following.start)))
            gap = f"joint {move.robot.joint_names[i]} by {abs(move.goal[i] - following.start[i]):.3g}"
            raise InputError(f"moves[{k + 1}]: does not start where moves[{k}] ends ({gap}); expected the same configuration")
    total = real("cycle_time", cycle_time, lambda t: 0 < t < np.inf, "seconds > 0")
    pauses = numbers("dwells", dwells, "seconds ≥ 0, one number or one a move")
    if pauses.ndim > 1 or pauses.size not in (1, len(moves)) or not np.all((pauses >= 0) & np.isfinite(pauses)):
        raise InputError(f"dwells is {shown(dwells)}: expected seconds ≥ 0, one number or {len(moves)}, one a move")
    pauses = np.broadcast_to(pauses, len(moves)).astype(float)
    least = sum(max(move.durations[0], duration_bounds(move).lower) for move in moves) + pauses.sum()
    if least > total:
        raise ProblemError(f"cycle_time is {total:.4g} s: moves and dwells take {least:.4g} s at least; allow more time")
    return pauses, total - float(pauses.sum())
