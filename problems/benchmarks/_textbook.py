"""The same problem written the way CasADi's examples write it, for comparison.

    min  Σ_k w_k Σ_i (W_i τ_ik² + λ_i q̇_ik²)      C = offset + X S,   Q = C B₀,   V = C B₁,   A = C B₂,   T = f.map(N)(Q, V, A)
     x
    s.t. bounds on control points of the motion and its derivatives,   |τ_ik| ≤ τ_max,i at every node k

X are the unknown control points, B₀ B₁ B₂ the constant basis matrices of the nodes, f the inverse dynamics as an SX function,
mapped over the nodes inside an MX graph that CasADi differentiates by itself. Spline, knots, nodes, quadrature, bounds, initial
guess, solver and tolerance are those of energyopt; only the way to the derivatives differs, and that torque limits are
rows at every node from the start (but for the variant that is told where energyopt needed them).
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import casadi as ca
import numpy as np

from energyopt import Problem
from energyopt.dynamics.kernels import kernels_of
from energyopt.parameterizations.bspline import SplineSpace
from energyopt.search import Search
from energyopt.search_state import SearchOptions
from energyopt.seeds import goals, guesses
from energyopt.solvers import SolverOptions
from energyopt.solvers.linear import MUMPS
from energyopt.transcription import NonlinearProgram, transcribe
from energyopt.verification import cost

AS_IT_COMES = {"print_level": 0, "sb": "yes", "tol": SolverOptions.tolerance, "max_iter": 1000}
TUNED = MUMPS | {"mu_init": SolverOptions.barrier, "min_refinement_steps": 0, "bound_relax_factor": 0.0}
"""IPOPT and MUMPS as energyopt sets them where it uses MUMPS."""


@dataclass(frozen=True)
class Variant:
    """One way to write the textbook program.

    Attributes:
        says: in words.
        settings: further options of IPOPT. options: further options of `nlpsol`.
        every_row: torque limits are rows at every node; else only where energyopt's search needed them, which it is told.
    """

    says: str
    settings: dict | None = None
    options: dict | None = None
    every_row: bool = True


_LEAN = {"no_nlp_grad": True, "calc_lam_p": False, "record_time": False}
_MACHINE_CODE = {"jit": True, "compiler": "shell", "jit_options": {"flags": ["-O1", "-march=native"]}}
VARIANTS = {
    "map": Variant("map + CasADi's AD, IPOPT as it comes"),
    "map_tuned": Variant("map + CasADi's AD, IPOPT and MUMPS set as energyopt sets them", settings=TUNED, options=_LEAN),
    "map_told": Variant("the same, torque rows only where energyopt found them needed (it is told where)",
                        settings=TUNED, options=_LEAN, every_row=False),
    "expanded": Variant("all nodes expanded to one scalar graph", settings=TUNED,
                        options=_LEAN | {"expand": True}),
    "map_jit": Variant("map + CasADi's AD, the whole program compiled to C", settings=TUNED,
                       options=_LEAN | _MACHINE_CODE),
}  # fmt: skip


@dataclass(frozen=True)
class Solved:
    """What a textbook solve took and gave: seconds by clock, iterations, J recomputed by numeric Pinocchio, success."""

    wall: float
    cpu: float
    iterations: int
    objective: float
    success: bool


class Textbook:
    """A problem in one variant, ready to be solved repeatedly; ``build_s`` is what CasADi took to differentiate it.

    ``motion`` is what the last solve found.
    """

    def __init__(self, problem: Problem, space: SplineSpace, variant: Variant):
        kernels, guess = kernels_of(problem.robot.dynamics), next(guesses(problem, goals(problem, 0), 0))
        search = Search(problem, space, kernels, guess, SearchOptions())
        if not variant.every_row:
            search.advance()
        self._problem = problem
        self._program = program = transcribe(problem, space, kernels, search.cuts)
        began = time.perf_counter()
        x, f, tau = _graph(problem, program)
        row, bound = _torque_rows(problem, program, tau, variant.every_row)
        options = {"ipopt": AS_IT_COMES | (variant.settings or {}), "print_time": False, **(variant.options or {})}
        linear = program.layout.linear
        matrix = np.zeros((len(linear.lower), program.size))
        matrix[linear.row, linear.column] = linear.value
        g = ca.vertcat(_sparse(matrix) @ x + ca.DM(linear.offset), row)
        self._solver = ca.nlpsol("textbook", "ipopt", {"x": x, "f": f, "g": g}, options)
        self.build_s = time.perf_counter() - began
        self._arguments = {
            "x0": program.guess(guess), "lbx": program.lower, "ubx": program.upper,
            "lbg": np.concatenate([linear.lower, -bound]), "ubg": np.concatenate([linear.upper, bound]),
        }  # fmt: skip

    def solve(self) -> Solved:
        wall, cpu = time.perf_counter(), time.process_time()
        result = self._solver(**self._arguments)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        stats = self._solver.stats()
        self.motion = self._program.trajectory(np.array(result["x"]).ravel())
        return Solved(wall, cpu, stats["iter_count"], sum(cost(self._problem, self.motion).values()), bool(stats["success"]))


def _graph(problem: Problem, program: NonlinearProgram) -> tuple[ca.MX, ca.MX, ca.MX]:
    """Unknowns, objective, and torques at all nodes (nv × N, those of further torque rows last)."""
    layout, unknowns, nv = program.layout, program.unknowns, problem.robot.nv
    x = ca.MX.sym("x", program.size)
    size, nodes = len(unknowns.block), np.arange(len(layout.weight))
    selection, basis = np.zeros((unknowns.count, size)), np.zeros((3, size, len(nodes)))
    known = np.flatnonzero(unknowns.block >= 0)
    selection[unknowns.block[known], known] = 1.0
    for order in range(3):
        basis[order, layout.column.T, nodes] = layout.basis[:, order].T
    coefficients = ca.DM(unknowns.offset.T) + ca.reshape(x, nv, unknowns.count) @ _sparse(selection)
    q, v, a = (coefficients @ _sparse(part) for part in basis)
    tau = problem.robot.inverse_dynamics.map(len(nodes))(q, v, a)
    squares = ca.DM(problem.torque_weights).T @ tau**2 + ca.DM(problem.velocity_weight).T @ v**2
    return x, squares @ ca.DM(layout.weight), tau


def _torque_rows(problem: Problem, program: NonlinearProgram, tau: ca.MX, every_row: bool) -> tuple[ca.MX, np.ndarray]:
    """The torques that are rows, and their bounds."""
    if every_row:
        return ca.vec(tau), np.tile(problem.limits.torque, tau.shape[1])
    rows = program.layout.torque
    return ca.vec(tau)[(rows.sample * problem.robot.nv + rows.joint).tolist()], rows.upper


def _sparse(matrix: np.ndarray) -> ca.DM:
    return ca.sparsify(ca.DM(matrix))
