"""Electrical energy: φ is the power the supply delivers, by the drive models of `energyopt.actuators`, smoothed.

With P = τ q̇, S(x) = tanh(x/w) for the sign and (x)⁺ = x (1 + S(x))/2 for max(x, 0), of each joint

    e = η^(−S(P))               gear: 1/η where the motor drives, η where it is driven, 1 at rest
    u = P e + κ (τ e)²          κ = R/(N k_t)²: mechanical power of the motor and copper loss
    h(u) = ρ u + (1 − ρ)(u)⁺    what is not regenerated is burnt

and φ = Σ h(uᵢ) + P₀ + Σ P_brake, or with one DC bus φ = h(Σ uᵢ) + P₀ + Σ P_brake. Derivatives follow by the chain rule from those
of m(P) = P e and g(P) = e²:

    u_τ  = m′ q̇ + κ (2τ g + τ² g′ q̇)              u_q̇  = m′ τ + κ τ³ g′
    u_ττ = m″ q̇² + κ (2g + 4τ g′ q̇ + τ² g″ q̇²)    u_q̇q̇ = m″ τ² + κ τ⁴ g″
    u_τq̇ = m′ + m″ P + κ τ² (3g′ + g″ P)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from energyopt.actuators import Actuators
from energyopt.costs.cost import CostTerm, Integrand, Samples
from energyopt.costs.power import SmoothTerm
from energyopt.costs.smoothing import smooth_positive, smooth_sign
from energyopt.errors import ProblemError
from energyopt.problem_values import shown
from energyopt.robots.model import RobotModel


class _Drive(NamedTuple):
    """u and its derivatives, as far as they are asked for, each of shape (N, nv)."""

    u: np.ndarray
    tau: np.ndarray | None = None
    v: np.ndarray | None = None
    tau_tau: np.ndarray | None = None
    tau_v: np.ndarray | None = None
    v_v: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class ElectricalEnergy(SmoothTerm):
    """∫ electrical power dt [J].

    Attributes:
        actuators: the drives; None takes the robot's own.
        smoothing: width w over which efficiency and regeneration change with the sign of a power [W].
    """

    name = "electrical_energy"
    unit = "J"
    symbol = "supply power"
    uses = ("tau", "v")

    actuators: Actuators | None = None

    def __post_init__(self):
        super().__post_init__()
        if self.actuators is not None and not isinstance(self.actuators, Actuators):
            raise ProblemError(f"{self.name}: actuators is {shown(self.actuators)}: expected energyopt.Actuators, or None")

    def fitted(self, robot: RobotModel) -> CostTerm:
        drives = robot.actuators if self.actuators is None else self.actuators
        if drives is None:
            remedy = "give them to load_robot(..., actuators=...) or [robot.actuators] of the problem file"
            raise ProblemError(f"{self.name}: {robot.name} has no actuator models: {remedy}")
        if len(drives) != robot.nv:
            joints = ", ".join(robot.joint_names)
            raise ProblemError(f"{self.name}: actuators has {len(drives)} models: expected {robot.nv}, for {joints}")
        return replace(self, actuators=drives)

    def integrand(self, samples: Samples, order: int = 0) -> Integrand:
        drives, width = self._drives(), self.smoothing
        one = _drive(drives, samples.tau, samples.v, width, order)
        at_supply = one.u.sum(axis=1, keepdims=True) if drives.shared_bus else one.u
        share = drives.values("regeneration")[:1] if drives.shared_bus else drives.values("regeneration")
        positive, first, second = smooth_positive(at_supply, width)
        h, h1, h2 = (share * at_supply + (1 - share) * positive, share + (1 - share) * first, (1 - share) * second)
        found = {"value": h.sum(axis=1) + drives.constant_power}
        if order >= 1:
            found |= {"tau": h1 * one.tau, "v": h1 * one.v}
        if order >= 2:
            found |= {"tau_tau": h1 * one.tau_tau, "tau_v": h1 * one.tau_v, "v_v": h1 * one.v_v}
            if drives.shared_bus:
                found |= {"bus": h2[:, 0], "bus_tau": one.tau, "bus_v": one.v}
            else:
                found["tau_tau"] += h2 * one.tau**2
                found["tau_v"] += h2 * one.tau * one.v
                found["v_v"] += h2 * one.v**2
        return Integrand(**found)

    def exact(self, samples: Samples) -> np.ndarray:
        return self._drives().flow(samples.tau, samples.v).supply

    def _drives(self) -> Actuators:
        if self.actuators is None:
            raise ProblemError(f"{self.name}: it has no actuator models yet: give actuators, or fit it to a robot that has them")
        return self.actuators


def _drive(drives: Actuators, tau: np.ndarray, v: np.ndarray, width: float, order: int) -> _Drive:
    """u of every joint with its derivatives in (τ, q̇) up to an order."""
    power, kappa = tau * v, drives.copper
    square = kappa * tau**2
    slope = -np.log(drives.values("efficiency"))
    s, s1, s2 = smooth_sign(power, width)
    e = np.exp(slope * s)
    g = e * e
    u = power * e + square * g
    if order < 1:
        return _Drive(u)
    slope1 = slope * s1
    e1 = e * slope1
    m1, g1 = e + power * e1, 2.0 * e * e1
    both = m1 + square * g1  # what u_τ and u_q̇ have in common: their factors are q̇ and τ
    first = both * v + 2.0 * kappa * tau * g, both * tau
    if order < 2:
        return _Drive(u, *first)
    e2 = e * (slope1 * slope1 + slope * s2)
    m2, g2 = 2.0 * e1 + power * e2, 2.0 * (e1 * e1 + e * e2)
    bend = m2 + square * g2
    return _Drive(
        u,
        *first,
        tau_tau=bend * v**2 + kappa * (2.0 * g + 4.0 * power * g1),
        tau_v=bend * power + m1 + 3.0 * square * g1,
        v_v=bend * tau**2,
    )
