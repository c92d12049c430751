"""Attempts: the guesses of one plan, one after another, and what they need first: goal configurations and a duration.

Where nothing but the arm itself is in the way, guesses are the straight quintic and motions that differ from it (`diversity`).
Among obstacles they come from `pathfinding`: the straight one even where it is not free, since a penalty mostly pushes it out,
and then free ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from energyopt.avoidance import arm_obstacles, bound_frames, planned_pairs
from energyopt.clearance_checks import check_ends
from energyopt.clock import now
from energyopt.diversity import Guess, diverse, hops
from energyopt.dynamics.kernels import Kernels
from energyopt.errors import ProblemError
from energyopt.feasibility import check_feasibility
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.pathfinding import Budget, FreeSpace
from energyopt.pathfinding import guesses as clear_guesses
from energyopt.problem import FramePose, Problem
from energyopt.search import Search
from energyopt.seeds import first_durations, goals, guesses

PATH_SECONDS = 8.0
"""Time for the search of one path [s]."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """One guess.

    Attributes:
        name, motion: of the guess; goal: the configuration it ends in.
        free: whether it is known to be free of obstacles.
        apart: whether links of the arm are to be kept apart from the beginning.
        warm: whether it is nearly optimal, on knots made for it.
        patient: whether it is worth many iterations, unlike one of many guesses.
    """

    name: str
    motion: Trajectory
    goal: np.ndarray
    free: bool = False
    apart: bool = False
    warm: bool = False
    patient: bool = False


@dataclass
class Attempts:
    """Where the guesses of one plan come from.

    Attributes:
        problem: with the duration to start from.
        given: a motion the caller starts from.
        path_search: what looks for ways around obstacles; until: when that ends, a time of `time.monotonic`.
        missed: searches for a path that found none; seconds: spent on guesses.
    """

    problem: Problem
    kernels: Kernels
    seed: int
    given: Trajectory | None = None
    path_search: str = "auto"
    until: float = np.inf
    missed: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def targets(self) -> list[np.ndarray]:
        """Goal configurations to aim at.

        Raises:
            ProblemError: start or goal touches something, or no goal configuration is possible.
        """
        began = now()
        targets = goals(self.problem, self.seed)
        if isinstance(self.problem.goal, FramePose):
            targets = self._possible(targets)
        else:
            check_ends(self.problem, self.problem.goal_position)
        self.seconds += now() - began
        return targets

    def all(self, targets: list[np.ndarray]) -> Iterator[Attempt]:
        """The given motion, and then one guess after another, without end."""
        return self._timed(self._all(targets))

    def hops(self, bases: list[Search], targets: list[np.ndarray], number: int, apart: bool) -> Attempt:
        """The changed copy of this number of one of two optima, of which the first is the better one."""
        began = now()
        some = [self.given_by(base.trajectory, targets, base.name) for base in bases]
        guess = next(hops(self.problem, [Guess(one.name, one.motion, one.goal) for one in some], self.seed, number))
        self.seconds += now() - began
        return Attempt(guess.name, guess.motion, guess.goal, apart=apart)

    def given_by(self, motion: Trajectory, targets: list[np.ndarray], name: str = "given") -> Attempt:
        """A motion to start from; it ends at the target it is nearest to."""
        motion = motion.stretched(self.problem.duration)
        end = motion(motion.duration)
        return Attempt(name, motion, min(targets, key=lambda q: float(np.linalg.norm(q - end))))

    def _timed(self, source: Iterator[Attempt]) -> Iterator[Attempt]:
        """The same, with the time counted that it takes to make each."""
        while True:
            began = now()
            try:
                attempt = next(source, None)
            finally:
                self.seconds += now() - began
            if attempt is None:
                return
            yield attempt

    def _all(self, targets: list[np.ndarray]) -> Iterator[Attempt]:
        problem = self.problem
        if self.given is not None:
            yield replace(self.given_by(self.given, targets), warm=True, patient=True)
        if is_plain(problem):
            for guess in diverse(problem, targets, self.seed, self.kernels):
                yield Attempt(guess.name, guess.motion, guess.goal, patient=guess.name == "straight")
        free = FreeSpace.of(
            problem.robot,
            arm_obstacles(problem),
            self_pairs=planned_pairs(problem),
            bound=bound_frames(problem),
            attached=problem.attached,
            limits=problem.limits,
            margin=problem.clearance,
        )
        how = {"budget": Budget(PATH_SECONDS, until=self.until), "path_search": self.path_search}
        seeds = range(self.seed, self.seed + len(targets))
        both = zip(seeds, targets, strict=True)
        sources = [clear_guesses(problem, free, q, seed=k, missed=self.missed.append, **how) for k, q in both]
        for guess, target in _in_turn(sources, targets):
            yield Attempt(guess.name, guess.trajectory, target, guess.free)
        for k, motion in enumerate(islice(guesses(problem, targets, self.seed), 1, None), start=1):
            yield Attempt(f"bent unchecked {k}", motion, targets[0])

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


def is_plain(problem: Problem) -> bool:
    """Whether nothing but the arm itself is in the way."""
    return not (problem.obstacles or problem.workspace)


def with_first_duration(
    problem: Problem, durations: tuple[float, float] | None, seed: int, kernels: Kernels, given: Trajectory | None
) -> Problem:
    """The problem, where its duration is free, in one to start from; at the goal, nothing that moves may be in the way then."""
    if durations is None:
        return problem
    goal = problem.goal_position
    if given is not None:
        candidates = [float(np.clip(given.duration, *durations))]
    else:
        somewhere = goals(problem, seed)[0] if goal is None else goal
        candidates = first_durations(problem, durations, somewhere, kernels).tolist()
    if goal is None or not any(obstacle.moves for obstacle in problem.obstacles):
        return problem.lasting(candidates[0])
    for duration in candidates[:-1]:
        try:
            check_ends(problem.lasting(duration), goal)
            return problem.lasting(duration)
        except ProblemError:
            continue
    return problem.lasting(candidates[-1])


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
