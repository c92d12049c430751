"""What-if sessions: re-solves find what fresh plans of the changed problems find, compile nothing, follow the base problem."""

from dataclasses import replace

import arms
import numpy as np
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.costs import MechanicalPower
from energyopt.dynamics import compiler
from energyopt.verification import is_valid, objective, verify

SAME_OPTIMUM = 1e-4
"""Relative difference of J of two solves to the solver's tolerance on the same knots."""
FIXED = eo.BSpline(control_points=16, accuracy=None)


def rods(**options):
    text = factory.planar_arm([0.5, 0.4], [2.0, 1.5], velocity=4.0, effort=60.0)
    return arms.from_urdf(text, **options)


def swing(robot=None, **options):
    """A move so short that the straight guess leads to the optimum that a session follows."""
    return eo.Problem(robot or rods(), [0.2, -0.4], [0.8, 0.1], 0.6, **options)


def reach(**options):
    start, goal = [0.0, -1.2, 1.4, -1.0, 0.3, 0.0], [1.0, -0.6, 0.7, -0.2, 0.8, 0.5]
    return eo.Problem(arms.catalogue_robot("ur5"), start, goal, 1.0, self_collision=False, **options)


PROBLEMS = {"two links": swing, "ur5": reach}
CHANGES = {
    "payload": lambda p: {"payload": eo.Payload(0.5, center=(0.05, 0.0, 0.02), inertia=(1e-3, 1e-3, 2e-3))},
    "mass": lambda p: {"mass": 1.0},
    "heavier links": lambda p: {"masses": 1.2},
    "viscous friction": lambda p: {"viscous_friction": 0.5},
    "armature": lambda p: {"armature": 0.1},
    "gravity": lambda p: {"gravity": (0.0, 0.0, -9.0)},
    "longer": lambda p: {"duration": 1.1 * p.duration},
    "shorter": lambda p: {"duration": 0.95 * p.duration},
    "velocity weight": lambda p: {"velocity_weight": 2.0 * p.velocity_weight},
    "torque weights": lambda p: {"torque_weights": np.linspace(1.0, 2.0, p.robot.nv)},
    "goal": lambda p: {"goal": p.goal + 0.05},
    "start": lambda p: {"start": p.start - 0.05},
    "velocity limits": lambda p: {"velocity_limits": 0.95 * p.limits.velocity},
    "torque limits": lambda p: {"torque_limits": 0.9 * p.limits.torque},
    "two at once": lambda p: {"mass": 0.3, "goal": p.goal + 0.03},
}


@pytest.fixture(scope="module", params=PROBLEMS)
def session(request):
    return eo.what_if(PROBLEMS[request.param](), parameterization=FIXED)


@pytest.mark.parametrize("change", CHANGES)
def test_a_re_solve_finds_what_a_fresh_plan_finds(session, change):
    """On knots that are not refined; the fresh plan starts from the straight guess."""
    changes = CHANGES[change](session.base.problem)
    found = session.solve(**changes)
    fresh = eo.plan(eo.what_if_problem(session.base.problem, **changes), FIXED)
    assert found.solved and fresh.solved
    assert abs(found.objective / fresh.objective - 1.0) < SAME_OPTIMUM
    assert is_valid(verify(found.problem, found.trajectory))
    assert abs(objective(found.problem, found.trajectory) / found.objective - 1.0) < 1e-9


def test_changes_count_from_the_base_and_not_from_the_last_solve(session):
    heavy = session.solve(mass=1.0)
    assert heavy.objective > session.base.objective
    assert abs(session.solve().objective / session.base.objective - 1.0) < SAME_OPTIMUM


def test_a_changed_robot_is_the_robot_loaded_with_these_numbers():
    """Torques, and what a replay reads: the prepared URDF."""
    held = eo.Payload(0.7, center=(0.1, 0.02, -0.03), inertia=(1e-3, 2e-3, 2e-3))
    numbers = {"payload": held, "viscous_friction": [0.3, 0.1], "armature": 0.05, "gravity": (0.0, 0.0, -3.7)}
    changed, loaded = eo.what_if_problem(swing(), **numbers).robot, rods(**numbers)
    states = arms.random_states(loaded, 30)
    assert arms.relative(changed.torque(*states), loaded.torque(*states)) < 1e-12
    assert changed.geometry is not changed and "payload" in changed.urdf


def test_nothing_is_compiled_for_other_numbers(session, monkeypatch):
    monkeypatch.setattr(compiler, "compile_library", lambda *_: pytest.fail("compiled"))
    for changes in ({"mass": 0.25}, {"armature": 0.02, "viscous_friction": 0.1}, {"masses": 0.9, "gravity": (0, 0, -8.0)}):
        assert session.solve(**changes).solved


def test_re_solves_take_fewer_iterations_than_plans_and_are_as_accurate():
    session = eo.what_if(reach())
    for changes in ({"mass": 0.3}, {"velocity_weight": 0.2}, {"duration": 1.05}, {"goal": session.base.problem.goal - 0.03}):
        found, fresh = session.solve(**changes), eo.plan(eo.what_if_problem(session.base.problem, **changes))
        assert found.iterations <= 0.6 * fresh.iterations
        assert found.discretization_error <= 0.01
        assert abs(found.objective / fresh.objective - 1.0) < 0.02  # two estimated errors of at most 1 %


def test_knots_are_refined_where_a_change_makes_them_too_coarse():
    session = eo.what_if(reach())
    slow = session.solve(duration=1.6)
    assert slow.solved and slow.discretization_error <= 0.01
    assert len(slow.trajectory.breaks) > len(session.base.trajectory.breaks)
    assert len(session.solve(velocity_weight=0.11).trajectory.breaks) == len(slow.trajectory.breaks)  # and kept


@pytest.mark.parametrize(
    "problem, parameterization, changes",
    [
        (swing(), eo.Sinusoid(harmonics=6), {"mass": 0.5}),
        (swing(), eo.HermiteSimpson(intervals=30), {"duration": 0.65}),
        (eo.Problem(rods(), [0.2, -0.4], [0.8, 0.1], (0.4, 2.0)), None, {"mass": 0.5}),
        (eo.Problem(rods(), [0.2, -0.4], [0.8, 0.1], 0.6, waypoints=[[0.5, -0.1]]), FIXED, {"velocity_weight": 1.0}),
        (swing(costs=MechanicalPower()), FIXED, {"mass": 0.2}),
    ],
    ids=["sinusoid", "collocation", "free duration", "waypoint", "power"],
)
def test_sessions_hold_for_every_kind_of_problem(problem, parameterization, changes):
    """A session follows the optimum it began with; many guesses for the changed problem may find a far better one."""
    options = {} if parameterization is None else {"parameterization": parameterization}
    session = eo.what_if(problem, **options)
    fresh = eo.plan(eo.what_if_problem(problem, **changes), guess=session.plan, **options)
    found = session.solve(**changes)
    assert found.solved and found.objective <= fresh.objective * 1.01


def test_clearance_holds_when_an_obstacle_moves():
    start, goal = [0.0, -0.7, 0.0, -2.2, 0.0, 1.6, 0.8], [1.2, 0.2, 0.0, -1.6, 0.0, 1.8, 0.8]
    ball = lambda y: (eo.Sphere(0.08, (0.45, y, 0.55)),)
    session = eo.what_if(eo.Problem(arms.catalogue_robot("panda"), start, goal, 2.0, obstacles=ball(0.35)))
    found = session.solve(obstacles=ball(0.30), mass=0.5)
    assert found.solved and found.violations.distance >= -1e-6


def test_a_cold_start_as_well_gives_the_better_of_the_two():
    session = eo.what_if(swing(), parameterization=FIXED)
    changes = {"goal": [-1.0, -0.9]}
    both = session.solve(cold=True, **changes)
    fresh = eo.plan(eo.what_if_problem(session.base.problem, **changes), FIXED)
    assert both.solved and both.objective <= fresh.objective * (1 + SAME_OPTIMUM)


def test_a_change_that_leaves_no_motion_is_told_and_the_session_goes_on():
    session = eo.what_if(swing(), parameterization=FIXED)
    failed = session.solve(torque_limits=[20.0, 5.2], duration=0.4, throw=False)
    assert not failed.solved
    with pytest.raises((eo.NoSolutionFound, eo.InputError)):
        session.solve(torque_limits=[20.0, 5.2], duration=0.4)
    assert abs(session.solve().objective / session.base.objective - 1.0) < SAME_OPTIMUM


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"payloads": 1.0}, "no change is named 'payloads'; nearest: payload"),
        ({"payload": 1.0}, "expected an energyopt.Payload"),
        ({"payload": eo.Payload(1.0), "mass": 1.0}, "expected one of them"),
        ({"mass": -1.0}, "expected a positive number"),
        ({"viscous_friction": [1.0, -1.0]}, "viscous_friction of joint"),
        ({"goal": [9.0, 0.0]}, "goal"),
        ({"duration": 0.0}, "duration"),
        ({"robot": None}, "no change is named 'robot'"),
    ],
)
def test_changes_that_make_no_sense_are_named(changes, said):
    session = eo.what_if(swing(), parameterization=FIXED)
    with pytest.raises(eo.InputError, match=said) as caught:
        session.solve(**changes)
    assert "\n" not in str(caught.value)


def test_ctrl_c_ends_a_re_solve_as_it_ends_a_plan(session, monkeypatch):
    """With the best motion so far, and without an exception; the session stays where it was."""
    before, half = session.plan, replace(session.base, status=eo.Status.INTERRUPTED, message="interrupted")
    monkeypatch.setattr(session, "_resolve", lambda problem: half)
    assert session.solve(velocity_weight=0.3).status is eo.Status.INTERRUPTED and session.plan is before
    monkeypatch.setattr("energyopt.planning.plan", lambda *_, **__: half)
    with pytest.raises(KeyboardInterrupt):
        eo.what_if(swing())


def test_sessions_begin_with_a_problem_or_a_solved_plan():
    plan = eo.plan(swing(), FIXED)
    assert eo.what_if(plan).base is plan
    for wrong, options in (("swing", {}), (plan, {"starts": 3})):
        with pytest.raises(eo.InputError, match="what_if"):
            eo.what_if(wrong, **options)
