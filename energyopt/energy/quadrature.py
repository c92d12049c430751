"""Times and weights at which powers are integrated: Gauss nodes between all the times at which a power has a kink or jump.

A power τ q̇ is smooth where the motion is. What drives make of it is not: gear losses jump where τ or q̇ changes sign, what a
supply takes back has a kink where a drive (or the shared bus) turns from drawing to braking. These times are bracketed on a
dense grid and bisected. Coulomb friction is smooth and steep within a few v_s of rest: these velocities bound intervals too.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from energyopt.actuators import Actuators
from energyopt.energy.drawn import flow_of
from energyopt.parameterizations.trajectory import Trajectory, gauss_on_spans
from energyopt.robots.model import RobotModel
from energyopt.sampling import sample_spans

PER_SPAN = 40
"""Samples a span (and `sampling.LEAST_SPANS` times as many in all) between which sign changes are looked for."""
NODES = 8
"""Gauss nodes between two such times."""
LONGEST = 1 / 32
"""Of an interval, as a share of the duration."""
HALVINGS = 26
"""From a sample's width down to 1e-11 of the duration."""
STEEP = (1.0, 3.0)
"""Velocities, in units of v_s, that bound intervals where there is Coulomb friction."""


def power_grid(robot: RobotModel, trajectory: Trajectory, actuators: Actuators | None) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and weights [s] of a quadrature for everything a power can become, both of shape (N,).

    Args:
        robot: whose torques. trajectory: the motion. actuators: the drives, where known.
    """
    samples = sample_spans(trajectory, PER_SPAN)
    signals = _signals(robot, actuators)
    values = signals(*(samples.flat(order) for order in range(3))).reshape(*samples.t.shape, -1)
    span, left, which = np.nonzero(values[:, :-1] * values[:, 1:] < 0)
    low, high, sign = samples.t[span, left], samples.t[span, left + 1], np.sign(values[span, left, which])
    rows = np.arange(len(which))
    for _ in range(HALVINGS if len(rows) else 0):
        middle = 0.5 * (low + high)
        same = sign * signals(*(trajectory(middle, order) for order in range(3)))[rows, which] > 0
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    breaks = np.unique(np.concatenate([trajectory.breaks, 0.5 * (low + high), _even(trajectory.duration)]))
    far = np.diff(breaks, prepend=-np.inf) > 1e-9 * trajectory.duration
    return gauss_on_spans(np.append(breaks[far][:-1], trajectory.duration), NODES)


def _signals(robot: RobotModel, actuators: Actuators | None) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """A function of (q, v, a), each (N, nv), whose columns change sign where a power is not smooth."""
    dynamics = robot.dynamics
    rubs = np.flatnonzero(dynamics.coulomb_friction)
    widths = np.broadcast_to(dynamics.coulomb_velocity, dynamics.nv)[rubs]
    levels = [sign * level * widths for level in STEEP for sign in (-1.0, 1.0)]

    def signals(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        columns = [v, *(v[:, rubs] - level for level in levels)]
        if actuators is not None:
            tau = robot.torque(q, v, a)
            drawn = flow_of(actuators, tau, v).electrical
            columns += [tau, drawn.sum(axis=1, keepdims=True) if actuators.shared_bus else drawn]
        return np.hstack(columns)

    return signals


def _even(duration: float) -> np.ndarray:
    return np.linspace(0.0, duration, round(1 / LONGEST) + 1)
