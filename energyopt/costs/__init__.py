"""Cost terms, one a file; `COSTS` lists them by name, and what stands there is tested and can be written in problem files."""

from energyopt.costs.acceleration_squared import AccelerationSquared
from energyopt.costs.cost import CostTerm, Integrand, Samples, checked_costs, formula
from energyopt.costs.duration import Duration
from energyopt.costs.electrical_energy import ElectricalEnergy
from energyopt.costs.jerk_squared import JerkSquared
from energyopt.costs.measure import integral, samples_of, smoothing_error, smoothing_notes
from energyopt.costs.mechanical_power import MechanicalPower
from energyopt.costs.positive_power import PositivePower
from energyopt.costs.torque_squared import TorqueSquared
from energyopt.costs.velocity_squared import VelocitySquared

COSTS: dict[str, type[CostTerm]] = {
    term.name: term
    for term in (
        TorqueSquared,
        VelocitySquared,
        AccelerationSquared,
        JerkSquared,
        MechanicalPower,
        PositivePower,
        ElectricalEnergy,
        Duration,
    )
}
"""Every cost term by its name."""

__all__ = [
    "COSTS",
    "AccelerationSquared",
    "CostTerm",
    "Duration",
    "ElectricalEnergy",
    "Integrand",
    "JerkSquared",
    "MechanicalPower",
    "PositivePower",
    "Samples",
    "TorqueSquared",
    "VelocitySquared",
    "checked_costs",
    "formula",
    "integral",
    "samples_of",
    "smoothing_error",
    "smoothing_notes",
]
