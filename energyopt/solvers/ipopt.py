"""IPOPT through CasADi, fed with a program's own objective, gradient, Jacobian and exact Hessian.

A. Wächter, L. T. Biegler, "On the implementation of an interior-point filter line-search algorithm for large-scale
nonlinear programming", Mathematical Programming 106 (2006).
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext

import casadi as ca
import numpy as np

from energyopt.solvers.callbacks import Monitor, ProgramFunctions
from energyopt.solvers.interrupts import Interrupts, unless_stopped
from energyopt.solvers.linear import linear_solvers
from energyopt.solvers.result import DEFAULT, VIOLATION, Outcome, Progress, SolverOptions, SolverResult, scaling

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


SMALLEST_STEP = 1e-9
"""Length of a step [rad] that is rounding where spans are short: their gradients cannot be brought below the tolerance."""


_ENDS = (Outcome.CONVERGED, Outcome.ACCEPTABLE, Outcome.INTERRUPTED, Outcome.TIME_LIMIT)
"""Outcomes after which no other linear solver is tried."""


def solve(
    program,
    x0: np.ndarray,
    options: SolverOptions = DEFAULT,
    progress: Progress | None = None,
    stop: Callable[[], bool] | None = None,
) -> SolverResult:
    """Minimise a program from ``x0``; ``stop`` ends the solve, with the iterate kept, within a tenth of a second.

    ``progress`` is called in another thread, where ``stop`` is given; what it raises ends the solve, and is raised again.
    """
    equalities = int(np.sum(program.row_lower == program.row_upper))
    if equalities > program.size:
        reason = "Not_Enough_Degrees_Of_Freedom"
        return SolverResult(np.array(x0, float), np.zeros(program.rows), _OUTCOMES[reason], reason, np.inf, 0)
    monitor = Monitor(program, progress, options.time_limit, stop)
    with stop.held() if isinstance(stop, Interrupts) else nullcontext():
        result = unless_stopped(lambda: _solve(program, x0, options, monitor), stop)
    return result or _left(program, x0, monitor)


def _left(program, x0: np.ndarray, monitor: Monitor) -> SolverResult:
    """The last iterate of a solve that was left in the middle of an iteration, or the point it started from."""
    x, objective, count = monitor.last or (np.array(x0, float), np.inf, 0)
    return SolverResult(x, np.zeros(program.rows), Outcome.INTERRUPTED, "User_Requested_Stop", objective, count)


def _solve(program, x0: np.ndarray, options: SolverOptions, monitor: Monitor) -> SolverResult:
    functions, equalities = ProgramFunctions(program), int(np.sum(program.row_lower == program.row_upper))
    for linear in linear_solvers(program.size, program.rows, equalities):
        settings = _casadi_options(program, functions, monitor, options, x0)
        settings["ipopt"] |= linear | {"max_iter": min(options.iterations, linear.get("max_iter", options.iterations))}
        solver = ca.nlpsol("energyopt", "ipopt", functions.problem, settings)
        result = solver(x0=x0, lbx=program.lower, ubx=program.upper, lbg=program.row_lower, ubg=program.row_upper)
        if monitor.error is not None:
            raise monitor.error
        outcome = _outcome(solver.stats(), monitor)
        if outcome in _ENDS or settings["ipopt"]["max_iter"] == options.iterations:
            break
    stats = solver.stats()
    reason = stats["return_status"]
    x = np.array(result["x"]).ravel()
    if not np.all(np.isfinite(x)):
        x, outcome = np.array(x0, float), Outcome.FAILED
    return SolverResult(
        x, np.array(result["lam_g"]).ravel(), outcome, reason, float(result["f"]), stats["iter_count"], dict(functions.calls)
    )


def _outcome(stats: dict, monitor: Monitor) -> Outcome:
    """What IPOPT's own word means; a step that fails because it is as small as rounding is the end of a convergence."""
    if monitor.interrupted:
        return Outcome.INTERRUPTED
    if stats["return_status"] == "User_Requested_Stop":
        return Outcome.TIME_LIMIT if monitor.out_of_time else Outcome.ACCEPTABLE
    reason, steps = stats["return_status"], stats.get("iterations") or {}
    last = lambda name: (steps.get(name) or [np.inf])[-1]
    if reason == "Error_In_Step_Computation" and last("d_norm") <= SMALLEST_STEP and last("inf_pr") <= VIOLATION:
        return Outcome.ACCEPTABLE
    return _OUTCOMES.get(reason, Outcome.FAILED)


def _casadi_options(program, functions: ProgramFunctions, monitor: Monitor, options: SolverOptions, x0: np.ndarray) -> dict:
    ipopt = {
        "print_level": 0,
        "sb": "yes",
        "tol": options.tolerance,
        "constr_viol_tol": VIOLATION,
        "acceptable_constr_viol_tol": VIOLATION,
        "acceptable_tol": 1e2 * options.tolerance,
        "max_iter": options.iterations,
        "mu_init": options.barrier,
        "obj_scaling_factor": scaling(program, x0),
        "min_refinement_steps": 0,
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
