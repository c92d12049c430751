"""The optimum of a problem at several durations, each sought near that of a neighbour.

The problem is solved once in the middle of the durations; from there the optimum is followed to both sides, each motion starting
from its neighbour's, run through in its own time, on the same knots and with the rows found so far. Where two neighbours have
reached different optima, the better one is carried over as well: J of a stretched motion is known before anything is solved.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from energyopt.errors import ProblemError
from energyopt.parcels import packed, unpacked
from energyopt.planning import Parameterization, planned
from energyopt.plans import Plan, Status
from energyopt.pool import Workers
from energyopt.problem import Problem
from energyopt.search import Search
from energyopt.verification import objective

WORTH_CARRYING = 0.01
"""Share of J that a neighbour's motion has to promise before a duration is solved again, and to give to be taken."""
OTHER_BRANCH = 0.08
"""Share of J by which a longer motion has to be cheaper than a slowed one, to be another optimum."""
ENOUGH = 1.5
"""Estimated errors up to this many times the accuracy asked are accepted where knots are taken over from a neighbour."""
WORTH_PROCESSES = 6.0
"""Estimated seconds from which a second process, which takes some to start, is worth it."""
SHARE = 0.5
"""Estimated time of a solve that follows another, as a share of the first."""
LEFT_OUT = "interrupted before it was planned"


@dataclass(frozen=True, eq=False)
class Found:
    """What there is at one duration [s]: a plan or None, the search that found it or None, and why there is no plan."""

    duration: float
    plan: Plan | None
    search: Search | None = None
    why: str = ""

    @property
    def price(self) -> float:
        """J; infinite where there is no valid plan."""
        return self.plan.objective if self.plan is not None and self.plan.solved else np.inf

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C has ended the search, or kept it from beginning."""
        return self.why == LEFT_OUT or (self.plan is not None and self.plan.status is Status.INTERRUPTED)

    def sent(self) -> Found:
        """Without what cannot be sent to another process, or is there already."""
        plan = self.plan and replace(self.plan, problem=None)
        return replace(self, plan=plan, search=self.search and self.search.sent())

    def received(self, problem: Problem) -> Found:
        """What was `sent`, to go on from; ``problem`` has this duration."""
        plan = self.plan and replace(self.plan, problem=problem)
        return replace(self, plan=plan, search=self.search and self.search.received(problem))


def left_out(times: np.ndarray) -> list[Found]:
    """Durations that were not reached before Ctrl-C."""
    return [Found(float(T), None, why=LEFT_OUT) for T in times]


class Follower:
    """Follows the optima of a problem.

    Attributes:
        problem: its own duration does not matter. parameterization, given: as for `planning.planned`.
        interrupted: whether Ctrl-C came while it was at work; what had been found by then is kept.
    """

    def __init__(self, problem: Problem, parameterization: Parameterization, given: dict):
        self.problem, self.parameterization, self.given = problem, parameterization, given
        self.interrupted = False

    def optima(self, times: np.ndarray, processes: int = 1) -> list[Found]:
        """The optimum at each of some rising durations [s], (N,)."""
        middle = len(times) // 2
        first = self._kept(self._cold, times[middle])
        sides = times[middle - 1 :: -1] if middle else times[:0], times[middle + 1 :]
        spent = SHARE * len(times) * sum(first.plan.time_s.values()) if first.plan is not None else 0.0
        if processes > 1 and spent > WORTH_PROCESSES and all(map(len, sides)):
            below, above = self._side_by_side(first, *sides)
        else:
            begun = first.search if first.price < np.inf else None
            below, above = (self.chain(side, begun) for side in sides)
        return self._carried([*below[::-1], first, *above])

    def chain(self, times: np.ndarray, begun: Search | None) -> list[Found]:
        """The optimum at each duration, one after another, from a search at a neighbour of the first."""
        chain, anchor = [], begun
        for k, T in enumerate(times):
            if self.interrupted:
                return [*chain, *left_out(times[k:])]
            chain.append(self._kept(self._near, T, begun))
            if (search := chain[-1].search) is not None and chain[-1].plan.solved:
                anchor = anchor or search
                begun = search.on_knots_of(anchor)
        return chain

    def _kept(self, find: Callable[..., Found], duration: float, *more: Any) -> Found:
        """What ``find`` finds; nothing where Ctrl-C comes between two solves, where `planned` does not hold it."""
        try:
            found = find(duration, *more)
        except KeyboardInterrupt:
            found = Found(float(duration), None, why=LEFT_OUT)
        self.interrupted |= found.interrupted
        return found

    def _cold(self, duration: float) -> Found:
        """From the usual guesses."""
        try:
            return Found(float(duration), *planned(self.problem.lasting(float(duration)), self.parameterization, self.given))
        except ProblemError as error:
            return Found(float(duration), None, why=str(error))

    def _near(self, duration: float, begun: Search | None) -> Found:
        """Near the optimum of another duration; where it leads to no valid motion, from the usual guesses."""
        if begun is None:
            return self._cold(duration)
        problem = self.problem.lasting(float(duration))
        try:
            found = Found(float(duration), *planned(problem, self.parameterization, self.given, begun=begun))
        except ProblemError as error:
            return Found(float(duration), None, why=str(error))
        return found if found.interrupted or (found.plan.solved and self._accurate(found.plan)) else self._cold(duration)

    def _accurate(self, plan: Plan) -> bool:
        """Whether knots made for another duration do for this one, by a margin: the estimate is one."""
        wanted, error = getattr(self.parameterization, "accuracy", None), plan.discretization_error
        return wanted is None or (error is not None and error <= ENOUGH * wanted)

    def _side_by_side(self, first: Found, shorter: np.ndarray, longer: np.ndarray) -> tuple[list[Found], list[Found]]:
        """The chains to both sides, that of the longer durations in another process."""
        begun = first.search if first.price < np.inf else None
        with Workers(1) as workers:
            sent = None if begun is None else begun.sent()
            away: Future = workers.submit(
                chain_of_parcel, packed(self.problem), longer, self.parameterization, self.given, sent
            )
            below = self.chain(shorter, begun)
            try:
                above = [] if self.interrupted else away.result()
            except KeyboardInterrupt:
                self.interrupted, above = True, []
            if self.interrupted:
                workers.shutdown(wait=False)
        return below, [found.received(self.problem.lasting(found.duration)) for found in above] or left_out(longer)

    def _carried(self, found: list[Found]) -> list[Found]:
        """Better optima carried over from neighbours, upwards and then downwards."""
        for step in (1, -1):
            for k in range(len(found))[::step]:
                if self.interrupted:
                    return found
                mine, other = found[k], found[k - step] if 0 <= k - step < len(found) else None
                if other is None or not _promises(mine, other.plan):
                    continue
                answer = self._kept(self._near, mine.duration, other.search)
                found[k] = min((mine, answer), key=lambda one: one.price)
        return found


def chain_of_parcel(
    parcel, times: np.ndarray, parameterization: Parameterization, given: dict, begun: Search | None
) -> list[Found]:
    """In a worker: `Follower.chain`, without what the caller has or cannot be sent."""
    problem = unpacked(parcel)
    begun = None if begun is None else begun.received(problem)
    return [found.sent() for found in Follower(problem, parameterization, given).chain(times, begun)]


def _promises(mine: Found, other: Plan | None) -> bool:
    """Whether the neighbour has found another, better optimum, so far as can be told without solving.

    A motion slowed down keeps its limits, so J of it is a bound of what its branch costs at the longer of the two durations.
    """
    plan = mine.plan
    if other is None or not other.solved:
        return False
    if plan is None or not plan.solved:
        return plan is not None
    if other.duration < mine.duration:
        return objective(plan.problem, other.trajectory.stretched(mine.duration)) < (1.0 - WORTH_CARRYING) * plan.objective
    slowed = objective(other.problem, plan.trajectory.stretched(other.duration))
    return other.objective < (1.0 - OTHER_BRANCH) * slowed
