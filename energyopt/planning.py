"""plan(): from a problem to a verified motion.

check what no motion can meet → guesses → local searches → refine the best → verify independently → Plan
"""

from __future__ import annotations

import sys
import time
from dataclasses import asdict, dataclass, replace
from itertools import islice

import numpy as np

from energyopt.arguments import check_planning
from energyopt.dynamics import backend
from energyopt.dynamics.compiler import why_interpreted
from energyopt.dynamics.kernels import Kernels, kernels_of
from energyopt.errors import NoSolutionFound, ProblemError
from energyopt.feasibility import check_feasibility
from energyopt.parameterizations import BSpline, HermiteSimpson, MotionSpace, Sinusoid
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.plans import Plan, Status
from energyopt.problem import FramePose, Problem
from energyopt.refinement import bisected
from energyopt.search import Progress, Search, SearchOptions
from energyopt.seeds import goals, guesses
from energyopt.solvers import Interrupts, Outcome
from energyopt.verification import cost, describe, is_valid, verify

Parameterization = BSpline | Sinusoid | HermiteSimpson

FALLBACKS = 3
"""Further guesses tried where the first ones lead to no valid motion."""
FINER = 2
"""Times the knots are bisected where no guess leads to a motion inside the limits."""
MOST_LEVELS = 12
ROUGH_NODES = 10
"""Quadrature nodes a span where there is Coulomb friction: with fewer, motions appear that change direction between them."""

_STATUS = {
    Outcome.INFEASIBLE: Status.INFEASIBLE,
    Outcome.ITERATION_LIMIT: Status.ITERATION_LIMIT,
    Outcome.TIME_LIMIT: Status.TIME_LIMIT,
    Outcome.INTERRUPTED: Status.INTERRUPTED,
    Outcome.FAILED: Status.NUMERICAL_ERROR,
}
_SENTENCE = {
    Status.SOLVED: "solved; every limit holds on the dense check",
    Status.INFEASIBLE: "no motion inside the limits was found: the solver ended where they contradict each other",
    Status.LIMITS_VIOLATED: "the solver converged, but the dense check found a limit exceeded",
    Status.ITERATION_LIMIT: "the solver ran out of iterations",
    Status.TIME_LIMIT: "the time limit passed before an optimum was found",
    Status.INTERRUPTED: "interrupted; this is the best motion so far",
    Status.NUMERICAL_ERROR: "the solver could not continue",
}
_STOP = (Outcome.INTERRUPTED, Outcome.TIME_LIMIT)


def plan(
    problem: Problem,
    parameterization: Parameterization | None = None,
    *,
    starts: int | None = None,
    seed: int = 0,
    time_limit: float | None = None,
    iterations: int = 500,
    verbose: bool | Progress = False,
    throw: bool = True,
) -> Plan:
    """Find the motion of least ∫ (Σ wτ² + Σ λq̇²) dt that a problem allows.

    Args:
        problem: what is asked.
        parameterization: `BSpline` (default), `Sinusoid` or `HermiteSimpson`.
        starts: initial guesses to try; the best verified motion is returned. By default 1, and one a goal configuration
            (4 at most) where the goal is Cartesian. Further guesses are tried where none of them leads to a valid motion.
        seed: of the random guesses.
        time_limit: seconds for all searches together.
        iterations: solver iterations, at most, in one solve.
        verbose: show progress on standard error, or a function called with (phase, iteration, objective, violation).
        throw: raise where no valid motion is found; otherwise return the best attempt with its status.

    Raises:
        InputError: an argument makes no sense, or the request is impossible whatever the motion.
        NoSolutionFound: no valid motion was found; carries the best attempt.
    """
    parameterization = BSpline() if parameterization is None else parameterization
    given = {"starts": starts, "seed": seed, "time_limit": time_limit, "iterations": iterations}
    check_planning(problem, parameterization, given | {"verbose": verbose, "throw": throw})
    check_feasibility(problem)
    started = time.perf_counter()
    kernels = kernels_of(problem.robot.dynamics)
    loaded = time.perf_counter() - started
    deadline = None if time_limit is None else time.monotonic() + time_limit
    with Interrupts() as interrupted:
        options = SearchOptions(iterations, deadline=deadline, progress=_progress(verbose), stop=interrupted)
        campaign = _Campaign(problem, parameterization, kernels, options, seed)
        search = campaign.run(starts)
    if callable(options.progress) and verbose is True:
        sys.stderr.write("\n")
    settings = {"parameterization": type(parameterization).__name__, **asdict(parameterization), **given,
                "kernels": kernels.kind, "dynamics": backend()}  # fmt: skip
    result = _finish(campaign, search, loaded, settings)
    if throw and result.status not in (Status.SOLVED, Status.INTERRUPTED):
        raise NoSolutionFound(result)
    return result


@dataclass
class _Campaign:
    """All searches of one call of `plan`."""

    problem: Problem
    parameterization: Parameterization
    kernels: Kernels
    options: SearchOptions
    seed: int
    guess_s: float = 0.0
    tried: int = 0

    def run(self, starts: int | None) -> Search:
        """The best search, refined."""
        began = time.perf_counter()
        targets = goals(self.problem, self.seed)
        if isinstance(self.problem.goal, FramePose):
            targets = self._possible(targets)
        source = guesses(self.problem, targets, self.seed)
        self.guess_s = time.perf_counter() - began
        wanted = starts or len(targets)
        searches = []
        for guess in islice(source, wanted + FALLBACKS):
            if len(searches) >= wanted and any(s.converged for s in searches):
                break
            search = Search(self.problem, self._space(), self.kernels, guess, self.options)
            search.advance()
            searches.append(search)
            if search.outcome in _STOP:
                break
        if all(search.outcome is Outcome.INFEASIBLE for search in searches):
            searches += self._on_finer_knots(next(guesses(self.problem, targets, self.seed)))
        self.tried = len(searches)
        best = min(searches, key=lambda s: (not s.converged, s.objective if s.converged else self._excess(s)))
        best.iterations = sum(s.iterations for s in searches)
        best.solve_s = sum(s.solve_s for s in searches)
        if searches[-1].outcome is Outcome.INTERRUPTED:
            best.outcome = Outcome.INTERRUPTED  # also where an earlier search had converged: the caller asked for more
        return self._refined(best)

    def _possible(self, targets: list[np.ndarray]) -> list[np.ndarray]:
        """Goal configurations that are not impossible; where all are, the error of the nearest is raised."""
        possible, errors = [], []
        for target in targets:
            try:
                check_feasibility(self.problem, goal=target)
                possible.append(target)
            except ProblemError as error:
                errors.append(error)
        if not possible:
            raise errors[0]
        return possible

    def _on_finer_knots(self, guess: Trajectory) -> list[Search]:
        """Searches in ever finer spaces, where the knots may be chosen: near the least duration coarse ones hold no motion."""
        spline, searches = self.parameterization, []
        if not isinstance(spline, BSpline) or spline.accuracy is None:
            return searches
        space = spline.space(self.problem.duration)
        for _ in range(FINER):
            space = bisected(space)
            searches.append(Search(self.problem, space, self.kernels, guess, self.options))
            searches[-1].advance()
            if searches[-1].outcome is not Outcome.INFEASIBLE:
                break
        return searches

    def _space(self) -> MotionSpace:
        """Where to search first; Coulomb friction, nearly a step in the velocity, wants more quadrature nodes."""
        rough = isinstance(self.parameterization, BSpline) and np.any(self.problem.robot.dynamics.coulomb_friction)
        return self.parameterization.space(self.problem.duration, **({"nodes": ROUGH_NODES} if rough else {}))

    def _holds(self, search: Search) -> bool:
        return is_valid(verify(self.problem, search.trajectory))

    def _excess(self, search: Search) -> float:
        violations = verify(self.problem, search.trajectory).amount
        return max(violations.values(), default=0.0)

    def _refined(self, search: Search) -> Search:
        """Refine until the estimated error is below the accuracy asked; keep the best motion that converged."""
        spline = self.parameterization
        accuracy = spline.accuracy if isinstance(spline, BSpline) else None
        while accuracy and search.converged and search.levels < MOST_LEVELS:
            if search.error is not None and search.error <= accuracy:
                break
            kept = replace(search)
            if not search.refine(spline) or not search.advance():
                kept.iterations, kept.solve_s = search.iterations, search.solve_s
                if search.outcome is Outcome.INTERRUPTED:
                    kept.outcome = Outcome.INTERRUPTED
                kept.reason = _stopped(kept.error, search.reason)
                return kept
            if not self._holds(search) and self._holds(kept):
                kept.iterations, kept.solve_s = search.iterations, search.solve_s
                kept.reason = _stopped(kept.error, "a limit did not hold on finer knots")
                return kept
            if search.objective > kept.objective:  # finer spaces contain the coarser ones: this is the solver's own error
                kept.gain, kept.iterations, kept.solve_s = search.gain, search.iterations, search.solve_s
                if kept.error > accuracy:
                    kept.reason = _stopped(kept.error, "finer knots gave no better motion")
                return kept
        return search


def _finish(campaign: _Campaign, search: Search, compile_s: float, settings: dict) -> Plan:
    began = time.perf_counter()
    violations = verify(campaign.problem, search.trajectory)
    terms = cost(campaign.problem, search.trajectory)
    verify_s = time.perf_counter() - began
    status = _STATUS.get(search.outcome) or (Status.SOLVED if is_valid(violations) else Status.LIMITS_VIOLATED)
    message = _SENTENCE[status]
    if status is not Status.SOLVED:
        message = f"{message} ({describe(violations)}; {campaign.tried} guess{'es' if campaign.tried > 1 else ''} tried)"
    return Plan(
        problem=campaign.problem,
        status=status,
        message=message,
        trajectory=search.trajectory,
        objective=sum(terms.values()),
        cost_terms=terms,
        violations=violations,
        discretization_error=search.error,
        iterations=search.iterations,
        time_s={"compile": compile_s, "build": campaign.guess_s + search.build_s, "solve": search.solve_s, "verify": verify_s},
        seed=campaign.seed,
        options=settings | {"levels": search.levels, "torque_rows": len(search.cuts.torque), "guesses": campaign.tried,
                            "evaluations": search.evaluations},
        notes=_notes(campaign, search),
    )  # fmt: skip


def _notes(campaign: _Campaign, search: Search) -> tuple[str, ...]:
    notes = list(campaign.problem.robot.notes)
    if campaign.kernels.kind == "interpreted":
        notes.append(f"{why_interpreted()}: kernels ran interpreted (same numbers, slower)")
    if search.reason.startswith("refinement stopped"):
        notes.append(search.reason)
    return tuple(notes)


def _stopped(error: float | None, reason: str) -> str:
    return f"refinement stopped at an estimated error of {_percent(error)}: {reason}"


def _percent(error: float | None) -> str:
    return "unknown size" if error is None else f"{100 * error:.2g} %"


def _progress(verbose: bool | Progress) -> Progress | None:
    if verbose is True:
        return _print_progress
    return verbose or None


def _print_progress(phase: str, iteration: int, objective: float, violation: float) -> None:
    end = "" if sys.stderr.isatty() else "\n"
    lead = "\r" if sys.stderr.isatty() else ""
    sys.stderr.write(
        f"{lead}  level {phase}  iteration {iteration:4d}  objective {objective:12.5g}  violation {violation:8.1e}{end}"
    )
    sys.stderr.flush()
