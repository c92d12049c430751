"""What the searches of one plan found: in which optima they ended, and what those cost with links of the arm kept apart."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from energyopt.attempts import Attempt
from energyopt.optima import HINGED_OBJECTIVE, SAME_OBJECTIVE, Optimum, above, distinct, groups
from energyopt.search import Search
from energyopt.search_state import STOP
from energyopt.searcher import Searcher, is_promising
from energyopt.solvers import Outcome

SAME = 1e-4
"""Relative difference of J up to which two first searches ended in the same optimum."""
NEAR = 0.1
"""By which share J may be above that of the best optimum, for another one to be better on finer knots."""
UNSEEN = 0.25
"""Optima still to be expected below which they count as known. On 30 random moves of two arms no plan became worse by more than
0.12 % for the guesses this saves, some 12 % of all iterations; with one half, one of the Z1's ten first did, by 1.6 %."""


@dataclass
class Tried:
    """What came of one guess.

    Attributes:
        search: from it; attempt: the guess, where links may be kept apart later.
        is_apart: whether they are apart in it anyway; None where that was not looked at.
        apart: the optimum with links kept apart; None where that was not looked for.
        gave_way: whether the search of another guess has taken its place.
    """

    search: Search
    attempt: Attempt | None = None
    is_apart: bool | None = None
    apart: Search | None = None
    gave_way: bool = False


@dataclass
class Found:
    """Searches, and what is known of them.

    Attributes:
        tried: in the order of the guesses.
        ended_by: the search that the user or a time limit ended, where it is not one of a guess.
    """

    tried: list[Tried] = field(default_factory=list)
    ended_by: Search | None = None

    def add(self, search: Search, attempt: Attempt | None = None) -> None:
        """One more search; with its ``attempt``, where it may be kept apart later."""
        self.tried.append(Tried(search, attempt))

    def give_way(self, search: Search) -> None:
        """Leave a search to the case that no better one holds."""
        next(one for one in self.tried if one.search is search).gave_way = True

    def put_in_order(self, first: int, numbers: list[int]) -> None:
        """What was tried from the place ``first`` on, in the order of these numbers."""
        self.tried[first:] = [self.tried[first + k] for k in np.argsort(numbers, kind="stable")]

    @property
    def names(self) -> list[str]:
        """Of the guesses."""
        return [one.search.name for one in self.tried]

    @property
    def searches(self) -> list[Search]:
        """Those that have not given way to another."""
        return [one.search for one in self.tried if not one.gave_way]

    @property
    def worse(self) -> list[Search]:
        """Those that have, for the case that the better ones do not hold."""
        return [one.search for one in self.tried if one.gave_way]

    @property
    def last(self) -> Search:
        """The search that ended last."""
        return self.ended_by or self.tried[-1].search

    @property
    def stopped(self) -> bool:
        """Whether the last search was ended by the user or by a time limit."""
        return self.ended_by is not None or (bool(self.tried) and self.last.outcome in STOP)

    @property
    def infeasible(self) -> int:
        """How many searches ended where limits contradict each other."""
        return sum(search.outcome is Outcome.INFEASIBLE for search in self.searches)

    @property
    def any_promising(self) -> bool:
        return any(map(is_promising, self.searches))

    @property
    def all_known(self) -> bool:
        """Whether hardly an optimum is left to be found, as far as the number of searches in each tells.

        Where n searches ended in w optima, w (n − 1) / (n − w − 2) is how many one has to expect in all (C. G. E. Boender, A. H.
        G. Rinnooy Kan, "Bayesian stopping rules for multistart global optimization methods", Mathematical Programming 37, 1987).
        """
        optima = self._optima()
        n, w = sum(map(len, optima)), len(optima)
        return n > w + 2 and w * (n - 1) / (n - w - 2) < w + UNSEEN

    def firsts(self) -> list[Search]:
        """One promising search for each optimum, least J first: of those that ended in it the earliest."""
        return [members[0].search for members in self._optima()]

    def keep_apart(self, searcher: Searcher, enough) -> None:
        """Keep links apart in one optimum after another, least J first, as long as one can be the best.

        Links that have to be kept apart only make a motion dearer: an optimum whose J is above that of one with links kept apart
        is hopeless, unless links are apart in it anyway: then it may be the better one on finer knots. ``enough``: tells whether
        time is short.
        """
        for one in (members[0] for members in self._optima()):
            search, best = one.search, min((other.objective for other in self.apart()), default=np.inf)
            if best < np.inf and (above(search.objective, best) >= NEAR or enough()):
                return
            if one.apart is not None or one.attempt is None:
                continue
            if one.is_apart is None:
                one.is_apart = searcher.is_apart(search)
            if one.is_apart:
                one.apart = search
            elif search.objective < best:
                one.apart = searcher.apart(search, one.attempt)
                if one.apart.outcome in STOP:
                    self.ended_by = one.apart
                    return

    def apart(self) -> list[Search]:
        """Optima with links kept apart, as far as that was looked at, in the order in which they were found."""
        return [one.apart for one in self.tried if one.apart is not None and is_promising(one.apart)]

    def best(self) -> list[Search]:
        """The same, least J first."""
        return sorted(self.apart(), key=lambda search: search.objective)

    def alone(self) -> list[Search]:
        """What the arm would do if it were not in its own way, in the order of J with links kept apart."""
        known = [one for one in self.tried if one.apart is not None and not one.search.stiffness]
        known.sort(key=lambda one: (not is_promising(one.apart), one.apart.objective))
        return [one.search for one in known]

    def optima(self, seed: int) -> tuple[Optimum, ...]:
        """All distinct ones, best first, with links kept apart as far as that was looked at."""
        ends = {id(one): self._end(members) for members in self._optima() for one in members}
        items = [(one.search.name, ends[id(one)] or one.search) for one in self.tried if id(one) in ends]
        same = HINGED_OBJECTIVE if any(end.stiffness for _, end in items) else SAME_OBJECTIVE
        return distinct([(end.objective, name, end.trajectory) for name, end in items], seed, same)

    def _optima(self) -> list[list[Tried]]:
        """What promising searches ended in one optimum, least J first; in the order of the guesses."""
        some = [one for one in self.tried if not one.gave_way and is_promising(one.search)]
        found = groups([one.search.objective for one in some], [one.search.trajectory for one in some], SAME)
        return [[some[k] for k in members] for members in found]

    @staticmethod
    def _end(members: list[Tried]) -> Search | None:
        """The optimum with links kept apart, where one was found for a search among these."""
        return next((one.apart for one in members if one.apart is not None and is_promising(one.apart)), None)
