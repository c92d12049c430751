"""A campaign: all guesses and searches that one call of `plan` makes.

Where nothing but the arm itself is in the way, guesses are the straight quintic, motions that differ from it (`diversity`), and
at last changed copies of the best optima found by then. Among obstacles they come from `pathfinding`: the straight one even where
it is not free, since a penalty mostly pushes it out, and then free ones. The searches of least J are refined, and of those that
hold the best is taken.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from energyopt.avoidance import Avoidance, arm_obstacles, avoidance_of, bound_frames, planned_pairs
from energyopt.clearance_checks import check_ends
from energyopt.diversity import Guess, diverse, hops
from energyopt.dynamics.kernels import Kernels, kernels_of
from energyopt.errors import ProblemError
from energyopt.feasibility import check_feasibility
from energyopt.optima import Optimum, distinct
from energyopt.parameterizations import BSpline, HermiteSimpson, MotionSpace, Sinusoid
from energyopt.parameterizations.bspline import SplineSpace
from energyopt.parameterizations.trajectory import SplineTrajectory, Trajectory
from energyopt.pathfinding import Budget, FreeSpace
from energyopt.pathfinding import guesses as clear_guesses
from energyopt.plans import Violations
from energyopt.problem import FramePose, Problem
from energyopt.refinement import ALIKE, DOUBT, bisected, difference, rough
from energyopt.search import DEEP, Search, SearchOptions, Spent
from energyopt.seeds import first_durations, goals, guesses
from energyopt.solvers import Outcome
from energyopt.transcription import NonlinearProgram
from energyopt.transcription.penalty import overlap
from energyopt.verification import is_valid, verify
from energyopt.workers import call_all

Parameterization = BSpline | Sinusoid | HermiteSimpson

STARTS = 20
"""Guesses by default, where a search takes milliseconds: splines, compiled kernels, and no obstacles. How often that is enough is
measured by `problems/benchmarks/optima.py`."""
HOPS = 0.25
"""Share of the guesses that are changed copies of the best optima the others have led to."""
LEAST_HOPS = 2
PATIENCE = 100
"""Solver iterations after which one of many guesses is hopeless: nearly all optima are found in 20 to 60. (J of a search in
progress tells little: giving up at iteration 20 what is above the first optimum saves 7 % of all iterations at most, at iteration
10 a quarter, and with them one in ten of the better optima.)"""
GUESSING = 0.6
"""Share of a time limit for guesses, once one has led to an optimum; the rest is for refining."""
FALLBACKS = 3
"""Further guesses tried where the first ones lead to no valid motion."""
MOST_FINISHED = 3
"""Searches that are refined, one after another, until one holds."""
CLOSE, SAME = 1.05, 1e-4
"""Searches whose first level ends within 5 % of the best are refined as well, unless they ended in the same optimum."""
FINER = 2
"""Times the knots are bisected where no guess leads to a motion inside the limits."""
MOST_LEVELS = 12
ROUGH_NODES = 10
"""Quadrature nodes a span where there is Coulomb friction: with fewer, motions appear that change direction between them."""
PATH_SECONDS = 8.0
"""Time for the search of one path [s]."""
FIRM, FIRMEST = 2, 4
"""Stiffness of the penalty, as a place in `search.STIFFNESS`, where the guess is free: softer, it lets motions through boards;
and where all guesses have failed with that."""
HOPELESS = 0.02
"""Overlap of spheres [m] with which a motion is hardly ever clear by exact geometry: that is how far they stick out."""
COSTLY, WORTH = 1.25, 1.08
"""J over that of the best optimum without obstacles, from which a second guess is tried: much may be gained; and from which that
optimum is the second guess, where it is another one than from the straight guess."""
BETTER = 0.98
"""Share of J below which that is said."""
UNAWARE = 3
"""Optima without obstacles that are looked for, from the straight guess and from bent ones: they cost little."""
WORTH_PROCESSES = 6.0
"""Estimated time of further searches [s] from which processes, which take seconds to start, are worth it."""
GRACE = 0.3
"""Seconds after the end of a time limit in which processes may still answer."""
STOP = (Outcome.INTERRUPTED, Outcome.TIME_LIMIT)


@dataclass(frozen=True, eq=False)
class Attempt:
    """One guess: its name, the motion, the goal configuration it ends in, and whether it is known to be free of obstacles."""

    name: str
    motion: Trajectory
    goal: np.ndarray
    free: bool = False


@dataclass
class Campaign:
    """All searches of one call of `plan`."""

    problem: Problem
    parameterization: Parameterization
    kernels: Kernels
    options: SearchOptions
    seed: int
    guess_s: float = 0.0
    verify_s: float = 0.0
    tried: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    path_search: str = "auto"
    spent: Spent = field(default_factory=Spent)
    durations: tuple[float, float] | None = None
    given: Trajectory | None = None
    _verdict: tuple[Trajectory, Violations] | None = None
    avoidance: Avoidance | None = None
    searches: list[Search] = field(default_factory=list)
    worse: list[Search] = field(default_factory=list)
    unaware: list[Search] = field(default_factory=list)
    free_guess: Attempt | None = None
    current: Search | None = None
    optima: tuple[Optimum, ...] = ()
    began: float = field(default_factory=time.monotonic)
    _first_space: MotionSpace | None = None
    _program: NonlinearProgram | None = None

    def run(self, starts: int | None) -> Search:
        """The best search, refined."""
        began = time.perf_counter()
        self._choose_duration()
        targets = self._targets()
        self.avoidance = avoidance_of(self.problem)
        self.guess_s = time.perf_counter() - began
        source = self._timed(self._attempts(targets))
        wanted, searches = starts or self._starts(targets), self.searches
        hopping = int(HOPS * wanted) if self._plain and self.given is None else 0
        if self.given is None and not self._plain:
            self._try_unaware(targets)
        self._search_all(source, wanted - hopping if hopping >= LEAST_HOPS else wanted)
        if hopping >= LEAST_HOPS and any(map(_promising, searches)) and searches[-1].outcome not in STOP:
            self._search_all(self._timed(self._hops(targets)), wanted)
        if not (self.free_guess is None or any(map(_promising, searches)) or searches[-1].outcome in STOP):
            firmer = replace(self.free_guess, name=f"{self.free_guess.name}, firmer")
            searches.append(self._searched(self._space(), firmer, firm=FIRMEST))
        if starts is None and len(searches) == 1:
            self._look_further(source, targets)
        promising = [search for search in searches if _promising(search)]
        self.optima = distinct([(s.objective, s.name, s.trajectory) for s in promising], self.seed)
        if searches[-1].outcome is Outcome.INTERRUPTED:
            return self.interrupted()
        if all(search.outcome is Outcome.INFEASIBLE for search in searches):
            searches += self._on_finer_knots(next(self._attempts(targets)))
        return self._best(searches)

    def _starts(self, targets: list[np.ndarray]) -> int:
        """How many guesses are tried by default."""
        if self.given is not None:
            return 1
        cheap = self._plain and isinstance(self.parameterization, BSpline) and self.kernels.kind == "compiled"
        return max(STARTS, len(targets)) if cheap else len(targets)

    @property
    def _plain(self) -> bool:
        """Whether nothing but the arm itself is in the way."""
        return not (self.problem.obstacles or self.problem.workspace)

    def _search_all(self, source: Iterator[Attempt], wanted: int) -> None:
        """Search from guesses until there are ``wanted`` searches, a few more where none is promising."""
        searches, first = self.searches, True
        while len(searches) < wanted or (len(searches) < wanted + FALLBACKS and not any(map(_promising, searches))):
            if self._enough():
                return
            searches.append(self._searched(self._space(), next(source)))
            if searches[-1].outcome in STOP:
                return
            rest = wanted - len(searches)
            if first and rest > 1 and self._ahead(rest) > WORTH_PROCESSES:
                self._in_processes(islice(source, rest))
            first = False

    def _ahead(self, rest: int) -> float:
        """About how long so many further searches will take [s], as far as there is time."""
        left = self.options.remaining()
        seconds = rest * self.spent.solve_s / len(self.searches)
        return seconds if left is None else min(seconds, GUESSING * left)

    def _enough(self) -> bool:
        """Whether so much of a time limit is over that the rest is better spent on refining."""
        end = self.options.deadline
        late = end is not None and time.monotonic() - self.began > GUESSING * (end - self.began)
        return late and any(map(_promising, self.searches))

    def _hops(self, targets: list[np.ndarray]) -> Iterator[Attempt]:
        """Changed copies of the two best optima found so far."""
        ranked = sorted(filter(_promising, self.searches), key=lambda search: search.objective)
        rivals = [search for search in ranked if search.objective > ranked[0].objective * (1.0 + SAME)]
        bases = []
        for search in [ranked[0], *rivals[:1]]:
            end = search.trajectory(search.trajectory.duration)
            bases.append(Guess(search.name, search.trajectory.stretched(self.problem.duration),
                               min(targets, key=lambda q: float(np.linalg.norm(q - end)))))  # fmt: skip
        for guess in hops(self.problem, bases, self.seed):
            yield Attempt(guess.name, guess.motion, guess.goal)

    def resume(self, begun: Search) -> Search:
        """The optimum near that of a similar problem: on its knots, with its rows, in the time of this one."""
        self.given, posed = begun.trajectory, isinstance(self.problem.goal, FramePose)
        self._choose_duration()
        targets = [begun.trajectory(begun.trajectory.duration)] if posed else self._targets()
        self.avoidance = avoidance_of(self.problem)
        attempt = self._given(targets)
        search = begun.restarted(self.problem, self.options, self._relaxed(attempt), self.spent)
        search.durations = self.durations
        self.searches.append(search)
        self.tried.append("the optimum before")
        self.current = search
        if search.resume() and self._accuracy is not None:
            far, search.gain = difference(attempt.motion, search.trajectory), begun.gain  # what these knots were refined by
            if begun.error is not None and far <= ALIKE:
                search.error = begun.error * (1.0 + DOUBT * far)
            else:
                search.reaches(self._accuracy)
        search.harden(self._accuracy)
        return search

    def _choose_duration(self) -> None:
        """Where the duration is free, one to start from; at the goal, nothing that moves may be in the way then."""
        if self.durations is None:
            return
        goal = self.problem.goal_position
        if self.given is not None:
            candidates = [float(np.clip(self.given.duration, *self.durations))]
        else:
            somewhere = goals(self.problem, self.seed)[0] if goal is None else goal
            candidates = first_durations(self.problem, self.durations, somewhere, self.kernels).tolist()
        moving = goal is not None and any(obstacle.moves for obstacle in self.problem.obstacles)
        self.problem = self.problem.lasting(candidates[0])
        for duration in candidates[1:] if moving else ():
            try:
                return check_ends(self.problem, goal)
            except ProblemError:
                self.problem = self.problem.lasting(duration)

    def _best(self, searches: list[Search]) -> Search:
        """Of the most promising searches, refined, the one of least J that holds; where none does, the least bad."""
        ranked = sorted(searches, key=lambda s: (not _promising(s), s.objective if _promising(s) else self._excess(s)))
        firsts = _first_of_each(ranked, searches)
        most = CLOSE * ranked[0].objective
        rivals = {id(search) for search in firsts if _promising(search) and search.objective <= most}
        ranked = [*firsts, *(search for search in ranked if not any(search is first for first in firsts))]
        finished: list[Search] = []
        held: list[Search] = []
        for search in [*ranked[:MOST_FINISHED], *self.worse]:
            hopeful = any(search is first for first in firsts) and _promising(search)
            if held and id(search) not in rivals and not (hopeful and search.objective < min(s.objective for s in held)):
                continue  # clearing a motion of itself may have made the best much dearer
            finished.append(self._refined(search))
            if finished[-1].outcome in STOP:
                return min(held, key=lambda s: s.objective, default=finished[-1])
            if self._holds(finished[-1]):
                held.append(finished[-1])
        return min(held, key=lambda s: s.objective) if held else min(finished, key=self._excess)

    def interrupted(self) -> Search | None:
        """The best search so far, as it stands; None before the first. Nothing is checked: whoever interrupts wants an end."""
        converged = [search for search in self.searches if search.converged]
        best = min(converged, key=lambda search: search.objective, default=self.current)
        if best is not None:
            best.outcome = Outcome.INTERRUPTED  # also where it had converged: the caller asked for more
        return best

    def _targets(self) -> list[np.ndarray]:
        """Goal configurations to aim at.

        Raises:
            ProblemError: start or goal touches something, or no goal configuration is possible.
        """
        targets = goals(self.problem, self.seed)
        if isinstance(self.problem.goal, FramePose):
            return self._possible(targets)
        check_ends(self.problem, self.problem.goal_position)
        return targets

    def _attempts(self, targets: list[np.ndarray]) -> Iterator[Attempt]:
        problem = self.problem
        if self.given is not None:
            yield self._given(targets)
        if not (problem.obstacles or problem.workspace):
            for guess in diverse(problem, targets, self.seed, self.kernels):
                yield Attempt(guess.name, guess.motion, guess.goal)
        free = FreeSpace.of(
            problem.robot,
            arm_obstacles(problem),
            self_pairs=planned_pairs(problem),
            bound=bound_frames(problem),
            attached=problem.attached,
            limits=problem.limits,
            margin=problem.clearance,
        )
        end = self.options.deadline
        how = {"budget": Budget(PATH_SECONDS, until=np.inf if end is None else end), "path_search": self.path_search}
        seeds = range(self.seed, self.seed + len(targets))
        both = zip(seeds, targets, strict=True)
        sources = [clear_guesses(problem, free, q, seed=k, missed=self.missed.append, **how) for k, q in both]
        for guess, target in _in_turn(sources, targets):
            yield Attempt(guess.name, guess.trajectory, target, guess.free)
        for k, motion in enumerate(islice(guesses(problem, targets, self.seed), 1, None), start=1):
            yield Attempt(f"bent unchecked {k}", motion, targets[0])

    def _given(self, targets: list[np.ndarray]) -> Attempt:
        """The motion the caller starts from; it ends at the target it is nearest to."""
        motion = self.given.stretched(self.problem.duration)
        end = motion(motion.duration)
        return Attempt("given", motion, min(targets, key=lambda q: float(np.linalg.norm(q - end))))

    def _timed(self, source: Iterator[Attempt]) -> Iterator[Attempt]:
        """The same, with the time counted that it takes to make each."""
        while True:
            began = time.perf_counter()
            try:
                attempt = next(source, None)
            finally:
                self.guess_s += time.perf_counter() - began
            if attempt is None:
                return
            yield attempt

    def _searched(self, space: MotionSpace, attempt: Attempt, unaware: bool = False, firm: int = FIRM) -> Search:
        """The first level from a guess; ``unaware`` of obstacles, or with a penalty so ``firm`` that a free one stays free."""
        avoidance = self._relaxed(attempt)
        start = (self.problem, space, self.kernels, attempt.motion, self.options, avoidance, attempt.name)
        search = Search(*start, durations=self.durations, spent=self.spent)
        if self._shared and space is self._first_space:
            search.begin_with(self._first_program(search))
        if attempt.name == "given":
            search.warm, search.space = True, self._space_of(attempt.motion, space)
        if avoidance is not None and avoidance.scene.obstacles and not unaware:
            search.stiffness = firm if attempt.free else 1
            self.free_guess = attempt if attempt.free else self.free_guess
        self.current = search
        if self._plain and attempt.name not in ("straight", "given"):
            search.options = replace(self.options, iterations=min(self.options.iterations, PATIENCE))
        search.advance()
        search.options = self.options
        self.tried.append(attempt.name)
        return search

    @property
    def _shared(self) -> bool:
        """Whether the first program of all searches is the same."""
        return self._plain and self.durations is None and self.problem.potential is None

    def _first_program(self, search: Search) -> NonlinearProgram:
        if self._program is None:
            self._program = search.made()
        return self._program

    def _try_unaware(self, targets: list[np.ndarray]) -> None:
        """Optima without obstacles: nothing is better near one that happens to be clear of them."""
        count = UNAWARE if len(targets) == 1 else 1
        for k, motion in enumerate(islice(guesses(self.problem, targets, self.seed), count)):
            name = f"free bent {k}" if k else "straight"
            search = self._searched(self._space(), Attempt(name, motion, targets[0]), unaware=True)
            self.tried.pop()
            if search.outcome in STOP:
                self.searches.append(search)
                return
            others = [other.objective for other in self.unaware]
            if search.converged and not any(abs(search.objective - other) <= SAME * abs(other) for other in others):
                self.unaware.append(search)
        for search in sorted(self.unaware, key=lambda search: search.objective):
            if overlap(search.avoidance, search.trajectory) <= HOPELESS and search.clear():
                self.searches.append(search)
                self.tried.append(search.name)
                return

    def _look_further(self, source: Iterator[Attempt], targets: list[np.ndarray]) -> None:
        """Another guess, where obstacles make the motion much dearer: the better of the two stays in ``searches``."""
        first = self.searches[0]
        if not self.unaware or not _promising(first):
            return
        best = min(self.unaware, key=lambda search: search.objective)
        straight = [search.objective for search in self.unaware if search.name == "straight"]
        other = best.objective < BETTER * min(straight, default=np.inf)
        if other and first.objective > WORTH * best.objective:
            self._compare(Attempt("free optimum", best.trajectory, targets[0]))
        if self.searches[-1].outcome not in STOP and self.searches[0].objective > COSTLY * best.objective:
            self._compare(next(source))

    def _compare(self, attempt: Attempt) -> None:
        """A search that takes the place of the first where it is better."""
        first, second = self.searches[0], self._searched(self._space(), attempt)
        if second.outcome is Outcome.INTERRUPTED:
            self.searches.append(second)
        elif _promising(second):
            better, other = sorted((first, second), key=lambda search: search.objective)
            self.searches[:] = [better]
            self.worse.append(other)

    def _in_processes(self, attempts: Iterator[Attempt]) -> None:
        """The same searches in worker processes; in the end they stand in the order of the attempts."""
        sent: dict[int, Attempt] = {}
        found: list[tuple[int, Search]] = []
        first, stop = len(self.searches), self.options.stop or (lambda: False)
        late = lambda grace: (left := self.options.remaining()) is not None and left < -grace

        def calls() -> Iterator[tuple]:
            for k, attempt in enumerate(attempts):
                if late(0.0):  # looking for a path may have taken all there was
                    return
                sent[k] = attempt
                yield self.problem, self.durations, self.parameterization, attempt, self.options.iterations, self.options.deadline

        for k, answer in call_all(search_once, calls(), os.cpu_count() or 1, lambda: stop() or late(GRACE) or self._enough()):
            attempt = sent.pop(k)
            search = self._received(answer, attempt) if isinstance(answer, Search) else self._searched(self._space(), attempt)
            self.searches.append(search)
            found.append((k, search))
            if self.options.progress is not None:
                self.options.progress(f"start {len(self.searches)}", self.spent.iterations, search.objective, search.depth)
            if search.outcome in STOP:
                break
        self.searches[first:] = [search for _, search in sorted(found, key=lambda item: item[0])]
        self.tried[first:] = [search.name for search in self.searches[first:]]
        if stop():
            self.searches.append(replace(self.current, outcome=Outcome.INTERRUPTED))

    def _received(self, answer: Search, attempt: Attempt) -> Search:
        """A search from another process, with what was not sent."""
        self.spent.add(answer.spent)
        problem = self.problem if self.durations is None else self.problem.lasting(answer.trajectory.duration)
        own = {"problem": problem, "kernels": self.kernels, "options": self.options, "spent": self.spent}
        return replace(answer, **own, avoidance=self._relaxed(attempt))

    def _relaxed(self, attempt: Attempt) -> Avoidance | None:
        """What is asked of the spheres, given that start, goal and timed waypoints are free."""
        if self.avoidance is None:
            return None
        problem = self.problem
        stops = [(0.0, problem.start), (problem.duration, attempt.goal)]
        return self.avoidance.relaxed(stops + [(w.time, w.position) for w in problem.waypoints if w.time is not None])

    def _possible(self, targets: list[np.ndarray]) -> list[np.ndarray]:
        """Goal configurations that are not impossible; where all are, the error of the nearest is raised."""
        possible, errors = [], []
        for target in targets:
            try:
                check_feasibility(self.problem, goal=target)
                check_ends(self.problem, target)
                possible.append(target)
            except ProblemError as error:
                errors.append(error)
        if not possible:
            raise errors[0]
        return possible

    def _on_finer_knots(self, attempt: Attempt) -> list[Search]:
        """Searches in ever finer spaces, where the knots may be chosen: near the least duration coarse ones hold no motion."""
        spline, searches = self.parameterization, []
        if not isinstance(spline, BSpline) or spline.accuracy is None:
            return searches
        space, attempt = spline.space(self.problem.duration), replace(attempt, name=f"{attempt.name} on finer knots")
        for _ in range(FINER):
            space = bisected(space)
            searches.append(self._searched(space, attempt))
            if searches[-1].outcome is not Outcome.INFEASIBLE:
                break
        return searches

    def _space(self) -> MotionSpace:
        """Where to search first; Coulomb friction, nearly a step in the velocity, wants more quadrature nodes."""
        if self._first_space is None or not self._shared:
            self._first_space = self.parameterization.space(self.problem.duration, ROUGH_NODES if rough(self.problem) else None)
        return self._first_space

    def _space_of(self, motion: Trajectory, otherwise: MotionSpace) -> MotionSpace:
        """The space of a spline, whose knots may have been chosen with care, unless the caller wants others."""
        spline = self.parameterization
        free = isinstance(spline, BSpline) and spline.knots is None and spline.control_points is None
        if not (free and isinstance(motion, SplineTrajectory) and motion.degree == spline.degree):
            return otherwise
        return SplineSpace(motion.breaks, spline.degree, otherwise.nodes)

    def verdict(self, search: Search) -> Violations:
        """The dense check of a search's motion, done once a motion."""
        if self._verdict is None or self._verdict[0] is not search.trajectory:
            began = time.perf_counter()
            self._verdict = (search.trajectory, verify(search.problem, search.trajectory))
            self.verify_s += time.perf_counter() - began
        return self._verdict[1]

    def _holds(self, search: Search) -> bool:
        return search.converged and is_valid(self.verdict(search))

    def _excess(self, search: Search) -> float:
        return max(self.verdict(search).amount.values(), default=0.0)

    def _refined(self, search: Search) -> Search:
        """Refine until the estimated error is below the accuracy asked; of all levels, the last that holds."""
        levels = [search]
        reason = self._levels(levels)
        held = last = levels[-1]
        for level in reversed(levels):
            level.harden(self._accuracy)
            if level.outcome in STOP or self._holds(level):
                held = level
                break
        if held is last and held.gain is None and held.levels > 1:
            levels = [held]
            reason = self._levels(levels)
            last = levels[-1]
            held = next((level for level in reversed(levels) if level.outcome in STOP or self._holds(level)), held)
        if held is not last:
            reason = "a limit or the clearance did not hold on finer knots"
        if reason and held.converged:
            held.reason = _stopped(held.error, reason)
        return held

    @property
    def _accuracy(self) -> float | None:
        """Of J, where it is asked for."""
        return self.parameterization.accuracy if isinstance(self.parameterization, BSpline) else None

    def _levels(self, levels: list[Search]) -> str:
        """Append a copy of the search for every level it converged on; returns why it stopped early, or nothing."""
        search, accuracy = levels[0], self._accuracy
        search.ease()
        levels[:] = [search.copy()]
        while accuracy and search.converged:
            reached = search.reaches(accuracy)
            levels[-1] = kept = search.copy()
            if reached:
                return ""
            if search.levels >= MOST_LEVELS:
                return f"{MOST_LEVELS} levels were made"
            if not search.refine(accuracy) or not search.advance():
                if search.outcome is Outcome.INTERRUPTED:
                    kept.outcome = Outcome.INTERRUPTED
                return search.reason
            if search.objective > kept.objective:  # finer spaces contain the coarser ones: this is the solver's own error
                return "finer knots gave no better motion"
            levels.append(search.copy())
        return ""


def search_once(
    problem: Problem,
    durations: tuple[float, float] | None,
    parameterization: Parameterization,
    attempt: Attempt,
    iterations: int,
    deadline: float | None,
) -> Search:
    """The first level from one guess, in a process of its own: without what cannot be sent, or the caller has."""
    options = SearchOptions(iterations, deadline=deadline)
    kernels = kernels_of(problem.robot.dynamics)
    campaign = Campaign(problem, parameterization, kernels, options, seed=0, durations=durations)
    campaign.avoidance = avoidance_of(problem)
    search = campaign._searched(campaign._space(), attempt)
    return search.sent()


def _promising(search: Search) -> bool:
    """Whether a search converged to a motion that overlaps nowhere, or so little that rows will push it out."""
    return search.converged and search.depth <= DEEP


def _first_of_each(ranked: list[Search], searches: list[Search]) -> list[Search]:
    """One search for each optimum, best first: of those that ended in it the earliest, so that chance does not choose."""
    groups: list[list[Search]] = []
    for search in ranked:
        if groups and abs(search.objective - groups[-1][0].objective) <= SAME * abs(search.objective):
            groups[-1].append(search)
        else:
            groups.append([search])
    place = {id(search): k for k, search in enumerate(searches)}
    return [min(group, key=lambda search: place[id(search)]) for group in groups]


def _in_turn(sources: list[Iterator], targets: list[np.ndarray]) -> Iterator[tuple]:
    """One guess of each source after another, with the source's target, until all have ended."""
    open_ = list(zip(sources, targets, strict=True))
    while open_:
        for pair in tuple(open_):
            guess = next(pair[0], None)
            if guess is None:
                open_.remove(pair)
            else:
                yield guess, pair[1]


def _stopped(error: float | None, reason: str) -> str:
    return f"refinement stopped at an estimated error of {_percent(error)}: {reason}"


def _percent(error: float | None) -> str:
    return "unknown size" if error is None else f"{100 * error:.2g} %"
