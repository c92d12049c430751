"""Free configurations and ways, paths around obstacles, and paths made shorter and rounder."""

from functools import cache

import arms
import numpy as np
import pytest
import urdf_factory as factory

from energyopt.clearance import check_clearance
from energyopt.errors import MissingDependencyError, ProblemError
from energyopt.geometry.bodies import Attached
from energyopt.geometry.moving import Moving
from energyopt.geometry.shapes import Box, Capsule, ConvexMesh, Cylinder, HalfSpace, Sphere
from energyopt.pathfinding import Budget, Effort, FreeSpace, length, resampled, rounded, rrt_connect, shorten
from energyopt.pathfinding.ompl_search import ompl_rrt_connect

RESOLUTION = 0.02
"""The default of FreeSpace [m]."""


@cache
def rods():
    """Two links of 0.5 and 0.4 m that turn about z, each a capsule of radius 0.04 m."""
    return arms.from_urdf(factory.planar_arm([0.5, 0.4], [2.0, 1.5], axis=(0, 0, 1), lower=-3.0, upper=3.0))


def rod(long, link):
    along_x = np.array([[0, 0, 1, 0.5 * long], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1.0]])
    return Attached(Capsule(0.04, long, along_x), link, f"rod of {link}")


RODS = (rod(0.5, "link1"), rod(0.4, "link2"))


def rods_among(*obstacles, **options):
    return FreeSpace.of(rods(), obstacles, self_pairs=(), attached=RODS, **options)


def panda_among(*obstacles, **options):
    return FreeSpace.of(arms.catalogue_robot("panda"), obstacles, **options)


def clutter():
    """Every shape, two of them moving, around the arm."""
    corners = np.array([(0, 0, 0), (0.3, 0, 0), (0, 0.3, 0), (0, 0, 0.3), (0.2, 0.2, 0.2)])
    return (
        Sphere(0.1, (0.5, 0.2, 0.4)),
        Capsule(0.05, 0.6, (-0.4, 0.3, 0.5)),
        Box((0.1, 0.6, 0.02), (0.4, -0.4, 0.5)),
        Cylinder(0.08, 0.4, (-0.3, -0.5, 0.6)),
        HalfSpace((0, 0, 1), -0.05),
        ConvexMesh(points=corners, pose=(0.3, 0.4, 0.7)),
        Box(0.15, Moving((-0.8, 0.0, 0.8), velocity=(0.8, 0, 0), angular_velocity=(0, 0, 1.0))),
        Sphere(0.1, Moving((0.0, 0.6, 0.9), velocity=(0, -0.3, 0))),
    )


def ball_behind_a_wall():
    """A ball that slides along x, and a wall across the whole of its way."""
    ball = (Attached(Sphere(0.1), name="ball"),)
    return FreeSpace.of(arms.sliders(1), [Box((0.1, 2.0, 2.0), (0.5, 0, 0))], self_pairs=(), attached=ball)


class Slab(Box):
    """A shape that the compiled routine has never heard of."""


def random_configurations(free, count, seed=0):
    return np.random.default_rng(seed).uniform(free.limits.lower, free.limits.upper, (count, free.robot.nv))


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("margin", [0.0, 0.03])
def test_a_configuration_is_free_exactly_where_the_exact_distances_say_so(compiled, margin):
    free = panda_among(*clutter(), Slab((0.2, 0.2, 0.02), (0.5, 0.0, 0.7)), margin=margin, compiled=compiled)
    q, t = random_configurations(free, 400), np.linspace(0.0, 2.0, 400)
    truth = free.scene.distances(q, t, cutoff=margin).min(axis=1) > margin
    assert 0.2 < truth.mean() < 0.8
    assert np.array_equal(free.free(q, t), truth)


def test_the_compiled_first_stage_flags_what_numpy_flags():
    """Of a mesh, the compiled one takes the planes only, so it may flag more there, and never less."""
    compiled, plain = (panda_among(*clutter(), compiled=choice) for choice in (True, False))
    q, t = random_configurations(compiled, 2000, seed=1), np.linspace(0.0, 2.0, 2000)
    flags, expected = compiled.overlaps.near(q, t, 0.01), plain.overlaps.near(q, t, 0.01)
    mesh = np.array([k < len(compiled.overlaps.balls.links) * 8 and k % 8 == 5 for k in range(flags.shape[1])])
    assert np.array_equal(flags[:, ~mesh], expected[:, ~mesh])
    assert np.all(flags[:, mesh] >= expected[:, mesh])


def test_outside_the_limits_nothing_is_free_nor_what_is_no_number():
    free = rods_among()
    assert free.free([[3.0 + 1e-7, 0.0], [3.01, 0.0], [0.0, np.nan], [np.inf, 0.0]]).tolist() == [True, False, False, False]


def test_a_frame_bound_to_a_workspace_has_to_stay_inside():
    free = rods_among(bound=[("tool", HalfSpace((1, 0, 0), 0.3))])
    assert free.free([[0.0, 0.0], [0.0, 2.8]]).tolist() == [True, False]
    with pytest.raises(ProblemError, match=r"^goal: a frame is outside"):
        rrt_connect(free, np.zeros(2), np.array([0.0, 2.8]), np.random.default_rng(0))


def test_a_bound_frame_is_watched_along_the_way():
    """Both ends are on the free side, the straight way between them swings the tool through the wall."""
    free = rods_among(bound=[("tool", HalfSpace((-1, 0, 0), -0.8))])
    assert free.free([[-0.6, 0.0], [0.6, 0.0]]).all()
    assert not free.free_way(np.array([-0.6, 0.0]), np.array([0.6, 0.0]))


def test_between_samples_of_a_way_no_distance_changes_by_more_than_the_resolution():
    free = panda_among(*clutter()[:6])
    for a, b in zip(random_configurations(free, 4), random_configurations(free, 4, seed=1), strict=True):
        way = np.vstack([a, free.way(a, b)])
        assert np.array_equal(way[-1], b)
        assert np.abs(np.diff(free.scene.distances(way), axis=0)).max() <= RESOLUTION


def test_a_thin_board_blocks_the_way():
    free = rods_among(Box((0.6, 0.004, 0.5), (0.8, 0.0, 0.0)))
    a, b = np.array([-0.5, 0.0]), np.array([0.5, 0.0])
    assert free.free([a, b]).all()
    assert not free.free_way(a, b)
    assert rods_among().free_way(a, b)


def test_a_path_leads_around_a_board_and_is_free():
    free = rods_among(Box((0.4, 0.02, 0.5), (0.8, 0.0, 0.0)))
    start, goal = np.array([-0.6, 0.0]), np.array([0.6, 0.0])
    found = rrt_connect(free, start, goal, np.random.default_rng(0))
    assert found.found and not found.reason
    assert np.array_equal(found.path[[0, -1]], [start, goal])
    fine = resampled(found.path, 1e-3)
    assert free.scene.distances(fine).min() > -0.5 * RESOLUTION
    assert free.inside(fine).all() and free.free_path(found.path)


def test_the_same_generator_gives_the_same_path():
    free = rods_among(Box((0.4, 0.02, 0.5), (0.8, 0.0, 0.0)))
    ends = np.array([-0.6, 0.0]), np.array([0.6, 0.0])
    first, again, other = (rrt_connect(free, *ends, np.random.default_rng(seed)).path for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert first.shape != other.shape or not np.allclose(first, other)


def test_a_way_that_is_free_is_the_path():
    found = rrt_connect(rods_among(), np.zeros(2), np.ones(2), np.random.default_rng(0))
    assert np.array_equal(found.path, [[0, 0], [1, 1]])


@pytest.mark.parametrize(("budget", "said"), [(Budget(None, 60), "s, with 6"), (Budget(0.0), "no path in ")])
def test_a_search_without_hope_ends_with_its_budget(budget, said):
    free = ball_behind_a_wall()
    found = rrt_connect(free, np.array([0.0]), np.array([1.0]), np.random.default_rng(0), budget)
    assert not found.found and said in found.reason and 2 <= found.nodes <= 100


def test_a_start_in_collision_is_refused_with_the_pair_and_the_depth():
    free = rods_among(Sphere(0.05, (0.7, 0.0, 0.0), "can"))
    with pytest.raises(ProblemError, match=r"^start: 'rod of link2' and 'can' are 90.00 mm inside one another"):
        rrt_connect(free, np.zeros(2), np.ones(2), np.random.default_rng(0))
    with pytest.raises(ProblemError, match=r"^goal: joint 'joint2' is at 4, 1 outside its position limits"):
        rrt_connect(free, np.ones(2), np.array([1.0, 4.0]), np.random.default_rng(0))


def test_paths_keep_the_margin_where_ends_have_it():
    free = rods_among(Box((0.4, 0.02, 0.5), (0.8, 0.0, 0.0)), margin=0.03, resolution=0.002)
    found = rrt_connect(free, np.array([-0.6, 0.0]), np.array([0.6, 0.0]), np.random.default_rng(0))
    assert free.scene.distances(resampled(found.path, 1e-3)).min() > 0.03 - 0.001


def test_shortening_keeps_ends_and_freedom_and_is_never_longer():
    free = rods_among(Box((0.4, 0.02, 0.5), (0.8, 0.0, 0.0)))
    start, goal = np.array([-0.6, 0.0]), np.array([0.6, 0.0])
    for seed in range(4):
        path = rrt_connect(free, start, goal, np.random.default_rng(seed)).path
        short, again = (shorten(free, path, np.random.default_rng(seed), Effort()) for _ in range(2))
        assert np.array_equal(short, again)
        assert np.array_equal(short[[0, -1]], path[[0, -1]])
        assert length(short) <= length(path)
        assert free.free_path(short)


def test_without_obstacles_a_path_shortens_to_the_straight_way():
    path = np.random.default_rng(0).uniform(-2, 2, (8, 2))
    short = shorten(rods_among(), path, np.random.default_rng(1), Effort())
    assert length(short) == pytest.approx(np.linalg.norm(path[-1] - path[0]), rel=1e-3)


def test_resampling_keeps_corners_and_spacing():
    path = np.array([[0, 0], [1.0, 0], [1.0, 0.5]])
    fine = resampled(path, 0.3)
    assert np.linalg.norm(np.diff(fine, axis=0), axis=1).max() <= 0.3
    assert all(np.any(np.all(fine == corner, axis=1)) for corner in path)
    assert length(fine) == pytest.approx(length(path), rel=1e-12)


def test_a_straight_path_becomes_a_curve_of_unit_speed():
    path = np.array([[0.1, -0.2, 0.3], [1.0, 0.4, -0.5]])
    curve = rounded(path)
    s = np.linspace(0, curve.duration, 50)
    assert curve.duration == pytest.approx(length(path), rel=1e-12)
    assert np.allclose(np.linalg.norm(curve(s, 1), axis=1), 1.0, atol=1e-9)
    assert np.allclose(curve(s, 2), 0.0, atol=1e-9)


def test_corners_are_rounded_no_farther_than_is_free():
    free = rods_among(Box((0.4, 0.02, 0.5), (0.8, 0.0, 0.0)))
    wide = free.with_margin(0.005)
    path = rrt_connect(wide, np.array([-0.6, 0.0]), np.array([0.6, 0.0]), np.random.default_rng(1)).path
    curve = rounded(path, free)
    assert np.allclose(curve(np.array([0.0, curve.duration])), path[[0, -1]], rtol=0, atol=1e-12)
    assert free.free(curve(np.linspace(0, curve.duration, 2000))).all()
    assert len(rounded(path).breaks) <= len(curve.breaks)


def test_rounded_corners_touch_nothing_between_the_samples_either():
    """Small balls beside corners that are hardly cut. In the cases 34 and 47 samples alone would let a link touch one."""
    for seed in (*range(5), 34, 47):
        rng = np.random.default_rng(seed)
        places = [rng.uniform(0.65, 0.95) * np.array([np.cos(a), np.sin(a), 0.0]) for a in rng.uniform(-0.9, 0.9, 3)]
        balls = [Sphere(0.01, place, f"ball {k}") for k, place in enumerate(places)]
        free = rods_among(*balls)
        near = free.with_margin(0.003)
        found = rrt_connect(near, np.array([-1.3, 0.0]), np.array([1.3, 0.0]), np.random.default_rng(seed), Budget(None, 400))
        curve = rounded(shorten(near, found.path, np.random.default_rng(0)), free)
        assert check_clearance(rods(), curve, balls, (), RODS).passes


@pytest.mark.parametrize("path", [np.zeros((1, 2)), np.zeros((3, 2)), np.full((2, 2), np.nan)])
def test_a_path_without_length_is_refused(path):
    with pytest.raises(ProblemError, match="at least two different configurations"):
        rounded(path)


def test_ompl_finds_a_free_path_the_same_for_the_same_seed():
    pytest.importorskip("ompl", reason="OMPL is an optional extra: pip install energyopt[ompl]")
    free = rods_among(Box((0.4, 0.02, 0.5), (0.8, 0.0, 0.0)))
    start, goal = np.array([-0.6, 0.0]), np.array([0.6, 3.0])  # the goal lies on a limit
    first, again = (ompl_rrt_connect(free, start, goal, np.random.default_rng(2)) for _ in range(2))
    assert first.found and np.array_equal(first.path, again.path)
    assert np.array_equal(first.path[[0, -1]], [start, goal]) and free.free_path(first.path)
    walled = ball_behind_a_wall()
    failed = ompl_rrt_connect(walled, np.array([0.0]), np.array([1.0]), np.random.default_rng(0), Budget(0.2))
    assert not failed.found and "no path in " in failed.reason


def test_without_ompl_the_message_says_how_to_get_it():
    try:
        import ompl  # noqa: F401
    except ImportError:
        with pytest.raises(MissingDependencyError, match=r"pip install 'energyopt\[ompl\]'"):
            ompl_rrt_connect(rods_among(), np.zeros(2), np.ones(2), np.random.default_rng(0))
    else:
        pytest.skip("OMPL is installed")
