"""Where a spline is too coarse, and how much of J that costs.

In the space with every span bisected, the optimum of the coarse space leaves a gradient g that no coarse direction sees. With the
Hessian H there and the gradients A of the active limits, a Newton step d along them,

    (H + ρAᵀA) d = g,   ρ → ∞,

promises a gain of gᵀd − ½ dᵀHd, to which each coefficient contributes about ½ g_j d_j (a residual estimator in the hierarchical
basis; R. E. Bank, "Hierarchical bases and the finite element method", Acta Numerica 5, 1996; the coupling of the coefficients is
kept). The contributions say which spans to cut. Still finer spaces gain a share of it (`REMAINDER`) more; all together is the
estimate of how far J is from the continuous optimum. Three things are set right:

- Where the coarse optimum is a saddle of the finer space there is no such step; the curvature is raised until there is one, and
  more is added for what it does not see (`SADDLE`).
- Limits that are not active but that the step breaks make its promise too large, active ones that it could leave too small. What
  the last refinement really gained bounds it from both sides (`REPEATED`).
- The error of the quadrature comes to it: J by the nodes of the program, less J by those of the finer one.

Coulomb friction makes J nearly a step in the velocities: its Hessian holds for velocities below a few hundredths of a rad/s
only, and no Newton step sees what finer knots gain. There all spans are bisected, and the last gain alone is the measure.

All this looks at the neighbourhood of one motion: other optima are not compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heapify, heappop, heapreplace

import numpy as np

from energyopt.parameterizations.bspline import SplineSpace
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.solvers.lookahead import newton_step, point_of
from energyopt.transcription import NonlinearProgram

REMAINDER = 1.75
"""Distance of J to the continuous optimum over the promise of the Newton step. Measured on random moves of four arms, against
solves on knots three times as fine: 0.8 to 1.4 (quartiles), up to 1.9."""
SADDLE = 4.5
"""The same where the curvature had to be raised."""
REPEATED = (0.15, 1.2)
"""The same over the gain of the last refinement, at least and at most: gains mostly shrink to a third from one to the next."""
CHANCE = 1 / 3
"""Share of the gain before the last that the last is taken to be at least, where J is rough."""
UNMEASURED = 0.3
"""Before a refinement has been measured, the estimate has to be below this share of the accuracy asked."""
AIM = 0.9
"""Share of the accuracy asked that a refinement aims at."""
PROGRESS = (0.05, 0.4)
"""It aims at no less and no more than these shares of the present error: a promise far from the optimum is not to be trusted, and
a refinement that gains little is not worth its solve."""
RATE = 0.125
"""Bisecting a span leaves about this share of what it costs."""
MOST_PARTS = 4
"""Parts into which one refinement cuts a span at most: what it costs is not known well before it has been cut once."""
END_SPLIT = 0.25
"""The two end spans hold ramps from and to zero acceleration, which cost in proportion to their length: they are always split,
at this share."""
LEAST_SPAN = 2e-5
"""No span becomes shorter than this share of the duration."""
ROUNDING = 20 * np.finfo(float).eps
"""Rounding of an n-th difference of coefficients around 1 rad; on a span h the n-th derivative has it over hⁿ."""
FORGIVEN = 3e-7
"""What rounding may contribute to an acceleration [rad/s²], or to a jerk as a share of its limit: the check forgives 1e-6."""
SHAPE_SAMPLES = 201
"""Times at which accelerations are compared."""
ALIKE, DOUBT = 0.2, 2.5
"""Relative difference of accelerations up to which an estimated error is taken over, and by how much more than it, per unit of
the difference, it is taken to be: over changes on three arms the estimate grew by a factor of 1.23 at most up to a difference of
0.1, 1.5 up to 0.2, 4.4 up to 0.4."""
MOST_SPANS = 400
"""Refinement ends here, whatever the accuracy asked."""


@dataclass(frozen=True, eq=False)
class Promise:
    """What a finer space promises.

    Attributes:
        gain: of J; None where it cannot be foreseen.
        by_span: contributions of the coarse spans, (spans,); they may add up to more than the gain.
        convex: whether the curvature was positive as it is.
        quadrature: J of the same motion by the nodes of the finer program.
    """

    gain: float | None
    by_span: np.ndarray
    convex: bool
    quadrature: float

    def error(self, objective: float, last_gain: float | None) -> float | None:
        """Estimated distance to the continuous optimum, in the unit of J; None where nothing is known of it.

        Args:
            objective: J by the nodes of the coarse program.
            last_gain: what the last refinement gained; None where there was none.
        """
        if self.gain is None and last_gain is None:
            return None
        left = np.inf if self.gain is None else (REMAINDER if self.convex else SADDLE) * self.gain
        if last_gain is not None:
            left = float(np.clip(left, REPEATED[0] * abs(last_gain), REPEATED[1] * abs(last_gain)))
        return left + abs(self.quadrature - objective)


def bisected(space: SplineSpace) -> SplineSpace:
    """The space with all spans bisected."""
    return space.refined(0.5 * (space.breaks[1:] + space.breaks[:-1]))


def promise(space: SplineSpace, fine: NonlinearProgram, x: np.ndarray) -> Promise:
    """Look one bisection ahead.

    Args:
        space: the coarse space.
        fine: the same problem transcribed in `bisected(space)`.
        x: the unknowns there of the motion that is optimal in the coarse space. Those that are no coefficients (times of
            waypoints) are held.
    """
    step, quadrature = newton_step(point_of(fine, x, fine.layout.size)), fine.evaluator.objective()
    if step is None:  # anything goes
        return Promise(quadrature, np.diff(space.breaks), False, quadrature)
    return Promise(max(step.gain, 0.0), _by_span(space, fine, step.shares), step.convex, quadrature)


def roughly(space: SplineSpace, fine: NonlinearProgram, x: np.ndarray) -> Promise:
    """As `promise`, where only the error of the quadrature can be foreseen."""
    fine.evaluator.move(x)
    return Promise(None, np.diff(space.breaks), False, fine.evaluator.objective())


def measured(gain: float, before: float | None, problem: Problem) -> float:
    """What the last refinement is taken to have gained; where J is rough, one small gain may be chance after a large one."""
    return gain if before is None or not rough(problem) else max(gain, CHANCE * abs(before))


def rough(problem: Problem) -> bool:
    """Whether the torque is nearly a step in the velocity."""
    return bool(np.any(problem.robot.dynamics.coulomb_friction))


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


def refine_evenly(space: SplineSpace, shortest: float = 0.0) -> SplineSpace:
    """All spans bisected and the end spans split; nodes of the quadrature about as far apart as before."""
    fine = refine(space, np.diff(space.breaks), 0.2, shortest)
    return SplineSpace(fine.breaks, space.degree, max(space.degree + 1, -(-space.nodes // 2)))


def refine(space: SplineSpace, cost: np.ndarray, share: float, shortest: float = 0.0) -> SplineSpace:
    """The space with spans cut, worst first, until they cost a share of what they did, and with the end spans split.

    Args:
        space: to be refined.
        cost: of each span, (spans,).
        share: of the cost to aim at; clipped to `PROGRESS`.
        shortest: no part becomes shorter than this [s].
    """
    breaks, shortest = space.breaks, max(shortest, LEAST_SPAN * space.duration)
    width, parts, total = np.diff(breaks), np.ones(len(cost), int), float(np.sum(cost))
    target = float(np.clip(share, *PROGRESS)) * total
    queue = [(-float(left), k) for k, left in enumerate(cost) if left > 0 and width[k] / 2 >= shortest]  # by cost a part
    heapify(queue)
    while total > target and queue:
        worst, k = queue[0]
        left = -worst * parts[k]
        parts[k] *= 2
        total -= (1.0 - RATE) * left
        if parts[k] < MOST_PARTS and width[k] / parts[k] / 2 >= shortest:
            heapreplace(queue, (-RATE * left / parts[k], k))
        else:
            heappop(queue)
    inner = [breaks[k] + width[k] * np.arange(1, parts[k]) / parts[k] for k in range(1, len(cost) - 1)]
    ends = np.array([breaks[0] + END_SPLIT * width[0], breaks[-1] - END_SPLIT * width[-1]])
    return space.refined(np.concatenate([*inner, ends[END_SPLIT * width[[0, -1]] >= shortest]]))


def _by_span(space: SplineSpace, fine: NonlinearProgram, contribution: np.ndarray) -> np.ndarray:
    """Sum over the unknowns of each coarse span, (spans,)."""
    nv, known = fine.layout.nv, np.flatnonzero(fine.unknowns.block >= 0)
    by_coefficient = contribution[: fine.unknowns.count * nv].reshape(-1, nv).sum(axis=1)[fine.unknowns.block[known]]
    span = np.searchsorted(space.breaks, fine.space.greville[known], side="right") - 1
    return np.bincount(np.clip(span, 0, len(space.breaks) - 2), by_coefficient, minlength=len(space.breaks) - 1)


def difference(one: Trajectory, other: Trajectory) -> float:
    """Relative difference of the accelerations of two motions, had they the same duration."""
    s = np.linspace(0.0, 1.0, SHAPE_SAMPLES)
    first, second = (motion(s * motion.duration, 2) * motion.duration**2 for motion in (one, other))
    return float(np.linalg.norm(first - second) / max(np.linalg.norm(first), 1e-300))
