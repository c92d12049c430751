"""Mechanical power: φ = Σ |τᵢ q̇ᵢ|: every joint pays for driving and for braking, none helps another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from energyopt.costs.cost import Samples
from energyopt.costs.power import PowerTerm
from energyopt.costs.smoothing import Derivatives, smooth_abs


@dataclass(frozen=True, eq=False)
class MechanicalPower(PowerTerm):
    """∫ Σ |τᵢ q̇ᵢ| dt [J]: the metric ``mechanical_abs_J``, smoothed over ``smoothing`` [W]."""

    name = "mechanical_power"
    symbol = "Σ|τq̇|"

    def smooth(self, power: np.ndarray) -> Derivatives:
        return smooth_abs(power, self.smoothing)

    def exact(self, samples: Samples) -> np.ndarray:
        return np.abs(samples.tau * samples.v).sum(axis=1)
