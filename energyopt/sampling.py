"""Times at which a motion is judged: dense one-sided samples, exact extrema, Gauss nodes.

A motion is smooth on spans [t_k, t_{k+1}]; at a break a derivative may jump, so both ends of every span are sampled
from inside. On a span a polynomial motion is q(x) = Σ_p c_p x^p with x = t − t_k, and the extrema of its derivative of
order k are the roots of the derivative of order k + 1: found as roots of a polynomial in s = x/h, 0 ≤ s ≤ 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from energyopt.parameterizations.trajectory import PolynomialTrajectory, SplineTrajectory, Trajectory, gauss_on_spans

LEAST_SPANS = 16
"""A motion is sampled as if it had at least this many spans, so that one long polynomial is not undersampled."""


@dataclass(frozen=True, eq=False)
class Samples:
    """A motion sampled span by span, each span's two ends from inside.

    Attributes:
        t: times [s], shape (K, S).
        derivative: order → values of that derivative, shape (K, S, nv).
    """

    t: np.ndarray
    derivative: Callable[[int], np.ndarray]

    def flat(self, order: int) -> np.ndarray:
        """The derivative as rows in time, shape (K·S, nv); breaks appear twice."""
        values = self.derivative(order)
        return values.reshape(-1, values.shape[-1])


def sample_spans(trajectory: Trajectory, per_span: int = 20) -> Samples:
    """Evenly spaced samples, at least ``per_span`` + 1 in every smooth span and ``per_span``·`LEAST_SPANS` in all."""
    breaks = np.asarray(trajectory.breaks, float)
    spans = len(breaks) - 1
    count = max(per_span, -(-per_span * LEAST_SPANS // spans))
    s = np.linspace(0.0, 1.0, count + 1)
    width = np.diff(breaks)[:, None]
    t = breaks[:-1, None] + width * s
    t[:, -1] = breaks[1:]
    pieces = polynomial_pieces(trajectory)
    if pieces is None:
        inside = t.copy()
        inside[:, 0], inside[:, -1] = np.nextafter(t[:, 0], np.inf), np.nextafter(t[:, -1], -np.inf)
        return Samples(t, cache(lambda order: trajectory(inside.ravel(), order).reshape(*t.shape, trajectory.nv)))
    return Samples(t, cache(lambda order: _evaluate(_derivative(pieces, order), width * s)))


def extrema(trajectory: Trajectory, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Interior extrema of one derivative of the motion, joint by joint.

    Args:
        trajectory: the motion.
        order: 0 position, 1 velocity, 2 acceleration, 3 jerk.

    Returns:
        t: times [s], shape (M, nv) (a row holds another time for every joint); values: the derivative there, same shape.
        Exact for piecewise polynomials; for other motions Newton's method from every sign change of the next derivative.
    """
    pieces = polynomial_pieces(trajectory)
    if pieces is None:
        return _newton_extrema(trajectory, order)
    breaks = np.asarray(trajectory.breaks, float)
    width = np.diff(breaks)[:, None, None]
    slope = _derivative(pieces, order + 1)
    scaled = slope * width ** np.arange(slope.shape[1])[None, :, None]
    s = unit_roots(np.moveaxis(scaled, 1, -1))
    x = np.moveaxis(s, -1, 1) * width
    values = _horner(_derivative(pieces, order), x)
    nv = trajectory.nv
    return (breaks[:-1, None, None] + x).reshape(-1, nv), values.reshape(-1, nv)


def gauss_grid(trajectory: Trajectory, per_span: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Gauss–Legendre times and weights over all smooth spans, long spans split into parts of at most T / `LEAST_SPANS`."""
    breaks = np.asarray(trajectory.breaks, float)
    longest = trajectory.duration / LEAST_SPANS * (1 + 1e-9)
    parts = [np.linspace(a, b, int(np.ceil((b - a) / longest)) + 1)[:-1] for a, b in zip(breaks[:-1], breaks[1:], strict=True)]
    fine = np.append(np.concatenate(parts), breaks[-1])
    return gauss_on_spans(fine, per_span)


def polynomial_pieces(trajectory: Trajectory) -> np.ndarray | None:
    """Ascending coefficients of every span, shape (K, degree + 1, nv); None where the motion is not piecewise polynomial."""
    if isinstance(trajectory, SplineTrajectory):
        return trajectory.polynomial_pieces()[1]
    if isinstance(trajectory, PolynomialTrajectory):
        return trajectory.coefficients
    return None


def unit_roots(coefficients: np.ndarray) -> np.ndarray:
    """Real roots in [0, 1] of many polynomials at once.

    Args:
        coefficients: ascending, shape (..., degree + 1).

    Returns:
        shape (..., degree); where a polynomial has fewer such roots the place holds 0.
    """
    c = np.asarray(coefficients, float)
    degree = c.shape[-1] - 1
    if degree < 1:
        return np.zeros(c.shape[:-1] + (0,))
    with np.errstate(all="ignore"):
        if degree == 1:
            roots = -c[..., :1] / c[..., 1:]
        elif degree == 2:
            # Citardauq form beside the usual one: no cancellation, and a vanishing leading coefficient does no harm.
            root = np.sqrt(c[..., 1] ** 2 - 4 * c[..., 2] * c[..., 0])
            q = -0.5 * (c[..., 1] + np.copysign(root, c[..., 1]))
            roots = np.stack([q / c[..., 2], c[..., 0] / q], axis=-1)
        else:
            roots = _companion_roots(c)
        return np.where((roots >= 0.0) & (roots <= 1.0), roots, 0.0)


def _companion_roots(c: np.ndarray) -> np.ndarray:
    """Eigenvalues of companion matrices; a nearly vanishing leading coefficient is kept off zero (its root is far away)."""
    degree = c.shape[-1] - 1
    size = np.abs(c).max(axis=-1)
    if not np.all(np.isfinite(size)):
        return np.zeros(c.shape[:-1] + (degree,))
    size = np.where(size > 0, size, 1.0)
    lead = c[..., -1] / size
    lead = np.where(np.abs(lead) < 1e-13, 1e-13, lead)
    matrix = np.zeros(c.shape[:-1] + (degree, degree))
    matrix[..., np.arange(1, degree), np.arange(degree - 1)] = 1.0
    matrix[..., :, -1] = -c[..., :-1] / size[..., None] / lead[..., None]
    values = np.linalg.eigvals(matrix)
    # A double root comes out as a pair with imaginary parts of about sqrt(machine precision).
    return np.where(np.abs(values.imag) < 1e-6, values.real, -1.0)


def _newton_extrema(trajectory: Trajectory, order: int) -> tuple[np.ndarray, np.ndarray]:
    t = sample_spans(trajectory).t
    slope = trajectory(t.ravel(), order + 1).reshape(*t.shape, trajectory.nv)
    span, left, joint = np.nonzero(slope[:, :-1] * slope[:, 1:] < 0)
    low, high = t[span, left], t[span, left + 1]
    at, rows = 0.5 * (low + high), np.arange(joint.size)
    for _ in range(5):
        step = trajectory(at, order + 1)[rows, joint] / _away_from_zero(trajectory(at, order + 2)[rows, joint])
        at = np.clip(at - step, low, high)
    times = np.zeros((joint.size, trajectory.nv)) + at[:, None]
    return times, trajectory(at, order)


def _away_from_zero(x: np.ndarray) -> np.ndarray:
    return np.where(np.abs(x) < 1e-300, 1e-300, x)


def _derivative(pieces: np.ndarray, order: int) -> np.ndarray:
    """Coefficients of the derivative of the given order; at least one coefficient is left."""
    for _ in range(order):
        degree = pieces.shape[1] - 1
        pieces = pieces[:, 1:] * np.arange(1, degree + 1)[None, :, None] if degree else np.zeros_like(pieces)
    return pieces


def _evaluate(pieces: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Every piece at its own local times ``x`` (K, S): shape (K, S, nv)."""
    return np.einsum("ksp,kpn->ksn", x[:, :, None] ** np.arange(pieces.shape[1]), pieces)


def _horner(pieces: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Every piece and joint at local times ``x`` (K, M, nv) of its own."""
    value = np.zeros_like(x) + pieces[:, -1:, :]
    for p in range(pieces.shape[1] - 2, -1, -1):
        value = value * x + pieces[:, p : p + 1, :]
    return value
