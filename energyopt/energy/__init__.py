"""Where the joules of a motion go: by joint and by cause, as far as the supply where the drives are known."""

from energyopt.energy.account import EnergyAccount, PowerRange, energy_account
from energyopt.energy.drawn import electrical_energy

__all__ = ["EnergyAccount", "PowerRange", "electrical_energy", "energy_account"]
