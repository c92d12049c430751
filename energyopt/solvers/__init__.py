"""Solvers of nonlinear programs; nothing here knows of robots."""

from energyopt.solvers.ipopt import IpoptOptions, Outcome, SolverResult, solve

__all__ = ["IpoptOptions", "Outcome", "SolverResult", "solve"]
