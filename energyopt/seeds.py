"""Initial guesses: motions from start to goal, one after another, the same for the same seed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.interpolate import CubicSpline

from energyopt.baselines import baseline
from energyopt.costs import Samples
from energyopt.dynamics.kernels import Kernels
from energyopt.inverse_kinematics import goal_configurations
from energyopt.parameterizations.trajectory import PolynomialTrajectory, Trajectory
from energyopt.problem import FramePose, Problem

SPREAD = 0.25
"""Standard deviation of a random via point, as a share of each joint's range (2π at most)."""

CANDIDATES, SAMPLES, STEEP = 16, 12, 6
"""Durations that are compared, samples of the motion, and the power by which one that breaks a limit is dearer."""


def goals(problem: Problem, seed: int) -> list[np.ndarray]:
    """Goal configurations to aim at: the problem's own, or several from inverse kinematics."""
    if isinstance(problem.goal, FramePose):
        return goal_configurations(problem, seed)
    return [problem.goal]


def guesses(problem: Problem, targets: list[np.ndarray], seed: int) -> Iterator[Trajectory]:
    """The straight quintic to each target, then for ever motions bent through random via points."""
    for target in targets:
        yield baseline(problem, "quintic", goal=target)
    k = 0
    while True:
        yield _bent(problem, targets[k % len(targets)], np.random.default_rng([seed, k]))
        k += 1


def first_durations(problem: Problem, durations: tuple[float, float], goal: np.ndarray, kernels: Kernels) -> np.ndarray:
    """Where to start from if T is free [s]: durations of the straight quintic, first the cheapest that keeps its limits, about.

    On a motion run through e^θ times as fast derivatives of order o are e^{oθ} times as large.
    """
    least, most = durations
    motion = baseline(problem.lasting(most), "quintic", goal=goal)
    t, weights = motion.quadrature(SAMPLES)
    q, v, a = (motion(t, order) for order in range(3))
    candidates = np.geomspace(least, most, CANDIDATES)
    price = []
    for speed in most / candidates:
        tau = kernels.torque(np.concatenate([q, speed * v, speed**2 * a], axis=1))
        samples = Samples(q, speed * v, speed**2 * a, np.zeros_like(a), tau)
        value = sum(term.weight * weights @ term.integrand(samples).value for term in problem.cost_terms) / speed
        used = max(
            np.max(speed * np.abs(v) / problem.limits.velocity), np.max(speed**2 * np.abs(a) / problem.limits.acceleration)
        )
        price.append(value * max(1.0, used) ** STEEP)
    return candidates[np.argsort(price, kind="stable")]


def _bent(problem: Problem, goal: np.ndarray, rng: np.random.Generator) -> Trajectory:
    """A cubic spline through the waypoints and one random via point, at rest at both ends."""
    low, high = problem.limits.lower, problem.limits.upper
    reach = np.minimum(high - low, 2.0 * np.pi)
    straight = baseline(problem, "quintic", goal=goal)
    via = straight(0.5 * problem.duration) + rng.normal(size=len(goal)) * SPREAD * reach
    times = [0.0, *(w.time for w in problem.waypoints if w.time is not None), 0.5 * problem.duration, problem.duration]
    points = [problem.start, *(w.position for w in problem.waypoints if w.time is not None), np.clip(via, low, high), goal]
    order = np.unique(np.round(times, 9), return_index=True)[1]
    times, points = np.array(times)[order], np.array(points)[order]
    spline = CubicSpline(times, points, bc_type=((1, problem.start_velocity), (1, problem.goal_velocity)))
    return PolynomialTrajectory(times, spline.c.transpose(1, 0, 2)[:, ::-1])
