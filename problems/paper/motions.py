"""The motions that the paper's claims are put to: strokes, repeated to and fro, under velocity scaling.

A stroke goes from rest to rest in T seconds. The sinusoidal one is half a period of q = m + A sin(ωt + φ),

    q(t) = (q₀ + q₁)/2 + (q₁ − q₀)/2 · sin(ωt − π/2),     ω = π/T,     0 ≤ t ≤ T,

all joints in phase. Repeated, a stroke p is passed forwards and backwards: p(x) for 0 ≤ x ≤ T, p(2T − x) for T ≤ x ≤ 2T, which
for the sinusoid is the sinusoid going on. Velocity scaling passes this path at the rate ṡ(t), which changes evenly from 1 to κ:

    s(t) = t − (1 − κ) t²/(2D),     D = 4NT/(1 + κ) for N cycles.
"""

from __future__ import annotations

import numpy as np

from energyopt import Problem
from energyopt.parameterizations.path_trajectory import PathTrajectory
from energyopt.parameterizations.trajectory import PolynomialTrajectory, SinusoidTrajectory, SplineTrajectory, Trajectory

CYCLES, SLOWEST = 4, 0.5
"""Cycles of a recording, and κ: the rate at its end."""


def sinusoidal_stroke(problem: Problem) -> Trajectory:
    """Half a period of the sinusoid between a problem's start and goal, in its duration.

    It starts and ends at rest, but with its largest acceleration.
    """
    T, start, goal = problem.duration, problem.start, problem.goal_position
    none = np.zeros((1, len(start)))
    period = SinusoidTrajectory(2.0 * T, 0.5 * (start + goal)[None], none, 0.5 * (start - goal)[None])
    return PathTrajectory(period, SplineTrajectory([0.0, 0.0, T, T], [[0.0], [T]], 1))


class ToAndFro(Trajectory):
    """A stroke passed forwards and backwards, ``cycles`` times; its time is x of the module's text."""

    kind = "to and fro"

    def __init__(self, stroke: Trajectory, cycles: int = CYCLES):
        self.stroke, self.cycles, self.nv = stroke, cycles, stroke.nv
        self.period = 2.0 * stroke.duration
        self.duration = cycles * self.period
        once = np.append(stroke.breaks[:-1], self.period - stroke.breaks[::-1][:-1])
        starts = self.period * np.arange(cycles)
        self.breaks = np.append((starts[:, None] + once).ravel(), self.duration)

    def _evaluate(self, t, order):
        x = np.where(t >= self.duration, self.period, t % self.period)
        back = x > self.stroke.duration
        place = np.clip(np.where(back, self.period - x, x), 0.0, self.stroke.duration)
        values = self.stroke._evaluate(place, order)
        return np.where(back[:, None], (-1.0) ** order * values, values)

    def to_arrays(self):
        return {"cycles": np.array(self.cycles), **self.stroke.to_arrays()}


def scaled(stroke: Trajectory, slowest: float = SLOWEST, cycles: int = CYCLES) -> PathTrajectory:
    """A stroke to and fro under velocity scaling.

    Args:
        stroke: one way, from rest to rest.
        slowest: κ, the rate at the end as a share of that at the start; above 1 the motion grows faster.
        cycles: N.
    """
    path = ToAndFro(stroke, cycles)
    D = 2.0 * path.duration / (1.0 + slowest)
    law = np.array([0.0, 1.0, -(1.0 - slowest) / (2.0 * D)])
    return PathTrajectory(path, PolynomialTrajectory([0.0, D], law[None, :, None]))
