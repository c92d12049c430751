"""What a local search knows, what it may spend, and what has been spent."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from energyopt.avoidance import Avoidance
from energyopt.clock import now
from energyopt.dynamics.kernels import Kernels, kernels_of
from energyopt.parameterizations.space import MotionSpace
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.refinement import Promise
from energyopt.solvers import Outcome
from energyopt.transcription import Cuts, NonlinearProgram

GOOD = (Outcome.CONVERGED, Outcome.ACCEPTABLE)
STOP = (Outcome.INTERRUPTED, Outcome.TIME_LIMIT)
"""Outcomes after which nothing more is searched."""
LEAST_SHARE = 1e-3
"""Share of the guess's J below which the accuracy of J is no longer relative to J itself."""

Progress = Callable[[str, int, float, float], None]
"""Called with (phase, iteration, objective, worst violation)."""


@dataclass(frozen=True)
class SearchOptions:
    """What a search may spend. ``deadline`` is a time of `time.monotonic`; ``stop`` tells whether the user wants an end."""

    iterations: int = 500
    tolerance: float = 1e-6
    deadline: float | None = None
    progress: Progress | None = None
    stop: Callable[[], bool] | None = None

    def remaining(self) -> float | None:
        return None if self.deadline is None else self.deadline - time.monotonic()

    @property
    def late(self) -> bool:
        """Whether the time is over."""
        return self.deadline is not None and time.monotonic() >= self.deadline


@dataclass
class Spent:
    """What all searches of one plan have spent: iterations of the solver, seconds to build programs and to solve them."""

    iterations: int = 0
    build_s: float = 0.0
    solve_s: float = 0.0

    def add(self, other: Spent) -> None:
        self.iterations, self.build_s = self.iterations + other.iterations, self.build_s + other.build_s
        self.solve_s += other.solve_s

    @contextmanager
    def building(self) -> Iterator[None]:
        """Count the time of what is done meanwhile as building."""
        began = now()
        try:
            yield
        finally:
            self.build_s += now() - began

    @contextmanager
    def solving(self) -> Iterator[None]:
        """Count the time of what is done meanwhile as solving, less what of it was building."""
        began, built = now(), self.build_s
        try:
            yield
        finally:
            self.solve_s += now() - began - (self.build_s - built)


@dataclass
class SearchState:
    """What one search knows; see `search.Search`.

    Attributes:
        space: motions of the next level; trajectory: the best motion so far, a guess at first.
        avoidance: what is to be kept apart; name: of the guess.
        outcome: of the last solve; reason: the solver's word; solver: which it was.
        objective: J of the last level by the program's own quadrature; first_objective: that of the guess.
        stiffness: of the penalty that keeps pairs apart, as a place in STIFFNESS from 1; 0 for none.
        depth: overlap of spheres, beyond what is allowed, that it left [m]; hard: whether rows have taken its place.
        gain: by how much the last refinement lowered J.
        promise: what finer knots promise; error: estimated relative distance of J to the continuous optimum near this motion.
        durations: bounds of the duration [s], where it is free; `problem` is then the problem at the duration reached.
        warm: whether the guess is nearly optimal, on knots made for it.
        sketch: whether a first look is enough, with fewer samples of the penalty and larger tolerances.
        ready: a program made already for the next round.
        spent: shared with other searches of the same plan, and with copies.
    """

    problem: Problem
    space: MotionSpace
    kernels: Kernels
    trajectory: Trajectory
    options: SearchOptions
    avoidance: Avoidance | None = None
    name: str = ""
    cuts: Cuts = field(default_factory=Cuts)
    outcome: Outcome | None = None
    reason: str = ""
    solver: str = ""
    objective: float = np.inf
    first_objective: float | None = None
    gain: float | None = None
    promise: Promise | None = None
    error: float | None = None
    stiffness: int = 0
    depth: float = 0.0
    hard: bool = False
    durations: tuple[float, float] | None = None
    warm: bool = False
    sketch: bool = False
    spent: Spent = field(default_factory=Spent)
    rounds: int = 0
    levels: int = 0
    ready: NonlinearProgram | None = None
    evaluations: dict[str, int] = field(default_factory=dict)

    @property
    def converged(self) -> bool:
        return self.outcome in GOOD

    @property
    def scale(self) -> float:
        """What errors of J are relative to."""
        return max(abs(self.objective), LEAST_SHARE * abs(self.first_objective), 1e-300)

    def copy(self) -> Self:
        """The search as it is now; what is done to one is not done to the other."""
        return replace(self, cuts=self.cuts.copy(), evaluations=dict(self.evaluations))

    def restarted(
        self,
        problem: Problem,
        options: SearchOptions,
        avoidance: Avoidance | None,
        spent: Spent,
        motion: Trajectory | None = None,
    ) -> Self:
        """A search of a similar problem that begins on this one's knots, with its rows, in that problem's duration: with this
        one's motion, or with another of that duration."""
        factor = problem.duration / self.space.duration
        return type(self)(
            problem,
            self.space if factor == 1.0 else self.space.stretched(problem.duration),
            kernels_of(problem.robot.dynamics),
            motion or self.trajectory.stretched(problem.duration),
            options,
            avoidance,
            name=self.name,
            cuts=self.cuts.stretched(factor),
            stiffness=self.stiffness,
            hard=self.hard,
            first_objective=self.first_objective,
            warm=True,
            spent=spent,
        )

    def on_knots_of(self, other: SearchState) -> Self:
        """The same motion and rows, on the knots of another search, run through in this one's time."""
        return replace(self.copy(), space=other.space.stretched(self.space.duration))

    def sent(self) -> Self:
        """Without what cannot be sent to another process, or is there already."""
        return replace(self, problem=None, kernels=None, options=None, avoidance=None)

    def received(self, problem: Problem) -> Self:
        """What was `sent`, to go on from (see `restarted`)."""
        return replace(self, problem=problem, kernels=kernels_of(problem.robot.dynamics))
