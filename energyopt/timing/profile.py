"""An arm on a path: what its joints do and need as functions of the place s and of v = ṡ, a = s̈, j = s⃛, with exact derivatives.

Along p(s) the dynamics of an arm are those of one mass (J. E. Bobrow, S. Dubowsky, J. S. Gibson, IJRR 4, 1985):

    τ = m(s) a + c(s) v² + d p'v + f tanh(p'v/v_s) + g(s),      m = M p',   c = M p'' + C(p, p') p',   g gravity,
    q̇ = p'v,      q̈ = p''v² + p'a,      q⃛ = p'''v³ + 3 p''v a + p'j.

m, c and g are evaluated once, by numeric Pinocchio at Chebyshev points of many short pieces, and are then polynomials of degree
`DEGREE` on each, whose error is far below that of any cost or limit; their derivatives are exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import PPoly

from energyopt.parameterizations.trajectory import Trajectory
from energyopt.robots.model import Limits, RobotModel

DEGREE = 7
PIECES = 48
"""Polynomial pieces of a path, at least."""
KINDS = ("velocity", "acceleration", "jerk", "torque")
S, V, A, J = range(4)
"""Places of s, v, a and j among derivatives."""


@dataclass(frozen=True, eq=False)
class Quantity:
    """Values of every joint at K states, with their derivatives by (s, v, a, j).

    Attributes:
        value: (K, nv). slope: (K, nv, 4). curvature: (K, nv, 4, 4), symmetric.
    """

    value: np.ndarray
    slope: np.ndarray
    curvature: np.ndarray


@dataclass(frozen=True, eq=False)
class PathProfile:
    """A robot on a path.

    Attributes:
        path: p(s). robot: the arm.
    """

    path: Trajectory
    robot: RobotModel

    def at(self, z: np.ndarray, kinds: tuple[str, ...]) -> dict[str, Quantity]:
        """Quantities at the states ``z`` (K, 4), columns s, v, a, j.

        Args:
            z: places and rates of a law; places outside the path count as its ends.
            kinds: some of `KINDS`.
        """
        s = np.clip(z[:, S], 0.0, self.path.duration)
        p = [None, *(self._rate(s, k) for k in range(1, 6 if "jerk" in kinds else 5))]
        rates = [None, *(z[:, k, None] for k in (V, A, J))]
        make = {"velocity": _velocity, "acceleration": _acceleration, "jerk": _jerk}
        return {kind: self._torque(s, p, rates) if kind == "torque" else make[kind](p, rates) for kind in kinds}

    def _rate(self, s: np.ndarray, order: int) -> np.ndarray:
        """A derivative of the path; beyond its highest order it is a polynomial's, zero."""
        return self.path._evaluate(s, order) if order <= self.path.highest_order else np.zeros((len(s), self.path.nv))

    def _torque(self, s: np.ndarray, p: list, rates: list) -> Quantity:
        _, v, a, _ = rates
        dynamics, nv = self.robot.dynamics, self.path.nv
        m, c, g, m1, c1, g1, m2, c2, g2 = self._table(s).reshape(len(s), 9, nv).swapaxes(0, 1)
        w = p[1] * v
        sign = np.tanh(w / dynamics.coulomb_velocity)
        f = dynamics.coulomb_friction
        rub1 = dynamics.viscous_friction + f * (1 - sign**2) / dynamics.coulomb_velocity
        rub2 = -2 * f * sign * (1 - sign**2) / dynamics.coulomb_velocity**2
        slope, curvature = np.zeros((len(s), nv, 4)), np.zeros((len(s), nv, 4, 4))
        slope[..., S] = m1 * a + c1 * v**2 + rub1 * p[2] * v + g1
        slope[..., V] = 2 * c * v + rub1 * p[1]
        slope[..., A] = m
        curvature[..., S, S] = m2 * a + c2 * v**2 + rub2 * (p[2] * v) ** 2 + rub1 * p[3] * v + g2
        curvature[..., S, V] = curvature[..., V, S] = 2 * c1 * v + rub2 * p[2] * v * p[1] + rub1 * p[2]
        curvature[..., S, A] = curvature[..., A, S] = m1
        curvature[..., V, V] = 2 * c + rub2 * p[1] ** 2
        return Quantity(m * a + c * v**2 + g + dynamics.viscous_friction * w + f * sign, slope, curvature)

    @cached_property
    def _table(self) -> PPoly:
        """m, c and g side by side, their first, and their second derivatives, (K, 9 nv)."""
        breaks = self.path.sample_times(max(1, -(-PIECES // (len(self.path.breaks) - 1))))
        x = 0.5 - 0.5 * np.cos(np.pi * (np.arange(DEGREE + 1) + 0.5) / (DEGREE + 1))
        places = (breaks[:-1, None] + np.diff(breaks)[:, None] * x).ravel()
        values = np.concatenate(self._terms(places), axis=1).reshape(len(breaks) - 1, DEGREE + 1, -1)
        # Ascending powers of the share x of a piece, then of s itself.
        powers = np.linalg.solve(np.vander(x, increasing=True), values)
        powers = powers / np.diff(breaks)[:, None, None] ** np.arange(DEGREE + 1)[:, None]
        slopes = np.pad(powers[:, 1:] * np.arange(1, DEGREE + 1)[:, None], ((0, 0), (0, 1), (0, 0)))
        bends = np.pad(slopes[:, 1:] * np.arange(1, DEGREE + 1)[:, None], ((0, 0), (0, 1), (0, 0)))
        return PPoly(np.concatenate([powers, slopes, bends], axis=2)[:, ::-1].transpose(1, 0, 2), breaks)

    def _terms(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        q, first, second = (self.path(s, order) for order in range(3))
        robot, rest = self.robot, np.zeros_like(q)
        held = robot.torque(q, rest, rest)
        mass = robot.torque(q, rest, first) - held
        return mass, robot.torque(q, first, second) - robot.dynamics.friction(first) - held, held


def bounds_of(limits: Limits) -> dict[str, np.ndarray]:
    """The limits by kind, (nv,), those that bound any joint."""
    return {kind: getattr(limits, kind) for kind in KINDS if np.any(np.isfinite(getattr(limits, kind)))}


def _empty(p: list) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((*p[1].shape, 4)), np.zeros((*p[1].shape, 4, 4))


def _velocity(p: list, rates: list) -> Quantity:
    v = rates[V]
    slope, curvature = _empty(p)
    slope[..., S], slope[..., V] = p[2] * v, p[1]
    curvature[..., S, S] = p[3] * v
    curvature[..., S, V] = curvature[..., V, S] = p[2]
    return Quantity(p[1] * v, slope, curvature)


def _acceleration(p: list, rates: list) -> Quantity:
    v, a = rates[V], rates[A]
    slope, curvature = _empty(p)
    slope[..., S], slope[..., V], slope[..., A] = p[3] * v**2 + p[2] * a, 2 * p[2] * v, p[1]
    curvature[..., S, S] = p[4] * v**2 + p[3] * a
    curvature[..., S, V] = curvature[..., V, S] = 2 * p[3] * v
    curvature[..., S, A] = curvature[..., A, S] = p[2]
    curvature[..., V, V] = 2 * p[2]
    return Quantity(p[2] * v**2 + p[1] * a, slope, curvature)


def _jerk(p: list, rates: list) -> Quantity:
    v, a, j = rates[V], rates[A], rates[J]
    slope, curvature = _empty(p)
    slope[..., S] = p[4] * v**3 + 3 * p[3] * v * a + p[2] * j
    slope[..., V], slope[..., A], slope[..., J] = 3 * p[3] * v**2 + 3 * p[2] * a, 3 * p[2] * v, p[1]
    curvature[..., S, S] = p[5] * v**3 + 3 * p[4] * v * a + p[3] * j
    curvature[..., S, V] = curvature[..., V, S] = 3 * p[4] * v**2 + 3 * p[3] * a
    curvature[..., S, A] = curvature[..., A, S] = 3 * p[3] * v
    curvature[..., S, J] = curvature[..., J, S] = p[2]
    curvature[..., V, V] = 6 * p[3] * v
    curvature[..., V, A] = curvature[..., A, V] = 3 * p[2]
    return Quantity(p[3] * v**3 + 3 * p[2] * v * a + p[1] * j, slope, curvature)
