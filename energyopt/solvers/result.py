"""What a solver is asked and what it answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

Progress = Callable[[int, float, float], None]
"""Called with (iteration, objective, worst violation of bounds and rows)."""

VIOLATION = 1e-8
"""Largest violation of a row. Rows are scaled to coefficients of one: on short spans this is a hundred times more in rad/s."""


class Outcome(str, Enum):
    """How the solver ended."""

    CONVERGED = "converged"
    ACCEPTABLE = "converged to a looser tolerance"
    INFEASIBLE = "the constraints contradict each other near here"
    ITERATION_LIMIT = "the iteration limit was reached"
    TIME_LIMIT = "the time limit passed"
    INTERRUPTED = "interrupted"
    FAILED = "the solver could not go on"


@dataclass(frozen=True)
class SolverOptions:
    """Settings of one solve.

    Attributes:
        tolerance: scaled optimality error at which the solver stops.
        iterations: at most this many.
        barrier: initial barrier parameter; small values suit good guesses.
        time_limit: seconds of wall time; None has no limit.
        multipliers: of the rows (m,) and of the bounds (n,) to start from, as in a `SolverResult`; None where nothing is known.
    """

    tolerance: float = 1e-6
    iterations: int = 500
    barrier: float = 1.0
    time_limit: float | None = None
    multipliers: tuple[np.ndarray, np.ndarray] | None = None


DEFAULT = SolverOptions()


@dataclass(frozen=True, eq=False)
class SolverResult:
    """What the solver found.

    Attributes:
        x: the point, (n,); multipliers: of the rows, (m,), positive where the upper side holds the row.
        outcome: how it ended; reason: the solver's own word; solver: its name.
        objective, iterations: at the end.
        evaluations: calls by function.
        bound_multipliers: of x (n,), likewise; None where the solver does not tell.
    """

    x: np.ndarray
    multipliers: np.ndarray
    outcome: Outcome
    reason: str
    objective: float
    iterations: int
    evaluations: dict[str, int] = field(default_factory=dict)
    solver: str = "ipopt"
    bound_multipliers: np.ndarray | None = None


def scaling(program, x0: np.ndarray) -> float:
    """Brings a small objective to one, since the tolerance is absolute: J falls with T⁻³ where there is no gravity."""
    program.evaluator.move(np.ascontiguousarray(x0, dtype=float))
    size = abs(program.evaluator.objective())
    return 1.0 / size if 1e-30 < size < 1.0 else 1.0


def violation(program, x: np.ndarray, g: np.ndarray) -> float:
    """By how much the worst bound or row is broken, each in its own unit."""
    worst = max(np.max(program.lower - x, initial=0.0), np.max(x - program.upper, initial=0.0))
    if program.rows:
        worst = max(worst, np.max(program.row_lower - g, initial=0.0), np.max(g - program.row_upper, initial=0.0))
    return float(worst)
