"""Velocity squared: φ = Σ wᵢ q̇ᵢ², which spreads a motion over its duration and is what viscous friction burns."""

from __future__ import annotations

from dataclasses import dataclass

from energyopt.costs.cost import SquaredTerm


@dataclass(frozen=True, eq=False)
class VelocitySquared(SquaredTerm):
    """∫ Σ wᵢ q̇ᵢ² dt; ``weights`` w: λ of J, where it stands beside `TorqueSquared` [N²·m²·s²/rad²]."""

    name = "velocity_squared"
    unit = "rad²/s"
    symbol = "Σq̇²"
    uses = ("v",)
