"""Solvers of nonlinear programs; nothing here knows of robots."""

from energyopt.solvers.interrupts import Interrupts
from energyopt.solvers.result import Outcome, SolverOptions, SolverResult
from energyopt.solvers.solving import solve

__all__ = ["Interrupts", "Outcome", "SolverOptions", "SolverResult", "solve"]
