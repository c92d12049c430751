"""A race of searches: all take one level, the best go on until J is as exact as asked, and the best of those that hold wins.

J on the knots that guesses begin with is some 10 % above that on finer ones, and not by the same share for all; one level further
it tells within 1 or 2 % which is best.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from energyopt.clock import now
from energyopt.optima import SAME_PLACE, place
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.plans import Violations
from energyopt.search import Search
from energyopt.searcher import STOP
from energyopt.solvers import Outcome
from energyopt.verification import is_valid, verify

MOST_LEVELS = 12
WIDE, MOST_RACED = 1.12, 6
"""Searches whose first level ends within 12 % of the best take part, so many at most."""
CLOSE, MOST_FINISHED = 1.015, 3
"""Of these, the best go on, and those within 1.5 % of it; so many at most."""
ALIKE = 0.01
"""Relative difference of J up to which two searches that are at one place run for the same optimum: only one takes part."""


@dataclass
class Judge:
    """The dense check of motions, done once a motion; ``seconds`` spent on it."""

    seconds: float = 0.0
    _last: tuple[Trajectory, Violations] | None = None

    def verdict(self, search: Search) -> Violations:
        if self._last is None or self._last[0] is not search.trajectory:
            began = now()
            self._last = (search.trajectory, verify(search.problem, search.trajectory))
            self.seconds += now() - began
        return self._last[1]

    def holds(self, search: Search) -> bool:
        """Whether a search converged to a motion inside all limits."""
        return search.converged and is_valid(self.verdict(search))

    def excess(self, search: Search) -> float:
        return max(self.verdict(search).amount.values(), default=0.0)


@dataclass
class Runner:
    """One search in the race, refined level by level.

    Attributes:
        accuracy: of J; None keeps the knots.
        levels: a copy of the search for every level it converged on; reason: why it stopped early, or nothing.
    """

    search: Search
    accuracy: float | None
    judge: Judge
    levels: list[Search] = field(default_factory=list)
    reason: str = ""
    _ended: bool = False

    def __post_init__(self):
        self.search = replace(self.search.copy(), sketch=False)

    @property
    def objective(self) -> float:
        return self.search.objective if not self.levels else self.levels[-1].objective

    @property
    def trajectory(self) -> Trajectory:
        return self.search.trajectory if not self.levels else self.levels[-1].trajectory

    def step(self) -> bool:
        """One level; False where there is no further one."""
        if not self.levels:
            self.search.ease()
            self.levels.append(self.search.copy())
        self._ended = self._ended or not (self.accuracy and self.search.converged) or not self._refine()
        return not self._ended

    def finish(self) -> Search:
        """Refine until the estimated error is below the accuracy asked; of all levels, the last that holds."""
        while self.step():
            pass
        held = last = self.levels[-1]
        for level in reversed(self.levels):
            level.harden(self.accuracy)
            if level.outcome in STOP or self.judge.holds(level):
                held = level
                break
        if held is last and held.gain is None and held.levels > 1:
            held = last = self._once_more(held)
        if held is not last:
            self.reason = "a limit or the clearance did not hold on finer knots"
        if self.reason and held.converged:
            held.reason = _stopped(held.error, self.reason)
        return held

    def _refine(self) -> bool:
        """Go on to finer knots, if J is not exact enough."""
        search = self.search
        reached = search.reaches(self.accuracy)
        self.levels[-1] = kept = search.copy()
        if reached:
            return False
        if search.levels >= MOST_LEVELS:
            self.reason = f"{MOST_LEVELS} levels were made"
        elif not search.refine(self.accuracy) or not search.advance():
            if search.outcome is Outcome.INTERRUPTED:
                kept.outcome = Outcome.INTERRUPTED
            self.reason = search.reason
        elif search.objective > kept.objective:  # finer spaces contain the coarser ones: this is the solver's own error
            self.reason = "finer knots gave no better motion"
        else:
            self.levels.append(search.copy())
            return True
        return False

    def _once_more(self, held: Search) -> Search:
        """Refined anew, since clearing the motion of the arm itself has made it another one."""
        again = Runner(held, self.accuracy, self.judge)
        while again.step():
            pass
        self.reason = again.reason
        return next((level for level in reversed(again.levels) if level.outcome in STOP or self.judge.holds(level)), held)


def winner(searches: Iterable[Search], others: list[Search], accuracy: float | None, judge: Judge) -> Search:
    """Of promising searches, refined, the one of least J that holds; where none does, one of the others; else the least bad.

    Args:
        searches: in the order in which they were found.
        others: tried one after another, some of them, until one holds.
        accuracy: of J; None keeps the knots.
        judge: says what holds.
    """
    finished: list[Search] = []
    held: list[Search] = []
    runners = _started(searches, accuracy, judge)
    for runner in [*runners, *(Runner(search, accuracy, judge) for search in others[:MOST_FINISHED])]:
        racing = any(runner is one for one in runners)
        if held and not (racing and runner.objective <= CLOSE * runners[0].objective):
            continue
        finished.append(runner.finish())
        if finished[-1].outcome in STOP:
            return min(held, key=lambda s: s.objective, default=finished[-1])
        if judge.holds(finished[-1]):
            held.append(finished[-1])
    return min(held, key=lambda s: s.objective) if held else min(finished, key=judge.excess)


def _started(searches: Iterable[Search], accuracy: float | None, judge: Judge) -> list[Runner]:
    """One level of each that may win; the best ones, best first."""
    ranked = _different(list(searches))
    runners = [Runner(s, accuracy, judge) for s in ranked if s.objective <= WIDE * ranked[0].objective][:MOST_RACED]
    for runner in runners if len(runners) > 1 else ():
        if not runner.step() and runner.search.outcome in STOP:
            break
    return _different(sorted(runners, key=lambda runner: runner.objective))[:MOST_FINISHED]


def _different(ones: list) -> list:
    """Searches or runners, best first; of those at one place the earliest, so that chance does not choose."""
    groups: list[tuple[float, np.ndarray, list[int]]] = []
    for k in sorted(range(len(ones)), key=lambda k: ones[k].objective):
        there = place(ones[k].trajectory)
        for objective, q, members in groups:
            if ones[k].objective <= (1.0 + ALIKE) * objective and np.abs(there - q).max() <= SAME_PLACE:
                members.append(k)
                break
        else:
            groups.append((ones[k].objective, there, [k]))
    return [ones[min(members)] for _, _, members in groups]


def _stopped(error: float | None, reason: str) -> str:
    return f"refinement stopped at an estimated error of {_percent(error)}: {reason}"


def _percent(error: float | None) -> str:
    return "unknown size" if error is None else f"{100 * error:.2g} %"
