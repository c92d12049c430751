"""Rows added where a dense check of the current motion finds a limit broken between the samples.

Torque limits start without any row: most motions break them nowhere or briefly, and a dense row at every sample would make
each solver step several times dearer. Rows accumulate over the rounds of a search; those of torque rates are pairs of
samples, (τ(t₁) − τ(t₀)) / (t₁ − t₀), the mean rate between them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from energyopt.dynamics.kernels import Kernels
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.sampling import extrema
from energyopt.transcription.layout import TorqueRows
from energyopt.transcription.linear import SampleRow, limits_of_order

PER_SPAN = 20
"""Samples a smooth span of the check."""
TORQUE_EXCESS = 5e-5
"""Relative excess that calls for rows: half of what the verification allows."""
TORQUE_BACKOFF = 2e-5
"""Rows are this much inside the limit, so that the torque between them stays within the excess."""
RATE_STEP = 2e-4
"""Distance of the two samples of a rate, as a share of their span: their mean rate is the rate at a point."""
RATE_BACKOFF, RATE_EXCESS = 3e-4, -1e-4
"""Rate rows are this much inside the limit; and the relative excess at a sample that calls for rows: between two it is higher."""
KINEMATIC_EXCESS = 2e-7
"""Absolute excess of a sampled kinematic limit that calls for a row."""
TIGHTENED = 1e-3
"""Share of the range between limits below which an excess is met by moving rows inside."""


@dataclass
class Cuts:
    """The rows added so far.

    Attributes:
        torque: (time, joint) pairs; rates: (start time, end time, joint); samples: (derivative order, time, joint);
        clearance: least distances [m] by (time, a, b), pairs as in `collision`.
        inside: by how much sampled rows are inside their limits, by derivative order, (4,).
        rate_inside: the same of rows of torque rates, as a share of the limit, besides `RATE_BACKOFF`.
    """

    torque: set[tuple[float, int]] = field(default_factory=set)
    rates: set[tuple[float, float, int]] = field(default_factory=set)
    samples: set[tuple[int, float, int]] = field(default_factory=set)
    clearance: dict[tuple[float, int, int], float] = field(default_factory=dict)
    inside: np.ndarray = field(default_factory=lambda: np.zeros(4))
    rate_inside: float = 0.0

    def __len__(self) -> int:
        return len(self.torque) + len(self.rates) + len(self.samples) + len(self.clearance)

    def copy(self) -> Cuts:
        kinds = set(self.torque), set(self.rates), set(self.samples), dict(self.clearance)
        return Cuts(*kinds, self.inside.copy(), self.rate_inside)

    def stretched(self, factor: float) -> Cuts:
        """The same rows of a motion that takes ``factor`` times as long."""
        f = factor
        return Cuts(
            {(t * f, i) for t, i in self.torque},
            {(t0 * f, t1 * f, i) for t0, t1, i in self.rates},
            {(order, t * f, i) for order, t, i in self.samples},
            {(t * f, a, b): distance for (t, a, b), distance in self.clearance.items()},
            self.inside.copy(),
            self.rate_inside,
        )

    def add_violated(
        self, problem: Problem, trajectory: Trajectory, kernels: Kernels, everywhere: bool, tighten: bool = False
    ) -> bool:
        """Add rows where the motion breaks a limit; False where nothing was found (or nothing new can be added).

        Args:
            everywhere: the kinematic limits hold for all t by construction.
            tighten: move sampled rows, and those of torque rates, inside their limits by twice what the motion now exceeds these
                by, if that is little. A motion that runs along a limit evades rows at points by ever less, but for ever.
        """
        before = len(self)
        times = trajectory.sample_times(PER_SPAN)
        tau = kernels.torque(np.concatenate([trajectory(times, order) for order in range(3)], axis=1))
        self._add_torque(times, np.abs(tau) / problem.limits.torque - 1.0)
        if np.any(np.isfinite(problem.limits.torque_rate)):
            self._add_rates(problem, trajectory, kernels, tighten)
        if not everywhere:
            for order in range(4):
                self._add_samples(order, trajectory, limits_of_order(problem.limits, order), tighten)
        return len(self) > before

    def torque_rows(self, problem: Problem, samples: int) -> TorqueRows:
        """The torque rows of the program; ``samples`` counts those of its quadrature, which come first."""
        torque, rates = sorted(self.torque), sorted(self.rates)
        times = np.unique([t for t, _ in torque] + [t for pair in rates for t in pair[:2]])
        at = lambda values: samples + np.searchsorted(times, values)
        limit = np.array([problem.limits.torque[i] for _, i in torque]) * (1.0 - TORQUE_BACKOFF)
        # In units of the limit: a tolerance in N·m/s would be below the rounding of a difference over so short a time.
        inverse = np.array([1.0 / (problem.limits.torque_rate[i] * (t1 - t0)) for t0, t1, i in rates])
        pair_row = len(torque) + np.arange(len(rates))
        joints = np.array([i for *_, i in rates], int)
        bound = np.concatenate([limit, np.full(len(rates), 1.0 - RATE_BACKOFF - self.rate_inside)])
        return TorqueRows(
            times=times,
            row=np.concatenate([np.arange(len(torque)), pair_row, pair_row]).astype(int),
            sample=np.concatenate(
                [at([t for t, _ in torque]), at([t for t, _, _ in rates]), at([t for _, t, _ in rates])]
            ).astype(int),
            joint=np.concatenate([np.array([i for _, i in torque], int), joints, joints]),
            scale=np.concatenate([np.ones(len(torque)), -inverse, inverse]),
            rate=np.repeat([False, True], [len(torque), 2 * len(rates)]),
            lower=-bound,
            upper=bound,
        )

    def sample_rows(self, joints: int) -> tuple[SampleRow, ...]:
        """The sampled kinematic rows, by derivative order."""
        rows = []
        for order in sorted({order for order, *_ in self.samples}):
            times = np.array(sorted({t for o, t, _ in self.samples if o == order}))
            needed = np.zeros((len(times), joints), bool)
            for t, i in ((t, i) for o, t, i in self.samples if o == order):
                needed[np.searchsorted(times, t), i] = True
            rows.append(SampleRow(order, times, needed, float(self.inside[order])))
        return tuple(rows)

    def _add_torque(self, times: np.ndarray, excess: np.ndarray) -> None:
        for i in np.flatnonzero(excess.max(axis=0) > TORQUE_EXCESS):
            self.torque.update((float(t), int(i)) for t in times[_stretches(excess[:, i], TORQUE_EXCESS)])
        self.torque.update((float(t), int(i)) for t, i in _vertices(times, excess, TORQUE_EXCESS))

    def _add_rates(self, problem: Problem, trajectory: Trajectory, kernels: Kernels, tighten: bool) -> None:
        """Pairs of samples a tiny step apart, inside one span, where the rate between them is too high."""
        width = np.diff(trajectory.breaks)[:, None]
        first = trajectory.breaks[:-1, None] + width * np.linspace(0.0, 1.0 - RATE_STEP, PER_SPAN + 1)
        pairs = np.stack([first, first + RATE_STEP * width], axis=-1).reshape(-1, 2)
        states = np.concatenate([trajectory(pairs.ravel(), order) for order in range(3)], axis=1)
        tau = kernels.torque(states).reshape(*pairs.shape, -1)
        rate = np.abs(tau[:, 1] - tau[:, 0]) / (pairs[:, 1] - pairs[:, 0])[:, None]
        beyond = rate / problem.limits.torque_rate - 1.0
        worst = beyond.max() - RATE_EXCESS
        if tighten and 0.0 < worst < TIGHTENED:
            self.rate_inside = max(self.rate_inside, 2.0 * worst)
        for i, excess in enumerate(beyond.T):
            self.rates.update((*map(float, pairs[k]), i) for k in _stretches(excess, RATE_EXCESS, stride=5))

    def _add_samples(self, order: int, trajectory: Trajectory, limits: tuple[np.ndarray, np.ndarray], tighten: bool) -> None:
        """The exact extrema of a derivative that lie outside its limits (nv,)."""
        low, high = limits
        if np.any(np.isfinite(low) | np.isfinite(high)):
            times, values = extrema(trajectory, order)
            excess = np.maximum(low - values, values - high)
            outside = np.argwhere(excess > KINEMATIC_EXCESS)
            worst = excess.max(initial=0.0)  # a motion may have no extrema
            if tighten and KINEMATIC_EXCESS < worst < TIGHTENED * np.min(high - low):
                self.inside[order] = max(self.inside[order], 2.0 * worst)
            self.samples.update((order, float(times[k, i]), int(i)) for k, i in outside)


def _peaks(excess: np.ndarray, threshold: float) -> np.ndarray:
    """Indices of the local maxima above a threshold."""
    padded = np.concatenate([[-np.inf], excess, [-np.inf]])
    return np.flatnonzero((excess > threshold) & (excess >= padded[:-2]) & (excess >= padded[2:]))


def _vertices(t: np.ndarray, excess: np.ndarray, threshold: float) -> list[tuple[float, int]]:
    """(Time, joint) between samples where a parabola through three of them rises above a threshold that none of them reaches."""
    at = excess[1:-1]
    peak = (at >= excess[:-2]) & (at >= excess[2:]) & (at <= threshold)
    peak[PER_SPAN - 1 :: PER_SPAN] = False  # at a knot the torque has a kink, and a parabola across it rises where it does not
    k, i = np.nonzero(peak)
    k += 1
    before, after = t[k] - t[k - 1], t[k + 1] - t[k]
    rise, fall = (excess[k, i] - excess[k - 1, i]) / before, (excess[k + 1, i] - excess[k, i]) / after
    slope, bend = (rise * after + fall * before) / (before + after), (fall - rise) / (before + after)
    shift = -0.5 * slope / np.where(bend < 0, bend, -np.inf)
    above = excess[k, i] + 0.5 * slope * shift > threshold
    return list(zip((t[k] + shift)[above], i[above], strict=True))


def _stretches(excess: np.ndarray, threshold: float, stride: int = 6) -> np.ndarray:
    """Indices that cover every stretch above a threshold: its peaks, every few samples of it, and its neighbours."""
    above = np.flatnonzero(excess > threshold)
    if not above.size:
        return above
    starts = above[np.concatenate([[True], np.diff(above) > 1])]
    ends = above[np.concatenate([np.diff(above) > 1, [True]])]
    spread = [
        np.arange(max(a - stride, 0), min(b + stride, len(excess) - 1) + 1, stride) for a, b in zip(starts, ends, strict=True)
    ]
    return np.unique(np.concatenate([*spread, _peaks(excess, threshold)]))
