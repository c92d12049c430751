"""Rigid-body dynamics of a fixed-base arm: symbolic (CasADi), numeric (Pinocchio), and compiled kernels."""

from energyopt.dynamics.body import Dynamics
from energyopt.dynamics.symbolic import backend

__all__ = ["Dynamics", "backend"]
