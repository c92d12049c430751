"""The dense check: it finds what is broken, where, by how much, and nothing else."""

import time
from dataclasses import replace

import numpy as np
import pytest
import urdf_factory as factory
from scipy.optimize import minimize_scalar

import energyopt as eo
from energyopt.parameterizations.trajectory import PolynomialTrajectory, SinusoidTrajectory, SplineTrajectory
from energyopt.sampling import extrema, gauss_grid, sample_spans, unit_roots
from energyopt.verification import cost, describe, excessive, is_valid, limits_hold, verify

EXACT = 1e-9


@pytest.fixture(scope="module")
def slider(tmp_path_factory):
    return eo.load_robot(factory.write(tmp_path_factory.mktemp("one"), factory.sliders(1)))


@pytest.fixture(scope="module")
def panda():
    return eo.load_robot("panda")


def random_spline(nv, degree, seed, count=12, duration=2.0):
    rng = np.random.default_rng(seed)
    inner = np.sort(rng.uniform(0.1, duration - 0.1, count - degree - 1))
    knots = np.concatenate([np.zeros(degree + 1), inner, np.full(degree + 1, duration)])
    return SplineTrajectory(knots, rng.normal(size=(count, nv)), degree)


def quintic(slider, **options):
    problem = eo.Problem(slider, [0.0], [1.6], 1.0, **options)
    return problem, eo.baseline(problem)


def test_margins_of_a_quintic_are_the_closed_forms(slider):
    """Peak velocity 15/8·1.6 = 3 at T/2, peak acceleration 10/√3·1.6, torque = acceleration for a unit mass."""
    problem, motion = quintic(slider, velocity_limits=4.0, acceleration_limits=20.0, torque_limits=10.0)
    found = verify(problem, motion)
    assert is_valid(found) and describe(found).startswith("every limit holds; tightest: torque of joint1")
    acceleration = 16 / np.sqrt(3)
    assert found.margin["velocity"] == pytest.approx(25.0, abs=EXACT)
    assert found.margin["acceleration"] == pytest.approx(100 * (1 - acceleration / 20), abs=EXACT)
    assert found.margin["torque_percent"] == pytest.approx(100 * (1 - acceleration / 10), abs=1e-4)
    assert found.worst["velocity"] == ("joint1", pytest.approx(0.5, abs=EXACT))


def test_every_broken_limit_is_reported_with_its_exact_excess(slider):
    problem, motion = quintic(
        slider, velocity_limits=2.5, acceleration_limits=9.0, jerk_limits=90.0, torque_limits=8.0, position_limits=(-1.0, 1.5)
    )
    amount = verify(problem, motion).amount
    acceleration = 16 / np.sqrt(3)
    assert amount["position"] == pytest.approx(0.1, abs=EXACT)
    assert amount["velocity"] == pytest.approx(0.5, abs=EXACT)
    assert amount["acceleration"] == pytest.approx(acceleration - 9.0, abs=EXACT)
    assert amount["jerk"] == pytest.approx(60 * 1.6 - 90.0, abs=1e-8)
    assert amount["torque_percent"] == pytest.approx(100 * (acceleration / 8 - 1), abs=1e-3)


def test_torque_rate_of_a_unit_mass_is_its_jerk(slider):
    problem, motion = quintic(slider, torque_rate_limits=80.0)
    found = verify(problem, motion)
    assert found.amount["torque_rate"] == pytest.approx(60 * 1.6 - 80.0, rel=1e-6)
    assert excessive(found) == ["torque_rate"]


def test_torque_rate_of_an_arm_is_the_finite_difference_of_its_torque(panda):
    middle = 0.5 * (panda.limits.lower + panda.limits.upper)
    problem = eo.Problem(panda, middle - 0.4, middle + 0.4, 1.0, torque_rate_limits=1.0)
    motion = eo.baseline(problem)
    t = np.linspace(2e-5, 1 - 2e-5, 4000)
    after, before = (panda.torque(*(motion(s, order) for order in range(3))) for s in (t + 1e-5, t - 1e-5))
    rate = np.abs(after - before).max() / 2e-5
    # The dense check samples 320 times: the peak between two samples is missed by less than 1e-3 of it.
    assert verify(problem, motion).amount["torque_rate"] + 1.0 == pytest.approx(rate, rel=1e-3)


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("degree", [3, 4, 5])
def test_a_violation_between_samples_is_caught(slider, degree, order):
    """The limit is put between the true extremum and the largest dense sample."""
    motion = random_spline(1, degree, seed=10 * degree + order)
    fine = np.unique(sample_spans(motion, 4000).flat(order))
    limit = {0: "position_limits", 1: "velocity_limits", 2: "acceleration_limits"}[order]
    top = np.abs(fine).max()
    sampled = np.abs(sample_spans(motion, 3).flat(order)).max()
    value = 0.5 * (top + sampled) if top > sampled else top * (1 - 1e-6)
    bounds = {limit: (-value, value) if order == 0 else value}
    found = verify(eo.Problem(slider, motion(0.0), motion(2.0), 2.0, **bounds), motion, per_span=3)
    name = limit.removesuffix("_limits")
    assert found.amount[name] >= top - value > 0
    assert found.amount[name] == pytest.approx(top - value, abs=1e-5 * top)


@pytest.mark.parametrize("seed", range(3))
def test_extrema_of_a_spline_agree_with_a_bounded_search(seed):
    motion = random_spline(2, 5, seed)
    times, values = extrema(motion, 1)
    for k, (left, right) in enumerate(zip(motion.breaks[:-1], motion.breaks[1:], strict=True)):
        inside = (times[:, 0] >= left) & (times[:, 0] <= right)
        found = max(values[inside, 0].max(), motion(left, 1)[0], motion(right, 1)[0])
        grid = np.linspace(left, right, 400)
        start = grid[np.argmax(motion(grid, 1)[:, 0])]
        span = (right - left) / 300
        bounds = (max(left, start - span), min(right, start + span))
        search = minimize_scalar(lambda t: -motion(t, 1)[0], bounds=bounds, method="bounded", options={"xatol": 1e-12})
        assert found == pytest.approx(max(-search.fun, motion(left, 1)[0], motion(right, 1)[0]), abs=1e-7), k


def test_extrema_of_a_sinusoid_are_exact(slider):
    """q = sin 2πs·0.3 over 3 s: |v| up to 0.2π, |a| up to 0.3 (2π/3)², met at quarter turns between no samples."""
    motion = SinusoidTrajectory(3.0, np.zeros((1, 1)), np.array([[0.3]]), np.array([[0.05]]))
    size = np.hypot(0.3, 0.05)
    for order in (0, 1, 2):
        assert np.abs(extrema(motion, order)[1]).max() == pytest.approx(size * (2 * np.pi / 3) ** order, abs=1e-12)


def test_roots_of_random_polynomials_are_all_found():
    rng = np.random.default_rng(4)
    for degree in (1, 2, 3, 4):
        roots = rng.uniform(0.05, 0.95, (50, degree))
        coefficients = np.array([np.polynomial.polynomial.polyfromroots(r) for r in roots]) * rng.normal(size=(50, 1))
        np.testing.assert_allclose(np.sort(unit_roots(coefficients)), np.sort(roots), atol=1e-5)
    # A vanishing leading coefficient leaves the roots of what is left.
    found = unit_roots(np.array([[-0.25, 0.0, 1.0, 0.0], [-0.5, 1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(found.max(axis=1), 0.5, atol=1e-6)


def test_one_sided_samples_see_both_sides_of_a_jump(slider):
    problem = eo.Problem(slider, [0.0], [1.0], 1.0)
    samples = sample_spans(eo.baseline(problem, "trapezoidal"))
    a = samples.derivative(2)[:, :, 0]
    np.testing.assert_allclose(a[:, 0], [4.5, 0.0, -4.5], atol=EXACT)
    np.testing.assert_allclose(a[:, -1], [4.5, 0.0, -4.5], atol=EXACT)


def test_a_jump_of_acceleration_breaks_any_jerk_limit_and_any_torque_rate_limit(slider):
    problem = eo.Problem(slider, [0.0], [1.0], 1.0, jerk_limits=100.0, torque_rate_limits=100.0)
    found = verify(problem, eo.baseline(problem, "trapezoidal"))
    assert {"jerk", "torque_rate"} <= set(excessive(found))


def test_a_jump_of_position_or_velocity_is_no_motion(slider):
    broken = PolynomialTrajectory(np.array([0.0, 0.5, 1.0]), np.array([[[0.0], [0.0]], [[0.0], [2.0]]]))
    problem = eo.Problem(slider, [0.0], [1.0], 1.0, goal_velocity=2.0)
    found = verify(problem, broken)
    assert found.amount["continuity"] == pytest.approx(2.0) and found.worst["continuity"] == ("joint1", 0.5)
    assert not is_valid(found) and not limits_hold(found)


@pytest.mark.parametrize(
    "change",
    [
        {"start": [0.01]},
        {"goal": [1.59]},
        {"start_velocity": 0.1},
        {"goal_velocity": -0.1},
        {"start_acceleration": 0.2},
        {"goal_acceleration": 0.2},
        {"duration": 1.01},
        {"waypoints": [([5.0], 0.5)]},
        {"waypoints": [[5.0]]},
    ],
)
def test_a_missed_condition_is_not_valid(slider, change):
    problem, motion = quintic(slider)
    assert is_valid(verify(problem, motion))
    asked = {"start": [0.0], "goal": [1.6], "duration": 1.0} | change
    found = verify(eo.Problem(slider, **asked), motion)
    assert not is_valid(found) and "missed by" in describe(found)


def test_waypoints_without_time_must_be_passed_in_order(slider):
    there = eo.Problem(slider, [0.0], [1.6], 1.0, waypoints=[[0.4], [1.1]])
    back = eo.Problem(slider, [0.0], [1.6], 1.0, waypoints=[[1.1], [0.4]])
    motion = eo.baseline(eo.Problem(slider, [0.0], [1.6], 1.0))
    assert verify(there, motion).amount["waypoint"] < 1e-9
    assert verify(back, motion).amount["waypoint"] == pytest.approx(0.7, abs=1e-6)


def test_cartesian_goal_error_adds_metres_and_radians(panda):
    q = panda.limits.lower + 0.5 * (panda.limits.upper - panda.limits.lower)
    frame = panda.tool_frame
    pose = panda.placement(frame, q + 0.1)
    turn = np.array([[1, 0, 0], [0, np.cos(0.2), -np.sin(0.2)], [0, np.sin(0.2), np.cos(0.2)]])
    motion = eo.baseline(eo.Problem(panda, q, q + 0.1, 1.0))
    exact = eo.Problem(panda, q, eo.FramePose(frame, pose.translation, pose.rotation), 1.0)
    assert is_valid(verify(exact, motion))
    off = eo.Problem(panda, q, eo.FramePose(frame, pose.translation + [0.03, 0, 0.04], pose.rotation @ turn), 1.0)
    assert verify(off, motion).amount["goal"] == pytest.approx(0.05 + 0.2, abs=1e-6)


def test_infinite_limits_have_no_entry_and_mixed_ones_only_judge_finite_joints(panda):
    q = 0.5 * (panda.limits.lower + panda.limits.upper)
    plain = verify(eo.Problem(panda, q, q + 0.3, 1.0), eo.baseline(eo.Problem(panda, q, q + 0.3, 1.0)))
    assert not {"acceleration", "jerk", "torque_rate", "goal", "waypoint"} & set(plain.amount)
    mixed = eo.Problem(panda, q, q + 0.3, 1.0, acceleration_limits=[np.inf] * 6 + [0.1])
    found = verify(mixed, eo.baseline(mixed))
    assert found.worst["acceleration"][0] == "panda_joint7" and found.amount["acceleration"] > 1.0


def test_a_motion_that_is_not_a_number_is_never_valid(slider):
    problem, _ = quintic(slider)
    broken = PolynomialTrajectory(np.array([0.0, 1.0]), np.full((1, 6, 1), np.nan))
    found = verify(problem, broken)
    assert not is_valid(found) and "not a number" in describe(found)


def test_tolerances_are_those_promised(slider):
    problem, motion = quintic(slider)
    assert is_valid(verify(eo.Problem(slider, [0.0], [1.6], 1.0, velocity_limits=3.0 - 0.9e-6), motion))
    assert not is_valid(verify(eo.Problem(slider, [0.0], [1.6], 1.0, velocity_limits=3.0 - 1.1e-6), motion))
    top = 16 / np.sqrt(3)
    assert is_valid(verify(eo.Problem(slider, [0.0], [1.6], 1.0, torque_limits=top * (1 - 0.9e-4)), motion))
    assert not is_valid(verify(eo.Problem(slider, [0.0], [1.6], 1.0, torque_limits=top * (1 - 1.1e-4)), motion))
    assert verify(problem, motion).amount["boundary"] < 1e-9


def test_torque_peak_between_samples_is_found_to_a_hundredth_percent(panda):
    q = 0.5 * (panda.limits.lower + panda.limits.upper)
    problem = eo.Problem(panda, q - 0.4, q + 0.4, 1.0, torque_limits=30.0)
    motion = eo.baseline(problem)
    t = np.linspace(0, 1, 20001)
    top = np.abs(panda.torque(motion(t), motion(t, 1), motion(t, 2))).max()
    assert verify(problem, motion).amount["torque_percent"] == pytest.approx(100 * (top / 30 - 1), abs=1e-2)


def test_gauss_grid_splits_one_long_span_and_integrates_exactly(slider):
    _, motion = quintic(slider)
    t, w = gauss_grid(motion)
    assert len(t) >= 16 * 6 and w.sum() == pytest.approx(1.0, abs=1e-14)
    assert w @ np.exp(t) == pytest.approx(np.e - 1, abs=1e-14)


def test_cost_is_the_integral_of_a_much_finer_grid(panda):
    q = 0.5 * (panda.limits.lower + panda.limits.upper)
    problem = eo.Problem(panda, q - 0.4, q + 0.4, 1.0, velocity_weight=np.arange(1, 8) / 10, torque_weights=np.arange(7, 0, -1))
    motion = random_spline(7, 3, 1, duration=1.0)
    samples = sample_spans(motion, 1000)
    tau = panda.torque(*(samples.flat(order) for order in range(3)))
    t = samples.t.ravel()
    fine = np.trapezoid(tau**2 @ problem.torque_weights, t), np.trapezoid(samples.flat(1) ** 2 @ problem.velocity_weight, t)
    found = cost(problem, motion)
    assert (found["torque_squared"], found["velocity_squared"]) == pytest.approx(fine, rel=1e-6)


@pytest.mark.parametrize("degree", [3, 4, 5])
def test_pieces_of_a_spline_are_the_spline(degree):
    motion = random_spline(2, degree, 7)
    samples = sample_spans(motion, 5)
    inner = samples.t[:, 1:-1]
    for order in range(degree):
        here = samples.derivative(order)[:, 1:-1].reshape(-1, 2)
        np.testing.assert_allclose(here, motion(inner.ravel(), order), rtol=1e-9, atol=1e-8 * np.abs(here).max())


@pytest.mark.alone
def test_the_check_of_a_seven_joint_plan_takes_milliseconds(panda):
    q = 0.5 * (panda.limits.lower + panda.limits.upper)
    motion = random_spline(7, 3, 3, count=19)
    problem = eo.Problem(panda, q, q, 2.0, jerk_limits=1e4, acceleration_limits=1e3)
    assert len(motion.breaks) == 17
    times = []
    for _ in range(5):
        began = time.perf_counter()
        verify(problem, motion)
        times.append(time.perf_counter() - began)
    # 4 ms on an idle core; ten times that on a loaded one.
    assert min(times) < 0.05


def test_violations_of_a_copy_with_other_limits_differ(panda):
    """The problem's own limits count, not the robot's."""
    q = 0.5 * (panda.limits.lower + panda.limits.upper)
    problem = eo.Problem(panda, q, q + 0.5, 1.0)
    motion = eo.baseline(problem)
    assert is_valid(verify(problem, motion))
    assert excessive(verify(replace(problem, velocity_limits=0.5), motion)) == ["velocity"]
