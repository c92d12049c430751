"""The double integrator, whose optimum is known in closed form, rest to rest over a distance d in the time T.

With q̈ = u the minimum of ∫u² is 12 d²/T³, reached by u = 6 d/T² (1 − 2t/T). With the added term λ∫q̇² the optimum obeys
d⁴q/dt⁴ = λ d²q/dt² (Euler and Poisson), which from rest to rest gives

    J = λ d² / (T − (2/√λ) tanh(√λ T/2)),        u(0) = −u(T) = λ d tanh(√λT/2) / (√λ T − 2 tanh(√λT/2)).

The optimum starts with an acceleration. A motion that has to start and end with none is dearer by what the ramps cost:
on end spans of length ε, u rises linearly to u(0), and the loss to first order is ∫₀^ε (u(0)(1 − t/ε))² dt = u(0)² ε/3 an end.
"""

import arms
import numpy as np
import pytest

import energyopt as eo

CLOSED_FORM = 1e-6
"""Relative; the spline of degree 5 misses the exponentials by less."""
D, T = 1.0, 1.0


def optimum(weight, d=D, duration=T):
    if weight == 0:
        return 12 * d**2 / duration**3
    root = np.sqrt(weight)
    return weight * d**2 / (duration - 2 / root * np.tanh(root * duration / 2))


def first_acceleration(weight, d=D, duration=T):
    if weight == 0:
        return 6 * d / duration**2
    root = np.sqrt(weight)
    return weight * d * np.tanh(root * duration / 2) / (root * duration - 2 * np.tanh(root * duration / 2))


def knots(end_span, inner, duration=T):
    """Even spans between two end spans of a given length."""
    return (0.0, *np.linspace(end_span, duration - end_span, inner + 1), duration)


def solve(weight, method, duration=T, **options):
    """The plan; no limit is near unless it is given."""
    options = {"velocity_limits": 1e9, "torque_limits": 1e12, **options}
    return eo.plan(eo.Problem(arms.sliders(), [0.0], [D], duration, velocity_weight=weight, **options), method)


@pytest.mark.parametrize("weight, published", [(0, 12.0), (1, 13.1985871), (10, 23.8713172), (100, 124.9971627)])
def test_the_optimum_with_its_own_end_accelerations_is_the_closed_form(weight, published):
    assert optimum(weight) == pytest.approx(published, rel=1e-8)
    u0 = first_acceleration(weight)
    plan = solve(weight, eo.BSpline(degree=5, control_points=30, accuracy=None), start_acceleration=u0, goal_acceleration=-u0)
    assert plan.objective == pytest.approx(optimum(weight), rel=CLOSED_FORM)
    exact = eo.plan(plan.problem, eo.HermiteSimpson(100))
    assert exact.objective == pytest.approx(optimum(weight), rel=1e-4)  # Simpson's rule with piecewise linear u: h² of u''


def test_without_velocity_cost_the_optimum_is_the_cubic_itself():
    plan = solve(0, eo.BSpline(control_points=9, accuracy=None), start_acceleration=6.0, goal_acceleration=-6.0)
    t = np.linspace(0.0, T, 101)
    np.testing.assert_allclose(plan.trajectory(t)[:, 0], 3 * t**2 - 2 * t**3, atol=1e-7)
    np.testing.assert_allclose(plan.torque(t)[:, 0], 6 - 12 * t, atol=1e-4)
    assert plan.objective == pytest.approx(12.0, rel=1e-9)


@pytest.mark.parametrize("weight", [0, 10])
def test_starting_without_acceleration_costs_what_the_ramps_cost(weight):
    """The excess over the closed form is 2 ε u(0)²/3 to first order, so it vanishes with the end spans."""
    excess = {}
    for end_span in (4e-3, 2e-3, 1e-3):
        plan = solve(weight, eo.BSpline(knots=knots(end_span, 24), accuracy=None))
        assert plan.objective > optimum(weight)
        excess[end_span] = plan.objective - optimum(weight)
        assert excess[end_span] == pytest.approx(2 / 3 * end_span * first_acceleration(weight) ** 2, rel=0.02)


@pytest.mark.parametrize("weight", [0, 1, 100])
def test_zero_end_accelerations_converge_to_the_closed_form(weight):
    """Extrapolated to end spans of length zero (linear in ε, so the remainder is of the order ε²)."""
    coarse, fine = (solve(weight, eo.BSpline(knots=knots(e, 60), accuracy=None)).objective for e in (1e-4, 5e-5))
    assert 2 * fine - coarse == pytest.approx(optimum(weight), rel=CLOSED_FORM)


@pytest.mark.parametrize("accuracy", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("weight", [0, 100])
def test_the_accuracy_asked_for_is_reached_and_estimated(weight, accuracy):
    plan = solve(weight, eo.BSpline(accuracy=accuracy))
    error = plan.objective / optimum(weight) - 1
    assert 0 < error <= accuracy
    assert plan.discretization_error <= accuracy
    assert 1 / 3 < plan.discretization_error / error < 6, "the estimate is of the size of the true error"


@pytest.mark.parametrize("duration", [1e-3, 1e-2, 300.0, 1e4])
def test_the_cost_scales_with_the_third_power_of_the_duration(duration):
    plan = solve(0, eo.BSpline(control_points=20, accuracy=None), duration)
    reference = solve(0, eo.BSpline(control_points=20, accuracy=None))
    assert plan.objective * duration**3 == pytest.approx(reference.objective, rel=CLOSED_FORM)


def test_masses_and_torque_weights_enter_with_their_squares_and_values():
    """Three bodies on rails do not know of each other: J = Σ wᵢ mᵢ² 12 dᵢ²/T³."""
    masses, weights, d = (1.0, 2.5, 0.5), np.array([1.0, 0.3, 4.0]), np.array([1.0, -0.4, 2.0])
    ends = {"start_acceleration": 6 * d / T**2, "goal_acceleration": -6 * d / T**2}
    problem = eo.Problem(arms.sliders(3, masses), np.zeros(3), d, T, velocity_weight=0.0, torque_weights=weights, **ends)
    plan = eo.plan(problem, eo.BSpline(control_points=9, accuracy=None))
    assert plan.objective == pytest.approx(np.sum(weights * np.square(masses) * 12 * d**2 / T**3), rel=1e-9)
    assert plan.cost_terms["velocity_squared"] == 0.0


def test_a_velocity_limit_costs_what_the_closed_form_says():
    """With |q̇| ≤ V and 1 < VT/d < 3/2, u falls linearly to zero at t₁ = 3(T − d/V)/2, the body coasts, then the mirror image.

    From ∫u dt = V over [0, t₁] with u = (2V/t₁)(1 − t/t₁): d = V(T − 2t₁/3), J = 2 · (4V²/3t₁) = 8V²/(3t₁).
    """
    V = 1.25
    t1 = 1.5 * (T - D / V)
    ends = {"start_acceleration": 2 * V / t1, "goal_acceleration": -2 * V / t1}
    for inner in (15, 20, 40, 60):
        plan = solve(0, eo.BSpline(knots=knots(t1, inner), accuracy=None), velocity_limits=V, **ends)
        assert plan.objective == pytest.approx(8 * V**2 / (3 * t1), rel=CLOSED_FORM)
        assert np.abs(plan.trajectory(np.linspace(0, T, 400), 1)).max() == pytest.approx(V, rel=1e-6)
