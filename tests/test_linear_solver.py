"""Our solver of IPOPT's linear systems against dense linear algebra, and IPOPT with it against IPOPT with MUMPS."""

import ctypes

import numpy as np
import pytest

import energyopt as eo
from energyopt.baselines import baseline
from energyopt.dynamics.kernels import kernels_of
from energyopt.parameterizations import BSpline
from energyopt.solvers import linear
from energyopt.solvers.ipopt import solve
from energyopt.transcription import transcribe

LIBRARY = linear._profile_library()
needs_compiler = pytest.mark.skipif(LIBRARY is None, reason="no C compiler on this machine: MUMPS is used throughout")


class Ma27:
    """The library called as IPOPT calls it: analyse once, then factor and solve."""

    def __init__(self, size, rows, columns):
        self.library = ctypes.CDLL(LIBRARY)
        self.size, self.rows, self.columns = size, np.intc(rows + 1), np.intc(columns + 1)
        self.info, self.icntl, self.cntl = np.zeros(20, np.intc), np.zeros(30, np.intc), np.zeros(5)
        self.keep, self.work = np.zeros(3 * size, np.intc), np.zeros(2 * size, np.intc)
        self.reals = np.zeros(max(size, 1))
        self._call("ma27ad_", size, len(rows), self.rows, self.columns, np.zeros(9, np.intc), 9, self.keep, self.work, 0, 0,
                   self.icntl, self.cntl, self.info, np.zeros(1))  # fmt: skip
        self.values, self.integers = np.zeros(self.info[4]), np.zeros(max(self.info[5], 1), np.intc)

    def factor(self, entries):
        """Returns the number of negative eigenvalues, or the error code."""
        self.values[: len(entries)] = entries
        self._call("ma27bd_", self.size, len(entries), self.rows, self.columns, self.values, len(self.values), self.integers,
                   len(self.integers), self.keep, 0, 0, self.work, self.icntl, self.cntl, self.info)  # fmt: skip
        return self.info[0] if self.info[0] < 0 else self.info[14]

    def solve(self, right):
        solution = right.copy()
        self._call("ma27cd_", self.size, self.values, len(self.values), self.integers, len(self.integers), self.reals, 0,
                   solution, self.work, 0, self.icntl, self.cntl)  # fmt: skip
        return solution

    def _call(self, name, *arguments):
        kept = [np.array([a], np.intc) if isinstance(a, int) else a for a in arguments]
        getattr(self.library, name)(*(ctypes.c_void_p(a.ctypes.data) for a in kept))


def kkt_entries(rng, unknowns, rows, indefinite=False):
    """Lower-triangle entries, some given twice, of a random system of IPOPT's shape with a banded Hessian."""
    dense = rng.normal(size=(unknowns, unknowns))
    near = np.abs(np.subtract.outer(np.arange(unknowns), np.arange(unknowns))) < 5
    hessian = np.where(near, dense + dense.T, 0.0) + (0.0 if indefinite else 20.0) * np.eye(unknowns)
    entries = [(i, j, hessian[i, j]) for i in range(unknowns) for j in range(i + 1) if near[i, j]]
    for k in range(rows):
        slack, multiplier = unknowns + k, unknowns + rows + k
        entries += [(slack, slack, rng.uniform(0.1, 10.0)), (multiplier, slack, -1.0), (multiplier, multiplier, -1e-9 * k)]
        for j in rng.choice(unknowns, size=min(3, unknowns), replace=False):
            entries += [(multiplier, j, rng.normal()), (multiplier, j, rng.normal())]
    return (np.array([e[k] for e in entries], int if k < 2 else float) for k in range(3))


def dense_matrix(size, rows, columns, values):
    matrix = np.zeros((size, size))
    np.add.at(matrix, (rows, columns), values)
    return matrix + np.tril(matrix, -1).T


@needs_compiler
@pytest.mark.parametrize(
    ("unknowns", "bounded", "indefinite"), [(1, 0, False), (12, 0, True), (9, 4, False), (40, 25, True), (5, 30, True)]
)
def test_solution_and_inertia_agree_with_dense_algebra(unknowns, bounded, indefinite):
    rng = np.random.default_rng(unknowns + bounded)
    rows, columns, values = kkt_entries(rng, unknowns, bounded, indefinite)
    size = unknowns + 2 * bounded
    solver, right = Ma27(size, rows, columns), rng.normal(size=size)
    for factor in (1.0, 1.7):  # the second factorization reuses the structure
        matrix = dense_matrix(size, rows, columns, factor * values)
        assert solver.factor(factor * values) == np.sum(np.linalg.eigvalsh(matrix) < 0)
        # 1e-8: no pivoting, so some digits are lost on indefinite systems; IPOPT refines by residuals.
        assert np.allclose(matrix @ solver.solve(right), right, atol=1e-8 * np.abs(right).max())


@needs_compiler
def test_a_singular_matrix_is_reported():
    assert Ma27(2, np.array([0, 1, 1]), np.array([0, 0, 1])).factor(np.array([1.0, 2.0, 4.0])) == -5


@needs_compiler
def test_a_pattern_of_another_kind_is_refused():
    """x = 0 and 1, slacks 2 … 4, multipliers 5 … 7, and an entry between the multipliers 5 and 6."""
    rows = np.array([0, 1, 2, 3, 4, 5, 6, 7, 5, 6])
    columns = np.array([0, 1, 2, 3, 4, 2, 3, 4, 0, 5])
    assert Ma27(8, rows, columns).info[0] < 0


@needs_compiler
def test_a_matrix_without_slacks_is_factored_whole():
    rng = np.random.default_rng(4)
    lower = np.tril(rng.normal(size=(9, 9))) + 9.0 * np.diag(rng.choice([-1.0, 1.0], 9))
    rows, columns = np.nonzero(lower)
    matrix, right = lower + np.tril(lower, -1).T, rng.normal(size=9)
    solver = Ma27(9, rows, columns)
    assert solver.factor(lower[rows, columns]) == np.sum(np.linalg.eigvalsh(matrix) < 0)
    assert np.allclose(matrix @ solver.solve(right), right, atol=1e-10)


@needs_compiler
@pytest.mark.parametrize("seed", range(3))
def test_ipopt_takes_the_same_way_with_our_solver_as_with_mumps(seed, monkeypatch):
    robot = eo.load_robot("panda")
    rng = np.random.default_rng(seed)
    goal = robot.home + rng.uniform(-0.6, 0.6, robot.nv)
    problem = eo.Problem(robot, robot.home, np.clip(goal, robot.limits.lower, robot.limits.upper), duration=1.2)
    program = transcribe(problem, BSpline(control_points=16).space(1.2), kernels_of(robot.dynamics))
    x0 = program.guess(baseline(problem))
    ours = solve(program, x0)
    monkeypatch.setattr(linear, "_profile_library", lambda: None)
    reference = solve(program, x0)
    assert ours.iterations == reference.iterations
    assert ours.objective == pytest.approx(reference.objective, rel=1e-9)
    assert np.allclose(ours.x, reference.x, atol=1e-5)


@needs_compiler
def test_what_stood_in_the_work_array_before_does_not_matter():
    """IPOPT hands over memory as it comes: it may hold the structure of an earlier solve of the same pattern, in part."""
    rng = np.random.default_rng(7)
    rows, columns, values = kkt_entries(rng, 12, 5)
    right, matrix = rng.normal(size=22), dense_matrix(22, rows, columns, values)
    before, after = Ma27(22, rows, columns), Ma27(22, rows, columns)
    before.factor(values)
    after.integers[:] = before.integers
    after.integers[10:] = rng.integers(0, 1000, len(after.integers) - 10)
    assert after.factor(values) == np.sum(np.linalg.eigvalsh(matrix) < 0)
    assert np.allclose(matrix @ after.solve(right), right, atol=1e-8 * np.abs(right).max())
