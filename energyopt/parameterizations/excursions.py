"""How far the joints can go from where they are in the middle t_m of an interval of half width h, by Taylor's theorem:

    |q(t) − q(t_m)| ≤ Σ_k |q⁽ᵏ⁾(t_m)| hᵏ / k!  ( + max |q⁽ⁿ⁺¹⁾| hⁿ⁺¹ / (n+1)! ),

which for a polynomial piece ends with its degree, and for a Fourier sum is closed by the sum of its amplitudes. A path can be
left no farther than the excursion of its time law leads.
"""

from __future__ import annotations

from math import factorial

import numpy as np

from energyopt.errors import GeometryError
from energyopt.parameterizations.path_trajectory import PathTrajectory
from energyopt.parameterizations.trajectory import PolynomialTrajectory, SinusoidTrajectory, SplineTrajectory, Trajectory

FOURIER_ORDERS = 3
"""Terms of the expansion of a Fourier sum before its remainder."""


def excursions(trajectory: Trajectory, middle: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Bounds of |q(t) − q(t_m)| for |t − t_m| ≤ half, shape (K, nv); no interval may reach across a break.

    Args:
        middle: t_m [s], shape (K,); half: [s], shape (K,).

    Raises:
        GeometryError: a kind of motion whose derivatives have no known bound.
    """
    if isinstance(trajectory, PathTrajectory):
        ahead = excursions(trajectory.law, middle, half)[:, 0]
        return excursions(trajectory.path, trajectory.places(middle), ahead)
    if isinstance(trajectory, SplineTrajectory):
        orders, rest = trajectory.degree, 0.0
    elif isinstance(trajectory, PolynomialTrajectory):
        orders, rest = trajectory.coefficients.shape[1] - 1, 0.0
    elif isinstance(trajectory, SinusoidTrajectory):
        orders, rest = FOURIER_ORDERS, _largest_derivative(trajectory, FOURIER_ORDERS + 1)
    else:
        raise GeometryError(f"motion: is a {type(trajectory).__name__}; expected a spline, a polynomial or a sinusoid")
    bound = rest * half[:, None] ** (orders + 1) / factorial(orders + 1) + np.zeros((len(half), trajectory.nv))
    for k in range(1, orders + 1):
        bound += np.abs(trajectory(middle, k)) * half[:, None] ** k / factorial(k)
    return bound


def _largest_derivative(trajectory: SinusoidTrajectory, order: int) -> np.ndarray:
    """Upper bound of a derivative over the whole motion, shape (nv,)."""
    power = np.abs(np.polynomial.polynomial.polyder(trajectory.polynomial, order)).sum(axis=0)
    omega = 2.0 * np.pi * np.arange(1, len(trajectory.sine) + 1)
    waves = omega**order @ np.hypot(trajectory.sine, trajectory.cosine)
    return (power + waves) / trajectory.duration**order
