"""Shares of the cost that samples of (τ, q̇, q̈) do not know: of the jerk, and of the duration."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from energyopt.costs import CostTerm, Samples
from energyopt.parameterizations.space import MotionSpace, Unknowns
from energyopt.transcription.extras import Priceless, ThetaTerms


class JerkCost(Priceless):
    """The share of a cost term in the third derivative of the motion: Σ_k ω_k φ(d³q/dt³(t_k)).

    In the unknowns the jerk is linear; on a motion e^θ times as long it is e^{−3θ} of what the space says.
    """

    variables = 0

    def __init__(self, term: CostTerm, space: MotionSpace, unknowns: Unknowns, parts: np.ndarray):
        """``parts``: offsets by what they come from, (3, size, nv); see `stretch.offset_parts`."""
        times, self._weight = space.quadrature()
        columns, values = space.basis(times, 4)
        values, blocks = values[:, 3], unknowns.block[columns]
        sample, place = np.nonzero(blocks >= 0)
        share = csr_array((values[sample, place], (sample, blocks[sample, place])), shape=(len(times), unknowns.count))
        self._term, self._share, self._nv, self._theta = term, share, parts.shape[2], 0.0
        self._parts = np.einsum("kl,pkli->pki", values, parts[:, columns])
        there = csr_array(abs(share)).T @ abs(share)
        self._first, self._second = np.nonzero(np.triu(there.toarray()))
        dense = share.toarray().T
        self._products = csr_array(dense[self._first] * dense[self._second])
        self.lower = self.upper = self.row_lower = self.row_upper = np.zeros(0)

    def guess(self, coefficients):
        return np.zeros(0)

    def jacobian_pattern(self):
        return np.zeros(0, int), np.zeros(0, int)

    def hessian_pattern(self):
        joints = np.arange(self._nv)
        rows, columns = ((blocks[:, None] * self._nv + joints).ravel() for blocks in (self._first, self._second))
        return rows, columns

    def stretch(self, theta):
        self._theta = theta

    def evaluate(self, x):
        free = self._share @ x[: self._share.shape[1] * self._nv].reshape(-1, self._nv)
        scale = [np.exp((k - 3) * self._theta) for k in range(3)]
        self._own = scale[0] * free
        self._ends = [s * part for s, part in zip(scale, self._parts, strict=True)]
        nothing = np.zeros_like(free)
        jerk = self._own + sum(self._ends)
        self._found = self._term.integrand(Samples(nothing, nothing, nothing, jerk, nothing), 2)
        self._omega = self._term.weight * self._weight * np.exp(self._theta)
        return np.zeros(0), np.zeros(0)

    def objective(self):
        return float(self._omega @ self._found.value)

    def gradient(self):
        return self._gathered(self._found.jerk)

    def curvature(self, x, sigma, multipliers):
        scale = sigma * np.exp(-6.0 * self._theta)
        return (self._products @ (scale * self._omega[:, None] * self._found.jerk_jerk)).ravel()

    def in_theta(self, x, sigma, multipliers):
        speed = -3.0 * self._own + sum((k - 3) * end for k, end in enumerate(self._ends))
        change = 9.0 * self._own + sum((k - 3) ** 2 * end for k, end in enumerate(self._ends))
        first, second = self._found.jerk, self._found.jerk_jerk
        slope = self.objective() + float(self._omega @ (first * speed).sum(axis=1))
        bent = float(self._omega @ (second * speed**2 + first * change + 2.0 * first * speed).sum(axis=1)) + self.objective()
        return ThetaTerms(slope, 0.0, sigma * self._gathered(second * speed - 2.0 * first), sigma * bent)

    def _gathered(self, values: np.ndarray) -> np.ndarray:
        return (self._share.T @ (np.exp(-3.0 * self._theta) * self._omega[:, None] * values)).ravel()


class TimePrice(Priceless):
    """The share of the cost that only grows with the duration: price · T."""

    variables = 0

    def __init__(self, price: float, space: MotionSpace):
        self._planned = self._value = price * space.duration
        self.lower = self.upper = self.row_lower = self.row_upper = np.zeros(0)

    def guess(self, coefficients):
        return np.zeros(0)

    def jacobian_pattern(self):
        return np.zeros(0, int), np.zeros(0, int)

    hessian_pattern = jacobian_pattern

    def stretch(self, theta):
        self._value = self._planned * np.exp(theta)

    def in_theta(self, x, sigma, multipliers):
        return ThetaTerms(self._value, 0.0, np.zeros(0), sigma * self._value)

    def evaluate(self, x):
        return np.zeros(0), np.zeros(0)

    def objective(self):
        return self._value

    def curvature(self, x, sigma, multipliers):
        return np.zeros(0)
