"""What the drives draw from the supply for given torques over time.

A joint that stands has velocities of 1e-15 rad/s by rounding, of either sign, and with gear losses the sign would decide whether
its motor holds ητ/N or τ/(ηN). Below `REST` a joint stands: the motor holds τ/N.
"""

from __future__ import annotations

import numpy as np

from energyopt.actuators import Actuators, PowerFlow

REST = 1e-8
"""Velocity [rad/s or m/s]: a hundred newton metres do a microwatt there."""


def flow_of(actuators: Actuators, tau: np.ndarray, v: np.ndarray) -> PowerFlow:
    """Where the power goes for joint torques [N·m] and velocities [rad/s], shape (N, nv)."""
    return actuators.flow(tau, np.where(np.abs(v) < REST, 0.0, v))


def electrical_energy(actuators: Actuators, t: np.ndarray, tau: np.ndarray, v: np.ndarray) -> float:
    """∫ supply power dt [J] by the trapezoidal rule, for samples such as those of a replay.

    Args:
        actuators: the drives.
        t: times [s], shape (N,). tau: joint torques [N·m]; v: joint velocities [rad/s], shape (N, nv).
    """
    return float(np.trapezoid(flow_of(actuators, tau, v).supply, t))
