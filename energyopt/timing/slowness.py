"""The durations at which a motion, made slower or faster as a whole, keeps its limits.

In x = 1/T, with s = t/T, velocity, acceleration and jerk ask for x ≤ V/|p'|, x² ≤ A/|p''|, x³ ≤ J/|p'''| at the extrema of
p', p'' and p''' (exact for polynomials), and a torque limit for

    −τ_max ≤ a x² + b x + g (+ Coulomb friction) ≤ τ_max     at every s:

each side is broken on an interval of x between the roots of a quadratic, and what is left of all x by all of them together is
found exactly, sample by sample. The samples are made denser around the one that binds. Gravity may leave a gap: what cannot be
held still can sometimes be swung through. Coulomb friction counts as none or all of it, whichever is worse: on the safe side.
"""

from __future__ import annotations

import numpy as np

from energyopt.errors import InputError
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem_values import DURATION_RANGE
from energyopt.robots.model import Limits, RobotModel
from energyopt.sampling import extrema, sample_spans

ROUNDS, DENSER = 3, 24
"""Times that the samples are made denser around the one that binds, and by how many."""


def allowed_durations(motion: Trajectory, robot: RobotModel, limits: Limits) -> np.ndarray:
    """Intervals of T [s] in which the limits hold, shape (K, 2), rising.

    Raises:
        InputError: there is none; names the joint.
    """
    most = min(1.0 / DURATION_RANGE[0], _kinematic_most(motion, limits))
    least = 1.0 / DURATION_RANGE[1]
    samples = sample_spans(motion)
    t = samples.t.ravel()
    states = [samples.flat(order) for order in range(3)]
    for _ in range(ROUNDS):
        low, high, where = _broken(motion, robot, limits, t, states)
        free, binding = _gaps(low, high, least, most)
        if binding is None:
            break
        row = where[binding]
        gap = np.diff(motion.breaks).min() / 20
        near = np.clip(t[row] + gap * np.linspace(-1, 1, DENSER), 0, motion.duration)
        t = np.concatenate([t, near])
        states = [np.concatenate([x, motion(near, order)]) for order, x in enumerate(states)]
    if not len(free):
        raise _never(motion, robot, limits, t, states)
    return 1.0 / free[::-1, ::-1]


def _kinematic_most(motion: Trajectory, limits: Limits) -> float:
    """The largest x that velocity, acceleration and jerk allow."""
    T, most = motion.duration, np.inf
    for order, bound in ((1, limits.velocity), (2, limits.acceleration), (3, limits.jerk)):
        if not np.any(np.isfinite(bound)):
            continue
        samples = np.concatenate([sample_spans(motion).flat(order), extrema(motion, order)[1]])
        peak = np.abs(samples).max(axis=0) * T**order
        with np.errstate(divide="ignore"):
            most = min(most, np.min((bound / peak) ** (1.0 / order)))
    return float(most)


def _broken(
    motion: Trajectory, robot: RobotModel, limits: Limits, t: np.ndarray, states: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Intervals of x in which a torque limit is broken at a sample: lower and upper ends, and the sample's row, each (M,)."""
    a, b, g = torque_terms(motion.duration, robot, *states)
    rub = robot.dynamics.coulomb_friction * np.sign(states[1])
    limited = np.isfinite(limits.torque)
    found = []
    for sign in (1.0, -1.0):
        excess = sign * g + np.maximum(sign * rub, 0.0) - limits.torque
        found.append(_above(*(x[:, limited] for x in (sign * a, sign * b, excess))))
    low, high = (np.concatenate([side[k] for side in found], axis=1) for k in (0, 1))
    rows = np.broadcast_to(np.arange(len(t))[:, None, None], low.shape)
    use = low < high
    return low[use], high[use], rows[use]


def torque_terms(T: float, robot: RobotModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, ...]:
    """a, b and g of τ = a/T² + b/T + g [N·m], each (N, nv), from the states of a motion of duration ``T``."""
    rest = np.zeros_like(q)
    held = robot.torque(q, rest, rest)
    v, a = T * v, T**2 * a
    moved = robot.torque(q, v, a) - robot.dynamics.friction(v) - held
    return moved, robot.dynamics.viscous_friction * v, held


def _above(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a x² + b x + c > 0 for x > 0: two intervals a place, as lower and upper ends (N, nv, 2); (0, 0) is empty."""
    a = np.where(a == 0, 1e-300, a)  # its second root is then at infinity, as that of a line
    with np.errstate(all="ignore"):
        discriminant = b * b - 4 * a * c
        h = -0.5 * (b + np.copysign(np.sqrt(np.maximum(discriminant, 0.0)), b))
        roots = np.nan_to_num(np.stack([h / a, c / h]), nan=0.0, posinf=np.inf, neginf=-np.inf)
    first, second = np.maximum(np.sort(roots, axis=0), 0.0)
    up, everywhere = a > 0, np.where(a > 0, np.inf, 0.0)
    real, none = discriminant >= 0, np.zeros_like(a)
    low = [np.where(real & ~up, first, none), np.where(real & up, second, none)]
    high = [np.where(real, np.where(up, first, second), everywhere), np.where(real & up, np.inf, none)]
    return np.stack(low, axis=-1), np.stack(high, axis=-1)


def _gaps(low: np.ndarray, high: np.ndarray, least: float, most: float) -> tuple[np.ndarray, int | None]:
    """What intervals leave free of [least, most], shape (K, 2), rising, and which one ends the last gap (None: ``most`` does)."""
    order = np.argsort(low)
    low, high = low[order], high[order]
    reach = np.maximum.accumulate(np.append(least, high))
    starts, ends = reach, np.append(low, np.inf)
    free = np.stack([starts, np.minimum(ends, most)], axis=1)
    keep = np.flatnonzero(free[:, 1] > free[:, 0])
    if not len(keep):
        return free[keep], None
    last = keep[-1]
    return free[keep], int(order[last]) if ends[last] < most else None


def _never(motion: Trajectory, robot: RobotModel, limits: Limits, t: np.ndarray, states: list[np.ndarray]) -> InputError:
    held = robot.torque(states[0], *np.zeros((2, *states[0].shape)))
    k, i = np.unravel_index(np.argmax(np.abs(held) / limits.torque), held.shape)
    needs = f"needs {abs(held[k, i]):.4g} N·m to be held at {100 * t[k] / motion.duration:.0f} % of the way"
    return InputError(
        f"no duration keeps the limits of this motion: joint '{robot.joint_names[i]}' {needs}, its torque limit is "
        f"{limits.torque[i]:.4g}; raise it, or go another way"
    )
