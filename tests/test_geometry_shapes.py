"""Shapes: signed distance and derivatives against the collision library coal and against finite differences.

The loops run over `SHAPES`, so that an added shape is tested by being there.
"""

from dataclasses import fields

import coal
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from energyopt.geometry.shapes import SHAPES, Box, Capsule, ConvexMesh, Cylinder, HalfSpace, workspace_walls

PAIRS = 10_000


def random_pose(rng):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=int(rng.integers(1 << 31))).as_matrix()
    pose[:3, 3] = rng.uniform(-0.3, 0.3, 3)
    return pose


FIELDS = {
    "radius": lambda rng: rng.uniform(0.02, 0.3),
    "length": lambda rng: rng.uniform(0.05, 0.6),
    "size": lambda rng: rng.uniform(0.03, 0.8, 3),
    "normal": lambda rng: rng.normal(size=3),
    "offset": lambda rng: rng.uniform(-0.3, 0.3),
    "points": lambda rng: 0.2 * rng.normal(size=(rng.integers(5, 40), 3)),
}
"""Random sizes, by the name of the field."""


def random_shape(kind, rng, pose=None):
    own = [field.name for field in fields(SHAPES[kind]) if field.name in FIELDS]
    values = {name: FIELDS[name](rng) for name in own}
    return SHAPES[kind](**values, pose=random_pose(rng) if pose is None else pose)


def coal_distance(ball, center, shape):
    transform = coal.Transform3s(shape.pose[:3, :3].copy(), shape.pose[:3, 3].copy())
    at = coal.Transform3s(np.eye(3), center.copy())
    return coal.distance(ball, at, shape.coal_geometry(), transform, coal.DistanceRequest(), coal.DistanceResult())


@pytest.mark.parametrize("kind", SHAPES)
def test_distance_and_its_sign_agree_with_coal_on_ten_thousand_random_pairs(kind):
    """Where the centre is inside a cylinder, coal's closed form for spheres is wrong (by up to 0.2 m); its general
    algorithm, which an ellipsoid of equal axes calls, is right to the 1e-4 m of its own tolerance."""
    rng = np.random.default_rng(11)
    touching = 0
    for _ in range(PAIRS // 100):
        shape = random_shape(kind, rng)
        points, radii = rng.uniform(-0.8, 0.8, (100, 3)), rng.uniform(0.005, 0.2, 100)
        distance = shape.distance(points)
        np.testing.assert_allclose(shape.signed_distance(points)[0], distance, rtol=0, atol=1e-14)
        for point, radius, d in zip(points, radii, distance, strict=True):
            general = kind == "cylinder" and d < 0
            ball = coal.Ellipsoid(radius, radius, radius) if general else coal.Sphere(radius)
            tolerance = 1e-4 if general else 1e-9
            expected = coal_distance(ball, point, shape)
            assert abs(d - radius - expected) < tolerance
            assert abs(expected) < tolerance or (d - radius > 0) == (expected > 0)
            touching += expected < 0
    assert PAIRS // 50 < touching < PAIRS  # both signs are met


@pytest.mark.parametrize("kind", SHAPES)
def test_derivatives_agree_with_finite_differences(kind):
    """Central differences of step 1e-6: rounding leaves 1e-9 in the gradient. Points beside a kink differ by more; they are
    a set of measure zero, and of 2000 random points at most 4 may lie that near to one."""
    rng = np.random.default_rng(12)
    step = 1e-6
    for _ in range(5):
        shape = random_shape(kind, rng)
        points = rng.uniform(-0.8, 0.8, (400, 3))
        points = points[np.abs(shape.distance(points)) > 1e-4]
        d, gradient, curvature = shape.signed_distance(points)
        moved = [(points + step * e, points - step * e) for e in np.eye(3)]
        slopes = np.stack([(shape.distance(a) - shape.distance(b)) / (2 * step) for a, b in moved], axis=1)
        bends = np.stack([(shape.signed_distance(a)[1] - shape.signed_distance(b)[1]) / (2 * step) for a, b in moved], axis=1)
        assert np.sum(np.abs(slopes - gradient).max(axis=1) > 1e-8) <= 1
        assert np.sum(np.abs(bends - curvature).max(axis=(1, 2)) > 1e-4 * (1 + np.abs(curvature).max(axis=(1, 2)))) <= 1
        np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1.0, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(d > 0, shape.distance(points) > 0)


@pytest.mark.parametrize("kind", SHAPES)
def test_derivatives_are_finite_on_every_kink(kind):
    """Centre, axes, faces, edges and corners, where the gradient is one of several."""
    rng = np.random.default_rng(13)
    shape = random_shape(kind, rng, pose=np.eye(4))
    special = [np.zeros((1, 3)), 0.1 * np.eye(3), -0.1 * np.eye(3)]
    if kind != "half-space":
        corners = shape.enclosing_points()
        special += [corners, 0.5 * (corners[:1] + corners), corners * [1, 1, 0]]
    points = np.concatenate(special)
    d, gradient, curvature = shape.signed_distance(points)
    assert np.isfinite(d).all() and np.isfinite(curvature).all()
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1.0, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", SHAPES)
def test_gradient_is_continuous_outside(kind):
    """Outside d is C¹ with Lipschitz constant 1/d: gradients of points 1e-6 apart differ by at most 1e-6/d."""
    rng = np.random.default_rng(14)
    for _ in range(10):
        shape = random_shape(kind, rng)
        points = rng.uniform(-0.8, 0.8, (500, 3))
        near = points + 1e-6 * rng.uniform(-0.5, 0.5, points.shape)
        d, gradient, _ = shape.signed_distance(points)
        outside = d > 0.01
        change = np.linalg.norm(shape.signed_distance(near)[1] - gradient, axis=1)
        assert np.all(change[outside] <= 1e-6 / d[outside] + 1e-9)


def test_distances_by_hand():
    box, cylinder = Box((0.2, 0.4, 0.6)), Cylinder(0.1, 0.4)
    np.testing.assert_allclose(box.distance([[0.4, 0, 0], [0.13, 0.24, 0], [0, 0, 0]]), [0.3, 0.05, -0.1], atol=1e-15)
    np.testing.assert_allclose(cylinder.distance([[0, 0, 0.5], [0.13, 0, 0.24], [0, 0.05, 0]]), [0.3, 0.05, -0.05], atol=1e-15)
    np.testing.assert_allclose(Capsule(0.1, 0.4).distance([[0, 0, 0.5], [0, 0.3, 0.1]]), [0.2, 0.2], atol=1e-15)
    np.testing.assert_allclose(HalfSpace((0, 0, 2), 0.1).distance([[5, 5, 0.4]]), [0.3], atol=1e-15)


def test_mesh_of_a_box_is_the_box():
    rng = np.random.default_rng(15)
    box = Box((0.2, 0.5, 0.3), random_pose(rng))
    mesh = ConvexMesh(points=box.enclosing_points(), pose=box.pose)
    points = rng.uniform(-0.8, 0.8, (3000, 3))
    for of_mesh, of_box in zip(mesh.signed_distance(points), box.signed_distance(points), strict=True):
        np.testing.assert_allclose(of_mesh, of_box, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", [k for k in SHAPES if k != "half-space"])
def test_enclosing_points_contain_the_shape_closely(kind):
    """Support functions over random directions: the hull of the points reaches at least as far, and at most 3 % farther."""
    rng = np.random.default_rng(16)
    shape = random_shape(kind, rng, pose=np.eye(4))
    hull = ConvexHull(shape.enclosing_points())
    outermost = shape.local_distance(hull.points[hull.vertices])
    assert np.all(outermost < 0.03 * shape.bounding_radius)
    directions = rng.normal(size=(500, 3))
    surface = rng.uniform(-1, 1, (4000, 3)) * shape.bounding_radius
    inside = surface[shape.local_distance(surface) <= 0]
    assert len(inside) > 50
    assert np.all(inside @ hull.equations[:, :3].T + hull.equations[:, 3] < 1e-12)
    assert np.all((inside @ directions.T).max(axis=0) <= (hull.points @ directions.T).max(axis=0) + 1e-12)
    assert np.linalg.norm(inside, axis=1).max() <= shape.bounding_radius + 1e-12


def test_walls_of_a_workspace_keep_points_inside():
    rng = np.random.default_rng(17)
    pose = random_pose(rng)
    walls = workspace_walls((1.0, 0.6, 0.8), pose)
    local = rng.uniform(-0.8, 0.8, (1000, 3))
    points = local @ pose[:3, :3].T + pose[:3, 3]
    clearance = np.min([wall.distance(points) for wall in walls], axis=0)
    np.testing.assert_allclose(
        clearance,
        -Box((1.0, 0.6, 0.8)).local_distance(local).clip(None, 0) * (clearance > 0) + clearance * (clearance <= 0),
        atol=1e-12,
    )
    assert {wall.name for wall in walls} == {f"workspace {side}{axis}" for side in "+-" for axis in "xyz"}
    assert walls[[w.name for w in walls].index("workspace +x")].distance(np.array([pose[:3, 3] + 0.4 * pose[:3, 0]])) < 0.11
