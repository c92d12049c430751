"""Programs with a free duration and general cost terms: every derivative against finite differences."""

import ctypes

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt.actuators import ActuatorModel, Actuators
from energyopt.avoidance import avoidance_of
from energyopt.baselines import baseline
from energyopt.collision import Hinge
from energyopt.costs import AccelerationSquared, ElectricalEnergy, JerkSquared, MechanicalPower, TorqueSquared, VelocitySquared
from energyopt.dynamics import compiler
from energyopt.dynamics.kernels import kernels_of
from energyopt.parameterizations import BSpline, HermiteSimpson, Sinusoid
from energyopt.transcription import Cuts, transcribe
from energyopt.transcription.clearance import ClearanceTerms

DRIVE = ActuatorModel(torque_constant=0.1, gear_ratio=100.0, resistance=0.5, efficiency=0.8, regeneration=0.4)
DRIVES = Actuators([DRIVE, DRIVE], shared_bus=True, standby_power=12.0)
STEP, TOLERANCE = 1e-6, 2e-6  # central differences, relative to the largest entry


def make_problem(arm, **more):
    n = arm.nv
    given = {
        "start": np.linspace(-0.4, 0.3, n), "goal": np.linspace(0.5, -0.6, n), "duration": (0.7, 3.0),
        "start_velocity": np.linspace(0.2, -0.1, n), "goal_acceleration": np.linspace(-0.5, 0.4, n),
        "velocity_limits": 2.0, "acceleration_limits": 9.0, "jerk_limits": 200.0, "torque_limits": 60.0,
        "torque_rate_limits": 500.0,
    }  # fmt: skip
    return eo.Problem(arm, **(given | more))


def cuts():
    return Cuts(torque={(0.31, 0), (0.5, 1)}, rates={(0.7, 0.701, 0), (0.2, 0.2003, 1)}, samples={(1, 0.4, 0)})


def derivatives(program, x, sigma, multipliers):
    """Objective, rows, gradient, dense Jacobian and Hessian of the Lagrangian."""
    n, m, e = program.size, program.rows, program.evaluator
    e.move(x)
    gradient, rows = np.empty(n), np.empty(m)
    e.gradient(gradient)
    e.constraints(x, rows)
    J, H = np.zeros((m, n)), np.zeros((n, n))
    for dense, (start, row), call in ((J, program.jacobian_pattern, e.jacobian), (H, program.hessian_pattern, None)):
        values, column = np.empty(len(row)), np.repeat(np.arange(n), np.diff(start))
        call(values) if call else e.hessian(sigma, multipliers, values)
        dense[row, column] = values
    return e.objective(), rows, gradient, J, H + np.triu(H, 1).T


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("costs", ["squares", "jerk", "power"])
@pytest.mark.parametrize(
    "space", [BSpline(control_points=12), HermiteSimpson(intervals=6), Sinusoid(3)], ids=lambda s: type(s).__name__
)
def test_derivatives_with_a_free_duration(space, costs, compiled):
    two_link = arms.two_link()
    terms = [TorqueSquared(weights=[1.0, 2.0]), 0.3 * VelocitySquared(), 0.1 * AccelerationSquared(), 1e-3 * JerkSquared()]
    if costs == "power":
        terms = [*terms[:2], MechanicalPower(), 0.4 * ElectricalEnergy(actuators=DRIVES)]
    problem = make_problem(two_link, costs=None if costs == "squares" else terms).lasting(1.2)
    kernels = kernels_of(two_link.dynamics, compiled)
    program = transcribe(problem, space.space(1.2), kernels, cuts(), durations=(0.7, 3.0))
    check_derivatives(program, problem)


@pytest.mark.parametrize("name", ["xarm7_conveyor", "panda_clutter"])
def test_derivatives_of_clearance_with_a_free_duration(name):
    """A part on a conveyor moves on while the duration grows; shelves stand still."""
    problem = eo.load_problem(name).lasting(2.5)
    avoidance, instants = avoidance_of(problem), np.linspace(0.0, 2.5, 40)
    rows, penalised = {(0.8, 5, 0): 0.01, (1.4, 9, -2): 0.0}, (instants, np.full(40, 2.5 / 40))
    terms = lambda space, unknowns, cuts: ClearanceTerms(avoidance, space, unknowns, rows, Hinge(500.0, 0.05), penalised)
    space = BSpline(control_points=9).space(2.5)
    program = transcribe(problem, space, kernels_of(problem.robot.dynamics), Cuts(), terms, durations=(1.0, 5.0))
    check_derivatives(program, problem)
    assert program.extras[0].objective() > 0


def check_derivatives(program, problem):
    rng = np.random.default_rng(3)
    x = program.guess(baseline(problem, "quintic"))
    x = x + 0.05 * rng.normal(size=program.size)
    x[-1] = 0.23
    multipliers = rng.normal(size=program.rows)
    _, _, gradient, J, H = derivatives(program, x, 0.7, multipliers)
    expected = [np.zeros(program.size), np.zeros_like(J), np.zeros_like(H)]
    for k in range(program.size):
        sides = []
        for sign in (1, -1):
            moved = x.copy()
            moved[k] += sign * STEP
            f, g, df, dg, _ = derivatives(program, moved, 0.7, multipliers)
            sides.append((f, g, 0.7 * df + dg.T @ multipliers))
        for wanted, plus, minus in zip(expected, *sides, strict=True):
            wanted[..., k] = (plus - minus) / (2 * STEP)
    for found, wanted in zip((gradient, J, H), expected, strict=True):
        np.testing.assert_allclose(found, wanted, atol=TOLERANCE * np.abs(wanted).max())


@pytest.mark.parametrize("name", ["rest", "rates"])
def test_the_compiled_border_gives_the_same_numbers(name):
    """Between rests `stretch.c` does what the Python of `stretch` does."""
    if compiler.find_compiler() is None:
        pytest.skip("no C compiler")
    two_link, rng = arms.two_link(), np.random.default_rng(5)
    still = {"start_velocity": 0.0, "goal_acceleration": 0.0}
    problem = make_problem(two_link, **still, **({} if name == "rates" else {"torque_rate_limits": np.inf})).lasting(1.2)
    rows = cuts() if name == "rates" else Cuts(torque={(0.31, 0), (0.5, 1)})
    space = BSpline(control_points=12).space(1.2)
    program = transcribe(problem, space, kernels_of(two_link.dynamics), rows, durations=(0.7, 3.0))
    x = program.guess(baseline(problem, "quintic")) + 0.1 * rng.normal(size=program.size)
    x[-1], multipliers = 0.23, rng.normal(size=program.rows)
    expected = derivatives(program, x, 0.7, multipliers)
    context, addresses = program.evaluator.native
    call = lambda name, *given: ctypes.CFUNCTYPE(None, ctypes.c_void_p, *(kind for kind, _ in given))(addresses[name])(
        context, *(value for _, value in given)
    )
    array = lambda values: (ctypes.c_void_p, values.ctypes.data)
    sizes = program.rows, program.size, len(program.jacobian_pattern[1]), len(program.hessian_pattern[1])
    rows, gradient, jacobian, hessian = (np.zeros(size) for size in sizes)
    call("state", array(x))
    call("constraints", array(x), array(rows))
    call("gradient", array(gradient))
    call("jacobian", array(jacobian))
    call("hessian", (ctypes.c_double, 0.7), array(multipliers), array(hessian))
    program.evaluator.move(x)
    own_jacobian, own_hessian = np.zeros_like(jacobian), np.zeros_like(hessian)
    program.evaluator.jacobian(own_jacobian)
    program.evaluator.gradient(np.zeros(program.size))
    program.evaluator.hessian(0.7, multipliers, own_hessian)
    for found, wanted in ((rows, expected[1]), (gradient, expected[2]), (jacobian, own_jacobian), (hessian, own_hessian)):
        np.testing.assert_allclose(found, wanted, atol=1e-11 * np.abs(wanted).max())
