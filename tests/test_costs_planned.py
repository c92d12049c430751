"""Motions planned for each cost term: best by their own measure, equal to closed forms, the same by every method."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from arms import sliders, two_link

import energyopt as eo
from energyopt import costs
from energyopt.actuators import ActuatorModel, Actuators

START, GOAL, T = [-1.2, 0.4], [0.9, -0.6], 1.0


@cache
def arm():
    drive = ActuatorModel(50.0, 0.1, 0.3, efficiency=0.8, regeneration=0.3, brake_power=1.0)
    return replace(two_link(), actuators=Actuators([drive] * 2, shared_bus=True, standby_power=5.0))


@cache
def planned(name):
    return eo.plan(eo.Problem(arm(), START, GOAL, T, costs=[costs.COSTS[name]()]))


@pytest.mark.parametrize("name", [name for name, term in costs.COSTS.items() if term.uses])  # not the duration itself
def test_a_motion_planned_for_a_term_is_the_best_of_all_by_that_term(name):
    measured = {other: costs.integral(costs.COSTS[name](), arm(), planned(other).trajectory) for other in costs.COSTS}
    # Motions are planned to 1 %; the two powers come down to the same least work.
    assert measured[name] <= 1.01 * min(measured.values()) < 0.99 * max(measured.values())
    assert planned(name).objective == pytest.approx(measured[name], rel=1e-3)  # six Gauss nodes a span against 96
    assert set(planned(name).cost_terms) == {name}


def test_a_plan_says_what_smoothing_changes():
    notes = [note for note in planned("mechanical_power").notes if "smoothed" in note]
    motion, term = planned("mechanical_power").trajectory, costs.MechanicalPower()
    exact, lost = costs.integral(term, arm(), motion, exact=True), costs.smoothing_error(term, arm(), motion)
    assert notes == [f"mechanical_power is smoothed over 0.2 W, which puts it {lost:.2g} J below the exact {exact:.4g} J."]
    assert 0 < lost < 0.01 * exact
    assert not any("smoothed" in note for note in planned("torque_squared").notes)


def test_work_against_gravity_is_the_least_that_power_terms_can_come_to():
    # Rest to rest without friction ∫Σ τ q̇ dt is the potential energy gained, and neither |P| nor max(P, 0) can be less.
    at = lambda q: float(arm().dynamics.energy(np.array([q]), np.zeros((1, 2)))[0])
    gained = at(GOAL) - at(START)
    for term in (costs.MechanicalPower(), costs.PositivePower()):
        least = costs.integral(term, arm(), planned(term.name).trajectory, exact=True)
        # The planner minimises the smooth term to 1 % and the smoothing error is below 1 % here.
        assert gained * (1 - 1e-6) <= least <= 1.02 * gained


def test_least_jerk_is_the_quintic():
    d, time = 0.5, 1.2
    problem = eo.Problem(sliders(1), [0.0], [d], time, costs=[costs.JerkSquared()])
    plan = eo.plan(problem, parameterization=eo.BSpline(degree=5))
    assert plan.objective == pytest.approx(720 * d**2 / time**5, rel=1e-9)  # a spline of degree 5 can be the quintic
    s = np.linspace(0, 1, 50)[:, None]
    np.testing.assert_allclose(plan.trajectory(s[:, 0] * time), d * (10 * s**3 - 15 * s**4 + 6 * s**5), atol=1e-6)


def test_least_acceleration_is_the_cubic():
    d, time = 0.5, 1.2
    plan = eo.plan(eo.Problem(sliders(1), [0.0], [d], time, costs=[costs.AccelerationSquared(weight=2.0)]))
    # The cubic steps to its acceleration; the planned motion starts with none, which costs up to the accuracy of 1 %.
    assert 1.0 <= plan.objective / (2.0 * 12 * d**2 / time**3) <= 1.01


def test_the_default_written_as_terms_is_the_default():
    default = eo.plan(eo.Problem(arm(), START, GOAL, T, velocity_weight=0.3, torque_weights=[1.0, 2.0]))
    terms = [costs.TorqueSquared([1.0, 2.0]), 0.3 * costs.VelocitySquared()]
    same = eo.plan(eo.Problem(arm(), START, GOAL, T, costs=terms))
    assert same.objective == pytest.approx(default.objective, rel=1e-6)  # both are solved to IPOPT's tolerance
    t = np.linspace(0, T, 200)
    np.testing.assert_allclose(same.trajectory(t), default.trajectory(t), atol=1e-3)


@pytest.mark.parametrize("method", [eo.Sinusoid(), eo.HermiteSimpson()], ids=lambda method: type(method).__name__)
def test_every_method_finds_the_same_electrical_energy(method):
    plan = eo.plan(planned("electrical_energy").problem, parameterization=method)
    assert plan.objective == pytest.approx(planned("electrical_energy").objective, rel=0.03)  # each to 1 % or so


def test_a_plan_for_electrical_energy_comes_back_from_its_file(tmp_path):
    plan = planned("electrical_energy")
    plan.save(tmp_path / "plan.npz")
    back = eo.load_plan(tmp_path / "plan.npz")
    assert back.objective == plan.objective and back.problem.costs[0].actuators is back.problem.robot.actuators
    again = costs.integral(back.problem.costs[0], back.problem.robot, back.trajectory)
    assert again == costs.integral(costs.ElectricalEnergy(), arm(), plan.trajectory)
