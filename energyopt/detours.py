"""Searches among obstacles: the optima there would be without them come first, since nothing is better near one that is clear."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice

import numpy as np

from energyopt.attempts import Attempt
from energyopt.found import SAME, Found
from energyopt.search import Search
from energyopt.searcher import HOPELESS, STOP, Searcher, is_promising
from energyopt.seeds import guesses
from energyopt.solvers import Outcome
from energyopt.transcription.penalty import overlap

COSTLY, WORTH = 1.25, 1.08
"""J over that of the best optimum without obstacles, from which a second guess is tried: much may be gained; and from which that
optimum is the second guess, where it is another one than from the straight guess."""
BETTER = 0.98
"""Share of J below which that is said."""
UNAWARE = 3
"""Optima without obstacles that are looked for, from the straight guess and from bent ones: they cost little."""


@dataclass
class Detours:
    """Searches among obstacles; ``worse``: searches that have given way to a better one, for the case that it does not hold."""

    searcher: Searcher
    found: Found
    targets: list[np.ndarray]
    worse: list[Search] = field(default_factory=list)
    _unaware: list[Search] = field(default_factory=list)

    def begin(self, seed: int) -> None:
        """Optima without obstacles; the best one that happens to be clear of them is a search of the plan."""
        count = UNAWARE if len(self.targets) == 1 else 1
        for k, motion in enumerate(islice(guesses(self.searcher.problem, self.targets, seed), count)):
            name = f"free bent {k}" if k else "straight"
            search = self.searcher.search(Attempt(name, motion, self.targets[0]), unaware=True)
            if search.outcome in STOP:
                self.found.searches.append(search)
                return
            others = [other.objective for other in self._unaware]
            if search.converged and not any(abs(search.objective - other) <= SAME * abs(other) for other in others):
                self._unaware.append(search)
        for search in sorted(self._unaware, key=lambda search: search.objective):
            if overlap(search.avoidance, search.trajectory) <= HOPELESS and search.clear():
                self.found.add(search)
                return

    def go_on(self, source: Iterator[Attempt]) -> None:
        """Another guess, where obstacles make the motion much dearer: the better of the two stays in the searches."""
        first = self.found.searches[0]
        if not self._unaware or not is_promising(first):
            return
        best = min(self._unaware, key=lambda search: search.objective)
        straight = [search.objective for search in self._unaware if search.name == "straight"]
        other = best.objective < BETTER * min(straight, default=np.inf)
        if other and first.objective > WORTH * best.objective:
            self._compare(Attempt("free optimum", best.trajectory, self.targets[0]))
        if not self.found.stopped and self.found.searches[0].objective > COSTLY * best.objective:
            self._compare(next(source))

    def _compare(self, attempt: Attempt) -> None:
        """A search that takes the place of the first where it is better."""
        first, second = self.found.searches[0], self.searcher.search(attempt)
        self.found.names.append(second.name)
        if second.outcome is Outcome.INTERRUPTED:
            self.found.searches.append(second)
        elif is_promising(second):
            better, other = sorted((first, second), key=lambda search: search.objective)
            self.found.searches[:] = [better]
            self.worse.append(other)
