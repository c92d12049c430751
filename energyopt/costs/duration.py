"""Duration: φ = 1, so that its weight is the price of a second.

Where the duration is free, the sum of an energy and this says how much energy a second may cost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from energyopt.costs.cost import CostTerm, Integrand, Samples


@dataclass(frozen=True, eq=False)
class Duration(CostTerm):
    """∫ 1 dt = T [s]."""

    name = "duration"
    unit = "s"
    symbol = "1"
    uses = ()

    def integrand(self, samples: Samples, order: int = 0) -> Integrand:
        return Integrand(value=np.ones(len(samples.v)))
