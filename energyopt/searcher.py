"""The first search from a guess, and what the first searches of one plan share: a motion space, a program, what is kept apart.

A search without obstacles knows nothing of self-collision either: an arm without it has few optima, which are found in
milliseconds. `apart` then keeps the arm from itself, once for each of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from energyopt.attempts import Attempt, is_plain
from energyopt.avoidance import Avoidance
from energyopt.dynamics.kernels import Kernels
from energyopt.parameterizations import BSpline, HermiteSimpson, MotionSpace, Sinusoid
from energyopt.parameterizations.bspline import SplineSpace
from energyopt.parameterizations.trajectory import SplineTrajectory, Trajectory
from energyopt.problem import Problem
from energyopt.refinement import bisected, rough
from energyopt.rounds import DEEP
from energyopt.search import Search
from energyopt.search_state import STOP, SearchOptions, Spent
from energyopt.solvers import Outcome
from energyopt.transcription import NonlinearProgram
from energyopt.transcription.penalty import overlap

Parameterization = BSpline | Sinusoid | HermiteSimpson

PATIENCE = 100
"""Solver iterations after which one of many guesses is hopeless: nearly all optima are found in 20 to 60. (J of a search in
progress tells little: giving up at iteration 20 what is above the first optimum saves 7 % of all iterations at most, at iteration
10 a quarter, and with them one in ten of the better optima.)"""
ROUGH_NODES = 10
"""Quadrature nodes a span where there is Coulomb friction: with fewer, motions appear that change direction between them."""
FIRM, FIRMEST = 2, 4
"""Stiffness of the penalty, as a place in `rounds.STIFFNESS`, where the guess is free: softer, it lets motions through boards;
and where all guesses have failed with that."""
STICKS_OUT = 0.02
"""Overlap of spheres [m] with which a motion is hardly ever clear by exact geometry: that is how far they stick out."""
FINER = 2
"""Times the knots are bisected where no guess leads to a motion inside the limits."""


@dataclass
class Searcher:
    """Makes the first searches of one plan.

    Attributes:
        problem: with the duration to start from; durations: its bounds [s], where it is free.
        avoidance: what is to be kept apart; None where there is nothing.
        spent: by all searches; current: the search begun last.
    """

    problem: Problem
    parameterization: Parameterization
    kernels: Kernels
    options: SearchOptions
    durations: tuple[float, float] | None = None
    avoidance: Avoidance | None = None
    spent: Spent = field(default_factory=Spent)
    current: Search | None = None
    _first_space: MotionSpace | None = None
    _program: NonlinearProgram | None = None
    _asked: dict[tuple[float, bytes], Avoidance] = field(default_factory=dict)

    @property
    def accuracy(self) -> float | None:
        """Of J, where it is asked for."""
        return self.parameterization.accuracy if isinstance(self.parameterization, BSpline) else None

    def search(self, attempt: Attempt, unaware: bool = False, firm: int = FIRM, space: MotionSpace | None = None) -> Search:
        """The first level from a guess; ``unaware`` of obstacles, or with a penalty so ``firm`` that a free one stays free."""
        space, avoidance = space or self.space(), self.relaxed(attempt)
        if attempt.warm:
            space = self._space_of(attempt.motion, space)
        start = (self.problem, space, self.kernels, attempt.motion, self.options, avoidance, attempt.name)
        search = Search(*start, durations=self.durations, warm=attempt.warm, spent=self.spent)
        if avoidance is not None and (attempt.apart or (avoidance.scene.obstacles and not unaware)):
            search.stiffness, search.sketch = firm if attempt.free else 1, attempt.apart
        elif self._shared and space is self._first_space:
            search.begin_with(self._first_program(search))
        if is_plain(self.problem) and not attempt.patient:
            search.options = replace(self.options, iterations=min(self.options.iterations, PATIENCE))
        self.current = search
        search.advance()
        search.options = self.options
        return search

    def apart(self, search: Search, attempt: Attempt) -> Search:
        """The optimum near that of a search which does not know self-collision, with links of the arm kept apart.

        What is near is found from the optimum and from the guess that led to it, since either may end with links on the wrong
        side of one another; the better one is returned.
        """
        pushed = search.copy()
        pushed.keep_apart()
        if pushed.outcome in STOP:
            return pushed
        again = self.search(replace(attempt, apart=True))
        return again if again.outcome in STOP else min(pushed, again, key=lambda s: (not is_promising(s), s.objective))

    def is_apart(self, search: Search) -> bool:
        """Whether links are apart in a motion, or were kept apart in its search."""
        if self.avoidance is None or search.stiffness or not search.converged:
            return True
        depth = overlap(search.avoidance, search.trajectory)
        return depth <= 0.0 or (depth <= STICKS_OUT and search.clear())

    def on_finer_knots(self, attempt: Attempt) -> list[Search]:
        """Searches in ever finer spaces, where the knots may be chosen: near the least duration coarse ones hold no motion."""
        spline, searches = self.parameterization, []
        if not isinstance(spline, BSpline) or spline.accuracy is None:
            return searches
        space = spline.space(self.problem.duration)
        attempt = replace(attempt, name=f"{attempt.name} on finer knots", warm=False)
        for _ in range(FINER):
            space = bisected(space)
            searches.append(self.search(attempt, space=space))
            if searches[-1].outcome is not Outcome.INFEASIBLE:
                break
        return searches

    def relaxed(self, attempt: Attempt) -> Avoidance | None:
        """What is asked of the spheres, given that start, goal and timed waypoints are free."""
        if self.avoidance is None:
            return None
        problem = self.problem
        key = (problem.duration, np.asarray(attempt.goal, float).tobytes())
        if key not in self._asked:
            stops = [(0.0, problem.start), (problem.duration, attempt.goal)]
            stops += [(w.time, w.position) for w in problem.waypoints if w.time is not None]
            self._asked[key] = self.avoidance.relaxed(stops)
        return self._asked[key]

    def space(self) -> MotionSpace:
        """Where to search first; Coulomb friction, nearly a step in the velocity, wants more quadrature nodes."""
        if self._first_space is None or not self._shared:
            self._first_space = self.parameterization.space(self.problem.duration, ROUGH_NODES if rough(self.problem) else None)
        return self._first_space

    @property
    def _shared(self) -> bool:
        """Whether the first program of all searches is the same."""
        return is_plain(self.problem) and self.durations is None and self.problem.potential is None

    def _first_program(self, search: Search) -> NonlinearProgram:
        if self._program is None:
            self._program = search.made()
        return self._program

    def _space_of(self, motion: Trajectory, otherwise: MotionSpace) -> MotionSpace:
        """The space of a spline, whose knots may have been chosen with care, unless the caller wants others."""
        spline = self.parameterization
        free = isinstance(spline, BSpline) and spline.knots is None and spline.control_points is None
        if not (free and isinstance(motion, SplineTrajectory) and motion.degree == spline.degree):
            return otherwise
        return SplineSpace(motion.breaks, spline.degree, otherwise.nodes)


def is_promising(search: Search) -> bool:
    """Whether a search converged to a motion that overlaps nowhere, or so little that rows will push it out."""
    return search.converged and search.depth <= DEEP
