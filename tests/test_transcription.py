"""Nonlinear programs: exact derivatives, the same from machine code and NumPy, and rows that mean what they say."""

import arms
import numpy as np
import pytest
from scipy.sparse import csc_array

import energyopt as eo
from energyopt.dynamics.kernels import kernels_of
from energyopt.transcription import Cuts, transcribe

SAME_SUMS = 1e-12
"""Relative: the same sums in another order."""
DIFFERENCES = 1e-6
"""Relative, against central differences."""

METHODS = {
    "cubic spline": eo.BSpline(control_points=14),
    "quintic spline": eo.BSpline(degree=5, control_points=13),
    "collocation": eo.HermiteSimpson(6),
    "sinusoid": eo.Sinusoid(3),
}
TIP = np.array([0.55, 0.0, 0.5])
TURN = np.array([np.cos(0.4), 0.0, -np.sin(0.4), 0.0])


def two_link_problem(**options):
    defaults = {"goal": [1.2, -0.8], "velocity_weight": [0.3, 0.7], "torque_weights": [1.0, 2.0]}
    return eo.Problem(arms.two_link(), [-0.4, 0.6], duration=0.7, **{**defaults, **options})


def rubbing_problem():
    ends = {"start_velocity": [0.1, 0.2, 0.3], "goal_acceleration": [1.0, -1.0, 0.5]}
    limits = {"torque_limits": 60.0, "torque_rate_limits": 900.0}
    return eo.Problem(arms.rubbing_chain(), [0.1, -0.2, 0.3], [0.8, 0.3, -0.5], 0.8, **ends, **limits)


PROBLEMS = {
    "torque and rate rows": lambda: two_link_problem(torque_limits=25.0, torque_rate_limits=150.0, velocity_limits=3.0),
    "friction and a slider": lambda: rubbing_problem(),
    "timed waypoint, all limits": lambda: two_link_problem(
        waypoints=[([0.3, 0.1], 0.3)], acceleration_limits=60.0, jerk_limits=3e3
    ),
    "goal position of the tool": lambda: two_link_problem(goal=eo.FramePose("tool", TIP), torque_limits=25.0),
    "goal pose of the tool": lambda: two_link_problem(goal=eo.FramePose("tool", TIP, TURN)),
    "free waypoints and a timed one": lambda: two_link_problem(
        waypoints=[[0.0, 0.5], [0.2, 0.3], ([0.5, 0.0], 0.4), [1.0, -0.4]], torque_limits=30.0
    ),
    "free waypoint, goal position of the tool": lambda: two_link_problem(goal=eo.FramePose("tool", TIP), waypoints=[[0.2, 0.3]]),
}


def program_of(problem, method, compiled):
    """The program, with the rows that a fast straight motion calls for."""
    kernels = kernels_of(problem.robot.dynamics, compiled=compiled)
    space, cuts = method.space(problem.duration), Cuts()
    goal = problem.goal_position if problem.goal_position is not None else np.array([0.9, 0.4])
    cuts.add_violated(problem, eo.baseline(problem, goal=goal), kernels, space.everywhere)
    return transcribe(problem, space, kernels, cuts)


def some_point(program, seed=0):
    """Unknowns inside their bounds, near a motion that wriggles."""
    rng, x = np.random.default_rng(seed), program.guess(wriggle(program))
    return np.clip(x + 0.02 * rng.normal(size=x.size), program.lower, program.upper)


def wriggle(program):
    space = program.space
    goal = np.where(np.arange(program.layout.nv) % 2, -0.7, 1.1)
    return eo.Sinusoid(2).space(space.duration).trajectory(np.outer([0.1, 0, 0, 1, 0, 0, 0.1, -0.05, 0.04, 0.02], goal))


def evaluate(program, x, sigma=0.7, seed=1):
    """Objective, rows, gradient, dense Jacobian and dense symmetric Hessian of the Lagrangian."""
    multipliers = np.random.default_rng(seed).normal(size=program.rows)
    evaluator = program.evaluator
    evaluator.move(x)
    rows, gradient = np.empty(program.rows), np.empty(program.size)
    jacobian, hessian = np.empty(len(program.jacobian_pattern[1])), np.empty(len(program.hessian_pattern[1]))
    evaluator.constraints(x, rows)
    evaluator.gradient(gradient)
    evaluator.jacobian(jacobian)
    evaluator.hessian(sigma, multipliers, hessian)
    J = dense(jacobian, program.jacobian_pattern, (program.rows, program.size))
    H = dense(hessian, program.hessian_pattern, (program.size, program.size))
    assert not np.any(np.tril(H, -1)), "the pattern is the upper triangle's"
    slope = sigma * gradient + J.T @ multipliers
    values = {"objective": evaluator.objective(), "rows": rows, "gradient": gradient}
    return values | {"jacobian": J, "hessian": H + np.triu(H, 1).T, "slope": slope}


def dense(values, pattern, shape):
    start, row = pattern
    return csc_array((values, np.asarray(row), np.asarray(start)), shape=shape).toarray()


def differences(function, x, step=1e-4):
    """Central differences of fourth order of a vector function, columns by unknown."""
    columns = []
    for k in range(x.size):
        h = np.zeros(x.size)
        h[k] = step
        columns.append((8 * (function(x + h) - function(x - h)) - (function(x + 2 * h) - function(x - 2 * h))) / (12 * step))
    return np.stack(columns, axis=-1)


@pytest.fixture(params=METHODS)
def method(request):
    return METHODS[request.param]


@pytest.fixture(params=PROBLEMS)
def problem(request):
    return PROBLEMS[request.param]()


def test_gradient_jacobian_and_hessian_match_differences(problem, method):
    program = program_of(problem, method, compiled=True)
    x = some_point(program)
    found = evaluate(program, x)
    differenced = differences(lambda x: np.concatenate([[(e := evaluate(program, x))["objective"]], e["rows"], e["slope"]]), x)
    rows = program.rows
    assert arms.relative(found["gradient"], differenced[0]) < DIFFERENCES
    assert arms.relative(found["jacobian"], differenced[1 : rows + 1]) < DIFFERENCES
    assert arms.relative(found["hessian"], differenced[rows + 1 :]) < DIFFERENCES


def test_machine_code_and_numpy_give_the_same_program(problem, method):
    programs = [program_of(problem, method, compiled) for compiled in (True, False)]
    if type(programs[0].evaluator) is type(programs[1].evaluator) and not programs[0].extras:
        pytest.skip("no C compiler: both are the same evaluator")
    x = some_point(programs[0])
    mine, other = (evaluate(program, x) for program in programs)
    for name in ("objective", "rows", "gradient", "jacobian", "hessian"):
        # A rate row is the difference of two torques a tiny step apart: their rounding is magnified.
        tolerance = 100 * SAME_SUMS if name in ("rows", "jacobian") else SAME_SUMS
        assert arms.relative(mine[name], other[name]) < tolerance, name


def test_torque_and_rate_rows_are_there_where_limits_are_broken(method):
    broken = PROBLEMS["torque and rate rows"]()
    free = two_link_problem(torque_limits=2500.0, torque_rate_limits=1.5e6, velocity_limits=3.0)
    with_rows, without = (program_of(p, method, compiled=True) for p in (broken, free))
    assert with_rows.rows > without.rows
    assert without.linear_only and not with_rows.linear_only


def test_the_objective_is_the_quadrature_of_numeric_pinocchio(method):
    problem = PROBLEMS["friction and a slider"]()
    program = program_of(problem, method, compiled=True)
    x = program.guess(wriggle(program))
    c, w = program.coefficients(x), program.space.quadrature()[1]
    columns, basis = program.space.quadrature_basis()
    q, v, a = np.einsum("kol,kli->oki", basis, c[columns])
    tau = problem.robot.torque(q, v, a)
    program.evaluator.move(x)
    expected = w @ (tau**2 @ problem.torque_weights + v**2 @ problem.velocity_weight)
    assert program.evaluator.objective() == pytest.approx(expected, rel=1e-10)


def smooth_motion(problem, program):
    """The quintic; for collocation the nearest motion without defects, a cubic spline on its nodes."""
    quintic = eo.baseline(problem)
    if not program.space.defects().count:
        return quintic
    nodes = eo.BSpline(knots=tuple(program.space.breaks)).space(problem.duration)
    cubic = transcribe(problem, nodes, kernels_of(problem.robot.dynamics))
    return cubic.trajectory(cubic.guess(quintic))


FINE = {"cubic spline": eo.BSpline(control_points=40), "quintic spline": eo.BSpline(5, 40), "collocation": eo.HermiteSimpson(30)}


@pytest.mark.parametrize("name", FINE)
@pytest.mark.parametrize("key", ["velocity", "acceleration", "jerk"])
def test_rows_tell_a_motion_inside_its_limits_from_one_outside(name, key):
    """The quintic's peaks are 1.875 Δ/T, 5.774 Δ/T² and 60 Δ/T³; half of them is too little, twice enough (hulls are wider)."""
    move, T = 1.6, 0.7
    order, peak = {"velocity": (1, 1.875), "acceleration": (2, 5.774), "jerk": (3, 60.0)}[key]
    for factor, inside in ((0.5, False), (2.0, True)):
        problem = two_link_problem(goal=[-0.4 + move, 0.6], **{f"{key}_limits": factor * peak * move / T**order})
        program = transcribe(problem, FINE[name].space(T), kernels_of(problem.robot.dynamics))
        x, rows = program.guess(smooth_motion(two_link_problem(goal=[-0.4 + move, 0.6]), program)), np.empty(program.rows)
        program.evaluator.move(x)
        program.evaluator.constraints(x, rows)
        slack = 1e-9 * np.abs(rows).max()
        held = np.all(rows >= program.row_lower - slack) and np.all(rows <= program.row_upper + slack)
        # A guess is moved inside the bounds of single unknowns: then it is no longer the motion.
        t = np.linspace(0, T, 50)
        kept = np.abs(program.trajectory(x)(t) - eo.baseline(problem)(t)).max() < 2e-3
        assert (held and kept) == inside


def test_a_guess_inside_the_limits_is_kept_as_it_is(method):
    problem = two_link_problem()
    program = transcribe(problem, method.space(problem.duration), kernels_of(problem.robot.dynamics))
    t, motion = np.linspace(0, problem.duration, 101), smooth_motion(problem, program)
    exact = isinstance(method, eo.HermiteSimpson) or (isinstance(method, eo.BSpline) and method.degree == 5)
    np.testing.assert_allclose(program.trajectory(program.guess(motion))(t), motion(t), atol=1e-12 if exact else 2e-3)


def test_rows_at_points_come_to_an_end_where_a_motion_runs_along_a_limit():
    """It evades them by ever less, but within 15 rounds only once they are moved inside the limit, which costs little."""
    lower, upper = [-1.0, -0.3], [0.5, 3.0]
    problem = eo.Problem(arms.two_link(), [0.3, -0.2], [-0.5, 0.4], 3.0, position_limits=(lower, upper))
    plan = eo.plan(problem, eo.Sinusoid(harmonics=6), starts=1)
    q = plan.trajectory(np.linspace(0.0, 3.0, 5001))
    assert plan.solved and np.all(q > lower) and np.all(q < upper)
    assert np.abs(q.min(axis=0) - lower).max() < 1e-3
