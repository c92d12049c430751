"""The robot as spheres: what they contain, how far they stick out, the cache, and what comes with the package."""

import time
import warnings
import xml.etree.ElementTree as ET
from concurrent.futures import ThreadPoolExecutor

import arms
import numpy as np
import pinocchio as pin
import pytest
import urdf_factory as factory

from energyopt.errors import GeometryError
from energyopt.geometry import bodies, cache
from energyopt.geometry import robot_spheres as module
from energyopt.geometry.bodies import Attached, collision_bodies
from energyopt.geometry.cover import cover_bodies, union_distance
from energyopt.geometry.kinematics import travel_bounds
from energyopt.geometry.mesh_files import read_mesh
from energyopt.geometry.moving import Moving
from energyopt.geometry.robot_spheres import center_jacobians, centers, robot_spheres
from energyopt.geometry.shapes import Box, Capsule, ConvexMesh, Cylinder, HalfSpace, Sphere
from energyopt.robots.catalogue import catalogue
from energyopt.robots.meshes import MAX_MESH_BYTES, resolve_mesh
from energyopt.robots.preparation import rotation_from_rpy
from energyopt.robots.urdf_xml import numbers

ROBOTS = ["panda", "ur5", "xarm7", "kinova", "baxter"]
PRIMITIVES = """
<collision><origin xyz="0.2 0 0.05" rpy="0.3 0.2 0.1"/><geometry><box size="0.4 0.1 0.06"/></geometry></collision>
<collision><origin xyz="0.4 0 0" rpy="1.2 0 0"/><geometry><cylinder radius="0.05" length="0.2"/></geometry></collision>
<collision><origin xyz="0.45 0.1 0"/><geometry><sphere radius="0.07"/></geometry></collision></link>"""


@pytest.fixture
def empty_cache(monkeypatch, tmp_path):
    monkeypatch.setattr(cache, "cache_folder", lambda: tmp_path)
    return tmp_path


@pytest.fixture
def nothing_shipped(monkeypatch, tmp_path):
    monkeypatch.setattr(cache, "SHIPPED", tmp_path / "none.npz")
    cache.shipped_archive.cache_clear()
    yield
    cache.shipped_archive.cache_clear()


def primitive_arm():
    """Each link a box, a cylinder and a sphere that overlap."""
    text = factory.planar_arm([0.5, 0.4], [2.0, 1.5])
    return arms.from_urdf(text.replace("</inertial></link>", "</inertial>" + PRIMITIVES))


def box_arm():
    """A small box at the end of an arm: its cover takes no time."""
    box = '<collision><origin xyz="0.5 0 0"/><geometry><box size="0.06 0.05 0.04"/></geometry></collision></link>'
    text = factory.planar_arm([0.5], [2.0])
    return arms.from_urdf(text.replace("</inertial></link>", "</inertial>" + box))


def mesh_surfaces(robot):
    """Straight from the files: by link, the triangles (F, 3, 3) of its collision meshes in the frame of the link [m]."""
    found = {}
    for link in ET.fromstring(robot.urdf).findall("link"):
        for element in link.findall("collision"):
            mesh = element.find("geometry/mesh")
            if mesh is None:
                continue
            vertices, faces = read_mesh(resolve_mesh(robot, mesh.get("filename")), MAX_MESH_BYTES, "test")
            vertices = vertices * np.array(numbers(mesh, "scale", "1 1 1"))
            origin = element.find("origin")
            turn = rotation_from_rpy(numbers(origin, "rpy", "0 0 0"))
            vertices = vertices @ turn.T + np.array(numbers(origin, "xyz", "0 0 0"))
            found.setdefault(link.get("name"), []).append(vertices[faces])
    return {link: np.concatenate(parts) for link, parts in found.items()}


def in_joint(robot, link, points):
    frame = robot.model.frames[robot.frame_id(link)]
    return points @ frame.placement.rotation.T + frame.placement.translation


def outside(spheres, link, points):
    """How far the farthest point is outside all spheres of a link [m]."""
    own = np.array([name == link for name in spheres.link])
    gaps = np.linalg.norm(points[:, None] - spheres.center[own], axis=2) - spheres.radius[own]
    return gaps.min(axis=1).max()


def on_triangles(rng, triangles, count):
    """Random points, even over the area."""
    areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    rows = rng.choice(len(triangles), count, p=areas / areas.sum())
    return np.einsum("nk,nki->ni", rng.dirichlet(np.ones(3), count), triangles[rows])


@pytest.mark.parametrize("name", ROBOTS)
def test_every_vertex_and_random_points_of_every_mesh_are_inside_the_spheres(name):
    robot = arms.catalogue_robot(name)
    spheres = robot_spheres(robot)
    rng = np.random.default_rng(1)
    surfaces = mesh_surfaces(robot)
    assert set(surfaces) <= set(spheres.links) and surfaces
    for link, triangles in surfaces.items():
        vertices = np.unique(triangles.reshape(-1, 3), axis=0)
        points = np.concatenate([vertices, on_triangles(rng, triangles, 2000)])
        assert outside(spheres, link, in_joint(robot, link, points)) <= 0
    assert all(cover.protrusion <= 0 for cover in spheres.covers)


@pytest.mark.parametrize("name", [*ROBOTS, "primitives"])
def test_no_sphere_sticks_out_farther_than_reported(name):
    robot = primitive_arm() if name == "primitives" else arms.catalogue_robot(name)
    spheres = robot_spheres(robot)
    rng = np.random.default_rng(2)
    for report in spheres.covers:
        shapes = [body.shape for body in collision_bodies(robot) if body.link == report.link]
        own = np.array([name == report.link for name in spheres.link])
        unit = rng.normal(size=(400, 3))
        unit /= np.linalg.norm(unit, axis=1)[:, None]
        points = (spheres.center[own][:, None] + spheres.radius[own][:, None, None] * unit).reshape(-1, 3)
        away = union_distance(shapes, points).max()
        assert away <= report.max_excess + 1e-9
        assert report.mean_excess <= report.max_excess + 1e-12 and own.sum() == report.count
        moving = spheres.joint[own][0] > 0
        assert not moving or report.max_excess <= module.RESOLUTION + 1e-6 or len(shapes) > 1
    assert f"{len(spheres)} spheres" in spheres.summary()


def test_primitives_of_a_urdf_are_covered():
    robot = primitive_arm()
    spheres = robot_spheres(robot)
    assert spheres.links == ("link1", "link2") and max(c.max_excess for c in spheres.covers) <= module.RESOLUTION + 1e-6
    rng = np.random.default_rng(3)
    for link in spheres.links:
        shapes = [body.shape for body in collision_bodies(robot) if body.link == link]
        points = rng.uniform((-0.1, -0.2, -0.2), (0.6, 0.2, 0.3), (100_000, 3))
        solid = points[union_distance(shapes, points) <= 0]
        surface = solid[union_distance(shapes, solid) > -0.005]
        assert len(surface) > 500 and outside(spheres, link, surface) <= 0


@pytest.mark.parametrize("resolution", [0.015, 0.03])
def test_random_solids_are_covered_within_the_resolution(resolution):
    rng = np.random.default_rng(4)
    for shape in (
        Box((0.15, 0.1, 0.05)),
        Cylinder(0.05, 0.1),
        Capsule(0.05, 0.2),
        ConvexMesh(points=0.04 * rng.normal(size=(20, 3))),
        Sphere(0.1, (0.1, 0.2, 0.3)),
    ):
        cover = cover_bodies([shape], resolution)
        points = on_triangles(rng, _boundary(shape), 3000)
        gaps = np.linalg.norm(points[:, None] - cover.centers, axis=2) - cover.radii
        assert gaps.min(axis=1).max() <= 0 and cover.protrusion <= 0
        assert cover.excess.max() <= resolution + 1e-6


def _boundary(shape):
    from energyopt.geometry.cover import posed_points
    from energyopt.geometry.hull import Hull

    hull = Hull.of_points(posed_points(shape), "test")
    # The polyhedron drawn around a round shape is larger than it; its points go to the nearest ones of the shape.
    d, gradient, _ = shape.signed_distance(hull.vertices)
    return (hull.vertices - d[:, None] * gradient)[hull.triangles]


def test_the_result_is_the_same_twice_and_inflation_adds_to_every_radius():
    robot = box_arm()
    first, second = robot_spheres(robot), robot_spheres(robot, inflation=0.01)
    np.testing.assert_array_equal(first.center, second.center)
    np.testing.assert_allclose(second.radius - first.radius, 0.01, atol=1e-15)
    assert [c.max_excess for c in first.covers] == [c.max_excess for c in second.covers]
    assert len(robot_spheres(robot, resolution=0.004)) > len(first)


def test_centers_and_their_jacobians_agree_with_pinocchio_and_finite_differences():
    for robot in (arms.catalogue_robot("panda"), arms.catalogue_robot("baxter"), primitive_arm()):
        spheres = robot_spheres(robot)
        q = np.random.default_rng(5).uniform(-1, 1, (3, robot.nv))
        data = robot.model.createData()
        for row, found in zip(q, centers(spheres, q), strict=True):
            pin.forwardKinematics(robot.model, data, row)
            expected = [data.oMi[int(j)].act(c) for j, c in zip(spheres.joint, spheres.center, strict=True)]
            np.testing.assert_allclose(found, expected, atol=1e-12)
        _, jacobian = center_jacobians(spheres, q)
        step = 1e-6
        for v in range(robot.nv):
            e = step * np.eye(robot.nv)[v]
            slope = (centers(spheres, q + e) - centers(spheres, q - e)) / (2 * step)
            np.testing.assert_allclose(jacobian[..., v], slope, atol=1e-8)


def test_no_ball_moves_faster_than_the_travel_bound():
    robot = arms.mixed_chain()
    rng = np.random.default_rng(6)
    joint, center, radius = np.array([1, 2, 3]), rng.normal(size=(3, 3)), np.array([0.1, 0.2, 0.05])
    bounds = travel_bounds(robot.model, joint, center, radius)
    spheres = module.SphereModel(robot.model, ("a", "b", "c"), joint, center, radius, ())
    q = rng.uniform(robot.limits.lower, robot.limits.upper, (2000, robot.nv))
    _, jacobian = center_jacobians(spheres, q)
    fastest = np.linalg.norm(jacobian, axis=2).max(axis=0)
    assert np.all(fastest <= bounds + 1e-12) and fastest.max() > 0.3 * bounds.max()


def test_a_tool_is_covered_where_it_is_attached():
    robot = arms.catalogue_robot("panda")
    tool = Attached(Box((0.05, 0.05, 0.3), (0, 0, 0.15)), "panda_hand_tcp", "stick")
    spheres = robot_spheres(robot, attached=[tool])
    bare = robot_spheres(robot)
    assert len(spheres) > len(bare) and spheres.links[-1] == "stick" and spheres.link[: len(bare)] == bare.link
    np.testing.assert_array_equal(spheres.center[: len(bare)], bare.center)
    corners = np.array([[x, y, z] for x in (-0.025, 0.025) for y in (-0.025, 0.025) for z in (0.0, 0.3)])
    assert outside(spheres, "stick", in_joint(robot, "panda_hand_tcp", corners)) <= 0


def test_the_cover_of_a_link_does_not_depend_on_the_joints_that_are_locked():
    """Found in what comes with the package: the same balls, moved with the link."""
    from energyopt import load_robot

    robot = load_robot("panda", locked={"panda_joint7": 0.5, "panda_finger_joint1": 0.02})
    spheres, usual = robot_spheres(robot), robot_spheres(arms.catalogue_robot("panda"))
    assert spheres.link == usual.link
    np.testing.assert_array_equal(spheres.radius, usual.radius)
    q = np.full(6, 0.3)
    at = centers(spheres, q)[0]
    expected = centers(usual, np.append(q, 0.5))[0]
    own = np.array(["finger" not in name for name in usual.link])
    np.testing.assert_allclose(at[own], expected[own], atol=1e-9)


@pytest.mark.parametrize("name", catalogue())
def test_the_cover_of_every_catalogue_robot_comes_with_the_package(name, empty_cache):
    """Else: python -m energyopt.geometry.ship."""
    bodies._own_bodies.cache_clear()
    spheres = robot_spheres(arms.catalogue_robot(name))
    assert len(spheres) and not [p.name for p in empty_cache.iterdir() if p.name.startswith(("cover-", "mesh-"))]
    assert all(cover.protrusion <= 0 and cover.mean_excess < 0.05 for cover in spheres.covers)


@pytest.fixture
def shipped_and_computed(request):
    """Covers of a robot that come with the package, and what is computed without them."""
    robot = arms.catalogue_robot(request.param)
    bodies._own_bodies.cache_clear()
    shipped = robot_spheres(robot)
    bodies._own_bodies.cache_clear()
    for name in ("empty_cache", "nothing_shipped"):
        request.getfixturevalue(name)
    yield shipped, robot_spheres(robot)
    bodies._own_bodies.cache_clear()


@pytest.mark.parametrize("shipped_and_computed", ["z1", "ur3"], indirect=True)
def test_what_comes_with_the_package_is_what_would_be_computed(shipped_and_computed):
    """Equal on the same processor; elsewhere rounding may decide a tie between two candidates otherwise: a tenth of slack."""
    shipped, computed = shipped_and_computed
    assert abs(len(computed) - len(shipped)) <= 0.1 * len(shipped)
    for mine, theirs in zip(computed.covers, shipped.covers, strict=True):
        assert mine.link == theirs.link and mine.protrusion <= 0
        assert mine.max_excess == pytest.approx(theirs.max_excess, abs=3e-3)


def damage(path, kind):
    data = path.read_bytes()
    if kind == "truncated":
        path.write_bytes(data[: len(data) // 2])
    elif kind == "text":
        path.write_text("nothing")
    elif kind == "flipped":
        path.write_bytes(data[:200] + bytes(255 - b for b in data[200:400]) + data[400:])
    else:
        with np.load(path) as archive:
            arrays = dict(archive)
        arrays["radius"] = -arrays["radius"] if kind == "negative" else arrays["radius"][1:]
        np.savez(path, **arrays)


@pytest.mark.parametrize("kind", ["truncated", "text", "flipped", "negative", "short"])
def test_a_damaged_file_of_the_cache_is_computed_again(kind, empty_cache):
    robot = box_arm()
    first = robot_spheres(robot)
    files = sorted(empty_cache.glob("cover-*.npz"))
    assert len(files) == 1
    damage(files[0], kind)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = robot_spheres(robot)
    np.testing.assert_array_equal(first.center, again.center)
    np.testing.assert_array_equal(first.radius, again.radius)


def test_a_read_only_cache_costs_time_and_nothing_else(monkeypatch, empty_cache):
    monkeypatch.setattr(cache.tempfile, "mkstemp", lambda **options: (_ for _ in ()).throw(OSError(30, "read-only")))
    assert len(robot_spheres(box_arm())) and not list(empty_cache.glob("*.npz"))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda r: robot_spheres(r, resolution=1e-3), "resolution is 0.001"),
        (lambda r: robot_spheres(r, resolution=np.nan), "resolution is nan"),
        (lambda r: robot_spheres(r, inflation=-0.1), "inflation is -0.1"),
        (lambda r: robot_spheres(r, attached=[Box(0.1)]), "expected energyopt.geometry.Attached"),
        (lambda r: robot_spheres(r, attached=[Attached(Box(0.1), name="link1")]), "'link1' is taken"),
        (lambda r: robot_spheres(r, attached=2 * [Attached(Box(0.1))]), "name of its own"),
        (lambda r: Attached(HalfSpace((0, 0, 1))), "finite size"),
        (lambda r: Attached(Box(0.1, Moving((0, 0, 0), velocity=(1, 0, 0)))), "does not move"),
    ],
)
def test_bad_arguments_are_one_clear_line(make, said):
    with pytest.raises(GeometryError, match=said):
        make(box_arm())


def test_a_robot_without_geometry_has_no_spheres():
    spheres = robot_spheres(arms.pendulum())
    assert len(spheres) == 0 and "no geometry" in spheres.summary()
    assert centers(spheres, np.zeros((2, 1))).shape == (2, 0, 3)


def test_arrays_are_read_by_one_thread_at_a_time(monkeypatch):
    """CPython 3.11 fails now and then, with a SystemError, to parse the heads of two arrays at once."""
    inside, most = [], []

    class Slow(dict):
        def __getitem__(self, key):
            inside.append(key)
            most.append(len(inside))
            time.sleep(1e-3)
            inside.remove(key)
            return super().__getitem__(key)

    names = [f"cover-{k}" for k in range(16)]
    members = {name: [f"{name}/radius"] for name in names}
    archive = Slow({f"{name}/radius": np.ones(1) for name in names})
    monkeypatch.setattr(cache, "shipped_archive", lambda: (archive, members))
    with ThreadPoolExecutor(4) as pool:
        assert all("radius" in found for found in pool.map(cache._shipped, names))
    assert len(most) == len(names) and max(most) == 1
