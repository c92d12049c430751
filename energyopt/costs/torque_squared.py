"""Torque squared: φ = Σ wᵢ τᵢ², proportional to the copper losses of motors behind ideal gears (P = R (τ/(k_t N))²)."""

from __future__ import annotations

from dataclasses import dataclass

from energyopt.costs.cost import SquaredTerm


@dataclass(frozen=True, eq=False)
class TorqueSquared(SquaredTerm):
    """∫ Σ wᵢ τᵢ² dt; ``weights`` w, dimensionless."""

    name = "torque_squared"
    unit = "N²·m²·s"
    symbol = "Στ²"
    uses = ("tau",)
