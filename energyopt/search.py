"""One local search, level by level: each on finer knots than the one before, from whose motion it starts (see `rounds`).

At the end of the last level rows take the place of the penalty that keeps things apart, where what that costs is more than the
accuracy asked leaves, or the motion is not clear by exact geometry.
"""

from __future__ import annotations

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
from energyopt.rounds import HINGE_BAND, WARM_BARRIER, Rounds
from energyopt.search_state import STOP
from energyopt.solvers import SolverOptions
from energyopt.transcription import NonlinearProgram, transcribe
from energyopt.transcription.easing import eased
from energyopt.transcription.penalty import overlap, price

FINER_BARRIER = 1e-2
"""Initial barrier parameter on knots that were just refined: 11 iterations, against 13 from 0.001 or less."""
NEAR_BARRIER = 1e-1
"""The same from the optimum of a problem much like this one: over changes of payload, weights, limits, goal and duration it took
11 iterations (19 at most), against 18 from 1 and 14 (31 at most) from 1e-5."""
NEAR_STIFF_BARRIER = 1e-2
"""The same with the stiff penalty at the end of a search, into which a larger one drives the motion: a curve of 12 durations took
23 s instead of 40."""
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
        previous, self.promise, self.error = self.objective if self.levels else None, None, None
        with self.spent.solving():
            self._solve_level()
        if self.converged:
            self.gain = None if previous is None else measured(previous - self.objective, self.gain, self.problem)
            self.levels += 1
        return self.converged

    def resume(self) -> bool:
        """As `advance`, on knots that were refined for a problem much like this one, from its optimum."""
        with self.spent.solving():
            self.first_objective = self.first_objective or self._guessed_objective()
            self._solve_rounds(NEAR_STIFF_BARRIER if self.hard else NEAR_BARRIER)
        self.levels, self.promise, self.error = 1, None, None
        return self.converged

    def keep_apart(self) -> bool:
        """Solve once more, on the same knots, with the penalty that the motion was found without; a first look."""
        self.stiffness, self.sketch = 1, True
        with self.spent.solving():
            self._solve_rounds(WARM_BARRIER)
        return self.converged

    def reaches(self, accuracy: float) -> bool:
        """Estimate `error`, relative to J (a small share of the guess's where J all but vanishes); whether it is low enough."""
        with self.spent.solving():
            fine = transcribe(self.problem, bisected(self.space), self.kernels, self.cuts, self._clearance_terms)
            look = roughly if rough(self.problem) else promise
            self.promise = look(self.space, fine, fine.guess(self.trajectory))
        left = self.promise.error(self.objective, self.gain)
        self.error = None if left is None else left / self.scale
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
        before, looked = self.avoidance, self.sketch
        with self.spent.solving():
            self.avoidance, self.sketch = eased(before, self.problem, self.trajectory, back), False
            if looked or self.avoidance is not before:
                self._solve_rounds(WARM_BARRIER)
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
            if self.outcome in STOP:
                return False
        if self.clear() and self._is_cheap(accuracy):
            return self.converged
        free, unaware = self.objective, not self.stiffness
        with self.spent.solving():
            self._solve_clear()
        if unaware and abs(self.objective - free) > CHANGED * abs(free):
            self.gain = self.error = None  # what was measured holds for another motion
        if self.converged and self.stiffness and self.error is not None:
            self.error += self._price()
        return self.converged

    def _solve_clear(self) -> None:
        """Solve with the stiffest hinge or rows, wherever something is near."""
        if self._stiffen():
            self._solve_rounds(WARM_BARRIER)
        self.hard = True
        if self.converged and (self._add_clearance() or (self.stiffness and self._near())):
            self._solve_rounds(WARM_BARRIER)

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
