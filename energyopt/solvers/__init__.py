"""Solvers of nonlinear programs; nothing here knows of robots."""

from energyopt.solvers.interrupts import Interrupts
from energyopt.solvers.ipopt import IpoptOptions, Outcome, SolverResult, solve

__all__ = ["Interrupts", "IpoptOptions", "Outcome", "SolverResult", "solve"]
