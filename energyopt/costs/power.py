"""Terms that are a smooth function of each joint's mechanical power: φ = Σ h(Pᵢ), Pᵢ = τᵢ q̇ᵢ.

With h′, h″ at P: ∂φ/∂τ = h′ q̇, ∂φ/∂q̇ = h′ τ, ∂²φ/∂τ² = h″ q̇², ∂²φ/∂τ∂q̇ = h′ + h″ P, ∂²φ/∂q̇² = h″ τ².
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field

import numpy as np

from energyopt import problem_values as values
from energyopt.costs.cost import CostTerm, Integrand, Samples
from energyopt.costs.smoothing import DEFAULT_WIDTH, Derivatives

NARROWEST = 1e-6
"""[W]: narrower, h″ loses its meaning in double precision."""


@dataclass(frozen=True, eq=False)
class SmoothTerm(CostTerm):
    """A term with a kink.

    Attributes:
        smoothing: width w over which its kinks are smoothed [W].
    """

    smoothing: float = field(default=DEFAULT_WIDTH, kw_only=True)

    def __post_init__(self):
        super().__post_init__()
        inside = lambda w: NARROWEST <= w <= 1e6
        width = values.real(f"{self.name}: smoothing", self.smoothing, inside, f"a width [W], {NARROWEST:g} to 1e6")
        object.__setattr__(self, "smoothing", width)


@dataclass(frozen=True, eq=False)
class PowerTerm(SmoothTerm):
    """∫ Σ h(τᵢ q̇ᵢ) dt."""

    unit = "J"
    uses = ("tau", "v")

    @abstractmethod
    def smooth(self, power: np.ndarray) -> Derivatives:
        """h, h′, h″ [W, 1, 1/W] at the powers [W], each of the shape of ``power``."""

    def integrand(self, samples: Samples, order: int = 0) -> Integrand:
        tau, v = samples.tau, samples.v
        power = tau * v
        h, first, second = self.smooth(power)
        found = {"value": h.sum(axis=1)}
        if order >= 1:
            found |= {"tau": first * v, "v": first * tau}
        if order >= 2:
            found |= {"tau_tau": second * v**2, "tau_v": first + second * power, "v_v": second * tau**2}
        return Integrand(**found)
