"""The penalty on what spheres miss, seen from outside the program: where it is sampled, how much is missed, what it costs.

Its samples lie so close that no sphere moves by much more than a step between two of them; the sum over them is the midpoint rule
for ∫ΣE dt.

A motion that is optimal with the penalty stays farther away than it has to. With f = −dE/dd the force on a pair and δ = d −
required the way it could still go, J falls by at most f δ along that way, where J is convex: at the optimum of the sum the
slopes of J and of the penalty cancel, and the slope of J rises from there. So what the penalty costs is at most about

    ∫ Σ f δ dt,      for a hinge of the band b, with δ = b − m:      Σ f δ = b Σ f − 3 ΣE,

since E = k m³ / 6b and f = k m² / 2b (see `collision.Hinge`); Σf is how fast ΣE grows with what is required.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from energyopt.avoidance import Avoidance
from energyopt.collision import Hinge
from energyopt.parameterizations.trajectory import Trajectory

STEP, SAMPLES = 0.02, (40, 300)
"""Distance [m] a sphere moves, about, from one sample of the penalty to the next, and bounds of their number."""
WIDE_STEP, FEW_SAMPLES = 0.05, (30, 100)
"""The same for a first look."""
FINE = 100
"""Even steps over which the way of the spheres is measured."""
SHIFT = 1e-5
"""Change of the requirement [m] by which Σf is measured."""


def overlap(avoidance: Avoidance, trajectory: Trajectory, slack: float = 0.0) -> float:
    """By how much [m] the worst pair of a motion misses what is asked of it and ``slack`` [m] more; 0 where none does."""
    times = travel_times(avoidance, trajectory, STEP, SAMPLES)
    least, _ = avoidance.kernels.place(avoidance.scene.at(times), trajectory(times)).least(slack)
    return float(max(0.0, slack - least.min(initial=slack)))


def price(avoidance: Avoidance, trajectory: Trajectory, hinge: Hinge) -> float:
    """At most about what a penalty costs, in the unit of J: by how much J would fall if it were left to hard limits."""
    times, weights = penalty_samples(avoidance, trajectory)
    scene, q = avoidance.scene.at(times), trajectory(times)

    def energy(more: float) -> float:
        asked = {"required": scene.required + more, "required_self": scene.required_self + more}
        placed = avoidance.kernels.place(replace(scene, hinge=hinge, **asked), q)
        return float(weights @ placed.penalty(derivatives=False)[0][:, 0])

    force = (energy(SHIFT) - energy(-SHIFT)) / (2.0 * SHIFT)
    return max(hinge.band * force - 3.0 * energy(0.0), 0.0)


def penalty_samples(avoidance: Avoidance, trajectory: Trajectory, rough: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Times and weights of the penalty, those of the midpoint rule; fewer for a ``rough`` look."""
    how = (WIDE_STEP, FEW_SAMPLES) if rough else (STEP, SAMPLES)
    edges = travel_times(avoidance, trajectory, *how)
    return 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)


def travel_times(avoidance: Avoidance, trajectory: Trajectory, step: float, count: tuple[int, int]) -> np.ndarray:
    """Times from 0 to T, denser where the arm moves fast, so that nothing passes through a thin board unseen.

    Between two of them no sphere moves by much more than ``step`` [m]; ``count`` bounds their number.
    """
    fewest, most = count
    fine = np.linspace(0.0, trajectory.duration, FINE + 1)
    centers = avoidance.centers(trajectory(fine))
    travel = np.sqrt(np.sum(np.diff(centers, axis=0) ** 2, axis=2).max(axis=1, initial=0.0))
    covered = np.concatenate([[0.0], np.cumsum(fewest / FINE + travel / step)])
    intervals = int(np.clip(np.ceil(covered[-1]), fewest, most))
    times = np.interp(np.linspace(0.0, covered[-1], intervals + 1), covered, fine)
    times[-1] = trajectory.duration
    return times
