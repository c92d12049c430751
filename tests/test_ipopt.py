"""The solver alone, on programs of a few unknowns whose optima are known; and what becomes of every way in which it can end."""

import time
from types import SimpleNamespace

import numpy as np
import pytest
from toy_programs import Toy, parabola, rosenbrock

from energyopt.solvers import Outcome, SolverOptions, ipopt
from energyopt.solvers.ipopt import solve

CONVERGED = 1e-6

START = np.array([-1.2, 1.0])


def test_rosenbrocks_valley_is_followed_to_its_end():
    result = solve(rosenbrock(), START)
    assert result.outcome is Outcome.CONVERGED and result.reason == "Solve_Succeeded"
    np.testing.assert_allclose(result.x, [1.0, 1.0], atol=1e-5)
    assert result.objective == pytest.approx(0.0, abs=1e-9)
    assert 5 < result.iterations < 60


def test_bounds_and_rows_hold_and_multipliers_are_those_of_the_optimum():
    """½|x|² with x + y ≥ 2 and x ≤ ½: x = (½, 3/2), and the row's multiplier is −3/2 in CasADi's sign."""
    program = parabola(rows=[[1.0, 1.0]], row_bounds=([2.0], [np.inf]), bounds=([-np.inf, -np.inf], [0.5, np.inf]))
    result = solve(program, np.zeros(2), SolverOptions(tolerance=1e-9))
    np.testing.assert_allclose(result.x, [0.5, 1.5], atol=CONVERGED)
    np.testing.assert_allclose(result.multipliers, [-1.5], atol=1e-5)


def test_equality_rows_are_met():
    result = solve(parabola(3, rows=[[1.0, 2.0, 2.0]], row_bounds=([9.0], [9.0])), np.ones(3))
    np.testing.assert_allclose(result.x, [1.0, 2.0, 2.0], atol=CONVERGED)


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1e6])
def test_the_optimum_does_not_depend_on_the_unit_of_the_objective(scale):
    base = rosenbrock()
    scaled = Toy(lambda x: scale * base.f(x), lambda x: scale * base.df(x), lambda x: scale * base.ddf(x), 2)
    np.testing.assert_allclose(solve(scaled, START).x, [1.0, 1.0], atol=1e-3)


def test_the_motion_is_evaluated_once_for_every_new_point():
    program = rosenbrock()
    result = solve(program, START)
    assert result.evaluations["hessian"] == result.iterations
    assert program.moves <= 3 * result.iterations + 5


def test_contradicting_rows_are_infeasible():
    program = parabola(rows=[[1.0, 0.0], [1.0, 0.0]], row_bounds=([1.0, -np.inf], [np.inf, 0.0]))
    assert solve(program, np.zeros(2)).outcome is Outcome.INFEASIBLE


def test_more_equalities_than_unknowns_are_infeasible():
    rows = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
    assert solve(parabola(rows=rows, row_bounds=([1.0, 1.0, 3.0],) * 2), np.zeros(2)).outcome is Outcome.INFEASIBLE


def test_iterations_are_counted_and_limited():
    result = solve(rosenbrock(), START, SolverOptions(iterations=3))
    assert result.outcome is Outcome.ITERATION_LIMIT and result.iterations == 3
    assert rosenbrock().f(result.x) < rosenbrock().f(START), "the last iterate is kept"


def test_time_is_limited():
    slow = rosenbrock()
    value = slow.f
    slow.f = lambda x: (time.sleep(0.02), value(x))[1]
    began = time.monotonic()
    result = solve(slow, START, SolverOptions(time_limit=0.1))
    assert result.outcome is Outcome.TIME_LIMIT
    assert time.monotonic() - began < 1.0
    assert np.all(np.isfinite(result.x))


def test_a_stop_request_ends_the_solve_and_keeps_the_iterate():
    calls = []
    result = solve(rosenbrock(), START, stop=lambda: calls.append(0) or len(calls) > 4)
    assert result.outcome is Outcome.INTERRUPTED and result.iterations <= 5
    assert rosenbrock().f(result.x) < rosenbrock().f(START)


def test_progress_is_reported_every_iteration():
    seen = []
    result = solve(rosenbrock(), START, progress=lambda *line: seen.append(line))
    iterations, objectives, violations = zip(*seen, strict=True)
    assert list(iterations) == list(range(result.iterations + 1))
    assert objectives[-1] == pytest.approx(result.objective, abs=1e-9) and max(violations) == 0.0


def test_the_worst_violation_is_reported_in_the_rows_own_unit():
    program, seen = parabola(rows=[[3.0, 0.0]], row_bounds=([6.0], [np.inf])), []
    solve(program, np.zeros(2), progress=lambda *line: seen.append(line))
    assert seen[0][2] == pytest.approx(6.0, abs=0.2) and seen[-1][2] < 1e-6


@pytest.mark.parametrize("where", ["objective", "gradient"])
def test_not_a_number_is_a_failure_that_gives_the_start_back(where):
    bad = rosenbrock()
    nan = lambda x: np.nan if where == "objective" else np.full(2, np.nan)
    setattr(bad, "f" if where == "objective" else "df", nan)
    result = solve(bad, START)
    assert result.outcome is Outcome.FAILED and np.all(np.isfinite(result.x))


ENDS = {  # every status IPOPT 3.14 has (IpReturnCodes.h, as CasADi spells them), and what is made of it
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
    "Diverging_Iterates": Outcome.FAILED,
    "Error_In_Step_Computation": Outcome.FAILED,
    "Invalid_Problem_Definition": Outcome.FAILED,
    "Invalid_Option": Outcome.FAILED,
    "Invalid_Number_Detected": Outcome.FAILED,
    "Unrecoverable_Exception": Outcome.FAILED,
    "NonIpopt_Exception_Thrown": Outcome.FAILED,
    "Insufficient_Memory": Outcome.FAILED,
    "Internal_Error": Outcome.FAILED,
}


class FakeSolver:
    """Ends at once with a given status."""

    def __init__(self, status, x, **iterations):
        self._stats = {"return_status": status, "iter_count": 7, "success": False, "iterations": iterations}
        self._x = x

    def __call__(self, **arguments):
        return {"x": self._x, "lam_g": np.zeros(0), "f": 1.0}

    def stats(self):
        return self._stats


def end_with(monkeypatch, status, x=START, **iterations):
    monkeypatch.setattr(ipopt, "ca", SimpleNamespace(nlpsol=lambda *a, **k: FakeSolver(status, x, **iterations)))
    return solve(rosenbrock(), START)


@pytest.mark.parametrize("status, outcome", ENDS.items())
def test_every_status_of_ipopt_has_one_outcome(monkeypatch, status, outcome):
    result = end_with(monkeypatch, status)
    assert result.outcome is outcome and result.reason == status and result.iterations == 7


def test_a_status_of_a_future_release_is_a_failure(monkeypatch):
    assert end_with(monkeypatch, "Something_New").outcome is Outcome.FAILED


def test_a_step_too_small_to_be_computed_at_a_feasible_point_is_the_end_of_a_convergence(monkeypatch):
    failed = "Error_In_Step_Computation"
    assert end_with(monkeypatch, failed, d_norm=[1e-3, 1e-12], inf_pr=[1e-9, 0.0]).outcome is Outcome.ACCEPTABLE
    assert end_with(monkeypatch, failed, d_norm=[1e-3, 1e-12], inf_pr=[1e-9, 1e-3]).outcome is Outcome.FAILED
    assert end_with(monkeypatch, failed, d_norm=[1e-12, 1e-3], inf_pr=[0.0, 0.0]).outcome is Outcome.FAILED


def test_a_point_that_is_not_finite_is_never_returned(monkeypatch):
    result = end_with(monkeypatch, "Solve_Succeeded", np.array([np.nan, 1.0]))
    assert result.outcome is Outcome.FAILED
    np.testing.assert_array_equal(result.x, START)
