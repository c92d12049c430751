"""Trajectory: a motion q(t) on [0, T], a callable that gives any derivative at any times.

Every motion in energyopt (plans, baselines, guesses) is one of the classes of this file, so that everything
that judges or draws a motion needs only `traj(t, order)`. Outside [0, T] there is no motion, and asking for it is an error.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import lru_cache

import numpy as np
from scipy.interpolate import BSpline as ScipySpline
from scipy.interpolate import PPoly

from energyopt.errors import ProblemError
from energyopt.problem_values import numbers, whole
from energyopt.readable import Readable, counted

ROUNDING = 1e-9
"""Share of the duration by which a time may lie outside [0, T] and still count as its end."""


@lru_cache(maxsize=32)
def gauss_legendre(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights on [−1, 1]; exact to degree 2·count − 1."""
    return np.polynomial.legendre.leggauss(count)


def gauss_on_spans(breaks: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss–Legendre times and weights with ``count`` nodes in each span between breakpoints, both (spans·count,)."""
    x, w = gauss_legendre(count)
    half, middle = 0.5 * np.diff(breaks)[:, None], 0.5 * (breaks[1:] + breaks[:-1])[:, None]
    return (middle + half * x).ravel(), (half * w).ravel()


class Trajectory(Readable, ABC):
    """A motion of nv joints over [0, duration] seconds.

    Attributes:
        kind: name under which `trajectory_from_arrays` makes it again.
        duration: T [s].
        nv: number of joints.
        breaks: times [s], 0 and T among them, between which the motion is smooth; shape (K + 1,).
    """

    kind: str
    duration: float
    nv: int
    breaks: np.ndarray

    def __call__(self, t: np.ndarray | float, order: int = 0) -> np.ndarray:
        """The derivative of the given order at the times ``t`` [s].

        Args:
            t: times from 0 to T, of any shape (N,), or one time. A motion says nothing of what comes before and after it:
                an arm that waits stands at ``traj(np.clip(t, 0, traj.duration))`` and has no velocity.
            order: 0 position [rad], 1 velocity, 2 acceleration, 3 jerk, and further up to `highest_order`.

        Returns:
            shape (N, nv), or (nv,) for one time.

        Raises:
            ProblemError: a time is no number or outside [0, T] by more than rounding, or there is no such derivative.
        """
        times = numbers("trajectory: t", t, "times in seconds")
        order = whole("trajectory: order", order, 0, self.highest_order, self._orders())
        flat = times.ravel()
        slack = ROUNDING * self.duration
        outside = np.flatnonzero(~((flat >= -slack) & (flat <= self.duration + slack)))
        if outside.size:
            raise ProblemError(
                f"trajectory: t is {flat[outside[0]]:.6g} s: expected 0 to {self.duration:.6g} s, its duration; "
                "numpy.clip(t, 0, duration) holds the ends"
            )
        return self._evaluate(np.clip(flat, 0.0, self.duration), order).reshape(times.shape + (self.nv,))

    def in_brief(self) -> str:
        return f"{counted(self.nv, 'joint')}, {self.duration:.6g} s, {counted(len(self.breaks) - 1, 'span')}"

    @property
    def highest_order(self) -> int:
        """The highest derivative that can be asked for."""
        return 3

    def _orders(self) -> str:
        names = "0 (position), 1 (velocity), 2 (acceleration) or 3 (jerk)"
        return names if self.highest_order == 3 else f"{names}, or up to {self.highest_order}"

    @abstractmethod
    def _evaluate(self, t: np.ndarray, order: int) -> np.ndarray: ...

    @abstractmethod
    def to_arrays(self) -> dict[str, np.ndarray]:
        """The numbers that define the motion exactly (for saving)."""

    def stretched(self, duration: float) -> Trajectory:
        """The same motion made slower or faster: q(t·T/duration), exactly.

        Args:
            duration: the new T [s], positive.
        """
        from energyopt.parameterizations.path_trajectory import PathTrajectory

        return PathTrajectory(self, SplineTrajectory([0.0, 0.0, duration, duration], [[0.0], [self.duration]], 1))

    def sample_times(self, per_span: int = 20) -> np.ndarray:
        """A dense grid: ``per_span`` + 1 evenly spaced times in every smooth span, shared ends once."""
        spans = np.linspace(self.breaks[:-1], self.breaks[1:], per_span + 1, axis=1)
        return np.append(spans[:, :-1].ravel(), self.duration)

    def quadrature(self, per_span: int = 6) -> tuple[np.ndarray, np.ndarray]:
        """Gauss–Legendre times and weights over all smooth spans; exact to degree 2·per_span − 1 in each."""
        return gauss_on_spans(self.breaks, per_span)


class SplineTrajectory(Trajectory):
    """A B-spline: Σ c_j B_j(t) with a clamped knot vector (C. de Boor, "A Practical Guide to Splines", 1978)."""

    kind = "bspline"

    def __init__(self, knots: np.ndarray, coefficients: np.ndarray, degree: int):
        self.spline = ScipySpline(np.asarray(knots, float), np.asarray(coefficients, float), degree)
        self.degree = degree
        knots = self.spline.t
        self.breaks = knots[np.append(True, knots[1:] > knots[:-1])]
        self.duration = float(self.breaks[-1])
        self.nv = self.spline.c.shape[1]
        self._derivatives = {0: self.spline}

    @property
    def highest_order(self) -> int:
        return max(3, self.degree)

    def _evaluate(self, t: np.ndarray, order: int) -> np.ndarray:
        if order > self.degree:
            return np.zeros((t.size, self.nv))
        for k in range(len(self._derivatives), order + 1):
            self._derivatives[k] = _slope(self._derivatives[k - 1])
        return self._derivatives[order](t)

    def polynomial_pieces(self) -> tuple[np.ndarray, np.ndarray]:
        """The spline as a + b t + c t² + d t³ … on each span, t counted from the span's start.

        Returns:
            breaks: shape (K + 1,) [s]; coefficients: shape (K, degree + 1, nv), ascending powers.
        """
        starts = self.breaks[:-1]
        factorial = np.cumprod([1.0] + [float(k) for k in range(1, self.degree + 1)])
        pieces = [self._evaluate(starts, k) / factorial[k] for k in range(self.degree + 1)]
        return self.breaks, np.stack(pieces, axis=1)

    def stretched(self, duration: float) -> SplineTrajectory:
        return SplineTrajectory(_stretched_times(self.spline.t, duration), self.spline.c, self.degree)

    def to_arrays(self) -> dict[str, np.ndarray]:
        return {"knots": self.spline.t, "coefficients": self.spline.c, "degree": np.array(self.degree)}


class PolynomialTrajectory(Trajectory):
    """Piecewise polynomials on given breaks, ascending powers of the time since the start of the piece."""

    kind = "polynomial"

    def __init__(self, breaks: np.ndarray, coefficients: np.ndarray):
        """``breaks`` [s] has shape (K + 1,), ``coefficients`` (K, degree + 1, nv)."""
        self.breaks = np.asarray(breaks, float)
        self.coefficients = np.asarray(coefficients, float)
        self.duration = float(self.breaks[-1])
        self.nv = self.coefficients.shape[2]
        self._pieces = {0: PPoly(self.coefficients[:, ::-1].transpose(1, 0, 2), self.breaks)}

    @property
    def highest_order(self) -> int:
        return max(3, self.coefficients.shape[1] - 1)

    def _evaluate(self, t: np.ndarray, order: int) -> np.ndarray:
        if order not in self._pieces:
            self._pieces[order] = self._pieces[0].derivative(order)
        return self._pieces[order](t)

    def stretched(self, duration: float) -> PolynomialTrajectory:
        powers = (self.duration / duration) ** np.arange(self.coefficients.shape[1])
        return PolynomialTrajectory(_stretched_times(self.breaks, duration), self.coefficients * powers[:, None])

    def to_arrays(self) -> dict[str, np.ndarray]:
        return {"breaks": self.breaks, "coefficients": self.coefficients}


class SinusoidTrajectory(Trajectory):
    """Polynomial part plus Fourier series: q(t) = Σ_k P_k s^k + Σ_h (A_h sin 2πhs + B_h cos 2πhs), s = t/T.

    A cycloid is q₀ + Δq (s − sin 2πs / 2π): P = (q₀, Δq), A₁ = −Δq/2π.
    """

    kind = "sinusoid"

    def __init__(self, duration: float, polynomial: np.ndarray, sine: np.ndarray, cosine: np.ndarray):
        """``polynomial`` has shape (degree + 1, nv), ascending; ``sine`` and ``cosine`` (H, nv) for h = 1 … H."""
        self.duration = float(duration)
        self.polynomial, self.sine, self.cosine = (np.asarray(x, float) for x in (polynomial, sine, cosine))
        self.nv = self.polynomial.shape[1]
        harmonics = max(1, len(self.sine))
        self.breaks = np.linspace(0.0, self.duration, 4 * harmonics + 1)

    @property
    def highest_order(self) -> int:
        """All exist; two more than the jerk serve to find where it is extreme."""
        return 5

    def _evaluate(self, t: np.ndarray, order: int) -> np.ndarray:
        s = t / self.duration
        power = np.polynomial.polynomial.polyder(self.polynomial, order) if order else self.polynomial
        omega = 2.0 * np.pi * np.arange(1, len(self.sine) + 1)
        phase = s[:, None] * omega + order * np.pi / 2.0
        scale = omega**order
        value = np.polynomial.polynomial.polyval(s, power).T
        value = value + (np.sin(phase) * scale) @ self.sine + (np.cos(phase) * scale) @ self.cosine
        return value / self.duration**order

    def stretched(self, duration: float) -> SinusoidTrajectory:
        return SinusoidTrajectory(duration, self.polynomial, self.sine, self.cosine)

    def to_arrays(self) -> dict[str, np.ndarray]:
        return {
            "duration": np.array(self.duration),
            "polynomial": self.polynomial,
            "sine": self.sine,
            "cosine": self.cosine,
        }


def _slope(spline: ScipySpline) -> ScipySpline:
    """The derivative of a spline: p (c_{j+1} − c_j) / (t_{j+p+1} − t_{j+1}), zero where knots of that multiplicity coincide."""
    t, c, p = spline.t, spline.c, spline.k
    width = (t[p + 1 : -1] - t[1 : -p - 1])[:, None]
    return ScipySpline.construct_fast(
        t[1:-1], np.diff(c, axis=0) * np.divide(p, width, out=np.zeros_like(width), where=width > 0), p - 1
    )


def _stretched_times(times: np.ndarray, duration: float) -> np.ndarray:
    """Times from 0 to T as the same shares of ``duration``; the last is exactly that."""
    stretched = times * (duration / times[-1])
    stretched[times == times[-1]] = duration
    return stretched
