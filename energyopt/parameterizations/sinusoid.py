"""Sinusoids: a cycloid from start to goal plus harmonics that leave the boundary conditions untouched. With s = t/T,

    q(s) = q₀ + Δq (s − sin 2πs / 2π) + Σ_h x_h χ_h(s) + y_h ψ_h(s)
    χ_h = [sin 2π(h+1)s / (h+1) − sin 2πs] / (h+1),      ψ_h = [(1 − cos 2π(h+1)s) / (h+1)² − (1 − cos 2πs)]

Value, slope and curvature of χ_h and ψ_h vanish at both ends. Boundary velocities and accelerations other than zero add
the quintic Hermite polynomials. Limits are imposed at samples and at every time where a check finds them exceeded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from energyopt.parameterizations.space import MotionSpace, Rows, Unknowns
from energyopt.parameterizations.trajectory import SinusoidTrajectory, Trajectory, gauss_on_spans
from energyopt.problem_values import whole

_HERMITE = np.array(
    [  # ascending powers of s: velocity and acceleration at 0, velocity and acceleration at 1
        [0.0, 1.0, 0.0, -6.0, 8.0, -3.0],
        [0.0, 0.0, 0.5, -1.5, 1.5, -0.5],
        [0.0, 0.0, 0.0, -4.0, 7.0, -3.0],
        [0.0, 0.0, 0.0, 0.5, -1.0, 0.5],
    ]
)


@dataclass(frozen=True)
class Sinusoid:
    """A cycloid plus harmonics.

    Attributes:
        harmonics: frequencies above the fundamental; each has a sine and a cosine amplitude a joint.
    """

    harmonics: int = 6

    def __post_init__(self):
        object.__setattr__(self, "harmonics", whole("Sinusoid harmonics", self.harmonics, 0, 64))

    def space(self, duration: float, nodes: int | None = None) -> SinusoidSpace:
        """The motions. ``nodes``: of the quadrature in each of 2 (harmonics + 2) parts; four by default."""
        return SinusoidSpace(duration, self.harmonics, nodes)


class SinusoidSpace(MotionSpace):
    """Coefficients: q₀, v₀, a₀, q₁, v₁, a₁, then the amplitudes of χ_1 … χ_H and ψ_1 … ψ_H."""

    everywhere = False

    def __init__(self, duration: float, harmonics: int, nodes: int | None = None):
        self.duration = float(duration)
        self.harmonics, self.nodes = harmonics, nodes or 4
        self.size = 6 + 2 * harmonics
        self._functions = self._basis_functions()

    def basis(self, t, orders=3):
        values = np.stack([self._functions(t, order) for order in range(orders)], axis=1)
        return np.tile(np.arange(self.size), (len(t), 1)), values

    def quadrature(self):
        return gauss_on_spans(np.linspace(0.0, self.duration, 2 * (self.harmonics + 1) + 3), self.nodes)

    def unknowns(self, start, goal):
        nv = len(start.velocity)
        offset, block = np.zeros((self.size, nv)), np.full(self.size, -1)
        offset[:3] = start.position, start.velocity, start.acceleration
        offset[4:6] = goal.velocity, goal.acceleration
        block[6:] = np.arange(self.size - 6)
        if goal.position is not None:
            offset[3] = goal.position
            return Unknowns(block, offset, self.size - 6)
        block[3] = self.size - 6
        return Unknowns(block, offset, self.size - 5, goal=self.size - 6)

    def closed_unknowns(self, position):
        offset, block = np.zeros((self.size, len(position))), np.full(self.size, -1)
        block[1:3] = block[4:6] = 0, 1
        block[6:], offset[[0, 3]] = np.arange(2, self.size - 4), position
        return Unknowns(block, offset, self.size - 4)

    def bounding_rows(self, order):
        """Rows at a few samples a period; further ones are added where a check finds a limit broken. None for positions,
        which hardly ever leave their limits."""
        if order == 0:
            return Rows.stacked([])
        times = np.linspace(0.0, self.duration, 2 * (self.harmonics + 1) + 1)
        return self.rows_at(times, order)

    def trajectory(self, coefficients):
        parts = self._functions
        return SinusoidTrajectory(
            self.duration, parts.polynomial @ coefficients, parts.sine @ coefficients, parts.cosine @ coefficients
        )

    def interpolate(self, trajectory: Trajectory):
        """Boundary values exactly, amplitudes by least squares."""
        T = self.duration
        scaled = lambda t, order: trajectory(t * trajectory.duration / T, order) * (trajectory.duration / T) ** order
        ends = [scaled(np.array([t]), order)[0] for t in (0.0, T) for order in range(3)]
        coefficients = np.zeros((self.size, trajectory.nv))
        coefficients[:6] = ends
        if self.harmonics:
            t = np.linspace(0.0, T, 8 * (self.harmonics + 1))
            values = self._functions(t)
            rest = scaled(t, 0) - values[:, :6] @ coefficients[:6]
            coefficients[6:] = np.linalg.lstsq(values[:, 6:], rest, rcond=None)[0]
        return coefficients

    def stretched(self, duration: float) -> SinusoidSpace:
        return SinusoidSpace(duration, self.harmonics, self.nodes)

    def _basis_functions(self) -> SinusoidTrajectory:
        """All basis functions as one trajectory, a "joint" each."""
        H, T = self.harmonics, self.duration
        polynomial, sine, cosine = np.zeros((6, self.size)), np.zeros((H + 1, self.size)), np.zeros((H + 1, self.size))
        polynomial[:2, 0], sine[0, 0] = (1.0, -1.0), 1.0 / (2.0 * np.pi)
        polynomial[1, 3], sine[0, 3] = 1.0, -1.0 / (2.0 * np.pi)
        polynomial[:, [1, 2, 4, 5]] = (_HERMITE * np.array([T, T**2, T, T**2])[:, None]).T
        for h in range(1, H + 1):
            k = h + 1.0
            odd, even = 5 + h, 5 + H + h
            sine[h, odd], sine[0, odd] = 1.0 / k**2, -1.0 / k
            polynomial[0, even] = 1.0 / k**2 - 1.0
            cosine[h, even], cosine[0, even] = -1.0 / k**2, 1.0
        return SinusoidTrajectory(T, polynomial, sine, cosine)
