"""One level of a local search: solve, add rows where a limit is broken between samples, and solve again.

Where there is something to stay clear of, a penalty that begins a little before it has to keeps the motion away from it: a hinge,
stiffer where that is not enough. At the end of a search rows may take its place.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import numpy as np

from energyopt.clearance_checks import clearance_of
from energyopt.collision import Hinge
from energyopt.parameterizations.space import MotionSpace, Unknowns
from energyopt.search_state import SearchState
from energyopt.solvers import Outcome, SolverOptions, solve
from energyopt.transcription import Cuts, NonlinearProgram, transcribe
from energyopt.transcription.clearance import ClearanceTerms, close_pairs, touching_pairs
from energyopt.transcription.duals import Duals
from energyopt.transcription.penalty import overlap, penalty_samples

ROUNDS = 15
"""Times rows are added in one level before the search gives up."""
CLEARANCE_ROUNDS = 40
"""The same where there is something to stay clear of."""
LATE = 8
"""Rounds after which rows of limits on the motion are moved a little inside these."""
WARM_BARRIER = 1e-5
"""Initial barrier parameter from a motion that is nearly optimal already. Where rows were added on the same knots, multipliers of
the others are given too: 5 iterations instead of 10."""
HINGE_BAND = 5e-3
"""Distance [m] beyond what is asked at which the hinge begins."""
HINGE_DEPTH = 1e-2
"""Depth [m] at which a hinge of stiffness 1 costs, over the whole motion, as much as the guess does."""
STIFFNESS = (0.03, 0.3, 3.0, 30.0)
HARD, HARD_BAND = 40.0, 4e-4
"""How much stiffer the hinge is at the end, and the distance [m] at which it begins then."""
ROUGH_TOLERANCE = 1e-6, 1e-3
"""Of solves with a penalty, which is no exact thing itself: as a share of the guess's J, and at most."""
SKETCH_TOLERANCE = 1e-6, 1e-2
"""The same of a first look."""
DEEP = 5e-3
"""Depth [m] of an overlap from which a stiffer hinge is tried; rows deal with less."""


class Rounds(SearchState):
    """The solves of one level."""

    def _solve_rounds(self, barrier: float) -> None:
        """Solve, and again with more rows, until a check finds nothing to add."""
        known = None
        most = CLEARANCE_ROUNDS if self.hard else ROUNDS
        for self.rounds in range(1, most + 1):
            program, self.ready = self.ready or self._transcribe(), None
            x0 = program.guess(self.trajectory)
            options = self._solver_options(barrier)
            if known is not None:
                options = replace(options, multipliers=known.to(program, self.cuts))
            result = solve(program, x0, options, self._reporter(), self.options.stop)
            self.spent.iterations += result.iterations
            self.outcome, self.reason, self.solver = result.outcome, result.reason, result.solver
            for name, count in result.evaluations.items():
                self.evaluations[name] = self.evaluations.get(name, 0) + count
            if result.outcome is Outcome.FAILED:
                return
            self.trajectory, self.objective = program.trajectory(result.x), result.objective
            if program.stretches:
                self._last(self.trajectory.duration)
            solved = self.cuts.copy()
            if not self.converged or not self._add_rows():
                return
            barrier, known = WARM_BARRIER, None if self.stiffness or self.hard else Duals.of(program, solved, result)

    def _last(self, duration: float) -> None:
        """Go on from another duration."""
        self.cuts = self.cuts.stretched(duration / self.space.duration)
        self.space, self.problem = self.space.stretched(duration), self.problem.lasting(duration)

    def _add_rows(self) -> bool:
        """Add rows where the motion breaks a limit or comes too close; False where it does not."""
        late = self.rounds > LATE
        added = self.cuts.add_violated(self.problem, self.trajectory, self.kernels, self.space.everywhere, late)
        if self.avoidance is None or (not self.hard and not self.stiffness):
            return added
        return (self._add_clearance() if self.hard else self._stiffen()) or added

    def _stiffen(self) -> bool:
        """A stiffer hinge where the motion overlaps deeply."""
        self.depth = overlap(self.avoidance, self.trajectory)
        if self.depth <= DEEP or self.stiffness == len(STIFFNESS):
            return False
        self.stiffness += 1
        return True

    def _add_clearance(self) -> bool:
        """Rows for pairs that are too close, or that the hinge may have kept from it."""
        if self.clear():
            return False  # the spheres stick out of the links: what they miss need not matter
        close = close_pairs(self.avoidance, self.trajectory)
        if not close and self.avoidance.eased:
            close = touching_pairs(self.avoidance, self.problem, self.trajectory)
        new = {key: bound for key, bound in close.items() if bound > self.cuts.clearance.get(key, -np.inf)}
        self.cuts.clearance.update(new)
        return bool(new)

    def clear(self) -> bool:
        """Whether the motion keeps the clearance, by exact geometry."""
        verdict = clearance_of(self.problem, self.trajectory)
        return verdict is None or verdict[0].amount == 0.0

    def _clearance_terms(self, space: MotionSpace, unknowns: Unknowns, cuts: Cuts) -> ClearanceTerms | None:
        """The hinge or the rows, and a potential where the problem has one."""
        if self.avoidance is None:
            return None
        samples = (np.zeros(0), np.zeros(0))
        if self.stiffness or self.avoidance.scene.potential is not None:
            samples = penalty_samples(self.avoidance, self.trajectory, self.sketch)
        if not (cuts.clearance or len(samples[0])):
            return None
        return ClearanceTerms(self.avoidance, space, unknowns, cuts.clearance, self._hinge(), samples)

    def _hinge(self) -> Hinge:
        if not self.stiffness:
            return Hinge()
        unit = 2.0 * abs(self.first_objective) / self.problem.duration / HINGE_DEPTH**2
        return Hinge(HARD * unit, HARD_BAND) if self.hard else Hinge(STIFFNESS[self.stiffness - 1] * unit, HINGE_BAND)

    def _guessed_objective(self) -> float:
        """J of the guess, without clearance. Where there is nothing else to it, its program is also that of the first round."""
        plain = self.avoidance is None and self.durations is None and not len(self.cuts)
        program = self._transcribe() if plain else transcribe(self.problem, self.space, self.kernels)
        self.ready = program if plain else None
        program.evaluator.move(program.guess(self.trajectory))
        return program.evaluator.objective()

    def _transcribe(self) -> NonlinearProgram:
        with self.spent.building() if not self.levels and self.rounds <= 1 else nullcontext():
            return transcribe(self.problem, self.space, self.kernels, self.cuts, self._clearance_terms, self.durations)

    def _solver_options(self, barrier: float) -> SolverOptions:
        options = self.options
        tolerance = options.tolerance
        if self.stiffness and not self.hard:
            share, most = SKETCH_TOLERANCE if self.sketch else ROUGH_TOLERANCE
            tolerance = max(tolerance, min(share * abs(self.first_objective), most))
        return SolverOptions(tolerance, options.iterations, barrier, options.remaining())

    def _reporter(self):
        progress = self.options.progress
        if progress is None:
            return None
        first, phase = self.spent.iterations, f"{self.levels + 1}.{self.rounds}"
        return lambda iteration, objective, violation: progress(phase, first + iteration, objective, violation)
