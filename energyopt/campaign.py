"""A campaign: all guesses and searches that one call of `plan` makes.

Where nothing but the arm itself is in the way, guesses come in rounds. Those of the first differ from each other; each leads to
an optimum of an arm that is not in its own way, and as far as one of them can be the best, links are kept apart there. Later
rounds change the best optima found by then. Among obstacles see `detours`. At last there is a race (`racing`).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import chain, islice

import numpy as np

from energyopt.attempts import Attempt, Attempts, is_plain
from energyopt.avoidance import avoidance_of
from energyopt.detours import Detours
from energyopt.dynamics.kernels import Kernels
from energyopt.fanout import search_in_processes
from energyopt.found import SAME, Found
from energyopt.optima import Optimum, above
from energyopt.parameterizations import BSpline
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import FramePose, Problem
from energyopt.racing import Judge, Runner, winner
from energyopt.refinement import ALIKE, DOUBT, difference
from energyopt.search import Search
from energyopt.search_state import SearchOptions
from energyopt.searcher import FIRMEST, Parameterization, Searcher, is_promising
from energyopt.serving import alone
from energyopt.solvers import Outcome
from energyopt.workers import Worker

STARTS = 64
"""Guesses by default, at most, where a search takes milliseconds: splines, compiled kernels, and no obstacles. How often that is
enough is measured by `problems/benchmarks/optima.py`."""
BLOCK = 8
"""Guesses after which it is asked whether all optima are known, and no more are needed."""
HOPS, LEAST_HOPS = 0.4, 2
"""Share of the guesses that are changed copies of the best optima the others have led to."""
HOP_ROUNDS = 4
"""Rounds of these: what one finds is changed in the next."""
KINDS = ("best", "alone", "cheapest", "alone")
"""What is changed, in turn, where the arm is in its own way; see `Campaign._hops`."""
GUESSING = 0.6
"""Share of a time limit for guesses, once one has led to an optimum; the rest is for refining."""
MOST_INFEASIBLE = 8
"""Guesses after which, where all contradict the limits, there are no more: these knots hold no motion."""
FALLBACKS = 3
"""Further guesses tried where the first ones lead to no valid motion."""
WORTH_PROCESSES = 6.0
"""Estimated time of further searches [s] from which processes, which take seconds to start, are worth it."""


@dataclass
class Campaign:
    """All searches of one call of `plan`.

    Attributes:
        problem: with the duration to start from; durations: its bounds [s], where it is free.
        given: a motion the caller starts from; path_search: what looks for ways around obstacles.
        optima: distinct ones, once `run` has ended.
    """

    problem: Problem
    parameterization: Parameterization
    kernels: Kernels
    options: SearchOptions
    seed: int
    path_search: str = "auto"
    durations: tuple[float, float] | None = None
    given: Trajectory | None = None
    found: Found = field(default_factory=Found)
    judge: Judge = field(default_factory=Judge)
    optima: tuple[Optimum, ...] = ()
    began: float = field(default_factory=time.monotonic)
    _sure: list[Search] = field(default_factory=list)
    _workers: list[Worker] = field(default_factory=list)

    def __post_init__(self):
        how = self.problem, self.parameterization, self.kernels, self.options, self.durations
        self.searcher = Searcher(*how, avoidance_of(self.problem))
        until = np.inf if self.options.deadline is None else self.options.deadline
        self.attempts = Attempts(self.problem, self.kernels, self.seed, self.given, self.path_search, until)

    def run(self, starts: int | None) -> Search:
        """The best search, refined."""
        try:
            return self._run(starts)
        finally:
            for worker in self._workers:
                worker.end()

    def _run(self, starts: int | None) -> Search:
        targets = self.attempts.targets()
        source = self.attempts.all(targets)
        found, detours = self.found, Detours(self.searcher, self.found, targets)
        wanted, thrifty = starts or self._starts(targets), starts is None
        if is_plain(self.problem):
            self._search_in_rounds(source, targets, wanted, thrifty)
        else:
            if self.given is None:
                detours.begin(self.seed)
            self._search_among_obstacles(source, wanted)
        if starts is None and len(found.searches) == 1:
            detours.go_on(source)
        self.optima = found.optima(self.seed)
        if found.last.outcome is Outcome.INTERRUPTED:
            return self.interrupted()
        if found.infeasible and not found.any_promising:
            for search in self.searcher.on_finer_knots(next(self.attempts.all(targets))):
                found.add(search)
        return self._best()

    def resume(self, begun: Search) -> Search:
        """The optimum near that of a similar problem: on its knots, with its rows, in the time of this one."""
        posed = isinstance(self.problem.goal, FramePose)
        targets = [begun.trajectory(begun.trajectory.duration)] if posed else self.attempts.targets()
        attempt, accuracy = self.attempts.given_by(begun.trajectory, targets), self.searcher.accuracy
        search = begun.restarted(self.problem, self.options, self.searcher.relaxed(attempt), self.searcher.spent)
        search.durations = self.durations
        self.found.add(search)
        self.searcher.current = search
        if search.resume() and accuracy is not None:
            far, search.gain = difference(attempt.motion, search.trajectory), begun.gain  # what these knots were refined by
            if begun.error is not None and far <= ALIKE:
                search.error = begun.error * (1.0 + DOUBT * far)
            else:
                search.reaches(accuracy)
        search.harden(accuracy)
        return search

    def refined(self, search: Search) -> Search:
        """Until the estimated error is below the accuracy asked."""
        return Runner(search, self.searcher.accuracy, self.judge).finish()

    def interrupted(self) -> Search | None:
        """The best search so far, as it stands; None before the first. Nothing is checked: whoever interrupts wants an end."""
        converged = self.found.best() or [search for search in self.found.searches if search.converged]
        best = min(converged, key=lambda search: search.objective, default=self.searcher.current)
        if best is not None:
            best.outcome = Outcome.INTERRUPTED  # also where it had converged: the caller asked for more
        return best

    def _starts(self, targets: list[np.ndarray]) -> int:
        """How many guesses are tried by default."""
        if self.given is not None:
            return 1
        cheap = is_plain(self.problem) and isinstance(self.parameterization, BSpline) and self.kernels.kind == "compiled"
        return max(STARTS, len(targets)) if cheap else len(targets)

    def _search_in_rounds(self, source: Iterator[Attempt], targets: list[np.ndarray], wanted: int, thrifty: bool) -> None:
        """One round of guesses that differ, and some of changed optima, where so many guesses are ``wanted``; ``thrifty``: no
        more than it takes to know all optima."""
        found, hopping = self.found, int(HOPS * wanted) if self.given is None else 0
        hopping = hopping if hopping >= LEAST_HOPS else 0
        different, before, block = wanted - hopping, -1, BLOCK
        self._secure(source, wanted)
        while before < len(found.tried) < different and not (found.stopped or self._hopeless or (thrifty and found.all_known)):
            before = len(found.tried)
            self._search_all(source, min(block, different) if thrifty else different)
            block = len(found.tried) + BLOCK
        found.keep_apart(self.searcher, self._enough)
        for k in range(HOP_ROUNDS):
            numbers = range(hopping * k // HOP_ROUNDS, hopping * (k + 1) // HOP_ROUNDS)
            if found.stopped or not numbers or not found.best():
                return
            if thrifty and found.all_known and not found.best()[0].stiffness:
                return
            self._search_all(self._hops(targets, numbers), len(found.tried) + len(numbers))
            found.keep_apart(self.searcher, self._enough)

    def _secure(self, source: Iterator[Attempt], wanted: int) -> None:
        """Where time is limited, a valid motion from the first guess before others are tried, and refined if that was quick: time
        may be over in the middle of all that makes the others valid."""
        if self.options.deadline is None or wanted < 2:
            return
        self._search_all(source, 1)
        for accuracy in dict.fromkeys((None, self.searcher.accuracy)):
            if self.found.stopped or not self.found.any_promising or self._enough():
                return
            search = Runner(self.found.searches[0], accuracy, self.judge).finish()
            if self.judge.holds(search):
                self._sure.append(search)

    def _search_among_obstacles(self, source: Iterator[Attempt], wanted: int) -> None:
        """From guesses, and at last from one that is free with a firmer penalty."""
        found, free = self.found, None

        def watched() -> Iterator[Attempt]:
            nonlocal free
            for attempt in source:
                free = attempt if attempt.free else free
                yield attempt

        some = watched()
        self._secure(some, wanted)
        self._search_all(some, wanted)
        if not (free is None or found.any_promising or found.stopped):
            found.add(self.searcher.search(replace(free, name=f"{free.name}, firmer"), firm=FIRMEST))

    def _search_all(self, source: Iterator[Attempt], wanted: int) -> None:
        """Search from guesses until there are ``wanted`` searches, a few more where none is promising."""
        found = self.found
        while not found.stopped and (rest := wanted - len(found.tried)) > (0 if found.any_promising else -FALLBACKS):
            if self._enough() or (attempt := next(source, None)) is None:
                return
            if self._in_processes(rest):
                some = chain([attempt], islice(source, rest - 1))
                search_in_processes(self.searcher, some, found, self._enough, self._workers)
            else:
                found.add(self.searcher.search(attempt), attempt)
            if self._hopeless:
                return

    @property
    def _hopeless(self) -> bool:
        """Whether these knots hold no motion, as far as one can tell."""
        return len(self.found.tried) == self.found.infeasible >= MOST_INFEASIBLE

    def _in_processes(self, rest: int) -> bool:
        """Whether so many further searches are worth processes, which have to begin with something that is not hopeless."""
        known = len(self.found.tried) > self.found.infeasible
        return known and rest > 1 and not alone() and self._ahead(rest) > WORTH_PROCESSES

    def _hops(self, targets: list[np.ndarray], numbers: range) -> Iterator[Attempt]:
        """Changed copies of the best optima found so far.

        Where the arm is in its own way, most are made of what it would do if it were not: of the cheapest such motion, with links
        kept apart, since there are many ways to do so; and of the one that led to the best, to find another such motion.
        """
        best, alone = self.found.best(), self.found.alone()
        aware = best[0].stiffness > 0
        cheapest = sorted(alone, key=lambda search: search.objective)
        for number in numbers:
            kind = KINDS[number % len(KINDS)] if aware and alone else "best"
            some = {"best": best, "cheapest": cheapest, "alone": alone}[kind]
            rivals = [search for search in some if above(search.objective, some[0].objective) > SAME]
            yield self.attempts.hops([some[0], *rivals[:1]], targets, number, aware and kind != "alone")

    def _ahead(self, rest: int) -> float:
        """About how long so many further searches will take [s], as far as there is time."""
        left = self.options.remaining()
        seconds = rest * self.searcher.spent.solve_s / len(self.found.tried)
        return seconds if left is None else min(seconds, GUESSING * left)

    def _enough(self) -> bool:
        """Whether so much of a time limit is over that the rest is better spent on refining."""
        end = self.options.deadline
        late = end is not None and time.monotonic() - self.began > GUESSING * (end - self.began)
        return late and self.found.any_promising

    def _best(self) -> Search:
        """The winner of the race; where none of those in it holds, of what has not been looked at, or was worse."""
        found, judge = self.found, self.judge
        firsts = found.firsts()
        best = found.apart() if is_plain(self.problem) else firsts

        def others() -> Iterator[Search]:
            yield from (search for search in firsts if not any(search is one for one in best))
            yield from found.worse
            ended = [found.ended_by] if found.ended_by else []
            yield from sorted((search for search in [*found.searches, *ended] if not is_promising(search)), key=judge.excess)

        return winner(best, others(), self.searcher.accuracy, judge, self._sure)
