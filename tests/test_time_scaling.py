"""Motions made slower or faster as a whole: against quadrature, finite differences, a scalar minimisation, the dense check."""

from dataclasses import replace

import arms
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.optimize import minimize_scalar

import energyopt as eo
from energyopt.cli import main
from energyopt.costs import TorqueSquared
from energyopt.parameterizations import PathTrajectory, PolynomialTrajectory, SplineTrajectory, trajectory_from_arrays
from energyopt.parameterizations.excursions import excursions
from energyopt.rescaling import rescale
from energyopt.verification import is_valid, objective, verify


def chain(friction="viscous"):
    """Three joints, two kinds, with rotors; gravity acts on all."""
    options = {"armature": (0.3, 0.5, 0.1)}
    if friction != "none":
        options["viscous_friction"] = (0.4, 2.0, 0.1)
    if friction == "coulomb":
        options["coulomb_friction"] = (1.5, 3.0, 0.5)
    return arms.mixed_chain(**options)


def problem_of(robot, duration=1.5, **options):
    q = 0.3 * arms.random_states(robot, 2, seed=3)[0]
    return eo.Problem(robot, q[0], q[1], duration, velocity_weight=0.7, self_collision=False, **options)


def scaling_of(problem, kind="quintic"):
    return eo.uniform_scaling(eo.baseline(problem, kind), problem.robot, problem.velocity_weight, problem.torque_weights)


def motions():
    """One of every kind, three joints."""
    robot = chain()
    problem = problem_of(robot)
    quintic = eo.baseline(problem)
    law = SplineTrajectory(np.repeat([0.0, 2.0], 4), 1.5 * np.array([[0.0], [0.1], [0.7], [1.0]]), 3)
    return {
        "spline": quintic,
        "polynomial": eo.baseline(problem, "trapezoidal"),
        "sinusoid": eo.baseline(problem, "cycloid"),
        "path": PathTrajectory(quintic, law),
    }


@pytest.mark.parametrize("kind", motions())
def test_a_stretched_motion_is_the_same_one_at_another_pace(kind):
    motion = motions()[kind]
    slow, r = motion.stretched(3.7), 3.7 / motion.duration
    assert slow.duration == 3.7 and slow.breaks[-1] == 3.7 and type(slow) is type(motion)
    t = np.random.default_rng(0).uniform(0, motion.duration, 100)
    for order in range(4):
        expected = motion(t, order) / r**order
        assert np.allclose(slow(r * t, order), expected, rtol=1e-9, atol=1e-9 * (1 + np.abs(expected).max()))


def test_a_motion_of_any_other_kind_can_be_stretched_too():
    class Parabola(PolynomialTrajectory):
        stretched = eo.baseline(problem_of(chain())).__class__.__mro__[1].stretched  # that of the abstract class

    motion = Parabola([0.0, 2.0], np.array([[[0.0], [0.0], [1.0]]]))
    slow = motion.stretched(6.0)
    assert isinstance(slow, PathTrajectory) and slow.duration == 6.0
    assert np.allclose(slow(np.array([0.0, 3.0, 6.0]))[:, 0], [0.0, 1.0, 4.0])
    assert np.allclose(slow(3.0, 1), 2.0 / 3.0)


def test_derivatives_of_a_path_passed_by_a_law_are_those_of_the_composition():
    """Central differences, 1e-5 apart; up to the fourth derivative of the third."""
    rng = np.random.default_rng(1)
    spline = make_interp_spline(np.linspace(0, 3, 7), rng.normal(size=(7, 2)), k=5)
    path = SplineTrajectory(spline.t, spline.c, 5)
    places = 3 * np.array([0.0, 0.0, 0.05, 0.3, 0.35, 0.8, 1.0, 1.0])
    law = SplineTrajectory(np.r_[0, 0, 0, np.linspace(0, 2, 6), 2, 2, 2], places[:, None], 3)
    motion, h = PathTrajectory(path, law), 1e-5
    t = rng.uniform(h, 2 - h, 200)
    t = t[np.abs(t[:, None] - motion.breaks).min(axis=1) > 2 * h]
    for order in range(4):
        slope = (motion(t + h, order) - motion(t - h, order)) / (2 * h)
        assert np.allclose(slope, motion(t, order + 1), rtol=1e-4, atol=1e-3)
    passed = law(motion.breaks)[:, 0]
    assert all(np.abs(passed - s).min() < 1e-12 for s in path.breaks), "every break of the path is a break of the motion"


def test_a_path_with_its_law_comes_back_from_its_arrays_bit_for_bit():
    motion = motions()["path"]
    again, t = trajectory_from_arrays(motion.kind, motion.to_arrays()), np.linspace(0, motion.duration, 50)
    assert all(np.array_equal(again(t, order), motion(t, order)) for order in range(4))
    assert np.array_equal(again.breaks, motion.breaks)


def test_a_law_that_runs_backwards_or_leaves_the_path_is_refused():
    path = eo.baseline(problem_of(chain()))
    law = lambda values: SplineTrajectory(np.repeat([0.0, 1.0], 4), np.array(values)[:, None], 3)
    with pytest.raises(ValueError, match="backwards"):
        PathTrajectory(path, law([0.0, 2.0, -0.5, 1.5]))
    with pytest.raises(ValueError, match=r"the path from 0 to 1\.5"):
        PathTrajectory(path, law([0.0, 0.5, 1.0, 2.0]))


def test_no_joint_goes_farther_on_a_path_than_the_bound_says():
    motion = motions()["path"]
    edges = np.union1d(motion.breaks, np.linspace(0, motion.duration, 20))
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    bound = excursions(motion, middle, half)
    for share in np.linspace(-1, 1, 21):
        assert np.all(np.abs(motion(middle + share * half) - motion(middle)) <= bound + 1e-12)


@pytest.mark.parametrize("kind", ["quintic", "trapezoidal", "cycloid"])
@pytest.mark.parametrize("friction", ["none", "viscous", "coulomb"])
def test_the_closed_form_is_the_integral_of_the_stretched_motion(friction, kind):
    """Relative error 1e-9 without Coulomb friction, whose steep change of sign a quadrature resolves to 1e-6 only."""
    problem = problem_of(chain(friction))
    scaling = scaling_of(problem, kind)
    assert scaling.closed_form == (friction != "coulomb")
    tolerance = 1e-6 if friction == "coulomb" else 1e-9
    for T in (0.2, 1.0, 1.5, 7.0):
        direct = objective(problem.lasting(T), scaling.trajectory(T))
        assert scaling.objective(T) == pytest.approx(direct, rel=tolerance)
        h = 1e-5 * T
        slope = (scaling.objective(T + h) - scaling.objective(T - h)) / (2 * h)
        assert scaling.slope(T) == pytest.approx(slope, rel=1e-6, abs=1e-6 * scaling.objective(T) / T)


@pytest.mark.parametrize("friction", ["none", "viscous", "coulomb"])
def test_the_cheapest_duration_is_where_a_scalar_minimisation_finds_it(friction):
    scaling = scaling_of(problem_of(chain(friction)))
    found = minimize_scalar(scaling.objective, bounds=(0.05, 20.0), method="bounded", options={"xatol": 1e-9})
    assert scaling.cheapest((0.05, 20.0)) == pytest.approx(found.x, rel=1e-4)
    assert scaling.objective(scaling.cheapest((0.05, 20.0))) <= found.fun * (1 + 1e-12)
    assert 0.05 < found.x < 20.0


def test_the_cheapest_duration_stays_inside_bounds_and_limits():
    problem = problem_of(chain())
    scaling = scaling_of(problem)
    best, least = scaling.cheapest((0.01, 20.0)), scaling.least_duration(problem.limits)
    assert scaling.cheapest((2 * best, 3 * best)) == 2 * best and scaling.cheapest((0.1 * best, 0.5 * best)) == 0.5 * best
    assert scaling.cheapest(limits=problem.limits) == pytest.approx(max(best, least), rel=1e-12)
    slow = replace(problem.limits, velocity=np.full(3, 0.2))
    assert scaling.cheapest((0.01, 20.0), limits=slow) == scaling.least_duration(slow) > best


def test_without_gravity_the_cheapest_motion_has_no_duration():
    robot = arms.sliders(1)
    scaling = scaling_of(eo.Problem(robot, [0.0], [0.5], 1.0, self_collision=False))
    with pytest.raises(eo.InputError, match="falls with every second more"):
        scaling.cheapest()
    assert scaling.cheapest((1.0, 3.0)) == 3.0


LIMITS = {
    "velocity": {"velocity_limits": 0.8},
    "acceleration": {"acceleration_limits": (2.0, 1.0, 3.0)},
    "jerk": {"jerk_limits": 9.0},
    "torque": {"torque_limits": (40.0, 40.0, 20.0)},
    "all": {"velocity_limits": 0.8, "acceleration_limits": 2.0, "jerk_limits": 9.0, "torque_limits": (40.0, 40.0, 20.0)},
}


@pytest.mark.parametrize("kind", LIMITS)
@pytest.mark.parametrize("shape", ["quintic", "cycloid"])
def test_at_its_least_duration_a_motion_holds_its_limits_and_just_below_it_does_not(kind, shape):
    """The dense check, which finds extrema in another way, agrees to 0.1 %."""
    robot = chain().with_limits(velocity=np.full(3, 100.0), torque=np.full(3, 1e4))
    problem = problem_of(robot, **LIMITS[kind])
    scaling = scaling_of(problem, shape)
    least = scaling.least_duration(problem.limits)
    check = lambda T: is_valid(verify(problem.lasting(T), scaling.trajectory(T)))
    assert check(least * (1 + 1e-6)) and not check(least * 0.999)


def test_a_weight_that_cannot_be_held_may_still_be_swung_through():
    """A pendulum is swung past the horizontal, where 9.81 N·m would hold it, while it brakes: not too slowly, not too fast."""
    problem = eo.Problem(arms.pendulum(), [-1.5], [0.6], 1.0, torque_limits=9.0, velocity_limits=1e3, self_collision=False)
    scaling = scaling_of(problem)
    ((low, high),) = scaling.allowed(problem.limits)
    assert 0.1 < low < high < 10.0
    check = lambda T: is_valid(verify(problem.lasting(T), scaling.trajectory(T)))
    assert [check(T) for T in (0.999 * low, 1.001 * low, 0.999 * high, 1.001 * high)] == [False, True, True, False]


def test_a_weight_that_cannot_be_held_at_an_end_cannot_be_moved_at_any_duration():
    problem = eo.Problem(arms.pendulum(), [0.0], [-3.0], 1.0, self_collision=False)
    weak = replace(problem.limits, torque=np.array([9.0]))
    with pytest.raises(
        eo.InputError, match=r"joint 'joint1' needs 9\.81 N·m to be held at 0 % of the way, its torque limit is 9;"
    ):
        scaling_of(problem).least_duration(weak)


def test_a_plan_made_slower_is_judged_anew_and_its_ends_are_scaled():
    robot = arms.two_link()
    problem = eo.Problem(robot, [0.0, 0.0], [1.0, 0.5], 1.0, start_velocity=[0.4, 0.0], self_collision=False)
    plan = eo.plan(problem)
    slow = rescale(plan, 2.0)
    assert slow.solved and slow.duration == 2.0 and np.allclose(slow.problem.start_velocity, [0.2, 0.0])
    assert slow.objective == pytest.approx(eo.uniform_scaling(plan.trajectory, robot).objective(2.0), rel=1e-9)
    assert not slow.optima and slow.time_s.keys() == plan.time_s.keys(), "the optima were those of another duration"
    fast = rescale(plan, 0.05)
    assert fast.status is eo.Status.LIMITS_VIOLATED and "exceeds its limit" in fast.message
    best = rescale(plan, lambda scaling: scaling.cheapest((0.3, 5.0)))
    assert best.objective <= min(plan.objective, slow.objective) * (1 + 1e-12)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda s: s.objective(-1.0), "duration is -1.0: expected one number of seconds"),
        (lambda s: s.objective((1.0, 2.0)), "expected one number of seconds"),
        (lambda s: s.trajectory(np.nan), "duration is nan"),
        (lambda s: s.cheapest((2.0, 1.0)), "the first is above the second"),
        (lambda s: s.cheapest(3.0), "expected a pair"),
        (lambda s: s.cheapest((0.001, 0.002), limits=s.robot.limits), "the limits hold from .* s on"),
        (lambda s: eo.uniform_scaling(s.motion, None), "expected a trajectory"),
        (lambda s: eo.uniform_scaling(s.motion, arms.two_link()), "expected a trajectory"),
        (lambda s: eo.uniform_scaling(s.motion, s.robot, velocity_weight=-1.0), "velocity_weight"),
    ],
)
def test_bad_input_is_one_clear_line(call, said):
    with pytest.raises(eo.InputError, match=said) as caught:
        call(scaling_of(problem_of(chain())))
    assert "\n" not in str(caught.value)


def test_the_command_line_scales_a_saved_plan(tmp_path, capsys):
    robot = arms.two_link()
    plan = eo.plan(eo.Problem(robot, [0.0, 0.0], [1.0, 0.5], 1.0, self_collision=False))
    plan.save(tmp_path / "plan.npz")
    run = lambda *words: main(["scale", str(tmp_path), "--no-replay", "--no-figures", *words])
    assert run("--cheapest", "--out", str(tmp_path / "cheapest")) == 0
    cheapest = eo.load_plan(tmp_path / "cheapest" / "plan.npz")
    scaling = eo.uniform_scaling(plan.trajectory, robot)
    assert cheapest.duration == pytest.approx(scaling.cheapest(limits=plan.problem.limits), rel=1e-12)
    assert run("--duration", "2") == 0 and "two" not in capsys.readouterr().err
    assert run("--duration", "0.01") == 1
    assert run("--duration", "-1") == 2 and capsys.readouterr().err.count("\n") == 1


def test_other_costs_have_no_closed_form_here():
    robot = arms.two_link()
    problem = eo.Problem(robot, [0.0, 0.0], [1.0, 0.5], 1.0, costs=[TorqueSquared()], self_collision=False)
    plan = eo.plan(problem)
    assert rescale(plan, 2.0).solved
    with pytest.raises(eo.InputError, match="give the duration"):
        rescale(plan, lambda scaling: scaling.cheapest())
