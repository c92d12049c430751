"""A cost term over a whole motion, and what its smoothing changes there.

Kinks of a power lie anywhere within a span of the motion, so each span is cut in `PIECES`, each with its Gauss–Legendre nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from energyopt.costs.cost import CostTerm, Samples
from energyopt.costs.power import SmoothTerm
from energyopt.parameterizations.trajectory import Trajectory, gauss_on_spans
from energyopt.robots.model import RobotModel

PIECES, NODES = 24, 4


def samples_of(robot: RobotModel, trajectory: Trajectory, t: np.ndarray) -> Samples:
    """A motion at the times ``t`` [s], shape (N,), with torques by numeric Pinocchio."""
    q, v, a, jerk = (trajectory(t, order) for order in range(4))
    return Samples(q, v, a, jerk, robot.torque(q, v, a))


def integral(term: CostTerm, robot: RobotModel, trajectory: Trajectory, exact: bool = False) -> float:
    """∫φ dt over the motion, without the weight, in the unit of the term; ``exact`` leaves the smoothing out."""
    term = term.fitted(robot)
    return _integral(robot, trajectory, term.exact if exact else lambda samples: term.integrand(samples).value)


def smoothing_error(term: CostTerm, robot: RobotModel, trajectory: Trajectory) -> float:
    """∫ (exact φ − smooth φ) dt over the motion, without the weight, in the unit of the term; 0 for a term without kinks."""
    term = term.fitted(robot)
    return _integral(robot, trajectory, lambda samples: term.exact(samples) - term.integrand(samples).value)


def smoothing_notes(terms: Sequence[CostTerm], robot: RobotModel, trajectory: Trajectory) -> list[str]:
    """What smoothing changes in each term that has kinks, one sentence each."""
    notes = []
    for term in terms:
        if isinstance(term, SmoothTerm) and term.weight > 0:
            exact, lost = integral(term, robot, trajectory, exact=True), smoothing_error(term, robot, trajectory)
            gap = f"{abs(lost):.2g} {term.unit} {'below' if lost >= 0 else 'above'} the exact {exact:.4g} {term.unit}"
            notes.append(f"{term.name} is smoothed over {term.smoothing:g} W, which puts it {gap}.")
    return notes


def _integral(robot: RobotModel, trajectory: Trajectory, of: Callable[[Samples], np.ndarray]) -> float:
    breaks = trajectory.breaks
    fine = np.append((breaks[:-1, None] + np.diff(breaks)[:, None] * np.arange(PIECES) / PIECES).ravel(), breaks[-1])
    t, weights = gauss_on_spans(fine, NODES)
    return float(weights @ of(samples_of(robot, trajectory, t)))
