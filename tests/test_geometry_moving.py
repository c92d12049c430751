"""Moving shapes: poses of time, and the distance's derivatives in time against finite differences."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_geometry_shapes import random_pose, random_shape

from energyopt.geometry.moving import Moving
from energyopt.geometry.shapes import SHAPES, Box, HalfSpace, Sphere


def swinging(t):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.3 * t, np.sin(t), 0.2]).as_matrix()
    pose[:3, 3] = np.cos(2 * t), 0.5 * t, np.sin(t)
    return pose


def moving_poses(rng):
    times = np.array([0.0, 0.4, 1.0, 2.0])
    poses = [random_pose(rng) for _ in times]
    return {
        "velocity": Moving(random_pose(rng), velocity=(0.3, -0.2, 0.1), angular_velocity=(0.5, 1.0, -0.3)),
        "waypoints": Moving(poses, times=times),
        "smooth waypoints": Moving(poses, times=times, smooth=True),
        "function": Moving(swinging, times=2.0),
    }


def test_constant_velocity_moves_as_said():
    moving = Moving((1, 2, 3), velocity=(0.5, 0, -1), angular_velocity=(0, 0, 2))
    pose = Box(0.1, moving).pose_at(0.7)
    np.testing.assert_allclose(pose[:3, 3], (1.35, 2, 2.3), atol=1e-15)
    np.testing.assert_allclose(pose[:3, :3], Rotation.from_euler("z", 1.4).as_matrix(), atol=1e-15)


@pytest.mark.parametrize("smooth", [False, True])
def test_waypoints_are_met_at_their_times_and_held_outside(smooth):
    rng = np.random.default_rng(1)
    times, poses = np.array([0.5, 1.0, 2.5]), np.array([random_pose(rng) for _ in range(3)])
    shape = Sphere(0.1, Moving(poses, times=times, smooth=smooth))
    np.testing.assert_allclose(shape.pose_at(times), poses, atol=1e-12)
    np.testing.assert_allclose(shape.pose_at([-1.0, 9.0]), poses[[0, 2]], atol=1e-12)
    held = shape.pose.derivatives([0.0, 3.0])
    assert not held.velocity.any() and not held.rotation_rate.any()
    if not smooth:
        np.testing.assert_allclose(shape.pose_at(0.75)[:3, 3], poses[:2, :3, 3].mean(axis=0), atol=1e-12)


def test_a_function_is_sampled_once_and_interpolated():
    """Positions: a cubic spline of step h = 0.01 s on fourth derivatives near 16 leaves 16·h⁴·5/384 ≈ 2e-9, some more at the
    ends. Rotations: the rotation spline turns evenly at its ends, which leaves h²/10 ≈ 1e-5 there."""
    calls = []
    moving = Moving(lambda t: calls.append(t) or swinging(t), times=2.0)
    assert len(calls) == 201
    t = np.linspace(0.0, 2.0, 777)
    pose, expected = Sphere(0.1, moving).pose_at(t), np.array([swinging(x) for x in t])
    np.testing.assert_allclose(pose[:, :3, 3], expected[:, :3, 3], rtol=0, atol=1e-7)
    np.testing.assert_allclose(pose, expected, rtol=0, atol=1e-5)
    assert len(calls) == 201


@pytest.mark.parametrize("kind", SHAPES)
def test_derivatives_in_point_and_time_agree_with_finite_differences(kind):
    """Steps of 1e-5; away from kinks of the shape (at most 2 of 200 points) and of the waypoints (0.02 s around them)."""
    rng = np.random.default_rng(2)
    step = 1e-5
    for name, moving in moving_poses(rng).items():
        shape = random_shape(kind, rng, pose=moving)
        points, t = rng.uniform(-0.8, 0.8, (200, 3)), rng.choice(np.array([0.1, 0.3, 0.6, 0.9, 1.3, 1.8]), 200)
        _, gradient, curvature = shape.signed_distance_in_time(points, t)
        np.testing.assert_allclose(gradient[:, :3], shape.signed_distance(points, t)[1], atol=1e-12)

        def central(f, points=points, t=t):
            pairs = [(f(points + step * e, t), f(points - step * e, t)) for e in np.eye(3)] + [
                (f(points, t + step), f(points, t - step))
            ]
            return np.stack([(a - b) / (2 * step) for a, b in pairs], axis=1)

        slopes = central(shape.distance)
        bends = central(lambda p, s, shape=shape: shape.signed_distance_in_time(p, s)[1])
        assert np.sum(np.abs(slopes - gradient).max(axis=1) > 1e-6) <= 2, name
        scale = 1 + np.abs(curvature).max(axis=(1, 2)) ** 3
        assert np.sum(np.abs(bends - curvature).max(axis=(1, 2)) > 1e-4 * scale) <= 2, name


def test_no_point_of_a_moving_shape_is_faster_than_the_bound():
    rng = np.random.default_rng(3)
    t = np.linspace(0, 2, 4001)
    for moving in moving_poses(rng).values():
        box = Box((0.4, 0.2, 0.6), moving)
        corners = np.concatenate([box.enclosing_points(), np.ones((8, 1))], axis=1)
        tracks = np.einsum("nij,kj->nki", box.pose_at(t), corners)[..., :3]
        fastest = np.linalg.norm(np.diff(tracks, axis=0), axis=2).max() / (t[1] - t[0])
        assert 0.2 * box.speed_bound() < fastest <= box.speed_bound() * (1 + 1e-9)


def test_a_turning_plane_has_no_speed_bound():
    assert HalfSpace((0, 0, 1), 0.0, Moving((0, 0, 0), velocity=(0, 0, 0.3))).speed_bound() == pytest.approx(0.3)
    assert HalfSpace((0, 0, 1), 0.0, Moving((0, 0, 0), angular_velocity=(0.1, 0, 0))).speed_bound() == np.inf
