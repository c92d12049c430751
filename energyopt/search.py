"""One local search: solve, add rows where a limit is broken between samples, refine the spline, and solve again.

A search advances by levels. A level ends with a motion that is optimal in its motion space and inside all limits between
the samples too; the next level has finer knots and starts from that motion. Where there is something to stay clear of, a
penalty that begins a little before it has to keeps the motion away from it. Where what that costs is more than the accuracy
asked leaves, or the motion is not clear by exact geometry, rows take its place at the end of the last level.
"""

from __future__ import annotations

import time

from energyopt.refinement import (
    AIM,
    MOST_SPANS,
    UNMEASURED,
    bisected,
    measured,
    promise,
    refine,
    refine_evenly,
    rough,
    roughly,
    shortest_span,
)
from energyopt.rounds import DEEP, HINGE_BAND, ROUNDS, STIFFNESS, WARM_BARRIER, Rounds
from energyopt.search_state import GOOD, Progress, SearchOptions, Spent
from energyopt.solvers import SolverOptions
from energyopt.transcription import NonlinearProgram, transcribe
from energyopt.transcription.easing import eased
from energyopt.transcription.penalty import overlap, price

__all__ = ["DEEP", "GOOD", "ROUNDS", "STIFFNESS", "Progress", "Search", "SearchOptions", "Spent"]

FINER_BARRIER = 1e-2
"""Initial barrier parameter on knots that were just refined: 11 iterations, against 13 from 0.001 or less."""
NEAR_BARRIER = 1e-1
"""The same from the optimum of a problem much like this one: over changes of payload, weights, limits, goal and duration it took
11 iterations (19 at most), against 18 from 1 and 14 (31 at most) from 1e-5."""
DEAR = 1e-3
"""What a penalty may cost, as a share of J, where no accuracy is asked for."""
CHANGED = 1e-2
"""Relative change of J by clearing a motion from which its discretisation is judged anew."""
TAKEN_BACK = 2
"""Times it is measured again what spheres ask too much, where a motion is not clear by exact geometry."""


class Search(Rounds):
    """A local search; `advance` takes it one level further. For its attributes see `SearchState`."""

    def made(self) -> NonlinearProgram:
        """The program of the first round, for searches that share it."""
        return self._transcribe()

    def begin_with(self, program: NonlinearProgram) -> None:
        """Begin with a program made already, that of another guess for the same problem in the same space."""
        program.evaluator.move(program.guess(self.trajectory))
        self.ready, self.first_objective = program, program.evaluator.objective()

    def advance(self) -> bool:
        """Solve one level. Returns whether it ended with an optimal motion inside all limits."""
        started, built = time.perf_counter(), self.spent.build_s
        previous, self.promise, self.error = self.objective if self.levels else None, None, None
        self._solve_level()
        if self.converged:
            self.gain = None if previous is None else measured(previous - self.objective, self.gain, self.problem)
            self.levels += 1
        self.spent.solve_s += time.perf_counter() - started - (self.spent.build_s - built)
        return self.converged

    def resume(self) -> bool:
        """As `advance`, on knots that were refined for a problem much like this one, from its optimum."""
        started, built = time.perf_counter(), self.spent.build_s
        self.first_objective = self.first_objective or self._guessed_objective()
        self._solve_rounds(NEAR_BARRIER)
        self.levels, self.promise, self.error = 1, None, None
        self.spent.solve_s += time.perf_counter() - started - (self.spent.build_s - built)
        return self.converged

    def keep_apart(self) -> bool:
        """Solve once more, on the same knots, with the penalty that the motion was found without; a first look."""
        started = time.perf_counter()
        self.stiffness, self.sketch = 1, True
        self._solve_rounds(WARM_BARRIER)
        self.spent.solve_s += time.perf_counter() - started
        return self.converged

    def reaches(self, accuracy: float) -> bool:
        """Estimate `error`, relative to J (a small share of the guess's where J all but vanishes); whether it is low enough."""
        started = time.perf_counter()
        fine = transcribe(self.problem, bisected(self.space), self.kernels, self.cuts, self._clearance_terms)
        look = roughly if rough(self.problem) else promise
        self.promise = look(self.space, fine, fine.guess(self.trajectory))
        left = self.promise.error(self.objective, self.gain)
        self.error = None if left is None else left / self.scale
        self.spent.solve_s += time.perf_counter() - started
        return left is not None and self.error <= accuracy * (UNMEASURED if self.gain is None and not self.warm else 1.0)

    def refine(self, accuracy: float) -> bool:
        """Prepare a finer level that should reach an accuracy; False where there is none."""
        if len(self.space.breaks) > MOST_SPANS:
            return False
        shortest = shortest_span(self.problem)
        if self.promise.gain is None:
            self.space = refine_evenly(self.space, shortest)
        else:
            self.space = refine(self.space, self.promise.by_span, AIM * accuracy / self.error, shortest)
        return True

    def ease(self, back: bool = False) -> bool:
        """Ask so much less of the spheres as exact geometry shows that they ask too much, and solve once more, as also after a
        first look; with ``back``, take back what was given too much."""
        if self.avoidance is None or not self.stiffness or self.hard or not self.converged:
            return self.converged
        started, before = time.perf_counter(), self.avoidance
        self.avoidance, looked = eased(before, self.problem, self.trajectory, back), self.sketch
        self.sketch = False
        if looked or self.avoidance is not before:
            self._solve_rounds(WARM_BARRIER)
        self.spent.solve_s += time.perf_counter() - started
        return self.converged

    def harden(self, accuracy: float | None) -> bool:
        """Clear the motion of all overlaps, on the same knots; as `advance`, and from then on at every level.

        Does nothing where the motion keeps clear and the penalty, if there is one, costs so little that the error stays below the
        accuracy asked. Otherwise the penalty becomes so stiff, and begins so late, that it moves the optimum by little; rows keep
        what it leaves.
        """
        if self.avoidance is None or not self.converged or self.hard:
            return self.converged
        for _ in range(TAKEN_BACK):
            if not self.clear() and self.stiffness:
                self.ease(back=True)
        if self.clear() and self._is_cheap(accuracy):
            return self.converged
        started, free, unaware = time.perf_counter(), self.objective, not self.stiffness
        if self._stiffen():
            self._solve_rounds(WARM_BARRIER)
        self.hard = True
        if self.converged and (self._add_clearance() or (self.stiffness and self._near())):
            self._solve_rounds(WARM_BARRIER)
        if unaware and abs(self.objective - free) > CHANGED * abs(free):
            self.gain = self.error = None  # what was measured holds for another motion
        if self.converged and self.stiffness and self.error is not None:
            self.error += self._price()
        self.spent.solve_s += time.perf_counter() - started
        return self.converged

    def _is_cheap(self, accuracy: float | None) -> bool:
        """Whether what the penalty costs is within the accuracy asked; it counts as error from then on."""
        if not self.stiffness:
            return True
        share = self._price()
        if share > (DEAR if accuracy is None or self.error is None else accuracy - self.error):
            return False
        self.error = None if self.error is None else self.error + share
        return True

    def _price(self) -> float:
        """What the penalty costs, as a share of J."""
        return price(self.avoidance, self.trajectory, self._hinge()) / self.scale

    def _near(self) -> bool:
        """Whether the penalty is felt at all."""
        return overlap(self.avoidance, self.trajectory, HINGE_BAND) > 0.0

    def _solve_level(self) -> None:
        if self.first_objective is None:
            self.first_objective = self._guessed_objective()
        self._solve_rounds(FINER_BARRIER if self.levels else WARM_BARRIER if self.warm else SolverOptions.barrier)
