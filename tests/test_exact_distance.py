"""Exact distances of robots, whose engine is coal, against closed forms and our own signed distances; and their bounds.

Coal ends within 1e-6 m; a tolerance of 3e-6 m compares two of its answers.
"""

import struct
from functools import cache as memoized

import arms
import numpy as np
import pinocchio as pin
import pytest
import urdf_factory as factory
from test_geometry_shapes import random_shape

from energyopt.errors import GeometryError
from energyopt.geometry import bodies, cache
from energyopt.geometry.bodies import Attached, collision_bodies
from energyopt.geometry.exact import CollisionScene, exact_distance
from energyopt.geometry.hull import Hull
from energyopt.geometry.moving import Moving
from energyopt.geometry.pieces import convex_pieces
from energyopt.geometry.self_collision import random_configurations
from energyopt.geometry.shapes import SHAPES, Box, Capsule, Cylinder, HalfSpace, Sphere

REACH, RADIUS = 0.6, 0.08
BALL = (Attached(Sphere(RADIUS), name="ball"),)


@memoized
def two_joints():
    """Turns about an unaligned axis and slides; its ball is not on either axis."""
    text = factory.chain(
        axes=[arms.UNALIGNED, (0, 0.6, 0.8)],
        origins=[(0, 0, 0), (0.2, 0.1, 0)],
        masses=[1, 1],
        centers=[(0, 0, 0)] * 2,
        inertias=[0.01 * np.eye(3)] * 2,
        types=["revolute", "prismatic"],
        tool=(0.1, 0.2, 0.0),
        lower=-1.0,
        upper=1.0,
    )
    return arms.from_urdf(text)


def ball_centers(robot, q):
    return np.array([robot.placement("tool", row).translation for row in q])


@pytest.mark.parametrize("kind", SHAPES)
def test_the_distance_of_a_ball_on_an_arm_is_the_signed_distance_less_the_radius(kind):
    """10,000 pairs of configurations and shapes. The ball itself goes through coal, but for cylinders, where coal errs."""
    robot, rng = two_joints(), np.random.default_rng(21)
    q = rng.uniform(-1, 1, (100, 2))
    shapes = [random_shape(kind, rng) for _ in range(100)]
    found = CollisionScene(robot, shapes, attached=BALL).distances(q)
    points = ball_centers(robot, q)
    expected = np.stack([shape.distance(points) for shape in shapes], axis=1) - RADIUS
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    assert found.size == 10_000 and 100 < np.sum(found < 0) < 9_900


def test_links_of_meshes_and_a_ball_agree_with_the_hulls_of_our_own():
    """Outside: coal's distance of a mesh and a ball against the closest point on the hull. Coal stops at 1e-6 relative."""
    robot, rng = arms.catalogue_robot("panda"), np.random.default_rng(22)
    q = random_configurations(robot, 60, 1)
    balls = [Sphere(0.05, rng.uniform(-0.6, 0.6, 3) + [0, 0, 0.5]) for _ in range(8)]
    scene = CollisionScene(robot, balls)
    found, data = scene.distances(q), robot.model.createData()
    expected = np.empty_like(found)
    for n, row in enumerate(q):
        pin.forwardKinematics(robot.model, data, row)
        for k, (i, j) in enumerate(scene.index):
            body, ball = scene.bodies[i], balls[j - len(scene.bodies)]
            local = data.oMi[body.joint].actInv(ball.pose[:3, 3])
            expected[n, k] = body.shape.distance(local[None])[0] - ball.radius
    outside = expected > 0
    np.testing.assert_allclose(found[outside], expected[outside], rtol=0, atol=2e-6)
    assert np.all(found[~outside] < 1e-6) and 10 < np.sum(~outside) < 0.5 * found.size


def test_a_box_and_a_plane_have_the_distance_of_the_lowest_corner():
    robot, rng = two_joints(), np.random.default_rng(23)
    size, floor = np.array([0.3, 0.2, 0.1]), HalfSpace((0.1, -0.2, 1.0), -0.3)
    q = rng.uniform(-1, 1, (200, 2))
    found = CollisionScene(robot, [floor], attached=[Attached(Box(size))]).distances(q)[:, 0]
    corners = 0.5 * size * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    expected = [floor.distance([robot.placement("tool", row).act(c) for c in corners]).min() for row in q]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    assert np.any(found < 0) and np.any(found > 0)


def test_two_links_have_the_distance_of_their_balls():
    text = factory.planar_arm([0.5, 0.5, 0.5], [1.0] * 3, axis=(0, 0, 1), lower=-3.0, upper=3.0)
    ball = '</inertial><collision><origin xyz="0.4 0 0"/><geometry><sphere radius="0.1"/></geometry></collision></link>'
    robot = arms.from_urdf(text.replace("</inertial></link>", ball))
    q = np.random.default_rng(24).uniform(-3, 3, (300, 3))
    found = CollisionScene(robot, (), [("link1", "link3")]).distances(q)[:, 0]
    a, b = q[:, 0], q[:, 0] + q[:, 1]
    c = b + q[:, 2]
    way = 0.1 * np.array([np.cos(a), np.sin(a)]) + 0.5 * np.array([np.cos(b), np.sin(b)]) + 0.4 * np.array([np.cos(c), np.sin(c)])
    np.testing.assert_allclose(found, np.linalg.norm(way, axis=0) - 0.2, rtol=0, atol=1e-9)


def test_moving_obstacles_are_where_they_are_at_that_time():
    robot, rng = arms.catalogue_robot("ur5"), np.random.default_rng(25)
    moving = Moving((0.4, -0.5, 0.4), velocity=(0.1, 0.5, 0), angular_velocity=(0.4, -1.0, 2.0))
    shapes = [Box((0.1, 0.2, 0.5), moving), Capsule(0.05, 0.4, moving), Cylinder(0.1, 0.2, (0.3, 0.3, 0.3))]
    q, t = random_configurations(robot, 12, 2), rng.uniform(0, 2, 12)
    found = CollisionScene(robot, shapes).distances(q, t)
    for row, time, distances in zip(q, t, found, strict=True):
        still = [Box((0.1, 0.2, 0.5), moving_at(shapes[0], time)), Capsule(0.05, 0.4, moving_at(shapes[1], time)), shapes[2]]
        np.testing.assert_allclose(CollisionScene(robot, still).distances(row)[0], distances, rtol=0, atol=3e-6)


def moving_at(shape, time):
    return shape.pose_at(time)


def test_far_pairs_give_lower_bounds_and_the_closest_is_the_least_of_all():
    robot = arms.catalogue_robot("xarm7")
    obstacles = [Box((0.1, 0.1, 0.6), (0.4, 0.3, 0.3), "post"), HalfSpace((0, 0, 1), -0.2, name="floor")]
    scene = CollisionScene(robot, obstacles, [("link1", "link6")])
    q = random_configurations(robot, 40, 3)
    exact, cut = scene.distances(q), scene.distances(q, cutoff=0.1)
    near = exact <= 0.1
    assert np.all(cut <= exact + 3e-6) and np.all(np.abs(cut - exact)[near] < 3e-6) and np.any(cut < exact - 0.01)
    for n, closest in enumerate(scene.closest(q)):
        assert abs(closest.distance - exact[n].min()) < 3e-6
        assert (closest.first, closest.second) == scene.pairs[int(exact[n].argmin())]
    assert exact_distance(robot, obstacles, q[5]) == CollisionScene(robot, obstacles).closest(q[5])[0]


def test_where_the_library_fails_a_lower_bound_stands_in(monkeypatch):
    """It answers with the largest double then, which must not pass for clear."""
    robot = arms.catalogue_robot("ur5")
    scene = CollisionScene(robot, [Box(0.2, (0.5, 0, 0.3))], [("shoulder_link", "wrist_3_link")])
    q = random_configurations(robot, 20, 6)
    exact = scene.distances(q)
    failed = type("Result", (), {"min_distance": np.finfo(float).max})
    monkeypatch.setattr(pin, "computeDistance", lambda *arguments: failed)
    found = scene.distances(q)
    assert np.all(found <= exact + 3e-6) and np.all(found > exact - 1.0)


def test_no_distance_changes_faster_than_its_bounds():
    """Small random steps of configuration and time; the motion of what both links hang on does not count."""
    robot, rng = arms.catalogue_robot("panda"), np.random.default_rng(26)
    obstacles = [
        Box(0.2, Moving((0.4, 0.3, 0.5), velocity=(0.3, 0, 0), angular_velocity=(0, 0, 1.0))),
        HalfSpace((0, 0, 1), -0.1),
    ]
    scene = CollisionScene(robot, obstacles, [("panda_link1", "panda_link5"), ("panda_link2", "panda_hand")])
    q, t = random_configurations(robot, 60, 4), rng.uniform(0, 1, 60)
    step, later = 1e-3 * rng.normal(size=q.shape), t + 1e-3 * rng.uniform(size=60)
    before, after = scene.distances(q, t), scene.distances(q + step, later)
    bound = np.abs(step) @ scene.rate_bounds.T + (later - t)[:, None] * scene.speed_bounds
    # Depths of penetration are only as good as coal's 1e-4; distances are good to 1e-6.
    apart = (before > 0) & (after > 0)
    assert np.all(np.abs(after - before)[apart] <= bound[apart] + 2e-6)
    first = [k for k, pair in enumerate(scene.pairs) if pair == ("panda_link1", "panda_link5")]
    assert not scene.rate_bounds[first, 0].any() and scene.rate_bounds[first, 1].all()


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda r: CollisionScene(r, ["box"]), "expected shapes such as"),
        (lambda r: CollisionScene(r, (), [("panda_link1", "panda_link55")]), "panda_link5"),
        (lambda r: CollisionScene(r).closest(r.home), "nothing to keep apart"),
        (lambda r: CollisionScene(r, [Box(0.1)]).distances(np.zeros(3)), "expected rows of 7"),
    ],
)
def test_bad_arguments_are_one_clear_line(make, said):
    with pytest.raises(GeometryError, match=said):
        make(arms.catalogue_robot("panda"))


def bent_mesh():
    """An L of two boxes of 0.3 × 0.1 × 0.1 m, as triangles of two hulls."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    found = []
    for size in ((0.3, 0.1, 0.1), (0.1, 0.3, 0.1)):
        hull = Hull.of_points(corners * size, "test")
        found.append(hull.vertices[hull.triangles])
    return np.concatenate(found)


def test_a_bent_mesh_becomes_convex_pieces_that_leave_its_bend_free():
    triangles = bent_mesh()
    points = triangles.reshape(-1, 3)
    pieces = [Hull.of_points(p, "test") for p in convex_pieces(points, np.arange(len(points)).reshape(-1, 3))]
    assert len(pieces) > 1
    assert np.min([piece.distance(points) for piece in pieces], axis=0).max() < 1e-9
    assert min(piece.distance(np.array([[0.22, 0.22, 0.05]]))[0] for piece in pieces) > 0.02


@pytest.mark.parametrize("name", ["panda", "ur5", "xarm7"])
def test_the_convex_bodies_of_a_robot_contain_its_meshes(name):
    from test_robot_spheres import in_joint, mesh_surfaces

    robot = arms.catalogue_robot(name)
    for link, triangles in mesh_surfaces(robot).items():
        shapes = [body.shape for body in collision_bodies(robot) if body.link == link]
        points = in_joint(robot, link, np.unique(triangles.reshape(-1, 3), axis=0))
        assert np.min([shape.distance(points) for shape in shapes], axis=0).max() < 1e-7


def stl_arm(tmp_path):
    triangles = bent_mesh()
    rows = [struct.pack("<12fH", *([0.0] * 3), *triangle.ravel(), 0) for triangle in triangles]
    (tmp_path / "bent.stl").write_bytes(b"\0" * 80 + struct.pack("<I", len(rows)) + b"".join(rows))
    mesh = '</inertial><collision><geometry><mesh filename="bent.stl"/></geometry></collision></link>'
    text = factory.planar_arm([0.5], [1.0], axis=(0, 0, 1)).replace("</inertial></link>", mesh)
    import energyopt as eo

    return eo.load_robot(factory.write(tmp_path, text))


@pytest.mark.parametrize("damage", [lambda data: b"", lambda data: data[:300], lambda data: b"PK" + bytes(500)])
def test_damaged_pieces_in_the_cache_are_computed_again(damage, monkeypatch, tmp_path):
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path)
    robot, wall = stl_arm(tmp_path), [HalfSpace((-1, 0, 0), -1.0)]
    q = np.linspace(-2, 2, 9)[:, None]
    first = CollisionScene(robot, wall).distances(q).min(axis=1)
    (file,) = tmp_path.glob("mesh-*.npz")
    file.write_bytes(damage(file.read_bytes()))
    bodies._own_bodies.cache_clear()
    again = CollisionScene(robot, wall).distances(q).min(axis=1)
    np.testing.assert_array_equal(first, again)
    corners = bent_mesh().reshape(-1, 3)[:, :2]
    expected = [1.0 - np.max(corners @ [np.cos(x), -np.sin(x)]) for x in q[:, 0]]
    np.testing.assert_allclose(first, expected, atol=1e-7)
    with np.load(file) as archive:
        assert len(archive.files) > 1


def test_an_attached_tool_is_looked_at_where_it_is():
    robot = arms.catalogue_robot("panda")
    tool = Attached(Box((0.02, 0.02, 0.5), (0, 0, 0.25)), "panda_hand_tcp", "stick")
    tip = robot.placement("panda_hand_tcp", robot.home).act(np.array([0, 0, 0.5]))
    under = HalfSpace((0, 0, 1), float(tip[2]) - 0.03, name="table")
    closest = CollisionScene(robot, [under], attached=[tool]).closest(robot.home)[0]
    assert (closest.first, closest.second) == ("stick", "table") and 0 < closest.distance < 0.03 + 1e-9
