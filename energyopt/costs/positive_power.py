"""Positive power: φ = Σ max(τᵢ q̇ᵢ, 0): driving costs, braking is free and gives nothing back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from energyopt.costs.cost import Samples
from energyopt.costs.power import PowerTerm
from energyopt.costs.smoothing import Derivatives, smooth_positive


@dataclass(frozen=True, eq=False)
class PositivePower(PowerTerm):
    """∫ Σ max(τᵢ q̇ᵢ, 0) dt [J]: the metric ``mechanical_positive_J``, smoothed over ``smoothing`` [W]."""

    name = "positive_power"
    symbol = "Σmax(τq̇, 0)"

    def smooth(self, power: np.ndarray) -> Derivatives:
        return smooth_positive(power, self.smoothing)

    def exact(self, samples: Samples) -> np.ndarray:
        return np.maximum(samples.tau * samples.v, 0.0).sum(axis=1)
