"""What the searches of one plan found: in which optima they ended, and what those cost with links of the arm kept apart."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from energyopt.attempts import Attempt
from energyopt.optima import Optimum, distinct
from energyopt.search import Search
from energyopt.searcher import STOP, Searcher, is_promising
from energyopt.solvers import Outcome

SAME = 1e-4
"""Relative difference of J up to which two first searches ended in the same optimum."""
NEAR = 1.1
"""J over that of the best optimum up to which another one may be better on finer knots."""


@dataclass
class Found:
    """Searches, and what is known of them.

    Attributes:
        searches: in the order of the guesses; names: of these guesses.
        _attempts, _apart: guess and optimum with links kept apart of a search, by its `id`.
    """

    searches: list[Search] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    _attempts: dict[int, Attempt] = field(default_factory=dict)
    _apart: dict[int, Search] = field(default_factory=dict)

    def add(self, search: Search, attempt: Attempt | None = None) -> None:
        """One more search; with its ``attempt``, where it may be kept apart later."""
        self.searches.append(search)
        self.names.append(search.name)
        if attempt is not None:
            self._attempts[id(search)] = attempt

    def put_in_order(self, first: int, numbers: list[int]) -> None:
        """The searches from the place ``first`` on, in the order of these numbers."""
        order = first + np.argsort(numbers, kind="stable")
        self.searches[first:] = [self.searches[k] for k in order]
        self.names[first:] = [self.names[k] for k in order]

    @property
    def stopped(self) -> bool:
        """Whether the last search was ended by the user or by a time limit."""
        return bool(self.searches) and self.searches[-1].outcome in STOP

    @property
    def infeasible(self) -> int:
        """How many searches ended where limits contradict each other."""
        return sum(search.outcome is Outcome.INFEASIBLE for search in self.searches)

    @property
    def any_promising(self) -> bool:
        return any(map(is_promising, self.searches))

    def firsts(self) -> list[Search]:
        """One promising search for each optimum, least J first: of those that ended in it the earliest."""
        groups: list[list[int]] = []
        promising = [k for k, search in enumerate(self.searches) if is_promising(search)]
        for k in sorted(promising, key=lambda k: self.searches[k].objective):
            objective = self.searches[k].objective
            if groups and abs(objective - self.searches[groups[-1][0]].objective) <= SAME * abs(objective):
                groups[-1].append(k)
            else:
                groups.append([k])
        return [self.searches[min(group)] for group in groups]

    def keep_apart(self, searcher: Searcher, enough) -> None:
        """Keep links apart in one optimum after another, least J first, as long as one can be the best.

        Links that have to be kept apart only make a motion dearer: an optimum whose J is above that of one with links kept apart
        is hopeless, unless links are apart in it anyway: then it may be the better one on finer knots. ``enough``: tells whether
        time is short.
        """
        for search in self.firsts():
            best = min((one.objective for one in self.best()), default=np.inf)
            if search.objective >= NEAR * best or (best < np.inf and enough()):
                return
            if id(search) in self._apart or id(search) not in self._attempts:
                continue
            if search.objective >= best and not searcher.is_apart(search):
                continue
            self._apart[id(search)] = one = searcher.apart(search, self._attempts[id(search)])
            if one.outcome in STOP:
                self.searches.append(one)
                return

    def apart(self) -> list[Search]:
        """Optima with links kept apart, as far as that was looked at, in the order in which they were found."""
        known = [self._apart[id(search)] for search in self.searches if id(search) in self._apart]
        return [search for search in known if is_promising(search)]

    def best(self) -> list[Search]:
        """The same, least J first."""
        return sorted(self.apart(), key=lambda search: search.objective)

    def alone(self) -> list[Search]:
        """What the arm would do if it were not in its own way, in the order of J with links kept apart."""
        known = [(self._apart[id(search)], search) for search in self.searches if id(search) in self._apart]
        known = [((not is_promising(one), one.objective), search) for one, search in known if not search.stiffness]
        return [search for _, search in sorted(known, key=lambda pair: pair[0])]

    def optima(self, seed: int) -> tuple[Optimum, ...]:
        """All distinct ones, best first, with links kept apart as far as that was looked at."""
        firsts, items = self.firsts(), []
        for search in filter(is_promising, self.searches):
            first = min(firsts, key=lambda one: abs(one.objective - search.objective))
            one = self._apart.get(id(first), search)
            one = one if is_promising(one) else search
            items.append((one.objective, search.name, one.trajectory))
        return distinct(items, seed)
