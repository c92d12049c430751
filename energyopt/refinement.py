"""Where a spline is too coarse, and how much of J that costs.

In the space with every span bisected, the optimum of the coarse space leaves a gradient g that no coarse direction sees.
Moving one fine coefficient alone by a step −g/H (H: its curvature), or as far as the limits allow, gains

    δ = |g| s − ½ H s²,   s = min(|g| / H, room to the limits),

and the gains of its coefficients say how much a span has to win by bisection (the diagonal residual estimator of
hierarchical bases: R. E. Bank, "Hierarchical bases and the finite element method", Acta Numerica 5, 1996). The gains rank the
spans; how far J still is from the continuous optimum is estimated from what the last refinement really gained.
"""

from __future__ import annotations

import numpy as np

from energyopt.parameterizations.bspline import SplineSpace
from energyopt.problem import Problem
from energyopt.transcription import NonlinearProgram

REMAINDER = 0.7
"""Distance to the continuous optimum over the gain of the last refinement. Gains shrink to about a third from one refinement
to the next, which would leave 1/3 + 1/9 + … = 1/2; measured on random Panda moves: 0.25 to 0.6, rarely up to 1.2."""
SHARE = 0.9
"""Spans are bisected, worst first, until they hold this share of the estimated gain."""
END_SPLIT = 0.25
"""The two end spans, whose ramps from and to zero acceleration the estimate does not see, are always split at this share."""
LEAST_SPAN = 2e-5
"""No span becomes shorter than this share of the duration."""
ROUNDING = 20 * np.finfo(float).eps
"""Rounding of an n-th difference of coefficients around 1 rad; on a span h the n-th derivative has it over hⁿ."""
FORGIVEN = 3e-7
"""What rounding may contribute to an acceleration [rad/s²], or to a jerk as a share of its limit: the check forgives 1e-6."""
MOST_SPANS = 400
"""Refinement ends here, whatever the accuracy asked."""


def bisected(space: SplineSpace) -> SplineSpace:
    """The space with all spans bisected."""
    return space.refined(0.5 * (space.breaks[1:] + space.breaks[:-1]))


def span_gains(space: SplineSpace, fine: NonlinearProgram, x: np.ndarray) -> np.ndarray:
    """Estimated gain in J of bisecting each span.

    Args:
        space: the coarse space.
        fine: the same problem transcribed in `bisected(space)`.
        x: the unknowns there of the motion that is optimal in the coarse space.

    Returns:
        gains: shape (spans,).
    """
    evaluator = fine.evaluator
    gradient, hessian = np.empty(fine.size), np.empty(len(fine.hessian_pattern[1]))
    evaluator.move(x)
    evaluator.gradient(gradient)
    evaluator.hessian(1.0, np.zeros(fine.rows), hessian)
    curvature = np.maximum(hessian[fine.hessian_pattern[0][1:] - 1], 1e-300)
    step = np.minimum(np.abs(gradient) / curvature, _room(fine, x, -np.sign(gradient)))
    gain = np.abs(gradient) * step - 0.5 * curvature * step**2
    nv, known = fine.layout.nv, np.flatnonzero(fine.unknowns.block >= 0)
    by_coefficient = gain[: fine.unknowns.count * nv].reshape(-1, nv).sum(axis=1)[fine.unknowns.block[known]]
    degree, knots = fine.space.degree, fine.space.knots
    center = np.array([knots[j + 1 : j + degree + 1].mean() for j in known])
    span = np.clip(np.searchsorted(space.breaks, center, side="right") - 1, 0, len(space.breaks) - 2)
    return np.bincount(span, by_coefficient, minlength=len(space.breaks) - 1)


def shortest_span(problem: Problem) -> float:
    """The span [s] on which accelerations and jerks that have limits are still exact enough to be checked against them.

    Splitting further would gain nothing either: in so short a time a limited jerk changes no acceleration.
    """
    limits = problem.limits
    ends = (problem.start, problem.goal_position)
    rounding = ROUNDING * max(1.0, *(np.abs(q).max() for q in ends if q is not None))
    least = [LEAST_SPAN * problem.duration, (rounding / (FORGIVEN * limits.jerk.min())) ** (1 / 3)]
    if np.isfinite(limits.acceleration).any():
        least.append((rounding / FORGIVEN) ** 0.5)
    return max(least)


def refine(space: SplineSpace, gains: np.ndarray, shortest: float = 0.0) -> SplineSpace:
    """The space with the worst spans bisected and the end spans split, but for parts shorter than ``shortest`` [s]."""
    order, breaks = np.argsort(gains)[::-1], space.breaks
    needed = np.searchsorted(np.cumsum(gains[order]), SHARE * gains.sum()) + 1
    split = np.full(len(gains), np.nan)
    split[order[:needed]] = 0.5
    split[0], split[-1] = END_SPLIT, 1.0 - END_SPLIT
    width = np.diff(breaks)
    split[np.minimum(split, 1.0 - split) * width < max(shortest, LEAST_SPAN * space.duration)] = np.nan
    return space.refined((breaks[:-1] + split * width)[np.isfinite(split)])


def _room(program: NonlinearProgram, x: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """How far each unknown alone can move in its direction before a bound or a row is met, shape (n,)."""
    start, row = program.jacobian_pattern
    values, g = np.empty(len(row)), np.empty(program.rows)
    program.evaluator.jacobian(values)
    program.evaluator.constraints(x, g)
    room = np.where(direction > 0, program.upper - x, x - program.lower)
    column = np.repeat(np.arange(len(start) - 1), np.diff(start))
    speed = values * direction[column]
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = np.where(speed > 0, (program.row_upper[row] - g[row]) / speed, (program.row_lower[row] - g[row]) / speed)
    np.minimum.at(room, column[speed != 0], ahead[speed != 0])
    return np.maximum(room, 0.0)
