"""A Newton step along the limits that are near: against the constrained minimum of a quadratic, and C against SciPy's factors."""

import numpy as np
import pytest

import energyopt as eo
from energyopt.baselines import baseline
from energyopt.dynamics.kernels import kernels_of
from energyopt.solvers import lookahead
from energyopt.solvers.lookahead import STIFFNESS, Point, newton_step, point_of, step_by_factors
from energyopt.transcription import transcribe


def quadratic(rng, n=8, m=3, active=(0,), near=()):
    """½ xᵀHx + gᵀx at x = 0 with banded H, rows aᵀx ≤ b of which some hold with equality, and unknowns at a bound."""
    H = np.diag(rng.uniform(1.0, 5.0, n)) + np.diag(rng.uniform(-0.4, 0.4, n - 1), 1)
    H = np.triu(H) + np.triu(H, 1).T
    A, g = rng.normal(size=(m, n)), rng.normal(size=n)
    lower, upper = np.full(n, -1.0), np.full(n, 1.0)
    upper[list(near)] = 1e-3
    row_upper = np.full(m, 5.0)
    row_upper[list(active)] = 1e-6
    columns = [np.flatnonzero(np.abs(np.triu(H)[:, j]) > 0) for j in range(n)]
    hessian = np.concatenate([np.triu(H)[c, j] for j, c in enumerate(columns)])
    pattern = np.cumsum([0, *map(len, columns)]), np.concatenate(columns)
    jacobian = np.arange(0, n * m + 1, m), np.tile(np.arange(m), n)
    bounds = (lower, upper), (np.full(m, -5.0), row_upper)
    return Point(*bounds, jacobian, pattern, np.zeros(n), np.zeros(m), g, A.T.ravel(), hessian, n), H, A, g


@pytest.mark.parametrize("how", [newton_step, step_by_factors])
def test_the_gain_is_that_of_the_quadratic_along_its_active_limits(how):
    for seed in range(10):
        point, H, A, g = quadratic(np.random.default_rng(seed), active=(0, 2), near=(1, 5))
        free = np.setdiff1d(np.arange(len(g)), (1, 5))
        kkt = np.block([[H[np.ix_(free, free)], A[np.ix_((0, 2), free)].T], [A[np.ix_((0, 2), free)], np.zeros((2, 2))]])
        d = np.linalg.solve(kkt, np.concatenate([g[free], np.zeros(2)]))[: len(free)]
        expected = g[free] @ d - 0.5 * d @ H[np.ix_(free, free)] @ d
        step = how(point)
        assert step.convex
        assert step.gain == pytest.approx(expected, rel=20 / STIFFNESS)
        assert step.shares[free] == pytest.approx(np.abs(g[free] * d), rel=1e-3, abs=1e-4)
        assert not step.shares[[1, 5]].any()


def test_curvature_that_is_not_positive_is_raised_and_said():
    point, *_ = quadratic(np.random.default_rng(3), active=())
    point.hessian[point.hessian_pattern[0][4] : point.hessian_pattern[0][5]] *= -1.0
    for how in (newton_step, step_by_factors):
        step = how(point)
        assert not step.convex
        assert step.gain > 0.0


def test_c_and_sparse_factors_agree_on_programs_of_an_arm_and_leave_them_unchanged():
    robot = eo.load_robot("panda")
    rng = np.random.default_rng(0)
    for _ in range(3):
        start, goal = (rng.uniform(0.6 * robot.limits.lower, 0.6 * robot.limits.upper) for _ in range(2))
        problem = eo.Problem(robot, start, goal, 2.5, self_collision=False)
        space = eo.BSpline(control_points=16, accuracy=None).space(problem.duration)
        program = transcribe(problem, space, kernels_of(robot.dynamics))
        x = program.guess(baseline(problem, "quintic"))
        pattern = [a.copy() for a in (*program.jacobian_pattern, *program.hessian_pattern)]
        point = point_of(program, x, program.layout.size)
        ours, theirs = newton_step(point), step_by_factors(point)
        assert ours.convex == theirs.convex
        assert ours.gain == pytest.approx(theirs.gain, rel=1e-8)
        assert ours.shares == pytest.approx(theirs.shares, rel=1e-6, abs=1e-8 * theirs.shares.max())
        assert all(map(np.array_equal, pattern, (*program.jacobian_pattern, *program.hessian_pattern)))


def test_no_step_is_given_where_the_curvature_is_no_number():
    point, *_ = quadratic(np.random.default_rng(0))
    point.hessian[:] = np.nan
    assert newton_step(point) is None
    assert step_by_factors(point) is None


def test_without_a_compiler_the_factors_are_used(monkeypatch):
    monkeypatch.setattr(lookahead, "library_path", lambda *names: None)
    point, *_ = quadratic(np.random.default_rng(1))
    assert newton_step(point).gain == step_by_factors(point).gain
