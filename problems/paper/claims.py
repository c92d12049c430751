"""Four claims about sinusoidal motions under velocity scaling, as checks that a motion passes or fails.

The motion is a path of period 2T passed at the rate ṡ(t) (see `motions`); its phase is u = s/2T cycles. Power is Σ|τ q̇|, energy
its integral, acceleration and velocity are the lengths ‖q̈‖ and ‖q̇‖ over all joints. Peaks are looked for in ‖q̈‖/ṡ² and ‖q̇‖/ṡ
over the phase, where a motion that repeats itself looks the same in every cycle however slow it has become.

    power          mean power of each cycle is lower than that of the cycle before it, by `FALL` of it at least
    acceleration   ‖q̈‖ has one peak every half period (a sinusoid is extreme twice a period), to within `OFF_BEAT` of it, and q̈
                   jumps nowhere by more than `JUMP` of its largest value
    energy         in no window of a twentieth of a cycle is energy used up at more than `SPIKE` times the mean rate of that cycle
    velocity       ‖q̇‖ and ṡ|sin 2πu|, the speed of a sinusoid, have a correlation (Pearson's) of `LIKENESS` at least

The sum of |τ q̇| cannot fall: that it rises says nothing, so the check asks for evenness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from motions import ToAndFro
from scipy.signal import find_peaks

from energyopt import RobotModel
from energyopt.parameterizations.path_trajectory import PathTrajectory

FALL, OFF_BEAT, JUMP, SPIKE, LIKENESS = 0.01, 0.1, 0.01, 4.0, 0.95
"""Thresholds, see the module's text."""
PROMINENCE = 0.1
"""A peak rises above the valleys around it by at least this share of the highest."""
SAMPLES, WINDOWS = 400, 20
"""A cycle: samples, and windows of the energy check."""
BESIDE = 1e-9
"""Distance from a break at which accelerations are compared, as a share of the duration."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A motion to and fro, evenly sampled in its phase, N·`SAMPLES` + 1 rows.

    Attributes:
        t: times [s]. phase: u, in cycles. rate: ṡ.
        power: Σ|τ q̇| [W]. energy: its integral so far [J].
        acceleration: ‖q̈‖ [rad/s²]. velocity: ‖q̇‖ [rad/s].
        torque_squared: Στ² [N²·m²].
        jump: largest jump of q̈ inside the motion, start_step: from rest to the first q̈; shares of the largest ‖q̈‖.
    """

    t: np.ndarray
    phase: np.ndarray
    rate: np.ndarray
    power: np.ndarray
    energy: np.ndarray
    acceleration: np.ndarray
    velocity: np.ndarray
    torque_squared: np.ndarray
    jump: float
    start_step: float

    @property
    def cycles(self) -> int:
        return round(self.phase[-1])

    def by_cycle(self, values: np.ndarray) -> np.ndarray:
        """∫ values dt of every cycle, shape (N,)."""
        return np.diff(_so_far(self.t, values)[::SAMPLES])


@dataclass(frozen=True)
class Verdict:
    """What became of a claim. ``str()`` is a line.

    Attributes:
        claim: power, acceleration, energy or velocity. passed: whether it holds.
        measured, bound: in words.
    """

    claim: str
    passed: bool
    measured: str
    bound: str

    def __str__(self) -> str:
        return f"{self.claim:13} {'pass' if self.passed else 'FAIL'}   {self.measured} (bound: {self.bound})"


def record(robot: RobotModel, motion: PathTrajectory) -> Recording:
    """Sample a motion made by `motions.scaled`."""
    path: ToAndFro = motion.path
    phase = np.linspace(0.0, path.cycles, path.cycles * SAMPLES + 1)
    fine = np.linspace(0.0, motion.duration, 20 * len(phase))
    t = np.interp(phase * path.period, motion.places(fine), fine)
    q, v, a = (motion(t, order) for order in range(3))
    tau = robot.torque(q, v, a)
    power, size = np.abs(tau * v).sum(axis=1), np.linalg.norm(a, axis=1)
    beside = BESIDE * motion.duration
    inner = motion.breaks[1:-1]
    jumps = np.linalg.norm(motion(inner + beside, 2) - motion(inner - beside, 2), axis=1)
    return Recording(
        t, phase, motion.law(t, 1)[:, 0], power, _so_far(t, power), size, np.linalg.norm(v, axis=1), (tau**2).sum(axis=1),
        jump=float(jumps.max(initial=0.0) / size.max()), start_step=float(size[0] / size.max()),
    )  # fmt: skip


def power_falls(seen: Recording) -> Verdict:
    """Claim 1: power consumption falls progressively under velocity scaling."""
    mean = seen.by_cycle(seen.power) / np.diff(seen.t[::SAMPLES])
    fall = 1.0 - mean[1:] / mean[:-1]
    words = " → ".join(f"{power:.1f}" for power in mean)
    return Verdict("power", bool(fall.min() >= FALL), f"{words} W, mean of each cycle", f"each {100 * FALL:.0f} % lower at least")


def acceleration_has_periodic_peaks(seen: Recording) -> Verdict:
    """Claim 2: acceleration shows peaks at the sinusoid's period and no jumps."""
    spacing = np.diff(_peaks(seen.phase, seen.acceleration / seen.rate**2), prepend=0.0, append=seen.cycles)
    off = float(np.abs(spacing / 0.5 - 1.0).max())
    jump, step = 100 * seen.jump, 100 * seen.start_step
    words = (
        f"{len(spacing) - 1} peaks inside {seen.cycles} cycles, up to {100 * off:.0f} % off the beat; "
        f"jumps {jump:.1f} %, from rest {step:.0f} %"
    )
    bound = f"a peak every half period ± {100 * OFF_BEAT:.0f} %, jumps inside ≤ {100 * JUMP:.0f} %"
    return Verdict("acceleration", off <= OFF_BEAT and seen.jump <= JUMP, words, bound)


def energy_rises_steadily(seen: Recording) -> Verdict:
    """Claim 3: cumulative energy rises steadily, without spikes."""
    window = SAMPLES // WINDOWS
    gain, time = seen.energy[window:] - seen.energy[:-window], seen.t[window:] - seen.t[:-window]
    cycle = np.minimum((seen.phase[:-window] + 0.5 / WINDOWS).astype(int), seen.cycles - 1)
    mean = seen.by_cycle(seen.power) / np.diff(seen.t[::SAMPLES])
    steepest = float((gain / time / mean[cycle]).max())
    return Verdict("energy", steepest <= SPIKE, f"steepest {steepest:.1f} × the mean rate of its cycle", f"≤ {SPIKE:g}")


def velocity_follows_the_sinusoid(seen: Recording) -> Verdict:
    """Claim 4: velocity magnitude oscillates with the sinusoid."""
    sine = seen.rate * np.abs(np.sin(2.0 * np.pi * seen.phase))
    likeness = float(np.corrcoef(seen.velocity, sine)[0, 1])
    return Verdict("velocity", likeness >= LIKENESS, f"correlation with the sinusoid's {likeness:.3f}", f"≥ {LIKENESS:g}")


CLAIMS = (power_falls, acceleration_has_periodic_peaks, energy_rises_steadily, velocity_follows_the_sinusoid)


def verdicts(seen: Recording) -> tuple[Verdict, ...]:
    """All four."""
    return tuple(claim(seen) for claim in CLAIMS)


def _peaks(phase: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Phases of the prominent peaks inside, in cycles; those of the two ends are left to the ends."""
    found, _ = find_peaks(values, prominence=PROMINENCE * values.max())
    away = np.abs(phase[found][:, None] - phase[[0, -1]]).min(axis=1) > OFF_BEAT / 2
    return phase[found][away]


def _so_far(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.append(0.0, np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t)))
