"""One local search: solve, add rows where a limit is broken between samples, refine the spline, and solve again.

A search advances by levels. A level ends with a motion that is optimal in its motion space and inside all limits between
the samples too; the next level has finer knots and starts from that motion.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from energyopt.avoidance import Avoidance
from energyopt.collision import Hinge
from energyopt.dynamics.kernels import Kernels
from energyopt.parameterizations import BSpline
from energyopt.parameterizations.space import MotionSpace, Unknowns
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.refinement import MOST_SPANS, REMAINDER, bisected, refine, shortest_span, span_gains
from energyopt.solvers import IpoptOptions, Outcome, solve
from energyopt.transcription import Cuts, NonlinearProgram, transcribe
from energyopt.transcription.clearance import ClearanceTerms, close_pairs, needed_rows, penalty_samples, touching_pairs

ROUNDS = 15
"""Times rows are added in one level before the search gives up."""
WARM_BARRIER = 1e-5
"""Initial barrier parameter from a motion that is nearly optimal already."""
CLEARANCE_ROUNDS = 40
"""The same where there is something to stay clear of."""
HINGE_BAND = 5e-3
"""Distance [m] beyond what is asked at which the hinge begins."""
HINGE_DEPTH = 1e-2
"""Depth [m] at which a hinge of stiffness 1 costs, over the whole motion, as much as the guess does."""
STIFFNESS = (1.0, 10.0, 100.0)
DEEP = 5e-3
"""Depth [m] of an overlap from which a stiffer hinge is tried before rows."""
LEAST_SHARE = 1e-3
"""Share of the guess's J below which the accuracy of J is no longer relative to J itself."""
GOOD = (Outcome.CONVERGED, Outcome.ACCEPTABLE)

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


@dataclass
class Search:
    """The state of one search; `advance` takes it one level further.

    Attributes:
        space: motions of the next level; trajectory: the best motion so far, a guess at first.
        avoidance: what is to be kept apart; name: of the guess.
        outcome: of the last solve; reason: the solver's word.
        objective: J of the last level by the program's own quadrature; first_objective: that of the guess.
        stiffness: of the hinge that keeps pairs apart which have no row yet, as a place in STIFFNESS from 1; 0 for none;
            banded: whether it begins before it has to, which moves the optimum.
        gain: by how much the last refinement lowered J.
        iterations: of all solves; build_s, solve_s: seconds spent.
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
    objective: float = np.inf
    first_objective: float | None = None
    gain: float | None = None
    stiffness: int = 0
    banded: bool = False
    iterations: int = 0
    rounds: int = 0
    levels: int = 0
    build_s: float = 0.0
    solve_s: float = 0.0
    evaluations: dict[str, int] = field(default_factory=dict)

    @property
    def converged(self) -> bool:
        return self.outcome in GOOD

    @property
    def error(self) -> float | None:
        """Estimated relative distance of J to the continuous optimum; None before a refinement has been measured.

        Relative to J, or to a small share of the guess's where J all but vanishes.
        """
        if self.gain is None:
            return None
        return REMAINDER * abs(self.gain) / max(self.objective, LEAST_SHARE * self.first_objective, 1e-300)

    def advance(self) -> bool:
        """Solve one level. Returns whether it ended with an optimal motion inside all limits."""
        started, built = time.perf_counter(), self.build_s
        previous = self.objective if self.levels else None
        self._solve_level()
        if self.converged:
            self.gain = None if previous is None else previous - self.objective
            self.levels += 1
        self.solve_s += time.perf_counter() - started - (self.build_s - built)
        return self.converged

    def refine(self, parameterization: BSpline) -> bool:
        """Prepare a finer level; False where there is none."""
        if len(self.space.breaks) > MOST_SPANS:
            return False
        started = time.perf_counter()
        fine = transcribe(self.problem, bisected(self.space), self.kernels, self.cuts, self._clearance_terms)
        gains = span_gains(self.space, fine, fine.guess(self.trajectory))
        self.space = refine(self.space, gains, shortest_span(self.problem))
        self.solve_s += time.perf_counter() - started
        return True

    def _solve_level(self) -> None:
        if self.first_objective is None:
            self.first_objective = self._guessed_objective()
        barrier = WARM_BARRIER if self.levels else IpoptOptions.barrier
        if self.levels and self.avoidance:  # near an optimum, rows are enough, and those far from being needed only cost
            self.stiffness = 0
            self.cuts.clearance = needed_rows(self.avoidance, self.trajectory, self.cuts.clearance)
        for self.rounds in range(1, (CLEARANCE_ROUNDS if self.avoidance else ROUNDS) + 1):
            program = self._transcribe()
            x0 = program.guess(self.trajectory)
            result = solve(program, x0, self._solver_options(barrier), self._reporter(), self.options.stop)
            self.iterations += result.iterations
            self.outcome, self.reason = result.outcome, result.reason
            for name, count in result.evaluations.items():
                self.evaluations[name] = self.evaluations.get(name, 0) + count
            if result.outcome is Outcome.FAILED:
                return
            self.trajectory, self.objective = program.trajectory(result.x), result.objective
            if not self.converged or not self._add_rows():
                return
            barrier = WARM_BARRIER

    def _add_rows(self) -> bool:
        """Add rows where the motion breaks a limit or comes too close; False where it does not."""
        added = self.cuts.add_violated(self.problem, self.trajectory, self.kernels, self.space.everywhere)
        return self._add_clearance() or added if self.avoidance else added

    def _add_clearance(self) -> bool:
        """The hinge pushes a motion out of deep overlaps, harder each time; rows then keep it from what is left."""
        close = close_pairs(self.avoidance, self.trajectory, HINGE_BAND if self.banded else 0.0)
        if close.depth > DEEP and self.stiffness < len(STIFFNESS) and not self.levels:
            self.stiffness, self.banded = self.stiffness + 1, True
            return True
        self.banded = False
        if not close.rows and self.avoidance.eased:
            close = touching_pairs(self.avoidance, self.problem, self.trajectory)
        new = {key: bound for key, bound in close.rows.items() if bound > self.cuts.clearance.get(key, -np.inf)}
        self.cuts.clearance.update(new)
        return bool(new)

    def _clearance_terms(self, space: MotionSpace, unknowns: Unknowns, cuts: Cuts) -> ClearanceTerms | None:
        """Rows found so far; a potential where the problem has one; a hinge that keeps the next motion from other pairs."""
        if self.avoidance is None:
            return None
        samples, hinge = (np.zeros(0), np.zeros(0)), Hinge()
        if self.stiffness or self.avoidance.scene.potential is not None:
            samples = penalty_samples(self.avoidance, self.trajectory)
        if self.stiffness:
            scale = abs(self.first_objective) / self.problem.duration
            hinge = Hinge(2.0 * scale * STIFFNESS[self.stiffness - 1] / HINGE_DEPTH**2, HINGE_BAND if self.banded else 0.0)
        if not (cuts.clearance or len(samples[0])):
            return None
        return ClearanceTerms(self.avoidance, space, unknowns, cuts.clearance, hinge, samples)

    def _guessed_objective(self) -> float:
        """J of the guess, without clearance."""
        program = transcribe(self.problem, self.space, self.kernels)
        program.evaluator.move(program.guess(self.trajectory))
        return program.evaluator.objective()

    def _transcribe(self) -> NonlinearProgram:
        started = time.perf_counter()
        program = transcribe(self.problem, self.space, self.kernels, self.cuts, self._clearance_terms)
        if not self.levels and self.rounds == 1:
            self.build_s += time.perf_counter() - started
        return program

    def _solver_options(self, barrier: float) -> IpoptOptions:
        options = self.options
        return IpoptOptions(options.tolerance, options.iterations, barrier, options.remaining())

    def _reporter(self):
        progress = self.options.progress
        if progress is None:
            return None
        first, phase = self.iterations, f"{self.levels + 1}.{self.rounds}"
        return lambda iteration, objective, violation: progress(phase, first + iteration, objective, violation)
