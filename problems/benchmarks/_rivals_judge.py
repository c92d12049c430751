"""The evaluator of `rivals.py`: the same for every motion, whoever made it, and independent of how.

The motion is looked at in the middles t_k = (k + 1/2) T/N of N = 2000 equal parts:

    J = T/N Σ_k (Σ_i w_i τ_ik² + λ_i q̇_ik²)          τ_k = rnea(q_k, q̇_k, q̈_k) by numeric Pinocchio (midpoint rule)
    violation = max over k, i of   q outside its limits / their range,   |q̇|/q̇_max − 1,   |τ|/τ_max − 1,   0

In the middles q̈ is single-valued, although motions of piecewise constant acceleration have it jump between.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from energyopt import Problem
from energyopt.parameterizations.trajectory import Trajectory

POINTS = 2000
HELD = 1e-3
"""Share of a limit (a thousandth) by which a motion may exceed it and still count as holding it."""
ARRIVED = 1e-3
"""Farthest from start or goal [rad], and fastest there (share of the velocity limit), with which a motion counts as arriving."""


@dataclass(frozen=True)
class Judgement:
    """What the evaluator finds.

    Attributes:
        objective: J.
        position, velocity, torque: worst excess as a share of the range or of the limit; 0 where the limit holds.
        miss: distance of the ends from start and goal [rad], or the velocity there as a share of its limit if that is more.
    """

    objective: float
    position: float
    velocity: float
    torque: float
    miss: float

    @property
    def violation(self) -> float:
        return max(self.position, self.velocity, self.torque)

    @property
    def valid(self) -> bool:
        return bool(self.violation <= HELD and self.miss <= ARRIVED)


def judge(problem: Problem, motion: Trajectory, points: int = POINTS) -> Judgement:
    """J, limits and ends of a motion on the grid. ``points``: N."""
    limits, duration = problem.limits, problem.duration
    t = (np.arange(points) + 0.5) * duration / points
    q, v, a = (motion(np.minimum(t, motion.duration), order) for order in range(3))
    tau = problem.robot.torque(q, v, a)
    rate = tau**2 @ problem.torque_weights + v**2 @ problem.velocity_weight
    return Judgement(
        objective=float(rate.sum() * duration / points),
        position=_worst(np.maximum(limits.lower - q, q - limits.upper) / (limits.upper - limits.lower)),
        velocity=_worst(np.abs(v) / limits.velocity - 1.0),
        torque=_worst(np.abs(tau) / limits.torque - 1.0),
        miss=_miss(problem, motion),
    )


def _worst(excess: np.ndarray) -> float:
    return float(max(np.max(excess), 0.0))


def _miss(problem: Problem, motion: Trajectory) -> float:
    ends = [(0.0, problem.start), (motion.duration, problem.goal_position)]
    apart = max(float(np.max(np.abs(motion(t) - q))) for t, q in ends)
    moving = max(float(np.max(np.abs(motion(t, 1)) / problem.limits.velocity)) for t, _ in ends)
    return max(apart, moving, abs(motion.duration / problem.duration - 1.0))
