"""Jerk squared: φ = Σ wᵢ (d³qᵢ/dt³)².

Source: N. Hogan, "An organizing principle for a class of voluntary movements", J. Neuroscience 4, 1984.
"""

from __future__ import annotations

from dataclasses import dataclass

from energyopt.costs.cost import SquaredTerm


@dataclass(frozen=True, eq=False)
class JerkSquared(SquaredTerm):
    """∫ Σ wᵢ (d³qᵢ/dt³)² dt; its minimiser between two rests is the quintic 10s³ − 15s⁴ + 6s⁵."""

    name = "jerk_squared"
    unit = "rad²/s⁵"
    symbol = "Σ(d³q/dt³)²"
    uses = ("jerk",)
