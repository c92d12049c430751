"""Searches among obstacles: the optima there would be without them come first, since nothing is better near one that is clear."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice

import numpy as np

from energyopt.attempts import Attempt
from energyopt.found import SAME, Found
from energyopt.optima import above
from energyopt.search import Search
from energyopt.search_state import STOP
from energyopt.searcher import STICKS_OUT, Searcher, is_promising
from energyopt.seeds import guesses
from energyopt.transcription.penalty import overlap

COSTLY, WORTH = 0.25, 0.08
"""By which share J has to be above that of the best optimum without obstacles for a second guess to be tried, as much may be
gained; and for that optimum to be the second guess, where it is another one than from the straight guess."""
BETTER = 0.02
"""By which share the other one's J has to be above it for that to be said."""
UNAWARE = 3
"""Optima without obstacles that are looked for, from the straight guess and from bent ones: they cost little."""


@dataclass
class Detours:
    """Searches among obstacles."""

    searcher: Searcher
    found: Found
    targets: list[np.ndarray]
    _unaware: list[Search] = field(default_factory=list)

    def begin(self, seed: int) -> None:
        """Optima without obstacles; the best one that happens to be clear of them is a search of the plan."""
        count = UNAWARE if len(self.targets) == 1 else 1
        for k, motion in enumerate(islice(guesses(self.searcher.problem, self.targets, seed), count)):
            name = f"free bent {k}" if k else "straight"
            search = self.searcher.search(Attempt(name, motion, self.targets[0]), unaware=True)
            if search.outcome in STOP:
                self.found.ended_by = search
                return
            others = [other.objective for other in self._unaware]
            if search.converged and not any(abs(above(search.objective, other)) <= SAME for other in others):
                self._unaware.append(search)
        for search in sorted(self._unaware, key=lambda search: search.objective):
            if overlap(search.avoidance, search.trajectory) <= STICKS_OUT and search.clear():
                self.found.add(search)
                return

    def go_on(self, source: Iterator[Attempt]) -> None:
        """Another guess, where obstacles make the motion much dearer: the better of the two stays in the searches."""
        first = self.found.searches[0]
        if not self._unaware or not is_promising(first):
            return
        best = min(self._unaware, key=lambda search: search.objective)
        straight = [search.objective for search in self._unaware if search.name == "straight"]
        other = above(min(straight, default=np.inf), best.objective) > BETTER
        if other and above(first.objective, best.objective) > WORTH:
            self._compare(Attempt("free optimum", best.trajectory, self.targets[0]))
        if not self.found.stopped and above(self.found.searches[0].objective, best.objective) > COSTLY:
            self._compare(next(source))

    def _compare(self, attempt: Attempt) -> None:
        """A search that takes the place of the first where it is better."""
        first, second = self.found.searches[0], self.searcher.search(attempt)
        self.found.add(second)
        if not self.found.stopped:
            self.found.give_way(first if is_promising(second) and second.objective < first.objective else second)
