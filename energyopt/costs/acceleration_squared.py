"""Acceleration squared: φ = Σ wᵢ q̈ᵢ², which makes a motion gentle on what the robot carries."""

from __future__ import annotations

from dataclasses import dataclass

from energyopt.costs.cost import SquaredTerm


@dataclass(frozen=True, eq=False)
class AccelerationSquared(SquaredTerm):
    """∫ Σ wᵢ q̈ᵢ² dt; its minimiser between two rests is the cubic 3s² − 2s³."""

    name = "acceleration_squared"
    unit = "rad²/s³"
    symbol = "Σq̈²"
    uses = ("a",)
