"""One local search: solve, add rows where a limit is broken between samples, refine the spline, and solve again.

A search advances by levels. A level ends with a motion that is optimal in its motion space and inside all limits between
the samples too; the next level has finer knots and starts from that motion. Where there is something to stay clear of, a
penalty that begins a little before it has to keeps the motion away from it. Where what that costs is more than the accuracy
asked leaves, or the motion is not clear by exact geometry, rows take its place at the end of the last level.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from energyopt.avoidance import Avoidance
from energyopt.clearance_checks import clearance_of
from energyopt.collision import Hinge
from energyopt.dynamics.kernels import Kernels, kernels_of
from energyopt.parameterizations.space import MotionSpace, Unknowns
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.refinement import (
    AIM,
    MOST_SPANS,
    UNMEASURED,
    Promise,
    bisected,
    measured,
    promise,
    refine,
    refine_evenly,
    rough,
    roughly,
    shortest_span,
)
from energyopt.solvers import Outcome, SolverOptions, solve
from energyopt.transcription import Cuts, NonlinearProgram, transcribe
from energyopt.transcription.clearance import ClearanceTerms, close_pairs, touching_pairs
from energyopt.transcription.duals import Duals
from energyopt.transcription.easing import eased
from energyopt.transcription.penalty import overlap, penalty_samples, price

ROUNDS = 15
"""Times rows are added in one level before the search gives up."""
WARM_BARRIER = 1e-5
"""Initial barrier parameter from a motion that is nearly optimal already."""
FINER_BARRIER = 1e-2
"""The same on knots that were just refined: 11 iterations, against 13 from 0.001 or less."""
KNOWN_BARRIER = 1e-5
"""The same where rows were added on the same knots, and the multipliers of the others are known: 5 iterations instead of 10."""
NEAR_BARRIER = 1e-1
"""The same from the optimum of a problem much like this one: over changes of payload, weights, limits, goal and duration it took
11 iterations (19 at most), against 18 from 1 and 14 (31 at most) from 1e-5."""
CLEARANCE_ROUNDS = 40
"""The same where there is something to stay clear of."""
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
DEAR = 1e-3
"""What a penalty may cost, as a share of J, where no accuracy is asked for."""
CHANGED = 1e-2
"""Relative change of J by clearing a motion from which its discretisation is judged anew."""
TAKEN_BACK = 2
"""Times it is measured again what spheres ask too much, where a motion is not clear by exact geometry."""
DEEP = 5e-3
"""Depth [m] of an overlap from which a stiffer hinge is tried; rows deal with less."""
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
class Spent:
    """What all searches of one plan have spent: iterations of the solver, seconds to build programs and to solve them."""

    iterations: int = 0
    build_s: float = 0.0
    solve_s: float = 0.0

    def add(self, other: Spent) -> None:
        self.iterations, self.build_s = self.iterations + other.iterations, self.build_s + other.build_s
        self.solve_s += other.solve_s


@dataclass
class Search:
    """The state of one search; `advance` takes it one level further.

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

    def copy(self) -> Search:
        """The search as it is now; what is done to one is not done to the other."""
        return replace(self, cuts=self.cuts.copy(), evaluations=dict(self.evaluations))

    def made(self) -> NonlinearProgram:
        """The program of the first round, for searches that share it."""
        return self._transcribe()

    def begin_with(self, program: NonlinearProgram) -> None:
        """Begin with a program made already, that of another guess for the same problem in the same space."""
        program.evaluator.move(program.guess(self.trajectory))
        self.ready, self.first_objective = program, program.evaluator.objective()

    def restarted(self, problem: Problem, options: SearchOptions, avoidance: Avoidance | None, spent: Spent) -> Search:
        """A search of a similar problem that begins with this one's motion, knots and rows, in its own duration."""
        factor = problem.duration / self.space.duration
        return Search(
            problem,
            self.space.stretched(problem.duration),
            self.kernels,
            self.trajectory.stretched(problem.duration),
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

    def on_knots_of(self, other: Search) -> Search:
        """The same motion and rows, on the knots of another search, run through in this one's time."""
        return replace(self.copy(), space=other.space.stretched(self.space.duration))

    def sent(self) -> Search:
        """Without what cannot be sent to another process, or is there already."""
        return replace(self, problem=None, kernels=None, options=None, avoidance=None)

    def received(self, problem: Problem) -> Search:
        """What was `sent`, to go on from (see `restarted`)."""
        return replace(self, problem=problem, kernels=kernels_of(problem.robot.dynamics))

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
        self.error = None if left is None else left / self._scale
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
        """Ask so much less of the spheres as exact geometry shows that they ask too much, and solve once more; with ``back``,
        take back what was given too much."""
        if self.avoidance is None or not self.stiffness or self.hard or not self.converged:
            return self.converged
        started, before = time.perf_counter(), self.avoidance
        self.avoidance = eased(before, self.problem, self.trajectory, back)
        if self.avoidance is not before:
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
        return price(self.avoidance, self.trajectory, self._hinge()) / self._scale

    def clear(self) -> bool:
        """Whether the motion keeps the clearance, by exact geometry."""
        verdict = clearance_of(self.problem, self.trajectory)
        return verdict is None or verdict[0].amount == 0.0

    def _near(self) -> bool:
        """Whether the penalty is felt at all."""
        return overlap(self.avoidance, self.trajectory, HINGE_BAND) > 0.0

    def _solve_level(self) -> None:
        if self.first_objective is None:
            self.first_objective = self._guessed_objective()
        warm = FINER_BARRIER if self.levels else WARM_BARRIER
        self._solve_rounds(warm if self.levels or self.warm else SolverOptions.barrier)

    def _solve_rounds(self, barrier: float) -> None:
        """Solve, and again with more rows, until a check finds nothing to add."""
        known = None
        most = CLEARANCE_ROUNDS if self.hard else ROUNDS
        for self.rounds in range(1, most + 1):
            program, self.ready = self.ready or self._transcribe(), None
            x0 = program.guess(self.trajectory)
            options, before = self._solver_options(barrier), self.cuts.copy()
            if known is not None and (multipliers := known.to(program, self.cuts)) is not None:
                options = replace(options, barrier=KNOWN_BARRIER, multipliers=multipliers)
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
            if not self.converged or not self._add_rows():
                return
            barrier, known = WARM_BARRIER, None if self.stiffness or self.hard else Duals.of(program, before, result)

    def _last(self, duration: float) -> None:
        """Go on from another duration."""
        self.cuts = self.cuts.stretched(duration / self.space.duration)
        self.space, self.problem = self.space.stretched(duration), self.problem.lasting(duration)

    def _add_rows(self) -> bool:
        """Add rows where the motion breaks a limit or comes too close; False where it does not."""
        added = self.cuts.add_violated(self.problem, self.trajectory, self.kernels, self.space.everywhere)
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

    @property
    def _scale(self) -> float:
        """What errors of J are relative to."""
        return max(self.objective, LEAST_SHARE * self.first_objective, 1e-300)

    def _guessed_objective(self) -> float:
        """J of the guess, without clearance. Where there is nothing else to it, its program is also that of the first round."""
        plain = self.avoidance is None and self.durations is None and not len(self.cuts)
        program = self._transcribe() if plain else transcribe(self.problem, self.space, self.kernels)
        self.ready = program if plain else None
        program.evaluator.move(program.guess(self.trajectory))
        return program.evaluator.objective()

    def _transcribe(self) -> NonlinearProgram:
        started = time.perf_counter()
        program = transcribe(self.problem, self.space, self.kernels, self.cuts, self._clearance_terms, self.durations)
        if not self.levels and self.rounds <= 1:
            self.spent.build_s += time.perf_counter() - started
        return program

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
