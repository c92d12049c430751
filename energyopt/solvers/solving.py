"""Which solver runs: our own where it can, IPOPT for what it cannot do or does not finish."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from energyopt.solvers import interior, ipopt
from energyopt.solvers.result import DEFAULT, Outcome, Progress, SolverOptions, SolverResult

_ENDS = (Outcome.CONVERGED, Outcome.ACCEPTABLE, Outcome.INTERRUPTED, Outcome.TIME_LIMIT)
"""Outcomes after which IPOPT need not try."""
LEAST_TIME = 1e-3
"""Seconds that IPOPT is given at least: it has no solve of none."""


def solve(
    program,
    x0: np.ndarray,
    options: SolverOptions = DEFAULT,
    progress: Progress | None = None,
    stop: Callable[[], bool] | None = None,
) -> SolverResult:
    """Minimise a program from ``x0``; ``stop`` ends the solve, with the iterate kept, within a tenth of a second.

    A solve that had come to its end by then is INTERRUPTED too: whoever asked for an end wants none of what comes next.
    ``progress`` may be called in another thread, where ``stop`` is given; what it raises ends the solve, and is raised again.
    """
    result = _solved(program, x0, options, progress, stop)
    return replace(result, outcome=Outcome.INTERRUPTED, reason="interrupted") if stop is not None and stop() else result


def _solved(program, x0: np.ndarray, options: SolverOptions, progress: Progress | None, stop: Callable[[], bool] | None):
    if np.any(program.lower > program.upper) or np.any(program.row_lower > program.row_upper):
        program.evaluator.move(x0)
        none = np.zeros(program.rows)
        return SolverResult(x0, none, Outcome.INFEASIBLE, "bounds contradict each other", program.evaluator.objective(), 0)
    began = time.monotonic()
    ours = interior.solve(program, x0, options, progress, stop)
    if ours is not None and (ours.outcome in _ENDS or ours.iterations >= options.iterations):
        return ours
    left = options
    if ours is not None:
        seen, shown = ours.iterations, progress
        rest = None if options.time_limit is None else max(options.time_limit - (time.monotonic() - began), LEAST_TIME)
        left = replace(options, iterations=options.iterations - seen, time_limit=rest)
        progress = None if shown is None else lambda k, objective, violation: shown(seen + k, objective, violation)
    result = ipopt.solve(program, x0, left, progress, stop)
    return result if ours is None else _with_effort(result, ours)


def _with_effort(result: SolverResult, before: SolverResult) -> SolverResult:
    """A result that also counts what was done before."""
    calls = {name: count + before.evaluations.get(name, 0) for name, count in result.evaluations.items()}
    return replace(result, iterations=result.iterations + before.iterations, evaluations=calls)
