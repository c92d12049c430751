"""The repulsive potential: Khatib's formulas, its smooth continuation, and the force as its negative gradient."""

import numpy as np
import pytest

from energyopt.errors import GeometryError
from energyopt.geometry.moving import Moving
from energyopt.geometry.potential import RepulsivePotential
from energyopt.geometry.shapes import Box, Capsule, HalfSpace, Sphere

FIELD = RepulsivePotential(gain=2.5, safe_distance=0.2, minimum_distance=0.03)
SHAPES = (
    Sphere(0.1, (0.3, 0, 0)),
    Box((0.1, 0.2, 0.3), (-0.3, 0.1, 0)),
    Capsule(0.05, 0.3, (0, -0.3, 0)),
    HalfSpace((0, 0, 1), -0.2),
)


def test_energy_and_force_are_khatibs():
    d = np.linspace(0.03, 0.2, 50)
    energy, slope, _ = FIELD.derivatives(d)
    np.testing.assert_allclose(energy, 0.5 * 2.5 * (1 / d - 5.0) ** 2, rtol=1e-12)
    np.testing.assert_allclose(-slope, 2.5 * (1 / d - 5.0) / d**2, rtol=1e-12)
    ball = Sphere(0.1)
    np.testing.assert_allclose(FIELD.force([[0, 0.15, 0]], [ball]), [[0, 2.5 * (20 - 5.0) * 400, 0]], rtol=1e-12)
    assert not np.any(FIELD.derivatives([0.2000001, 1.0, 1e3])) and not np.any(FIELD.force([[0, 0.31, 0]], [ball]))


@pytest.mark.parametrize("d", [-0.5, -0.02, 0.0, 0.0299, 0.0301, 0.08, 0.19, 0.3])
def test_derivatives_agree_with_finite_differences(d):
    step = 1e-6
    (above, slope_above, _), (below, slope_below, _) = FIELD.derivatives(d + step), FIELD.derivatives(d - step)
    _, first, second = FIELD.derivatives(d)
    assert (above - below) / (2 * step) == pytest.approx(first, rel=1e-6, abs=1e-6)
    assert (slope_above - slope_below) / (2 * step) == pytest.approx(second, rel=1e-5, abs=1e-6)


def test_continuation_is_twice_differentiable_and_pushes_out_of_any_depth():
    before, after = FIELD.derivatives(0.03 - 1e-12), FIELD.derivatives(0.03 + 1e-12)
    np.testing.assert_allclose(before, after, rtol=1e-8)
    energy, slope, second = FIELD.derivatives(np.linspace(-2.0, 0.2, 1000, endpoint=False))
    assert np.isfinite(energy).all() and np.all(slope < 0) and np.all(second > 0)


def test_force_is_the_negative_gradient_of_the_energy():
    """Central differences of step 1e-6, in free space and in penetration; relative tolerance 1e-5 of the largest force."""
    rng = np.random.default_rng(0)
    points, step = rng.uniform(-0.4, 0.4, (500, 3)), 1e-6
    moving = Sphere(0.08, Moving((0, 0, 0.3), velocity=(0.1, 0, 0)))
    radius, t = rng.uniform(0, 0.05, 500), rng.uniform(0, 2, 500)
    shapes = (*SHAPES, moving)
    energy = lambda p: FIELD.field_energy(p, shapes, t, radius)
    slopes = np.stack([(energy(points + step * e) - energy(points - step * e)) / (2 * step) for e in np.eye(3)], axis=1)
    force = FIELD.force(points, shapes, t, radius)
    wrong = np.linalg.norm(force + slopes, axis=1) > 1e-5 * np.linalg.norm(force, axis=1).max()
    assert np.sum(wrong) <= 2  # points within a step of a kink inside a shape
    assert np.sum(np.linalg.norm(force, axis=1) > 0) > 300


@pytest.mark.parametrize(
    "arguments", [(0, 0.1), (-1, 0.1), (np.nan, 0.1), (1, 0), (1, -0.1), (1, 0.1, 0.1), (1, 0.1, 0), ("k", 0.1)]
)
def test_parameters_that_make_no_field_are_refused(arguments):
    with pytest.raises(GeometryError, match="potential: ") as caught:
        RepulsivePotential(*arguments)
    assert "\n" not in str(caught.value)
