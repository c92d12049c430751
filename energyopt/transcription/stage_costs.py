"""The cost terms of a problem, summed at the samples of a program.

The objective is Σ_k ω_k φ(v, a, τ), φ = Σ_t w_t φ_t over the terms. With J = ∂τ/∂z and the kernels' p and μ, the gradient of a
sample's share in its state z = (q, v, a) is Jᵀφ_τ + (0, φ_v, φ_a), and the Hessian

    S(φ_τ) + Jᵀ diag(φ_ττ) J + Jᵀ diag(φ_τv) E + Eᵀ diag(φ_τv) J + diag(0, φ_vv, φ_aa) + κ d dᵀ,   E = (0, 1, 0),

where S(u) = ∂²(uᵀτ)/∂z² with u held and d = Jᵀα + Eᵀβ couples the joints (a shared supply).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from energyopt.costs import CostTerm, Samples


@dataclass(frozen=True, eq=False)
class StageCosts:
    """Weighted sums of the terms' integrands; terms of the jerk are left out (see `extras.JerkCost`)."""

    terms: tuple[CostTerm, ...]

    def value(self, state: np.ndarray, torque: np.ndarray, weight: np.ndarray) -> float:
        """Σ_k ω_k φ, from states (N, 3 nv), torques (N, nv) and quadrature weights ω (N,)."""
        return float(sum(term.weight * (weight @ part.value) for term, part in self._parts(state, torque, 0)))

    def first(self, state: np.ndarray, torque: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """ω times the derivatives of φ in τ, v and a, (N, 3 nv)."""
        parts = self._parts(state, torque, 1)
        return _summed(parts, weight, ("tau", "v", "a"), torque.shape)

    def second(self, state: np.ndarray, torque: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """ω times φ_ττ, φ_τv, φ_vv, φ_aa, (N, 4 nv), and ωκ, α, β, (N, 1 + 2 nv), or None."""
        parts = self._parts(state, torque, 2)
        mixed = None
        for term, part in parts:
            if part.bus is not None:
                mixed = np.concatenate([(term.weight * weight * part.bus)[:, None], part.bus_tau, part.bus_v], axis=1)
        return _summed(parts, weight, ("tau_tau", "tau_v", "v_v", "a_a"), torque.shape), mixed

    def _parts(self, state: np.ndarray, torque: np.ndarray, order: int) -> list:
        q, v, a = np.split(state, 3, axis=1)
        samples = Samples(q=q, v=v, a=a, jerk=np.zeros_like(a), tau=torque)
        return [(term, term.integrand(samples, order)) for term in self.terms]


def _summed(parts: list, weight: np.ndarray, names: tuple[str, ...], shape: tuple[int, int]) -> np.ndarray:
    total = np.zeros((shape[0], len(names), shape[1]))
    for term, part in parts:
        for k, name in enumerate(names):
            values = getattr(part, name)
            if values is not None:
                total[:, k] += term.weight * values
    return (weight[:, None, None] * total).reshape(shape[0], -1)
