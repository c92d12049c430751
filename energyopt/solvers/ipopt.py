"""IPOPT through CasADi, fed with a program's own objective, gradient, Jacobian and exact Hessian.

A. Wächter, L. T. Biegler, "On the implementation of an interior-point filter line-search algorithm for large-scale
nonlinear programming", Mathematical Programming 106 (2006).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

import casadi as ca
import numpy as np


class Outcome(str, Enum):
    """How the solver ended."""

    CONVERGED = "converged"
    ACCEPTABLE = "converged to a looser tolerance"
    INFEASIBLE = "the constraints contradict each other near here"
    ITERATION_LIMIT = "the iteration limit was reached"
    TIME_LIMIT = "the time limit passed"
    INTERRUPTED = "interrupted"
    FAILED = "the solver could not go on"


_OUTCOMES = {
    "Solve_Succeeded": Outcome.CONVERGED,
    "Solved_To_Acceptable_Level": Outcome.ACCEPTABLE,
    "Feasible_Point_Found": Outcome.ACCEPTABLE,
    "Search_Direction_Becomes_Too_Small": Outcome.ACCEPTABLE,
    "Infeasible_Problem_Detected": Outcome.INFEASIBLE,
    "Restoration_Failed": Outcome.INFEASIBLE,
    "Not_Enough_Degrees_Of_Freedom": Outcome.INFEASIBLE,
    "Maximum_Iterations_Exceeded": Outcome.ITERATION_LIMIT,
    "Maximum_CpuTime_Exceeded": Outcome.TIME_LIMIT,
    "Maximum_WallTime_Exceeded": Outcome.TIME_LIMIT,
    "User_Requested_Stop": Outcome.INTERRUPTED,
}


@dataclass(frozen=True)
class IpoptOptions:
    """Settings of one solve.

    Attributes:
        tolerance: scaled optimality error at which the solver stops.
        iterations: at most this many.
        barrier: initial barrier parameter; small values suit good guesses.
        time_limit: seconds of wall time; None has no limit.
    """

    tolerance: float = 1e-6
    iterations: int = 500
    barrier: float = 1.0
    time_limit: float | None = None


@dataclass(frozen=True, eq=False)
class SolverResult:
    """What the solver found.

    Attributes:
        x: the point, (n,); multipliers: of the rows, (m,).
        outcome: how it ended; reason: IPOPT's own word.
        objective, iterations: at the end.
        evaluations: calls by function.
    """

    x: np.ndarray
    multipliers: np.ndarray
    outcome: Outcome
    reason: str
    objective: float
    iterations: int
    evaluations: dict[str, int] = field(default_factory=dict)


Progress = Callable[[int, float, float], None]
"""Called with (iteration, objective, worst violation of bounds and rows)."""


def solve(
    program,
    x0: np.ndarray,
    options: IpoptOptions = IpoptOptions(),
    progress: Progress | None = None,
    stop: Callable[[], bool] | None = None,
) -> SolverResult:
    """Minimise a program from ``x0``; ``stop`` is asked after every iteration and ends the solve with the iterate kept."""
    functions = _Functions(program)
    monitor = _Monitor(program, progress, options.time_limit, stop)
    solver = ca.nlpsol("energyopt", "ipopt", functions.problem, _casadi_options(program, functions, monitor, options))
    result = solver(x0=x0, lbx=program.lower, ubx=program.upper, lbg=program.row_lower, ubg=program.row_upper)
    stats = solver.stats()
    reason = stats["return_status"]
    outcome = _OUTCOMES.get(reason, Outcome.FAILED)
    if outcome is Outcome.INTERRUPTED and monitor.out_of_time:
        outcome = Outcome.TIME_LIMIT
    if monitor.interrupted:
        outcome = Outcome.INTERRUPTED
    x = np.array(result["x"]).ravel()
    if not np.all(np.isfinite(x)):
        x, outcome = np.array(x0, float), Outcome.FAILED
    return SolverResult(
        x, np.array(result["lam_g"]).ravel(), outcome, reason, float(result["f"]), stats["iter_count"], dict(functions.calls)
    )


def _casadi_options(program, functions: _Functions, monitor: _Monitor, options: IpoptOptions) -> dict:
    ipopt = {
        "print_level": 0,
        "sb": "yes",
        "tol": options.tolerance,
        "constr_viol_tol": 1e-5,
        "acceptable_tol": 1e2 * options.tolerance,
        "max_iter": options.iterations,
        "mu_init": options.barrier,
        "mumps_pivot_order": 0,
        "mumps_scaling": 0,
        "mumps_permuting_scaling": 0,
        "min_refinement_steps": 0,
        "mumps_mem_percent": 50,
        "bound_relax_factor": 0.0,
        "honor_original_bounds": "yes",
    }
    if program.linear_only:
        ipopt |= {"jac_c_constant": "yes", "jac_d_constant": "yes"}
    if options.time_limit is not None:
        ipopt["max_wall_time"] = max(options.time_limit, 1e-3)
    return {
        "grad_f": functions.gradient,
        "jac_g": functions.jacobian,
        "hess_lag": functions.hessian,
        "iteration_callback": monitor,
        "no_nlp_grad": True,
        "calc_lam_p": False,
        "calc_lam_x": False,
        "calc_f": False,
        "calc_g": False,
        "print_time": False,
        "error_on_fail": False,
        "record_time": False,
        "ipopt": ipopt,
    }


class _Call(ca.Callback):
    """A CasADi function whose value is computed by ``evaluate(inputs, outputs)`` on NumPy views of CasADi's own buffers."""

    def __init__(self, name: str, inputs: dict, outputs: dict, evaluate: Callable):
        ca.Callback.__init__(self)
        self._inputs, self._outputs, self._evaluate = list(inputs.items()), list(outputs.items()), evaluate
        self.construct(name, {})

    def get_n_in(self):
        return len(self._inputs)

    def get_n_out(self):
        return len(self._outputs)

    def get_name_in(self, i):
        return self._inputs[i][0]

    def get_name_out(self, i):
        return self._outputs[i][0]

    def get_sparsity_in(self, i):
        return self._inputs[i][1]

    def get_sparsity_out(self, i):
        return self._outputs[i][1]

    def has_eval_buffer(self):
        return True

    def eval_buffer(self, arguments, results):
        self._evaluate(arguments, results)
        return 0


class _Functions:
    """The five functions of a program as CasADi sees them. The motion is evaluated once for each new x."""

    def __init__(self, program):
        self._evaluator = program.evaluator
        self._x = np.full(program.size, np.nan)
        self.calls = dict.fromkeys(("state", "gradient", "jacobian", "hessian"), 0)
        dense, n, m = ca.Sparsity.dense, program.size, program.rows
        x, f, g = {"x": dense(n), "p": ca.Sparsity(0, 0)}, {"f": dense(1)}, {"g": dense(m)}
        jacobian = _sparsity(m, n, program.jacobian_pattern)
        hessian = _sparsity(n, n, program.hessian_pattern)
        weights = {"lam_f": dense(1), "lam_g": dense(m)}
        self.problem = _Call("program", x, f | g, self._problem)
        self.gradient = _Call("slope", x, f | {"grad_f_x": dense(n)}, self._gradient)
        self.jacobian = _Call("row_jacobian", x, g | {"jac_g_x": jacobian}, self._jacobian)
        self.hessian = _Call("curvature", x | weights, {"triu_hess_gamma_x_x": hessian}, self._hessian)

    def _move(self, buffer) -> np.ndarray:
        x = np.frombuffer(buffer)
        if not np.array_equal(x, self._x):
            self._x[:] = x
            self._evaluator.move(self._x)
            self.calls["state"] += 1
        return self._x

    def _problem(self, arguments, results):
        x = self._move(arguments[0])
        if results[0] is not None:
            np.frombuffer(results[0])[0] = self._evaluator.objective()
        if results[1] is not None:
            self._evaluator.constraints(x, np.frombuffer(results[1]))

    def _gradient(self, arguments, results):
        self._move(arguments[0])
        self.calls["gradient"] += 1
        if results[0] is not None:
            np.frombuffer(results[0])[0] = self._evaluator.objective()
        if results[1] is not None:
            self._evaluator.gradient(np.frombuffer(results[1]))

    def _jacobian(self, arguments, results):
        x = self._move(arguments[0])
        self.calls["jacobian"] += 1
        if results[0] is not None:
            self._evaluator.constraints(x, np.frombuffer(results[0]))
        if results[1] is not None:
            self._evaluator.jacobian(np.frombuffer(results[1]))

    def _hessian(self, arguments, results):
        self._move(arguments[0])
        self.calls["hessian"] += 1
        multipliers = np.frombuffer(arguments[3]) if arguments[3] is not None and len(arguments[3]) else np.zeros(0)
        self._evaluator.hessian(float(np.frombuffer(arguments[2])[0]), multipliers, np.frombuffer(results[0]))


class _Monitor(ca.Callback):
    """IPOPT's view from outside, once an iteration: reports progress and stops it on request."""

    def __init__(self, program, progress: Progress | None, time_limit: float | None, stop: Callable[[], bool] | None):
        ca.Callback.__init__(self)
        self._program, self._progress, self._stop = program, progress, stop
        self._deadline = None if time_limit is None else time.monotonic() + time_limit
        self._count = 0
        self.interrupted = self.out_of_time = False
        n, m = program.size, program.rows
        self._sizes = {"x": n, "f": 1, "g": m, "lam_x": n, "lam_g": m, "lam_p": 0}
        self.construct("monitor", {})

    def get_n_in(self):
        return ca.nlpsol_n_out()

    def get_n_out(self):
        return 1

    def get_name_in(self, i):
        return ca.nlpsol_out(i)

    def get_name_out(self, i):
        return "stop"

    def get_sparsity_in(self, i):
        size = self._sizes[ca.nlpsol_out(i)]
        return ca.Sparsity.dense(size, 1) if size else ca.Sparsity(0, 0)

    def has_eval_buffer(self):
        return True

    def eval_buffer(self, arguments, results):
        if self._progress is not None:
            self._report(arguments)
        self._count += 1
        if self._deadline is not None and time.monotonic() > self._deadline:
            self.out_of_time = True
        if self._stop is not None and self._stop():
            self.interrupted = True
        if results[0] is not None:
            np.frombuffer(results[0])[0] = float(self.interrupted or self.out_of_time)
        return 0

    def _report(self, arguments):
        program = self._program
        x, f = np.frombuffer(arguments[0]), float(np.frombuffer(arguments[1])[0])
        worst = max(np.max(program.lower - x, initial=0.0), np.max(x - program.upper, initial=0.0))
        if program.rows:
            g = np.frombuffer(arguments[2])
            worst = max(worst, np.max(program.row_lower - g, initial=0.0), np.max(g - program.row_upper, initial=0.0))
        self._progress(self._count, f, float(worst))


def _sparsity(rows: int, columns: int, pattern: tuple[np.ndarray, np.ndarray]) -> ca.Sparsity:
    start, row = pattern
    return ca.Sparsity(rows, columns, start.tolist(), row.tolist())
