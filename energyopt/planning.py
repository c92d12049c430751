"""plan(): from a problem to a verified motion.

check what no motion can meet → guesses → local searches → refine the best → verify independently → Plan
"""

from __future__ import annotations

import sys
import time
from dataclasses import asdict, replace

from energyopt.arguments import check_guess, check_planning
from energyopt.attempts import with_first_duration
from energyopt.avoidance import unchecked
from energyopt.campaign import Campaign
from energyopt.clock import now
from energyopt.costs import smoothing_notes
from energyopt.dynamics.compiler import why_interpreted
from energyopt.dynamics.kernels import kernels_of
from energyopt.errors import NoSolutionFound
from energyopt.feasibility import check_feasibility
from energyopt.parameterizations import BSpline
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.plans import Plan, Status
from energyopt.problem import Problem
from energyopt.search import Search
from energyopt.search_state import Progress, SearchOptions
from energyopt.searcher import Parameterization
from energyopt.solvers import Interrupts, Outcome
from energyopt.threads import single_thread
from energyopt.verification import cost, describe, is_valid, verify

_STATUS = {
    Outcome.INFEASIBLE: Status.INFEASIBLE,
    Outcome.ITERATION_LIMIT: Status.ITERATION_LIMIT,
    Outcome.TIME_LIMIT: Status.TIME_LIMIT,
    Outcome.INTERRUPTED: Status.INTERRUPTED,
    Outcome.FAILED: Status.NUMERICAL_ERROR,
}
QUICK = {"per_span": 4, "distances": False}
"""How a motion is checked after Ctrl-C: it is not claimed to be valid anyway."""
DEFAULTS = {"starts": None, "seed": 0, "time_limit": None, "iterations": 500, "path_search": "auto"}
"""Options of `plan` that functions which plan several times take too."""
_SENTENCE = {
    Status.SOLVED: "solved; every limit holds on the dense check",
    Status.INFEASIBLE: "no motion inside the limits was found: the solver ended where they contradict each other",
    Status.LIMITS_VIOLATED: "the solver converged, but the dense check found a limit exceeded",
    Status.ITERATION_LIMIT: "the solver ran out of iterations",
    Status.TIME_LIMIT: "the time limit passed before an optimum was found",
    Status.INTERRUPTED: "interrupted; this is the best motion so far",
    Status.NUMERICAL_ERROR: "the solver could not continue",
}


def plan(
    problem: Problem,
    parameterization: Parameterization | None = None,
    *,
    starts: int | None = None,
    seed: int = 0,
    time_limit: float | None = None,
    guess: Trajectory | Plan | None = None,
    iterations: int = 500,
    path_search: str = "auto",
    verbose: bool | Progress = False,
    throw: bool = True,
) -> Plan:
    """Find the motion of least ∫ (Σ wτ² + Σ λq̇²) dt that a problem allows.

    Args:
        problem: what is asked.
        parameterization: `BSpline` (default), `Sinusoid` or `HermiteSimpson`.
        starts: initial guesses to try; the best verified motion is returned, and `Plan.optima` lists all they led to. By default
            64 at most, for splines where nothing stands around and kernels are compiled, fewer where they keep leading to the
            same optima; otherwise 1, another where obstacles make the motion much dearer, and one a goal configuration (4 at
            most) where the goal is Cartesian. 1 is a single local search, from the straight motion. Further guesses are tried
            where none of them leads to a valid motion.
        seed: of the random guesses.
        time_limit: seconds for all searches together; with many ``starts``, as many are tried as three fifths of it allow. What
            is valid by then is returned, be it less exact than asked; the first guess is made valid before others are tried.
        guess: a motion to start from, such as the plan of a similar problem; its ends need not be those of the problem, and
            the knots of a spline are taken over. Other guesses follow where it leads to no valid motion, or ``starts`` is more.
        iterations: solver iterations, at most, in one solve.
        path_search: what looks for ways around obstacles: "built-in" (RRT-Connect), "ompl" (the extra of that name), or
            "auto": built-in, and where that finds nothing and OMPL is installed, OMPL.
        verbose: show progress on standard error, or a function called with (phase, iteration, objective, violation).
        throw: raise where no valid motion is found; otherwise return the best attempt with its status.

    Returns:
        the best verified motion. After Ctrl-C, whatever ``throw`` is, the best motion so far, with the status INTERRUPTED.

    Raises:
        InputError: an argument makes no sense, or the request is impossible whatever the motion.
        NoSolutionFound: no valid motion was found; carries the best attempt.
    """
    parameterization = BSpline() if parameterization is None else parameterization
    given = {"starts": starts, "seed": seed, "time_limit": time_limit, "iterations": iterations,
             "path_search": path_search}  # fmt: skip
    check_planning(problem, parameterization, given | {"verbose": verbose, "throw": throw})
    start = guess.trajectory if isinstance(guess, Plan) else guess
    if start is not None:
        check_guess(problem, start)
    result, _ = planned(problem, parameterization, given, start, verbose)
    if throw and result.status not in (Status.SOLVED, Status.INTERRUPTED):
        raise NoSolutionFound(result)
    return result


def planned(
    problem: Problem,
    parameterization: Parameterization,
    given: dict,
    guess: Trajectory | None = None,
    verbose: bool | Progress = False,
    begun: Search | None = None,
) -> tuple[Plan, Search]:
    """A plan, and the search that found it.

    Args:
        given: starts, seed, time_limit, iterations and path_search, as for `plan`, checked.
        begun: the search of a similar problem, whose optimum, knots and rows this one goes on from.

    Raises:
        ProblemError: the request is impossible whatever the motion.
    """
    durations = problem.durations if problem.free_duration else None
    problem = problem.lasting(problem.durations[1])
    check_feasibility(problem)
    started = now()
    kernels = kernels_of(problem.robot.dynamics)
    loaded = now() - started
    limit, own = given["time_limit"], {} if durations is None else {"durations": durations}
    deadline = None if limit is None else time.monotonic() + limit
    settings = {"parameterization": type(parameterization).__name__, **asdict(parameterization), **given, **own,
                "kernels": kernels.kind}  # fmt: skip
    with single_thread(), Interrupts() as interrupted:
        options = SearchOptions(given["iterations"], deadline=deadline, progress=_progress(verbose), stop=interrupted)
        started = now()
        base = guess if begun is None else begun.trajectory
        problem = with_first_duration(problem, durations, given["seed"], kernels, base)
        how = {"path_search": given["path_search"], "durations": durations, "given": guess}
        campaign = Campaign(problem, parameterization, kernels, options, given["seed"], **how)
        campaign.attempts.seconds = now() - started
        try:
            search = campaign.run(given["starts"]) if begun is None else campaign.resume(begun)
        except BaseException:  # KeyboardInterrupt, or what a library that calls back has made of it
            search = campaign.interrupted() if interrupted() else None
            if search is None:
                raise
        with interrupted.held():
            result = finished_plan(campaign, search, loaded, settings)
        if interrupted() and result.solved:
            result = replace(result, status=Status.INTERRUPTED, message=_SENTENCE[Status.INTERRUPTED])
    if callable(options.progress) and verbose is True:
        sys.stderr.write("\n")
    return result, search


def finished_plan(campaign: Campaign, search: Search, compile_s: float, settings: dict) -> Plan:
    """The plan of a search, with the verdict on its motion; ``settings``: the options that were used."""
    stopped = search.outcome is Outcome.INTERRUPTED
    violations = verify(search.problem, search.trajectory, **QUICK) if stopped else campaign.judge.verdict(search)
    terms = cost(search.problem, search.trajectory)
    status = _STATUS.get(search.outcome) or (Status.SOLVED if is_valid(violations) else Status.LIMITS_VIOLATED)
    message, spent = _SENTENCE[status], search.spent
    if status is not Status.SOLVED:
        unseen = "; contact not looked for" if stopped and campaign.searcher.avoidance is not None else ""
        message = f"{message} ({describe(violations)}{unseen}; {_tried(campaign.found.names, campaign.attempts.missed)})"
    return Plan(
        problem=search.problem,
        status=status,
        message=message,
        trajectory=search.trajectory,
        objective=sum(terms.values()),
        cost_terms=terms,
        violations=violations,
        discretization_error=search.error,
        iterations=spent.iterations,
        time_s={"compile": compile_s, "guess": campaign.attempts.seconds, "build": spent.build_s, "solve": spent.solve_s,
                "verify": campaign.judge.seconds},
        seed=campaign.seed,
        options=settings | {"levels": search.levels, "torque_rows": len(search.cuts.torque), "guesses": len(campaign.found.names),
                            "clearance_rows": len(search.cuts.clearance), "guess": search.name,
                            "tried": [*campaign.found.names, *campaign.attempts.missed],
                            "evaluations": search.evaluations, "solver": search.solver},
        notes=_notes(campaign, search),
        optima=campaign.optima,
    )  # fmt: skip


def _notes(campaign: Campaign, search: Search) -> tuple[str, ...]:
    notes = list(campaign.problem.robot.notes)
    if campaign.kernels.kind == "interpreted":
        notes.append(f"{why_interpreted()}: kernels ran interpreted (same numbers, slower)")
    reason = unchecked(campaign.problem)
    if reason is not None:
        notes.append(reason)
    if search.reason.startswith("refinement stopped"):
        notes.append(search.reason)
    notes += smoothing_notes(search.problem.cost_terms, search.problem.robot, search.trajectory)
    return tuple(notes)


def _tried(names: list[str], missed: list[str]) -> str:
    said = f"{len(names)} guess{'es' if len(names) > 1 else ''} tried: {', '.join(names)}" if names else "no guess tried"
    if not missed:
        return said
    return f"{said}; {len(missed)} search{'es' if len(missed) > 1 else ''} without a path: {'; '.join(missed)}"


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
