"""The clearance of a whole motion: against closed forms, and against dense sampling with the exact distances."""

from functools import cache

import arms
import numpy as np
import pytest
import urdf_factory as factory

from energyopt.clearance import around_base, check_clearance, clearance_at, touching
from energyopt.errors import GeometryError
from energyopt.geometry.bodies import Attached
from energyopt.geometry.exact import CollisionScene
from energyopt.geometry.moving import Moving
from energyopt.geometry.self_collision import self_collision_pairs
from energyopt.geometry.shapes import Box, Capsule, Cylinder, HalfSpace, Sphere
from energyopt.parameterizations.excursions import excursions
from energyopt.parameterizations.trajectory import PolynomialTrajectory, SinusoidTrajectory, SplineTrajectory, Trajectory

TOLERANCE = 1e-4
"""The default of check_clearance [m]."""
REACH, RADIUS = 0.8, 0.1
BALL = (Attached(Sphere(RADIUS), name="ball"),)


@cache
def turning_arm():
    """Turns about z; its tool, which carries the ball, is 0.8 m away."""
    return arms.from_urdf(factory.planar_arm([REACH], [1.0], axis=(0, 0, 1)))


@cache
def slider():
    """Slides along x; the ball is attached to it."""
    return arms.sliders(1)


def quintic(start, end, duration):
    """From rest to rest on one polynomial."""
    start, way = np.atleast_1d(start).astype(float), np.atleast_1d(end) - np.atleast_1d(start)
    rows = [start, 0 * way, 0 * way, 10 * way / duration**3, -15 * way / duration**4, 6 * way / duration**5]
    return PolynomialTrajectory([0.0, duration], np.array([rows]))


def cycloid(start, end, duration):
    start, way = np.atleast_1d(start).astype(float), np.atleast_1d(end) - np.atleast_1d(start)
    return SinusoidTrajectory(duration, np.array([start, way]), -way[None] / (2 * np.pi), np.zeros((1, len(way))))


def random_spline(rng, low, high, spans=8, degree=3, duration=2.0):
    knots = np.concatenate([np.zeros(degree), np.linspace(0, duration, spans + 1), np.full(degree, duration)])
    return SplineTrajectory(knots, rng.uniform(low, high, (spans + degree, len(low))), degree)


MOTIONS = {"polynomial": quintic, "sinusoid": cycloid}


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_a_ball_passes_an_obstacle_at_the_distance_known_in_closed_form(motion):
    """The ball's centre runs on a circle of 0.8 m; from the point at polar angle 40° and 1.3 m the circle is 0.5 m away."""
    angle, far = np.deg2rad(40.0), 1.3
    post = Sphere(0.15, (far * np.cos(angle), far * np.sin(angle), 0), name="post")
    found = check_clearance(turning_arm(), motion(-1.0, 2.0, 1.7), [post], attached=BALL)
    least = far - REACH - 0.15 - RADIUS
    assert 0.99 * least <= found.certified_margin <= least + 1e-9
    assert abs(found.distance - least) < 1e-5
    assert (found.first, found.second) == ("ball", "post") and found.passes
    assert abs(float(motion(-1.0, 2.0, 1.7)(found.time)[0]) - angle) < 5e-3


def test_a_wall_is_met_where_the_sine_is_largest():
    """The wall fills y > 0.85: the ball's centre rises to 0.8 sin q, most at q = 90° in the middle of the motion."""
    wall = HalfSpace((0, -1, 0), -0.95, name="wall")
    found = check_clearance(turning_arm(), quintic(np.pi / 4, 3 * np.pi / 4, 1.0), [wall], attached=BALL, margin=0.02)
    assert found.passes and abs(found.distance - 0.05) <= 1e-6
    close = check_clearance(turning_arm(), quintic(np.pi / 4, 3 * np.pi / 4, 1.0), [wall], attached=BALL, margin=0.06)
    assert not close.passes and len(close.violations) == 1
    worst = close.violations[0]
    assert (worst.first, worst.second, worst.certified) == ("ball", "wall", True)
    assert abs(worst.distance - 0.05) < 1e-6 and abs(worst.time - 0.5) < 2e-3


def test_a_thin_board_between_two_samples_is_found_with_its_depth():
    """The ball crosses a board of 1 mm in 8 ms at the full speed of its motion; deepest when their middles coincide, where
    the board would have to go by the radius and half its thickness."""
    board = Box((1e-3, 2.0, 2.0), (1.234, 0, 0), name="board")
    motion = quintic(0.0, 100.0, 2.0)
    found = check_clearance(slider(), motion, [board], attached=BALL)
    assert not found.passes and len(found.violations) == 1
    deepest = found.violations[0]
    assert abs(float(motion(deepest.time)[0]) - 1.234) < 1e-3
    assert abs(deepest.distance + RADIUS + 0.5e-3) < 1e-4
    assert found.distance == deepest.distance and found.certified_margin < deepest.distance


def test_every_passage_of_a_motion_to_and_fro_is_reported():
    knots = np.array([0.0, 1.0, 2.0, 3.0])
    there = quintic(-1.0, 1.0, 1.0).coefficients
    back = quintic(1.0, -1.0, 1.0).coefficients
    motion = PolynomialTrajectory(knots, np.concatenate([there, back, there]))
    found = check_clearance(slider(), motion, [Sphere(0.05, (0.0, 0.12, 0), name="post")], attached=BALL)
    assert [round(i.time, 2) for i in sorted(found.violations, key=lambda i: i.time)] == [0.5, 1.5, 2.5]
    for instant in found.violations:
        assert abs(instant.distance + 0.03) < 1e-6


@pytest.mark.parametrize(("margin", "passes"), [(0.2 - 3e-4, True), (0.2, True), (0.2 + 3e-4, False)])
def test_a_motion_along_a_wall_at_exactly_the_margin_ends_by_the_tolerance(margin, passes):
    floor = HalfSpace((0, 0, 1), -0.3, name="floor")
    found = check_clearance(turning_arm(), quintic(-2.0, 2.0, 2.0), [floor], attached=BALL, margin=margin)
    assert found.passes == passes
    assert abs(found.distance - 0.2) < 1e-12 and found.certified_margin >= 0.2 - (TOLERANCE if passes else 1.1e-3)
    assert found.checks < 60_000


def test_what_touches_never_passes_even_without_a_margin():
    """The ball slides along a floor that it touches, or that is nearer by less than the tolerance."""
    for gap, passes in ((0.0, False), (-5e-5, False), (3e-4, True)):
        floor = HalfSpace((0, 0, 1), -RADIUS - gap)
        found = check_clearance(turning_arm(), quintic(0.0, 0.5, 1.0), [floor], attached=BALL)
        assert found.passes == passes and (not passes or found.certified_margin >= 0)


def test_a_moving_obstacle_is_met_at_the_right_time():
    """Ball and obstacle move towards one another on lines 0.4 m apart: the distance is least when their x agree."""
    motion = quintic(-1.0, 1.0, 2.0)
    for speed in (0.0, 0.3, -0.7):
        part = Sphere(0.2, Moving((0.5, 0.4, 0), velocity=(speed, 0, 0)), name="part")
        t = np.linspace(0, 2, 200_001)
        away = np.hypot(motion(t)[:, 0] - 0.5 - speed * t, 0.4) - 0.2 - RADIUS
        found = check_clearance(slider(), motion, [part], attached=BALL)
        assert found.passes and found.certified_margin <= away.min() + 1e-9
        assert abs(found.distance - away.min()) <= 1e-5 and abs(found.time - t[away.argmin()]) < 0.01


def test_a_turning_plane_whose_far_points_have_no_speed_bound_is_certified():
    """The plane through (0, −1, 0) turns about x: the ball at (x, 0, 0) is cos(ωt) above it, less its radius."""
    plane = HalfSpace((0, 1, 0), 0.0, Moving((0, -1, 0), angular_velocity=(0.5, 0, 0)), name="plane")
    found = check_clearance(slider(), quintic(0.0, 1.0, 2.0), [plane], attached=BALL)
    assert found.passes and abs(found.distance - (np.cos(1.0) - RADIUS)) <= 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_certified_is_below_every_sample_and_within_the_tolerance_of_the_least(seed):
    """Random arms' motions of three kinds among fixed and moving obstacles, 2000 samples each with the exact distances."""
    rng = np.random.default_rng(seed)
    robot = arms.catalogue_robot(["panda", "ur5"][seed % 2])
    low, high = 0.5 * np.maximum(robot.limits.lower, -3.0), 0.5 * np.minimum(robot.limits.upper, 3.0)
    start, end = rng.uniform(low, high, (2, robot.nv))
    motion = [quintic(start, end, 2.0), cycloid(start, end, 2.0), random_spline(rng, low, high)][seed % 3]
    place = lambda: rng.uniform((-1, -1, 0.6), (1, 1, 1.6))
    obstacles = [Box(rng.uniform(0.02, 0.3, 3), place()), Cylinder(0.1, 0.4, place()), Capsule(0.05, 0.3, place())]
    obstacles += [Sphere(0.1, Moving(place(), velocity=rng.uniform(-0.3, 0.3, 3))), HalfSpace((0, 0, 1), -0.9)]
    pairs = self_collision_pairs(robot).checked
    found = check_clearance(robot, motion, obstacles, pairs)
    t = np.linspace(0.0, motion.duration, 2001)
    seen = clearance_at(robot, motion(t), t, obstacles, pairs)
    least = min(seen, key=lambda closest: closest.distance)
    assert found.certified_margin <= least.distance + 1e-6
    if found.passes:
        assert least.distance >= -1e-6
        slack = max(TOLERANCE, 0.01 * found.distance)
        assert found.distance - slack - 1e-12 <= found.certified_margin
        assert abs(found.distance - least.distance) <= slack
    else:
        assert found.distance <= least.distance + 1e-3
        worst = found.violations[0]
        same = [c.distance for c in clearance_at(robot, motion(np.array([worst.time])), worst.time, obstacles, pairs)]
        assert same[0] == pytest.approx(worst.distance, abs=1e-9)


def test_each_violating_instant_is_below_the_margin_and_every_sampled_violation_has_one():
    robot = arms.catalogue_robot("panda")
    motion = quintic(robot.home + [-1.2, 0, 0, 0, 0, 0, 0], robot.home + [1.2, 0.3, 0, 0.3, 0, 0, 0], 2.0)
    obstacles = [Box((0.05, 0.05, 1.0), (0.3, 0.2, 0.5), "post"), Box((0.4, 0.1, 0.1), (0.4, -0.3, 0.6), "bar")]
    found = check_clearance(robot, motion, obstacles, margin=0.01)
    scene = CollisionScene(robot, obstacles)
    t = np.linspace(0, 2, 1001)
    below = scene.distances(motion(t), t) < 0.01
    sampled = {scene.pairs[k] for k in np.flatnonzero(below.any(axis=0))}
    assert sampled and sampled <= {(i.first, i.second) for i in found.violations}
    for instant in found.violations:
        now = scene.distances(motion(np.array([instant.time])), instant.time)[0]
        assert min(d for d, pair in zip(now, scene.pairs, strict=True) if pair == (instant.first, instant.second)) < 0.01


def test_a_spent_budget_is_a_violation_and_says_so():
    found = check_clearance(turning_arm(), quintic(0, 1, 1.0), [HalfSpace((0, 0, 1), -0.2)], attached=BALL, margin=0.1, budget=40)
    assert not found.passes and not found.violations[0].certified and "could not be proved" in str(found)


def test_no_joint_leaves_the_bound_of_its_excursion():
    rng = np.random.default_rng(4)
    low, high = np.array([-2.0, -1.0]), np.array([2.0, 3.0])
    waves = SinusoidTrajectory(1.5, rng.normal(size=(4, 2)), rng.normal(size=(3, 2)), rng.normal(size=(3, 2)))
    for motion in (quintic(low, high, 1.3), waves, random_spline(rng, low, high, degree=5)):
        edges = np.unique(np.concatenate([motion.breaks, np.linspace(0, motion.duration, 30)]))
        middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
        bound = excursions(motion, middle, half)
        t = np.linspace(edges[:-1], edges[1:], 41)
        gone = np.abs(motion(t.ravel()).reshape(*t.shape, 2) - motion(middle)).max(axis=0)
        assert np.all(gone <= bound * (1 + 1e-9) + 1e-12)
        assert np.median(bound / gone) < 1.5


def test_touching_names_the_pairs_and_their_depths():
    robot = turning_arm()
    obstacles = [Sphere(0.1, (0.75, 0, 0), "near"), Sphere(0.1, (2, 0, 0), "far"), HalfSpace((0, 0, 1), -0.05, name="floor")]
    assert [(c.first, c.second) for c in touching(robot, [0.0], obstacles, attached=BALL)] == [
        ("ball", "near"),
        ("ball", "floor"),
    ]
    depths = [c.distance for c in touching(robot, [0.0], obstacles, attached=BALL)]
    np.testing.assert_allclose(depths, [-0.15, -0.05], atol=1e-9)
    assert len(touching(robot, [0.0], obstacles, attached=BALL, margin=1.1)) == 3
    assert touching(robot, [np.pi / 2], obstacles[:2], attached=BALL) == []
    assert touching(robot, [0.0]) == []


def test_touching_sees_links_that_hit_one_another():
    robot = arms.catalogue_robot("panda")
    folded = np.array([0.0, 0.0, 0.0, -3.0, 0.0, 0.0, 0.0])
    found = touching(robot, folded, self_pairs=self_collision_pairs(robot).checked)
    assert found and found[0].distance < 0 and {found[0].first, found[0].second} & {"panda_hand", "panda_link7", "panda_link6"}


def test_a_ball_in_a_cylinder_has_its_true_depth():
    """Coal's own closed form is wrong by the radius here; nearest is the wall, 0.2 − 0.05 away from the ball's centre."""
    can = Cylinder(0.2, 2.0, (0.75, 0, 0), "can")
    assert touching(turning_arm(), [0.0], [can], attached=BALL)[0].distance == pytest.approx(-0.15 - RADIUS, abs=1e-12)


def test_an_obstacle_around_the_base_is_named():
    robot = arms.catalogue_robot("panda")
    table, box = HalfSpace((0, 0, 1), -0.001, name="table"), Box(0.3, (0, 0, 0.1), "crate")
    assert around_base(robot, [table]) == []
    found = around_base(robot, [table, box])
    assert [(c.first, c.second) for c in found] == [("panda_link0", "crate")] and found[0].distance < -0.1


def test_nothing_to_keep_apart_passes():
    found = check_clearance(turning_arm(), quintic(0, 1, 1.0))
    assert found.passes and found.distance == np.inf and str(found) == "nothing to keep apart"


class Broken(Trajectory):
    kind, duration, nv, breaks = "broken", 1.0, 1, np.array([0.0, 1.0])

    def _evaluate(self, t, order):
        return np.zeros((len(t), 1))

    def to_arrays(self):
        return {}


def test_bad_motions_and_numbers_are_one_clear_line():
    post = [Sphere(0.1, (3, 0, 0))]
    check = lambda motion, **options: check_clearance(turning_arm(), motion, post, attached=BALL, **options)
    for motion, said in (
        (quintic(0, np.nan, 1.0), "not finite"),
        (quintic([0, 0], [1, 1], 1.0), "has 2 joints"),
        (Broken(), "is a Broken"),
    ):
        with pytest.raises(GeometryError, match=said):
            check(motion)
    for options in ({"margin": -1.0}, {"margin": np.nan}, {"tolerance": 0.0}):
        with pytest.raises(GeometryError, match="expected"):
            check(quintic(0, 1, 1.0), **options)
