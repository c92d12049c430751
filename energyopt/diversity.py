"""Guesses that differ, for problems with many optima: an arm can swing with or against gravity, and fold this way or that.

After the straight quintic come, in turn, motions

    two, one    through two or one random via points;
    fold        that go to a configuration, hold it and go on: of many random ones those of least J;
    rest        the same, of least J at rest, ∫ φ(q, 0, 0, g(q)) dt: heavy links near the base's axis or hanging down.

`hops` change an optimum in one joint, in two, or a little in all. Measured on 28 random moves of four arms, some 88 guesses each:
the straight one led to within 1 % of the best optimum found in 18 of them, 19 diverse ones in 27. In the 23 with more than one
optimum a single guess did so in 54 % of cases for two via points, 42 % for one, 54 and 60 % for the two folds, 71 % for hops.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np
from scipy.interpolate import CubicSpline

from energyopt.baselines import baseline, stations
from energyopt.costs import Samples
from energyopt.dynamics.kernels import Kernels
from energyopt.parameterizations.trajectory import PolynomialTrajectory, Trajectory
from energyopt.problem import Problem

PATTERN = ("two", "fold", "two", "rest", "one")
"""Kinds of guesses, in turn."""
SPREAD = {"one": 0.25, "two": 0.35}
"""Standard deviation of random via points, as a share of each joint's range (2π at most)."""
CANDIDATES, CHOSEN, APART = 200, 4, 0.3
"""Folds drawn at a time, those of them that are tried, and the distance between them, as a share of the box in each joint."""
SAMPLES = 6
"""Quadrature nodes a span of a fold's motion."""
FAR, QUICK = 1.9, 0.25
"""How far [rad] folds lie outside the box of start and goal, at most, and as a share of the way at full speed."""
HOLD = (0.4, 0.6)
"""When a fold is held, as shares of the time between two stations."""
HOPS = ((1, 0.5), (2, 0.4), (None, 0.15))
"""How many joints a hop changes (None: all), and the standard deviation of the change as a share of the range."""
HOP_SAMPLES = 30


@dataclass(frozen=True, eq=False)
class Guess:
    """A motion to start from, its name, and the goal configuration it ends in."""

    name: str
    motion: Trajectory
    goal: np.ndarray


@dataclass(frozen=True, eq=False)
class _Leg:
    """The longest time between two stations (start, waypoints, goal), in which motions are bent, and all stations."""

    problem: Problem
    times: np.ndarray
    points: np.ndarray

    @property
    def span(self) -> tuple[float, float]:
        k = int(np.argmax(np.diff(self.times)))
        return self.times[k], self.times[k + 1]

    def times_at(self, shares: tuple[float, ...]) -> np.ndarray:
        low, high = self.span
        return low + (high - low) * np.array(shares)

    def through(self, shares: tuple[float, ...], vias: np.ndarray) -> PolynomialTrajectory:
        """The cubic spline through all stations and ``vias`` (K, nv) at ``shares`` of the leg."""
        times = np.concatenate([self.times, self.times_at(shares)])
        order = np.argsort(times)
        ends = (1, self.problem.start_velocity), (1, self.problem.goal_velocity)
        return _polynomials(CubicSpline(times[order], np.concatenate([self.points, vias])[order], bc_type=ends))

    def weight(self, shares: tuple[float, ...], t: np.ndarray) -> np.ndarray:
        """By how much `through` moves where all ``vias`` move by one: value and two derivatives, (3, N)."""
        times = np.concatenate([self.times, self.times_at(shares)])
        values = np.concatenate([np.zeros(len(self.times)), np.ones(len(shares))])
        order = np.argsort(times)
        spline = CubicSpline(times[order], values[order], bc_type="clamped")
        return np.stack([spline(t, k) for k in range(3)])


def diverse(problem: Problem, targets: list[np.ndarray], seed: int, kernels: Kernels) -> Iterator[Guess]:
    """The straight quintic to each target, then for ever motions that differ; the same for the same seed."""
    for target in targets:
        yield Guess("straight", baseline(problem, "quintic", goal=target), target)
    sources = [_bent(problem, target, [seed, k], kernels) for k, target in enumerate(targets)]
    for number in count():
        guess = next(sources[number % len(targets)])
        yield Guess(f"{guess.name} {number + 1}", guess.motion, guess.goal)


def hops(problem: Problem, bases: list[Guess], seed: int, first: int = 0) -> Iterator[Guess]:
    """Changed optima, for ever, from the number ``first`` on: two of three of the first base, the best, and others of the second
    where there is one."""
    for number in count(first):
        base = bases[1 if number % 3 == 2 and len(bases) > 1 else 0]
        rng = np.random.default_rng([seed, 1, number])
        joints, spread = HOPS[number % len(HOPS)]
        change = rng.normal(size=problem.robot.nv) * spread * _reach(problem)
        if joints is not None:
            change[rng.permutation(len(change))[joints:]] = 0.0
        leg = _Leg(problem, *stations(problem, base.goal))
        yield Guess(f"hop {number + 1}", _hopped(leg, base.motion, change, rng.uniform(0.3, 0.7)), base.goal)


def _hopped(leg: _Leg, motion: Trajectory, change: np.ndarray, peak: float) -> Trajectory:
    """A motion moved by ``change`` at a share ``peak`` of the longest leg, by less before and after, not at its ends."""
    low, high = leg.span
    t = np.union1d(np.linspace(0.0, motion.duration, HOP_SAMPLES), leg.times.clip(0.0, motion.duration))
    s = np.clip((t - low) / (high - low), 0.0, 1.0)
    weight = np.sin(0.5 * np.pi * np.minimum(s / peak, (1.0 - s) / (1.0 - peak))) ** 2
    limits = leg.problem.limits
    moved = np.clip(motion(t) + weight[:, None] * change, limits.lower, limits.upper)
    return _polynomials(CubicSpline(t, moved, bc_type=((1, leg.problem.start_velocity), (1, leg.problem.goal_velocity))))


def _bent(problem: Problem, goal: np.ndarray, seed: list[int], kernels: Kernels) -> Iterator[Guess]:
    leg, rng = _Leg(problem, *stations(problem, goal)), np.random.default_rng(seed)
    folds = {"fold": _folds(leg, kernels, [*seed, 0], 1.0), "rest": _folds(leg, kernels, [*seed, 1], 0.0)}
    straight = baseline(problem, "quintic", goal=goal)
    for number in count():
        kind = PATTERN[number % len(PATTERN)]
        if kind in folds:
            fold = next(folds[kind])
            motion = leg.through(HOLD, np.stack([fold] * len(HOLD)))
        else:
            shares = (0.5,) if kind == "one" else (1 / 3, 2 / 3)
            vias = straight(leg.times_at(shares)) + rng.normal(size=(len(shares), len(goal))) * SPREAD[kind] * _reach(problem)
            motion = leg.through(shares, np.clip(vias, problem.limits.lower, problem.limits.upper))
        yield Guess(kind, motion, goal)


def _folds(leg: _Leg, kernels: Kernels, seed: list[int], speed: float) -> Iterator[np.ndarray]:
    """Configurations to go through: of many random ones the cheapest that are far apart, then those of the next many."""
    problem, rng = leg.problem, np.random.default_rng(seed)
    way = np.minimum(QUICK * problem.limits.velocity * problem.duration, FAR)
    low = np.maximum(problem.limits.lower, leg.points.min(axis=0) - way)
    high = np.minimum(problem.limits.upper, leg.points.max(axis=0) + way)
    size = np.maximum(high - low, 1e-9)
    while True:
        drawn = low + (high - low) * rng.random((CANDIDATES, len(low)))
        cheapest, chosen = np.argsort(_costs(leg, kernels, drawn, speed), kind="stable"), []
        for fold in drawn[cheapest]:
            if all(np.linalg.norm((fold - other) / size) > APART * np.sqrt(len(low)) for other in chosen):
                chosen.append(fold)
                yield fold
            if len(chosen) == CHOSEN:
                break


def _costs(leg: _Leg, kernels: Kernels, folds: np.ndarray, speed: float) -> np.ndarray:
    """J (K,) of the motions that hold each of ``folds`` (K, nv), run through at a share of their speed (0: at rest)."""
    problem = leg.problem
    motion = leg.through(HOLD, np.zeros((len(HOLD), folds.shape[1])))
    t, weights = motion.quadrature(SAMPLES)
    moves = leg.weight(HOLD, t)
    q, v, a = ((speed**k * (motion(t, k) + moves[k][:, None] * folds[:, None])).reshape(-1, folds.shape[1]) for k in range(3))
    tau = kernels.torque(np.concatenate([q, v, a], axis=1))
    samples = Samples(q, v, a, np.zeros_like(a), tau)
    integrand = sum(term.weight * term.integrand(samples).value for term in problem.cost_terms)
    price = np.broadcast_to(integrand, len(q)).reshape(len(folds), -1) @ weights
    return np.where(np.isfinite(price), price, np.inf)


def _reach(problem: Problem) -> np.ndarray:
    return np.minimum(problem.limits.upper - problem.limits.lower, 2.0 * np.pi)


def _polynomials(spline: CubicSpline) -> PolynomialTrajectory:
    return PolynomialTrajectory(spline.x, spline.c.transpose(1, 0, 2)[:, ::-1])
