"""Ways to describe a motion: every exported one keeps its promises; splines, sinusoids and collocation each their own."""

import numpy as np
import pytest
from scipy.interpolate import BSpline as ScipySpline
from scipy.linalg import null_space

import energyopt as eo
from energyopt import parameterizations
from energyopt.parameterizations import BoundaryState, BSpline, HermiteSimpson, Sinusoid, trajectory_from_arrays
from energyopt.parameterizations.bspline import SplineSpace, graded_breaks

T, NV = 1.7, 3
ROUNDING = 1e-12
"""Relative to the largest value: sums of a few dozen terms."""
DIFFERENCES = 1e-6
"""Relative, against central differences."""
UNEVEN = (0.0, 0.02, 0.1, 0.4, 0.45, 0.9, 1.3, 1.65, 1.69, T)

METHODS = {
    "cubic spline": BSpline(),
    "quartic spline": BSpline(degree=4, control_points=15),
    "quintic spline": BSpline(degree=5),
    "spline on uneven knots": BSpline(knots=UNEVEN),
    "collocation": HermiteSimpson(intervals=9),
    "collocation on four intervals": HermiteSimpson(intervals=4),
    "cycloid": Sinusoid(harmonics=0),
    "sinusoid": Sinusoid(harmonics=5),
}


@pytest.fixture(params=METHODS)
def space(request):
    return METHODS[request.param].space(T)


def states(rng):
    return [BoundaryState(*rng.normal(size=(3, NV))) for _ in range(2)]


def random_coefficients(space, rng, ends=None):
    """Coefficients (size, NV) without defects, with the given boundary states where there are some."""
    defects = space.defects() @ np.eye(space.size)
    if ends is None:
        basis = null_space(defects) if len(defects) else np.eye(space.size)
        return basis @ rng.normal(size=(basis.shape[1], NV))
    unknowns = space.unknowns(*ends)
    known = unknowns.block >= 0
    selection = np.zeros((space.size, unknowns.count))
    selection[np.flatnonzero(known), unknowns.block[known]] = 1.0
    x = rng.normal(size=(unknowns.count, NV))
    if len(defects):
        x -= np.linalg.lstsq(defects @ selection, defects @ (unknowns.offset + selection @ x), rcond=None)[0]
    return unknowns.offset + selection @ x


def dense_basis(space, t, order):
    columns, values = space.basis(t, 4)
    matrix = np.zeros((len(t), space.size))
    np.add.at(matrix, (np.arange(len(t))[:, None], columns), values[:, order])
    return matrix


def inner_times(space, count=40):
    """Times away from every break, where derivatives are smooth."""
    breaks = space.trajectory(np.zeros((space.size, 1))).breaks
    share = np.random.default_rng(0).uniform(0.1, 0.9, (count, len(breaks) - 1))
    return (breaks[:-1] + share * np.diff(breaks)).ravel()


def near(value, expected, tolerance):
    return np.max(np.abs(value - expected)) <= tolerance * np.max(np.abs(expected))


def test_every_exported_parameterization_is_tested_here():
    exported = {name for name in parameterizations.__all__ if hasattr(getattr(parameterizations, name), "space")}
    assert exported == {type(method).__name__ for method in METHODS.values()}
    assert exported <= set(eo.__all__)


def test_basis_derivatives_match_finite_differences(space):
    t = inner_times(space)
    shortest = np.diff(space.trajectory(np.zeros((space.size, 1))).breaks).min()
    h = 1e-4 * shortest
    for order in range(3):
        slope = (dense_basis(space, t + h, order) - dense_basis(space, t - h, order)) / (2 * h)
        assert near(slope, dense_basis(space, t, order + 1), DIFFERENCES), order


def test_basis_and_trajectory_are_the_same_motion(space):
    c, t = random_coefficients(space, np.random.default_rng(1)), inner_times(space)
    motion = space.trajectory(c)
    assert motion.duration == space.duration == T
    for order in range(4):
        assert near(dense_basis(space, t, order) @ c, motion(t, order), ROUNDING), order
        assert near(space.rows_at(t, order) @ c, motion(t, order), ROUNDING), order


def test_boundary_states_are_met_exactly_whatever_the_unknowns(space):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        start, goal = states(rng)
        motion = space.trajectory(random_coefficients(space, rng, (start, goal)))
        for time, state in ((0.0, start), (T, goal)):
            for order, wanted in enumerate((state.position, state.velocity, state.acceleration)):
                np.testing.assert_allclose(motion(time, order), wanted, atol=1e-9)


def test_a_free_goal_position_is_its_own_block_of_unknowns(space):
    rng = np.random.default_rng(2)
    start, goal = states(rng)
    unknowns = space.unknowns(start, BoundaryState(None, goal.velocity, goal.acceleration))
    fixed = space.unknowns(start, goal)
    assert unknowns.count == fixed.count + 1 and fixed.goal is None
    c = random_coefficients(space, rng, (start, BoundaryState(None, goal.velocity, goal.acceleration)))
    end = [space.trajectory(c)(T, order) for order in range(3)]
    known = unknowns.block == unknowns.goal
    x_goal = (c - unknowns.offset)[known]
    np.testing.assert_allclose(x_goal, np.tile(end[0], (len(x_goal), 1)), atol=1e-9)
    np.testing.assert_allclose(end[1:], [goal.velocity, goal.acceleration], atol=1e-9)


def test_interpolation_reproduces_every_motion_of_the_space(space):
    motion = space.trajectory(random_coefficients(space, np.random.default_rng(3)))
    again = space.trajectory(space.interpolate(motion))
    t = motion.sample_times(7)
    assert near(again(t), motion(t), ROUNDING)


def test_quadrature_sums_to_the_duration_and_integrates_the_velocity(space):
    times, weights = space.quadrature()
    assert weights.sum() == pytest.approx(T, rel=1e-14) and np.all(weights > 0)
    motion = space.trajectory(random_coefficients(space, np.random.default_rng(4)))
    tolerance = 1e-5 if isinstance(space, type(METHODS["sinusoid"].space(T))) else 1e-12  # sines are not polynomials
    np.testing.assert_allclose(weights @ motion(times, 1), motion(T) - motion(0.0), atol=tolerance)
    columns, values = space.quadrature_basis()
    c = space.interpolate(motion)
    assert near(np.einsum("kol,kli->koi", values, c[columns])[:, 1], motion(times, 1), ROUNDING)


@pytest.mark.parametrize("order", range(4))
@pytest.mark.parametrize("name", [name for name, method in METHODS.items() if method.space(T).everywhere])
def test_bounding_rows_bound_the_motion_for_all_times(name, order):
    space = METHODS[name].space(T)
    for seed in range(10):
        c = random_coefficients(space, np.random.default_rng(seed))
        rows, motion = space.bounding_rows(order) @ c, space.trajectory(c)
        values = motion(motion.sample_times(100), order)
        slack = 1e-10 * np.abs(rows).max()
        assert np.all(values <= rows.max(axis=0) + slack) and np.all(values >= rows.min(axis=0) - slack)


def test_bounding_rows_are_not_needlessly_wide():
    """For a smooth motion on 64 spans they exceed its extrema by less than one per cent: the gap falls with h²."""
    problem_like = Sinusoid(1).space(T).trajectory(np.eye(8)[:, [3, 6]])
    for space in (BSpline(control_points=67).space(T), HermiteSimpson(64).space(T)):
        c = space.interpolate(problem_like)
        motion = space.trajectory(c)
        for order in range(3):
            assert np.abs(space.bounding_rows(order) @ c).max() < 1.01 * np.abs(motion(motion.sample_times(20), order)).max()


def test_sinusoid_rows_are_its_values_at_samples():
    space = Sinusoid(3).space(T)
    c = random_coefficients(space, np.random.default_rng(5))
    t = np.linspace(0.0, T, len(space.bounding_rows(1) @ c))
    assert near(space.bounding_rows(1) @ c, space.trajectory(c)(t, 1), ROUNDING)


def test_a_motion_is_made_again_from_its_arrays_bit_for_bit(space):
    motion = space.trajectory(random_coefficients(space, np.random.default_rng(6)))
    again = trajectory_from_arrays(motion.kind, motion.to_arrays())
    t = motion.sample_times(5)
    for order in range(4):
        np.testing.assert_array_equal(again(t, order), motion(t, order))


@pytest.mark.parametrize("degree", [3, 4, 5])
def test_knot_insertion_leaves_the_curve_unchanged(degree):
    rng = np.random.default_rng(degree)
    space = SplineSpace(np.array(UNEVEN), degree)
    motion = space.trajectory(rng.normal(size=(space.size, NV)))
    fine = space.refined(rng.uniform(0.0, T, 11))
    assert fine.size == space.size + 11 and set(space.breaks) <= set(fine.breaks)
    again = fine.trajectory(fine.interpolate(motion))
    t = fine.trajectory(np.zeros((fine.size, 1))).sample_times(9)
    assert near(again(t), motion(t), 1e-12)


@pytest.mark.parametrize("degree", [3, 4, 5])
def test_spline_bases_are_those_of_scipy(degree):
    space = SplineSpace(np.array(UNEVEN), degree)
    t = inner_times(space)
    for order in range(4):
        expected = ScipySpline(space.knots, np.eye(space.size), degree).derivative(order)(t)
        assert near(dense_basis(space, t, order), expected, ROUNDING)


def test_a_cubic_is_exported_as_powers_of_time_on_each_span():
    space = METHODS["spline on uneven knots"].space(T)
    motion = space.trajectory(np.random.default_rng(7).normal(size=(space.size, NV)))
    breaks, coefficients = motion.polynomial_pieces()
    assert coefficients.shape == (len(breaks) - 1, 4, NV)
    for k, (a, b, c, d) in enumerate(coefficients):
        t = np.linspace(0.0, breaks[k + 1] - breaks[k], 20)[:-1, None]
        np.testing.assert_allclose(a + b * t + c * t**2 + d * t**3, motion(breaks[k] + t[:, 0]), rtol=0, atol=1e-12)
        np.testing.assert_allclose(b + 2 * c * t + 3 * d * t**2, motion(breaks[k] + t[:, 0], 1), rtol=0, atol=1e-10)


def test_spline_quadrature_is_exact_for_the_square_of_the_acceleration():
    for degree in (3, 4, 5):
        space = BSpline(degree=degree).space(T)
        motion = space.trajectory(np.random.default_rng(8).normal(size=(space.size, NV)))
        times, weights = space.quadrature()
        fine_times, fine_weights = motion.quadrature(per_span=8)
        assert near(weights @ motion(times, 2) ** 2, fine_weights @ motion(fine_times, 2) ** 2, 1e-12)


def test_default_knots_are_symmetric_dense_at_the_ends_and_never_too_many():
    for duration in (0.05, 1.0, 7.0, 600.0):
        breaks = BSpline().space(duration).breaks
        spans = np.diff(breaks)
        assert 14 <= len(spans) <= 40
        np.testing.assert_allclose(spans, spans[::-1], rtol=1e-9)
        assert spans[0] < 0.1 * spans[len(spans) // 2]
    assert len(graded_breaks(1.0, 7)) == 8, "as many spans as asked"


def test_without_harmonics_the_sinusoid_is_the_cycloid():
    space, s = Sinusoid(0).space(T), np.linspace(0.0, 1.0, 101)[:, None]
    start, goal = np.array([0.3, -1.0, 0.0]), np.array([1.0, 0.5, -2.0])
    rest = np.zeros(NV)
    unknowns = space.unknowns(BoundaryState(start, rest, rest), BoundaryState(goal, rest, rest))
    assert unknowns.count == 0
    motion, d = space.trajectory(unknowns.offset), goal - start
    w = 2 * np.pi
    closed = [start + d * (s - np.sin(w * s) / w), d / T * (1 - np.cos(w * s)), d / T**2 * w * np.sin(w * s)]
    for order, expected in enumerate(closed):
        np.testing.assert_allclose(motion(T * s[:, 0], order), expected, atol=1e-12)


def test_harmonics_vanish_with_their_first_two_derivatives_at_both_ends():
    space = Sinusoid(harmonics=20).space(T)
    for time in (0.0, T):
        for order in range(3):
            ends = dense_basis(space, np.array([time]), order)[0, 6:]
            assert np.abs(ends).max() < 1e-10 * (2 * np.pi * 21 / T) ** order
    inside = dense_basis(space, np.linspace(0.0, T, 200), 0)[:, 6:]
    assert np.linalg.matrix_rank(inside) == 40, "no harmonic is a combination of others"


def test_collocation_defects_vanish_exactly_for_motions_of_linear_acceleration():
    space = HermiteSimpson(9).space(T)
    rng = np.random.default_rng(9)
    cubic = BSpline(knots=tuple(space.breaks)).space(T)
    motion = cubic.trajectory(rng.normal(size=(cubic.size, NV)))
    c = space.interpolate(motion)
    assert np.abs(space.defects() @ c).max() < ROUNDING * np.abs(c).max()
    free = rng.normal(size=(space.size, NV))
    assert np.abs(space.defects() @ free).max() > 0.1


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: BSpline(degree=2), ["degree", "2", "3, 4 or 5"]),
        (lambda: BSpline(control_points=6), ["control_points", "6", "7 to"]),
        (lambda: BSpline(degree=5, control_points=8), ["control_points", "9 to"]),
        (lambda: BSpline(degree=3.0), ["degree is 3.0", "3, 4 or 5"]),
        (lambda: BSpline(control_points=16.0), ["control_points is 16.0", "whole number"]),
        (lambda: BSpline(control_points="many"), ["control_points is 'many'"]),
        (lambda: BSpline(accuracy="x"), ["accuracy is 'x'", "between 0 and 1"]),
        (lambda: BSpline(accuracy=float("nan")), ["accuracy is nan"]),
        (lambda: BSpline(accuracy=True), ["accuracy is True"]),
        (lambda: BSpline(knots=(0.0, 0.4, 0.8, 1.2, T), control_points=9), ["both knots and control_points"]),
        (lambda: BSpline(knots=5), ["knots is 5", "increasing times"]),
        (lambda: BSpline(knots=(0.0, 0.5, float("nan"), 1.5, T)), ["knots", "nan"]),
        (lambda: Sinusoid(harmonics=1.5), ["harmonics is 1.5", "whole number, 0 to 64"]),
        (lambda: HermiteSimpson(intervals=None), ["intervals is None", "whole number"]),
        (lambda: HermiteSimpson(intervals=40.5), ["intervals is 40.5"]),
        (lambda: BSpline(accuracy=0.0), ["accuracy", "between 0 and 1"]),
        (lambda: BSpline(accuracy=2.0), ["accuracy", "2.0"]),
        (lambda: BSpline(knots=(0.0, 1.0, 0.5, 1.5, T)).space(T), ["knots", "increasing", "1.7"]),
        (lambda: BSpline(knots=(0.0, 0.5, 1.0, 1.2, 1.5)).space(T), ["knots", "duration 1.7"]),
        (lambda: Sinusoid(harmonics=-1), ["harmonics", "-1", "0 to"]),
        (lambda: HermiteSimpson(intervals=3), ["intervals", "3", "4 to"]),
    ],
)
def test_impossible_options_are_refused_in_one_line(make, words):
    with pytest.raises(eo.InputError) as caught:
        make()
    message = str(caught.value)
    assert "\n" not in message and all(word in message for word in words)


def test_times_may_have_any_shape_and_their_ends_are_forgiven_rounding(space):
    motion = space.trajectory(random_coefficients(space, np.random.default_rng(9)))
    t = np.linspace(0.0, T, 6)
    assert motion(0).shape == (NV,) and motion([0, 1]).shape == (2, NV) and motion(np.empty(0)).shape == (0, NV)
    np.testing.assert_array_equal(motion(t.reshape(2, 3), 1), motion(t, 1).reshape(2, 3, NV))
    np.testing.assert_array_equal(motion(np.array([-1e-10, T * (1 + 1e-10)])), motion(np.array([0.0, T])))


@pytest.mark.parametrize(
    "t, order, words",
    [
        (T + 0.1, 0, ["t is 1.8 s", "0 to 1.7 s", "numpy.clip"]),
        (-0.01, 1, ["t is -0.01 s", "0 to 1.7 s"]),
        ([0.5, float("nan")], 0, ["t is nan"]),
        (float("inf"), 0, ["t is inf"]),
        (None, 0, ["t is None", "times in seconds"]),
        ("start", 0, ["t is 'start'"]),
        (0.5, -1, ["order is -1", "0 (position)", "3 (jerk)"]),
        (0.5, 6, ["order is 6"]),
        (0.5, 1.0, ["order is 1.0"]),
        (0.5, "velocity", ["order is 'velocity'", "1 (velocity)"]),
        (0.5, None, ["order is None"]),
        (0.5, True, ["order is True"]),
    ],
)
def test_what_a_motion_does_not_say_is_an_error_and_no_number(space, t, order, words):
    motion = space.trajectory(np.zeros((space.size, NV)))
    with pytest.raises(eo.InputError) as caught:
        motion(t, order)
    assert "\n" not in str(caught.value) and all(word in str(caught.value) for word in words), str(caught.value)


def test_derivatives_go_up_to_the_degree_and_to_the_jerk_at_least():
    """A cubic's fourth derivative is zero nearly everywhere and infinite at the knots: it is no number to hand out."""
    rng = np.random.default_rng(10)
    for degree, highest in ((3, 3), (4, 4), (5, 5)):
        space = BSpline(degree=degree).space(T)
        motion = space.trajectory(random_coefficients(space, rng))
        step = 1e-4 * np.diff(space.breaks).min()
        t = 0.5 * (space.breaks[1:] + space.breaks[:-1])
        slope = (motion(t + step, highest - 1) - motion(t - step, highest - 1)) / (2 * step)
        assert near(motion(t, highest), slope, 1e-6)
        with pytest.raises(eo.InputError, match=f"order is {highest + 1}"):
            motion(t, highest + 1)
