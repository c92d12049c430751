"""How far a motion exceeds the limits of its joints, and where: one `Finding` a limit.

Positions, velocities, accelerations and jerks are compared with their limits at dense samples of every smooth span
and at the exact extrema between them (see `sampling`), so for piecewise polynomials these verdicts hold for ALL t.
Torques come from numeric Pinocchio at the same samples, the largest one of every joint refined by a parabola through
its neighbours. The torque rate is the derivative of inverse dynamics along the motion's own Taylor expansion,

    dτ/dt ≈ ( τ(q + εv + ε²a/2, v + εa + ε²j/2, a + εj) − τ(q − εv + ε²a/2, v − εa + ε²j/2, a − εj) ) / 2ε,

which stays on one side of every break. A jump of an acceleration or torque at a break counts as a rate over one sample.
Margins are in % of the limit; of a position in % of half its range, so that 100 % is the middle and 0 % the limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.sampling import Samples, extrema

_RATE_STEP = 1e-5
"""ε [s] of the torque rate: truncation ε²τ⃛/6 and rounding 1e-16·τ/ε are both near 1e-9 relative."""


@dataclass(frozen=True)
class Finding:
    """One line of the dense check.

    Attributes:
        name: of the limit or condition.
        amount: worst excess, 0 where it holds, in the unit of the entry.
        margin: smallest distance to the limit in % of it, negative where exceeded; None where there is no limit.
        joint, time: where the margin is smallest (the excess largest); time in seconds.
    """

    name: str
    amount: float
    margin: float | None = None
    joint: str = ""
    time: float = 0.0


def kinematic_findings(problem: Problem, trajectory: Trajectory, samples: Samples) -> list[Finding]:
    """Position, velocity, acceleration and jerk; no finding for a limit that is infinite for every joint."""
    limits, found = problem.limits, []
    bounds = {
        "position": (limits.lower, limits.upper),
        "velocity": (-limits.velocity, limits.velocity),
        "acceleration": (-limits.acceleration, limits.acceleration),
        "jerk": (-limits.jerk, limits.jerk),
    }
    for order, (name, (lower, upper)) in enumerate(bounds.items()):
        if not np.any(np.isfinite(lower) | np.isfinite(upper)):
            continue
        times, values = extrema(trajectory, order)
        t = np.concatenate([np.repeat(samples.t.reshape(-1, 1), trajectory.nv, axis=1), times])
        values = np.concatenate([samples.flat(order), values])
        if order == 3:
            t, values = _with_jumps(t, values, samples.t, samples.derivative(2))
        found.append(_bounded(problem, name, t, values, lower, upper))
    return found


def torque_findings(problem: Problem, samples: Samples) -> list[Finding]:
    """Torque (in % of the limit) and torque rate, likewise."""
    limits, robot = problem.limits, problem.robot
    if not np.any(np.isfinite(limits.torque) | np.isfinite(limits.torque_rate)):
        return []
    q, v, a = (samples.flat(order) for order in range(3))
    shape = (*samples.t.shape, robot.nv)
    t = np.repeat(samples.t.reshape(-1, 1), robot.nv, axis=1)
    found, tau = [], robot.torque(q, v, a)
    if np.any(np.isfinite(limits.torque)):
        peak_t, peak = _parabolic_peaks(samples.t, tau.reshape(shape))
        times, values = np.vstack([t, peak_t]), np.vstack([tau, peak])
        found.append(_bounded(problem, "torque_percent", times, values, -limits.torque, limits.torque))
    if np.any(np.isfinite(limits.torque_rate)):
        j, e = samples.flat(3), _RATE_STEP
        ahead = robot.torque(q + e * v + 0.5 * e * e * a, v + e * a + 0.5 * e * e * j, a + e * j)
        behind = robot.torque(q - e * v + 0.5 * e * e * a, v - e * a + 0.5 * e * e * j, a - e * j)
        times, rate = _with_jumps(t, (ahead - behind) / (2 * e), samples.t, tau.reshape(shape))
        found.append(_bounded(problem, "torque_rate", times, rate, -limits.torque_rate, limits.torque_rate))
    return found


def _bounded(problem: Problem, name: str, t: np.ndarray, values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Finding:
    """The finding for ``lower`` ≤ ``values`` ≤ ``upper``; times and values have shape (M, nv)."""
    with np.errstate(invalid="ignore"):
        excess = np.maximum(values - upper, lower - values)
        half = np.where(np.isfinite(upper - lower), 0.5 * (upper - lower), 1.0)
    # An infinite limit is never exceeded, but a value that is not a number must not pass for one that holds.
    excess = np.where(np.isnan(values), np.nan, excess)
    half = np.where(half > 0, half, 1.0)
    percent = 100.0 * excess / half
    row, joint = np.unravel_index(np.argmax(np.where(np.isnan(percent), np.inf, percent)), percent.shape)
    amount = float(np.max(percent if name == "torque_percent" else excess))
    amount = 0.0 if amount <= 0 else amount
    return Finding(name, amount, -float(percent[row, joint]), problem.robot.joint_names[joint], float(t[row, joint]))


def _parabolic_peaks(t: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of the parabolas through every joint's largest |τ| and its two neighbours in the same span, shape (1, nv)."""
    count, nv = tau.shape[1:]
    index = np.argmax(np.abs(tau).reshape(-1, nv), axis=0)
    span, left, joint = index // count, np.clip(index % count, 1, count - 2), np.arange(nv)
    before, at, after = (tau[span, left + d, joint] for d in (-1, 0, 1))
    slope, curvature = 0.5 * (after - before), after - 2.0 * at + before
    with np.errstate(all="ignore"):
        shift = -slope / curvature
    shift = np.where(np.abs(shift) <= 1.0, shift, 0.0)
    step = t[span, left + 1] - t[span, left]
    return (t[span, left] + shift * step)[None], (at + slope * shift + 0.5 * curvature * shift**2)[None]


def _with_jumps(t: np.ndarray, rates: np.ndarray, times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rates (M, nv) and, below them, those of the jumps of ``values`` (K, S, nv) at breaks, taken over one sample."""
    jump = values[1:, 0] - values[:-1, -1]
    step = np.minimum(np.diff(times[1:, :2], axis=1), np.diff(times[:-1, :2], axis=1))
    # Rounding is not a jump: coefficients of neighbouring spans agree to about 1e-12 of the values themselves.
    jump = np.where(np.abs(jump) > 1e-9 * (1.0 + np.abs(values[1:, 0])), jump, 0.0)
    at = np.repeat(times[1:, :1], values.shape[2], axis=1)
    return np.vstack([t, at]), np.vstack([rates, jump / step])
