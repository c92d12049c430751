"""A race of searches: all take one level, the best go on until J is as exact as asked, and the best of those that hold wins.

J on the knots that guesses begin with is some 10 % above that on finer ones, and not by the same share for all; one level further
it tells within 1 or 2 % which is best.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import islice

from energyopt.clock import now
from energyopt.optima import above, groups
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.plans import Violations
from energyopt.search import Search
from energyopt.search_state import STOP
from energyopt.solvers import Outcome
from energyopt.verification import is_valid, verify

MOST_LEVELS = 12
WIDE, MOST_RACED = 0.12, 6
"""Searches whose first level ends within 12 % of the best take part, so many at most."""
CLOSE, MOST_FINISHED = 0.015, 3
"""Of these, the best go on, and those within 1.5 % of it; so many at most."""
ALIKE = 0.01
"""Relative difference of J up to which two searches that are at one place run for the same optimum: only one takes part."""


@dataclass
class Judge:
    """The dense check of motions, done once a motion; ``seconds`` spent on it."""

    seconds: float = 0.0
    _known: dict[Trajectory, Violations] = field(default_factory=dict)

    def verdict(self, search: Search) -> Violations:
        if search.trajectory not in self._known:
            began = now()
            self._known[search.trajectory] = verify(search.problem, search.trajectory)
            self.seconds += now() - began
        return self._known[search.trajectory]

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
        late: whether a time limit has passed: from then on motions are looked at only, and nothing is solved.
    """

    search: Search
    accuracy: float | None
    judge: Judge
    levels: list[Search] = field(default_factory=list)
    reason: str = ""
    late: bool = False
    _ended: bool = False

    def __post_init__(self):
        self.search = self.search.copy()

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
            self.search.sketch = False
            self.levels.append(self.search.copy())
        self.late = self.late or self.search.options.late
        self._ended = self._ended or self.late or not (self.accuracy and self.search.converged) or not self._refine()
        return not self._ended

    def finish(self) -> Search:
        """Refine until the estimated error is below the accuracy asked; of all levels, the last that holds."""
        held = self._refined()
        if held is self.levels[-1] and held.gain is None and held.levels > 1:
            again = Runner(held, self.accuracy, self.judge)  # clearing the motion of the arm itself has made it another one
            held, self.reason = again._refined(), again.reason
        if self.reason and held.converged:
            held.reason = _stopped(held.error, self.reason)
        return held

    def _refined(self) -> Search:
        while self.step():
            pass
        for level in reversed(self.levels):
            kept, self.late = level.copy(), self.late or level.options.late
            if not self.late:
                level.harden(self.accuracy)
                self.late = level.outcome is Outcome.TIME_LIMIT
            if level.outcome is Outcome.INTERRUPTED:
                return level
            if self.late and self.judge.holds(kept):
                self.reason = "the time limit has passed"
                return kept
            if not self.late and self.judge.holds(level):
                if level is not self.levels[-1]:
                    self.reason = "a limit or the clearance did not hold on finer knots"
                return level
        if self.late:
            self.levels[-1].outcome = Outcome.TIME_LIMIT
        return self.levels[-1]

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


def winner(
    searches: Iterable[Search],
    others: Iterable[Search],
    accuracy: float | None,
    judge: Judge,
    sure: Iterable[Search] = (),
) -> Search:
    """Of promising searches, refined, the one of least J that holds; where none does, one of the others; else the least bad.

    Args:
        searches: in the order in which they were found.
        others: tried one after another, some of them, until one holds; not looked at before.
        accuracy: of J; None keeps the knots.
        judge: says what holds.
        sure: refined already, and known to hold.
    """
    searches = list(searches)
    finished: list[Search] = []
    held: list[Search] = []

    def ended(runner: Runner) -> bool:
        """Whether that was the last one, at the wish of the user or of a time limit."""
        finished.append(runner.finish())
        stopped = finished[-1].outcome in STOP
        if not stopped and judge.holds(finished[-1]):
            held.append(finished[-1])
        return stopped or runner.late

    runners = _started(searches, accuracy, judge)
    close = lambda runner: above(runner.objective, runners[0].objective) <= CLOSE
    stopped = any(ended(runner) for runner in runners if not held or close(runner))
    for search in () if held or stopped else islice(others, MOST_FINISHED):
        stopped = ended(Runner(search, accuracy, judge))
        if held or stopped:
            break
    if stopped and finished[-1].outcome is Outcome.INTERRUPTED:
        return finished[-1]
    if stopped and not held:
        held += [search for search in _cheapest(searches) if judge.holds(search)][:1]
    if held := [*held, *sure]:
        return min(held, key=lambda s: s.objective)
    return finished[-1] if stopped else min(finished, key=judge.excess)


def _cheapest(searches: list[Search]) -> list[Search]:
    """Some to look at as they are, where there is no time to refine them."""
    return sorted(searches, key=lambda search: search.objective)[:MOST_RACED]


def _started(searches: Iterable[Search], accuracy: float | None, judge: Judge) -> list[Runner]:
    """One level of each that may win; the best ones, best first."""
    ranked = _different(list(searches))
    close = [search for search in ranked if above(search.objective, ranked[0].objective) <= WIDE]
    runners = [Runner(search, accuracy, judge) for search in close[:MOST_RACED]]
    for runner in runners if len(runners) > 1 else ():
        if not runner.step() and runner.search.outcome in STOP:
            break
    return _different(sorted(runners, key=lambda runner: runner.objective))[:MOST_FINISHED]


def _different(ones: list) -> list:
    """Searches or runners, best first; of those at one place the earliest, so that chance does not choose."""
    found = groups([one.objective for one in ones], [one.trajectory for one in ones], ALIKE)
    return [ones[members[0]] for members in found]


def _stopped(error: float | None, reason: str) -> str:
    return f"refinement stopped at an estimated error of {_percent(error)}: {reason}"


def _percent(error: float | None) -> str:
    return "unknown size" if error is None else f"{100 * error:.2g} %"
