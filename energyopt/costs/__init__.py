"""Cost terms, one a file; `COSTS` lists them by name, and what stands there is tested and can be written in problem files."""

from energyopt.costs.acceleration_squared import AccelerationSquared
from energyopt.costs.cost import CostTerm, Integrand, Samples, checked_costs
from energyopt.costs.jerk_squared import JerkSquared
from energyopt.costs.torque_squared import TorqueSquared
from energyopt.costs.velocity_squared import VelocitySquared

COSTS: dict[str, type[CostTerm]] = {
    term.name: term for term in (TorqueSquared, VelocitySquared, AccelerationSquared, JerkSquared)
}
"""Every cost term by its name."""

__all__ = [
    "COSTS",
    "AccelerationSquared",
    "CostTerm",
    "Integrand",
    "JerkSquared",
    "Samples",
    "TorqueSquared",
    "VelocitySquared",
    "checked_costs",
]
