"""Our own interior-point method: optima that are known, IPOPT's on motions of arms, and every way in which it can end."""

import ctypes
import time
from dataclasses import replace
from importlib.resources import files
from types import SimpleNamespace

import arms
import numpy as np
import pytest
from toy_programs import Toy, parabola, rosenbrock

import energyopt as eo
from energyopt.baselines import baseline
from energyopt.dynamics import compiler
from energyopt.dynamics.kernels import kernels_of
from energyopt.parameterizations import BSpline
from energyopt.solvers import Outcome, SolverOptions, SolverResult, interior, ipopt, solve, solving
from energyopt.transcription import Cuts, transcribe
from energyopt.transcription.duals import Duals

pytestmark = pytest.mark.skipif(compiler.find_compiler() is None, reason="needs a C compiler")

CONVERGED = 1e-6
START = np.array([-1.2, 1.0])


def quadratic(H, c, **options):
    """f = ½ xᵀHx + cᵀx."""
    return Toy(lambda x: 0.5 * x @ H @ x + c @ x, lambda x: H @ x + c, lambda x: H, len(c), **options)


class Curved(Toy):
    """x₁x₄(x₁ + x₂ + x₃) + x₃ with x₁x₂x₃x₄ ≥ 25, |x|² = 40 and 1 ≤ x ≤ 5 (W. Hock, K. Schittkowski, "Test Examples for
    Nonlinear Programming Codes", 1981, problem 71)."""

    def __init__(self, equal=40.0):
        super().__init__(self._f, self._df, None, 4, bounds=(np.ones(4), np.full(4, 5.0)))
        self.row_lower, self.row_upper, self.rows = np.array([25.0, equal]), np.array([np.inf, equal]), 2
        self.jacobian_pattern = np.arange(0, 10, 2), np.tile([0, 1], 4)

    def _f(self, x):
        return x[0] * x[3] * x[:3].sum() + x[2]

    def _df(self, x):
        s = x[:3].sum()
        return np.array([x[3] * (s + x[0]), x[0] * x[3], x[0] * x[3] + 1.0, x[0] * s])

    def constraints(self, x, out):
        out[:] = x.prod(), x @ x

    def jacobian(self, out):
        out[:] = np.array([self.x.prod() / self.x, 2.0 * self.x]).T.ravel()

    def hessian(self, sigma, multipliers, out):
        x, H = self.x, np.zeros((4, 4))
        H[0, 0], H[0, 1], H[0, 2], H[0, 3] = 2 * x[3], x[3], x[3], 2 * x[0] + x[1] + x[2]
        H[1, 3] = H[2, 3] = x[0]
        pairs = np.triu(x.prod() / np.outer(x, x), 1)
        H = sigma * H + multipliers[0] * pairs + 2.0 * multipliers[1] * np.eye(4)
        out[:] = H[tuple(self._upper)]


def test_rosenbrocks_valley_is_followed_to_its_end():
    result = interior.solve(rosenbrock(), START)
    assert result.outcome is Outcome.CONVERGED and result.solver == "interior" and 5 < result.iterations < 60
    np.testing.assert_allclose(result.x, [1.0, 1.0], atol=1e-5)


def test_rosenbrocks_valley_with_a_row_across_it_ends_on_the_row():
    """x + y ≤ 1: the optimum on the line y = 1 − x is where 200 (1 − x − x²)(−1 − 2x) − 2 (1 − x) vanishes, x = 0.61880."""
    result = interior.solve(rosenbrock(rows=[[1.0, 1.0]], row_bounds=([-np.inf], [1.0])), START, SolverOptions(tolerance=1e-9))
    x = np.roots([400.0, 600.0, -198.0, -202.0])
    x = x[np.argmin(np.abs(x - 0.6))]
    np.testing.assert_allclose(result.x, [x, 1.0 - x], atol=CONVERGED)
    assert result.multipliers[0] > 0, "the upper side holds"


@pytest.mark.parametrize("seed", range(5))
def test_a_separable_quadratic_ends_at_its_clipped_minimum(seed):
    rng = np.random.default_rng(seed)
    H, c, bounds = np.diag(rng.uniform(0.5, 5.0, 12)), rng.normal(size=12), np.sort(rng.normal(size=(2, 12)), axis=0)
    result = interior.solve(quadratic(H, c, bounds=bounds), np.zeros(12), SolverOptions(tolerance=1e-10))
    np.testing.assert_allclose(result.x, np.clip(-c / np.diag(H), *bounds), atol=1e-7)


@pytest.mark.parametrize("seed", range(5))
def test_equality_rows_and_their_multipliers_are_those_of_the_linear_system(seed):
    """[H Aᵀ; A 0] [x; y] = [−c; b], H indefinite but positive where A x = 0."""
    rng = np.random.default_rng(seed)
    A, c, b = rng.normal(size=(3, 10)), rng.normal(size=10), rng.normal(size=3)
    H = np.eye(10) - 1.0 * np.outer(A[0], A[0]) / (A[0] @ A[0]) * 3.0
    expected = np.linalg.solve(np.block([[H, A.T], [A, np.zeros((3, 3))]]), np.concatenate([-c, b]))
    result = interior.solve(quadratic(H, c, rows=A, row_bounds=(b, b)), np.zeros(10), SolverOptions(tolerance=1e-9))
    assert result.outcome is Outcome.CONVERGED
    np.testing.assert_allclose(np.concatenate([result.x, result.multipliers]), expected, atol=1e-6)


def test_a_problem_with_curved_rows_ends_at_the_published_optimum():
    result = interior.solve(Curved(), np.array([1.0, 5.0, 5.0, 1.0]))
    assert result.outcome is Outcome.CONVERGED
    np.testing.assert_allclose(result.x, [1.0, 4.7429994, 3.8211503, 1.3794082], atol=1e-5)
    assert result.objective == pytest.approx(17.0140173, abs=1e-5)


def test_the_last_unknown_may_be_tied_to_all():
    """A Hessian like an arrow, as a free duration gives it: the optimum against NumPy."""
    rng = np.random.default_rng(3)
    H = np.diag(rng.uniform(2.0, 3.0, 40))
    H[-1, :-1] = H[:-1, -1] = rng.uniform(-0.1, 0.1, 39)
    c = rng.normal(size=40)
    result = interior.solve(quadratic(H, c), np.zeros(40), SolverOptions(tolerance=1e-10))
    np.testing.assert_allclose(result.x, np.linalg.solve(H, -c), atol=1e-8)
    assert result.iterations <= 2


def test_a_saddle_is_left():
    """x² − y² + y⁴/2 from its saddle at the origin, a little aside: y = ±1."""
    f = lambda x: x[0] ** 2 - x[1] ** 2 + 0.5 * x[1] ** 4
    df = lambda x: np.array([2 * x[0], -2 * x[1] + 2 * x[1] ** 3])
    ddf = lambda x: np.diag([2.0, -2.0 + 6 * x[1] ** 2])
    result = interior.solve(Toy(f, df, ddf, 2), np.array([0.5, 1e-3]))
    np.testing.assert_allclose(np.abs(result.x), [0.0, 1.0], atol=1e-5)


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1e6])
def test_the_optimum_does_not_depend_on_the_unit_of_the_objective(scale):
    base = rosenbrock()
    scaled = Toy(lambda x: scale * base.f(x), lambda x: scale * base.df(x), lambda x: scale * base.ddf(x), 2)
    np.testing.assert_allclose(interior.solve(scaled, START).x, [1.0, 1.0], atol=1e-3)


def test_a_limit_in_force_does_not_hide_curvatures_that_are_small_beside_it():
    """In the end the limit on x₀ adds 10⁷ to its curvature, 10²⁰ times the least of the others."""
    unit, base = 1e7, rosenbrock()
    curvature = lambda x: np.block([[0.0, np.zeros(2)], [np.zeros((2, 1)), 100.0 * base.ddf(x[1:] / unit) / unit**2]])
    f = lambda x: x[0] + 100.0 * base.f(x[1:] / unit)
    df = lambda x: np.concatenate([[1.0], 100.0 * base.df(x[1:] / unit) / unit])
    program = Toy(f, df, curvature, 3, bounds=([0.0, -np.inf, -np.inf], [1.0, np.inf, np.inf]))
    result = interior.solve(program, np.array([1e-7, *(unit * START)]))
    assert result.outcome is Outcome.CONVERGED and result.iterations < 40
    np.testing.assert_allclose(result.x / [1.0, unit, unit], [0.0, 1.0, 1.0], atol=0.05)


def test_a_row_of_large_terms_is_held_as_well_as_their_rounding_lets_it():
    """g = 10¹⁰ (x₁ − x₀) is known to 10⁻⁶ only, and its slack no better."""
    rows, target = [[-1e10, 1e10]], np.array([1.0, 2.0]) / 3.0
    f, df = lambda x: ((x - target) ** 2).sum(), lambda x: 2.0 * (x - target)
    program = Toy(f, df, lambda x: 2.0 * np.eye(2), 2, rows=rows, row_bounds=([-1.0], [1.0]))
    result = interior.solve(program, np.zeros(2))
    assert result.outcome is Outcome.CONVERGED and result.iterations < 20
    np.testing.assert_allclose(result.x, 0.5, atol=1e-6)


# ---- ways to end ----


def contradiction():
    return parabola(rows=[[1.0, 0.0], [1.0, 0.0]], row_bounds=([1.0, -np.inf], [np.inf, 0.0]))


def test_contradicting_rows_are_left_to_ipopt_which_names_them():
    assert interior.solve(contradiction(), np.zeros(2)).outcome is Outcome.FAILED
    result = solve(contradiction(), np.zeros(2))
    assert result.outcome is Outcome.INFEASIBLE and result.solver == "ipopt"


def test_what_was_done_before_ipopt_took_over_is_counted():
    ours, both = interior.solve(contradiction(), np.zeros(2)), solve(contradiction(), np.zeros(2))
    alone = ipopt.solve(contradiction(), np.zeros(2))
    assert both.iterations == ours.iterations + alone.iterations
    assert both.evaluations["hessian"] == ours.evaluations["hessian"] + alone.evaluations["hessian"]


def test_ipopt_has_the_time_that_is_left(monkeypatch):
    clock, given = [100.0], []

    def ours(*_):
        clock[0] += 0.5
        return SolverResult(START, np.zeros(0), Outcome.FAILED, "no step", 0.0, 3)

    def theirs(program, x0, options, *_):
        given.append(options.time_limit)
        return SolverResult(START, np.zeros(0), Outcome.CONVERGED, "", 0.0, 1)

    monkeypatch.setattr(solving.interior, "solve", ours)
    monkeypatch.setattr(solving.ipopt, "solve", theirs)
    monkeypatch.setattr(solving.time, "monotonic", lambda: clock[0])
    for limit in (0.6, 0.4, None):
        solving.solve(rosenbrock(), START, SolverOptions(time_limit=limit))
    assert given == [pytest.approx(0.1), solving.LEAST_TIME, None]


def test_ipopt_runs_without_a_compiler(monkeypatch):
    monkeypatch.setattr(interior, "library_path", lambda *names: None)
    assert solve(rosenbrock(), START).solver == "ipopt"


def test_fixed_unknowns_and_many_equalities_are_not_its_kind():
    fixed = parabola(bounds=([1.0, -1.0], [1.0, 1.0]))
    many = quadratic(np.eye(80), np.zeros(80), rows=np.eye(80)[:40], row_bounds=(np.ones(40), np.ones(40)))
    assert interior.solve(fixed, np.zeros(2)) is None and interior.solve(many, np.zeros(80)) is None
    assert solve(fixed, np.zeros(2)).solver == solve(many, np.zeros(80)).solver == "ipopt"


def test_iterations_are_counted_and_limited():
    result = solve(rosenbrock(), START, SolverOptions(iterations=3))
    assert result.outcome is Outcome.ITERATION_LIMIT and result.iterations == 3 and result.solver == "interior"
    assert rosenbrock().f(result.x) < rosenbrock().f(START)


def test_time_is_limited():
    slow = rosenbrock()
    value = slow.f
    slow.f = lambda x: (time.sleep(0.02), value(x))[1]
    began = time.monotonic()
    result = solve(slow, START, SolverOptions(time_limit=0.1))
    assert result.outcome is Outcome.TIME_LIMIT and time.monotonic() - began < 1.0


def test_a_stop_request_ends_the_solve_and_keeps_the_iterate():
    slow = rosenbrock()
    value, calls = slow.f, []
    slow.f = lambda x: (time.sleep(0.02), value(x))[1]
    result = solve(slow, START, stop=lambda: calls.append(0) or len(calls) > 6)
    assert result.outcome is Outcome.INTERRUPTED and result.iterations < 10
    assert value(result.x) <= value(START)


def test_progress_is_reported_every_iteration_in_the_rows_own_unit():
    seen = []
    program = parabola(rows=[[3.0, 0.0]], row_bounds=([6.0], [np.inf]))
    result = solve(program, np.zeros(2), progress=lambda *line: seen.append(line))
    iterations, objectives, violations = zip(*seen, strict=True)
    assert list(iterations) == list(range(result.iterations + 1))
    assert violations[0] == pytest.approx(6.0) and violations[-1] < 1e-6
    assert objectives[-1] == pytest.approx(result.objective, abs=1e-9)


@pytest.mark.parametrize("where", ["move", "objective", "gradient", "hessian", "constraints", "jacobian"])
def test_what_an_evaluator_raises_reaches_the_caller(where):
    program = Curved()
    setattr(program, where, lambda *arguments: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        interior.solve(program, np.array([1.0, 5.0, 5.0, 1.0]))


def test_what_progress_raises_reaches_the_caller():
    with pytest.raises(ZeroDivisionError):
        solve(rosenbrock(), START, progress=lambda *line: 1 / 0)


@pytest.mark.parametrize("where", ["objective", "gradient"])
def test_not_a_number_is_a_failure_that_gives_the_start_back(where):
    bad = rosenbrock()
    setattr(bad, "f" if where == "objective" else "df", lambda x: np.nan if where == "objective" else np.full(2, np.nan))
    result = solve(bad, START)
    assert result.outcome is Outcome.FAILED and np.all(np.isfinite(result.x))


# ---- motions ----


def move(name, seed, torque_rows=False, **options):
    """The program of a random move, and its start."""
    robot, rng = arms.catalogue_robot(name), np.random.default_rng(seed)
    low, high = np.maximum(robot.limits.lower, -2.5), np.minimum(robot.limits.upper, 2.5)
    begin, end = rng.uniform(low + 0.1 * (high - low), high - 0.1 * (high - low), (2, robot.nv))
    duration = 1.45 * np.max(1.875 * np.abs(end - begin) / robot.limits.velocity)
    problem = eo.Problem(robot, begin, end, duration, self_collision=False, **options)
    cuts = Cuts(torque={(float(t), i) for t in np.linspace(0, duration, 12) for i in range(robot.nv)} if torque_rows else set())
    program = transcribe(problem, BSpline(control_points=14).space(duration), kernels_of(robot.dynamics), cuts)
    return program, program.guess(baseline(problem))


KINDS = [
    *(("panda", seed, {}) for seed in range(4)),
    *(("ur5", seed, {"torque_rows": True}) for seed in range(3)),
    *(("xarm7", seed, {"acceleration_limits": 15.0}) for seed in range(3)),
    *(("z1", seed, {}) for seed in range(2)),
]


@pytest.mark.parametrize("name, seed, options", KINDS)
def test_ipopt_finds_nothing_better_near_our_optimum(name, seed, options):
    """Nor anything worse: from there it ends at the same J (1e-6: both stop at that scaled error)."""
    program, x0 = move(name, seed, **options)
    ours = interior.solve(program, x0)
    assert ours.outcome is Outcome.CONVERGED
    near = ipopt.solve(program, ours.x, SolverOptions(barrier=1e-7))
    assert near.objective == pytest.approx(ours.objective, rel=2e-6)


def test_in_most_cases_the_optimum_is_ipopts_or_a_better_one_in_less_time():
    found = []
    for name, seed, options in KINDS:
        program, x0 = move(name, seed, **options)
        clock = [time.process_time()]
        results = []
        for method in (interior.solve, ipopt.solve):
            results.append(method(program, x0))
            clock.append(time.process_time())
        found.append((results[0].objective / results[1].objective - 1.0, *np.diff(clock)))
    change, ours, reference = np.array(found).T
    assert np.mean(change < 1e-5) >= 0.75 and np.mean(change) < 0.01
    assert ours.sum() < 0.8 * reference.sum()


def test_compiled_functions_and_callbacks_take_the_same_way():
    program, x0 = move("panda", 1)
    evaluator = program.evaluator
    names = ("move", "objective", "constraints", "gradient", "jacobian", "hessian")
    object.__setattr__(program, "evaluator", SimpleNamespace(**{name: getattr(evaluator, name) for name in names}))
    called = interior.solve(program, x0)
    object.__setattr__(program, "evaluator", evaluator)
    direct = interior.solve(program, x0)
    assert called.iterations == direct.iterations and called.x.tobytes() == direct.x.tobytes()


def test_the_same_solve_gives_the_same_bits_in_slices_of_any_length():
    program, x0 = move("panda", 2)
    at_once, step_by_step = interior.solve(program, x0), interior.solve(program, x0, progress=lambda *line: None)
    assert at_once.x.tobytes() == step_by_step.x.tobytes()


@pytest.mark.parametrize("seed", range(3))
def test_a_warm_start_after_a_small_change_takes_half_the_iterations(seed):
    robot = arms.catalogue_robot("panda")
    goal = robot.home + np.random.default_rng(seed).uniform(-0.6, 0.6, 7)
    goal[3], goal[5] = robot.home[3] + 0.3, robot.home[5] - 0.2
    programs = [
        transcribe(eo.Problem(robot, robot.home, g, 1.2), BSpline(control_points=14).space(1.2), kernels_of(robot.dynamics))
        for g in (goal, goal + 0.01)
    ]
    start = programs[0].guess(baseline(eo.Problem(robot, robot.home, goal, 1.2)))
    first = interior.solve(programs[0], start)
    cold, warm = interior.solve(programs[1], start), interior.solve(programs[1], first.x, SolverOptions(barrier=1e-5))
    assert warm.iterations <= 0.6 * cold.iterations
    assert warm.objective <= cold.objective * (1 + 1e-6)


# ---- linear algebra ----

PROBE = """
long probe(long n, const double *A, long *first, double *x, long most) {
  Skyline s;
  long *own = malloc(n * sizeof *own);
  memcpy(own, first, n * sizeof *own);
  if (!skyline_make(&s, n, own)) return -2;
  skyline_zero(&s);
  for (long i = 0; i < n; ++i)
    for (long j = first[i]; j <= i; ++j) *entry(&s, j, i) += A[i * n + j];
  const long negative = skyline_factor(&s, most);
  if (negative >= 0 && negative <= most) skyline_solve(&s, x);
  skyline_free(&s);
  return negative;
}
"""


@pytest.fixture(scope="module")
def probe():
    text = (files("energyopt.solvers") / "skyline.c").read_text() + PROBE
    path = compiler.compile_library(compiler.library_key(text), {"probe": (text, ("-O2", "-std=gnu11"))})
    function = ctypes.CDLL(str(path)).probe
    function.restype = ctypes.c_long

    def call(matrix, first, right, most):
        x, A, first = right.copy(), np.ascontiguousarray(matrix), np.asarray(first, np.int64)
        pointers = (ctypes.c_void_p(array.ctypes.data) for array in (A, first, x))
        A, first, x_at = pointers
        return function(ctypes.c_long(len(matrix)), A, first, x_at, ctypes.c_long(most)), x

    return call


@pytest.mark.parametrize("size, band, border", [(1, 1, 0), (9, 9, 0), (60, 7, 0), (60, 7, 3)])
def test_a_skyline_solves_and_counts_negative_eigenvalues_as_numpy_does(probe, size, band, border):
    rng = np.random.default_rng(size + border)
    near = np.abs(np.subtract.outer(np.arange(size), np.arange(size))) < band
    near[size - border :] = near[:, size - border :] = True
    matrix = np.where(near, rng.normal(size=(size, size)), 0.0)
    matrix = matrix + matrix.T + np.diag(rng.choice([-20.0, 20.0], size))
    first, right = [np.flatnonzero(row)[0] for row in near], rng.normal(size=size)
    negative, x = probe(matrix, first, right, size)
    assert negative == np.sum(np.linalg.eigvalsh(matrix) < 0)
    np.testing.assert_allclose(x, np.linalg.solve(matrix, right), rtol=1e-8, atol=1e-10)


def test_a_skyline_tells_that_a_matrix_is_singular_or_not_definite_enough(probe):
    assert probe(np.array([[1.0, 2.0], [2.0, 4.0]]), [0, 0], np.ones(2), 2)[0] == -1
    assert probe(np.diag([1.0, -1.0, -1.0, np.nan]), range(4), np.ones(4), 0)[0] == 1, "it stops at the first"
    assert probe(np.diag([1.0, np.nan]), range(2), np.ones(2), 2)[0] == -1


def test_a_start_with_the_multipliers_of_the_optimum_takes_few_iterations():
    program = Curved()
    first = interior.solve(program, np.array([1.0, 5.0, 5.0, 1.0]))
    known = SolverOptions(barrier=1e-6, multipliers=(first.multipliers, first.bound_multipliers))
    again = interior.solve(program, first.x, known)
    assert again.outcome is Outcome.CONVERGED
    assert again.x == pytest.approx(first.x, abs=1e-6)
    assert again.iterations <= 3 < first.iterations


def test_bound_multipliers_balance_the_gradient():
    """Minimise ½|x|² − 2 x₁ with x₁ ≤ 1: the upper bound holds with multiplier 1, none holds x₂."""
    program = quadratic(np.eye(2), np.array([-2.0, 0.0]), bounds=(np.full(2, -3.0), np.array([1.0, 3.0])))
    result = interior.solve(program, np.zeros(2))
    assert result.bound_multipliers == pytest.approx([1.0, 0.0], abs=1e-5)


def test_multipliers_of_rows_that_stay_are_found_again_among_new_ones():
    robot = arms.catalogue_robot("ur5")
    problem = eo.Problem(robot, np.zeros(6), np.full(6, 0.8), 1.0, self_collision=False)
    space, kernels = BSpline(control_points=12, accuracy=None).space(1.0), kernels_of(robot.dynamics)
    cuts = Cuts(torque={(0.2, 1), (0.4, 2)})
    program = transcribe(problem, space, kernels, cuts)
    result = solve(program, program.guess(baseline(problem)))
    duals = Duals.of(program, cuts, result)
    more = Cuts(torque={*cuts.torque, (0.3, 1), (0.1, 0)})
    rows, bounds = duals.to(transcribe(problem, space, kernels, more), more)
    linear = len(program.layout.linear.lower)
    assert rows[:linear] == pytest.approx(result.multipliers[:linear], abs=0.0)
    kept = dict(zip(sorted(cuts.torque), result.multipliers[linear:], strict=True))
    assert rows[linear:] == pytest.approx([kept.get(key, 0.0) for key in sorted(more.torque)], abs=0.0)
    assert bounds == pytest.approx(result.bound_multipliers, abs=0.0)
    start = SolverOptions(barrier=1e-5)
    known = interior.solve(program, result.x, replace(start, multipliers=(result.multipliers, result.bound_multipliers)))
    assert known.iterations < interior.solve(program, result.x, start).iterations
    finer = BSpline(control_points=16, accuracy=None).space(1.0)
    assert duals.to(transcribe(problem, finer, kernels, cuts), cuts) is None
