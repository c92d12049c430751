"""What touches in a replay: obstacles as bodies of MuJoCo, against distances in closed form and against another library."""

import numpy as np
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.errors import InputError
from energyopt.geometry.bodies import Attached
from energyopt.geometry.exact import CollisionScene
from energyopt.geometry.moving import Moving
from energyopt.geometry.self_collision import self_collision_pairs
from energyopt.geometry.shapes import Box, Capsule, ConvexMesh, Cylinder, HalfSpace, Sphere
from energyopt.simulation import replay_trajectory

RADIUS = 0.05
HOME = np.array([0, -0.7, 0, -2.3, 0, 1.6, 0.8])


@pytest.fixture(scope="module")
def panda():
    return eo.load_robot("panda")


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """A ball of 50 mm on a slider along x."""
    text = factory.sliders(1).replace(
        "</inertial></link>", f'</inertial><collision><geometry><sphere radius="{RADIUS}"/></geometry></collision></link>'
    )
    assert text.count("<collision>") == 1
    return eo.load_robot(factory.write(tmp_path_factory.mktemp("ball"), text), gravity=(0, 0, 0), torque_limits=np.inf)


def slide(robot, *obstacles, duration=2.0, **fields):
    """From x = 0 to 1 m at constant 0.5 m/s, as near as a motion from and to that speed can be."""
    problem = eo.Problem(
        robot, [0.0], [1.0], duration, start_velocity=[1 / duration], goal_velocity=[1 / duration],
        velocity_limits=10.0, position_limits=([-3.0], [3.0]), obstacles=obstacles, **fields,
    )  # fmt: skip
    return replay_trajectory(problem, eo.baseline(problem))


def at(x, y=0.0, z=0.0):
    return np.array([x, y, z])


CUBE = 0.05 * np.array([(x, 4 * y, 4 * z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
SHAPES = {
    "sphere": lambda pose: Sphere(0.05, pose),
    "box": lambda pose: Box((0.1, 0.4, 0.4), pose),
    "capsule": lambda pose: Capsule(0.05, 0.4, pose),
    "cylinder": lambda pose: Cylinder(0.05, 0.4, pose),
    "mesh": lambda pose: ConvexMesh(points=CUBE, pose=pose),
}
"""Solids that reach from −0.05 to 0.05 m along the x axis."""


@pytest.mark.parametrize("kind", SHAPES)
def test_a_ball_through_an_obstacle_touches_it_from_entry_to_exit(ball, kind):
    """At 0.5 m/s the ball's front meets the obstacle at x = 0.4 and its back leaves it at x = 0.6: from 0.8 to 1.2 s."""
    log = slide(ball, SHAPES[kind](at(0.5)))
    (touch,) = log.touches
    assert (touch.first, touch.second) == ("link1", f"{kind} 1")
    # A contact counts from a depth of 0.1 mm, 0.2 ms after the surfaces meet; a step is 0.5 ms.
    assert touch.begin == pytest.approx(0.8, abs=2e-3) and touch.end == pytest.approx(1.2, abs=2e-3)
    # Deepest halfway: the overlap along x is then the two half widths; other ways out are longer.
    assert touch.depth == pytest.approx(0.1, abs=2e-3) and touch.time == pytest.approx(1.0, abs=5e-3)
    steps = np.flatnonzero(log.contacts)
    assert log.contacts.max() == 1 and log.t[steps[0]] == touch.begin and log.t[steps[-1]] == touch.end
    assert log.contact_steps == len(steps)


@pytest.mark.parametrize("kind", SHAPES)
def test_a_ball_that_passes_beside_an_obstacle_touches_nothing(ball, kind):
    log = slide(ball, SHAPES[kind](at(0.5, 0.3)), SHAPES[kind](at(0.5, -0.3)))
    assert log.contacts is not None and not log.contacts.any() and log.touches == ()


def test_contact_is_seen_from_a_tenth_of_a_millimetre(ball):
    for gap, touching in ((1e-3, False), (1e-5, False), (-5e-5, False), (-2e-4, True), (-1e-3, True)):
        log = slide(ball, Box((0.2, 0.1, 0.2), at(0.5, 0.1 + gap)))
        assert bool(log.touches) is touching, gap
        if touching:
            assert log.touches[0].depth == pytest.approx(-gap, abs=1e-6)


@pytest.mark.parametrize("normal", [(-1, 0, 0), (-2, 0, 1e-9), (-1, -1, 0), (-1, 0.5, 1)])
def test_a_half_space_is_a_wall_of_any_direction(ball, normal):
    """A wall through (0.75, 0, 0): the ball is inside from where n·x reaches n·0.75 + r."""
    unit = np.array(normal) / np.linalg.norm(normal)
    log = slide(ball, HalfSpace(normal, float(unit @ at(0.75))))
    (touch,) = log.touches
    met = 0.75 - RADIUS / abs(unit[0])
    assert touch.begin == pytest.approx(2 * met, abs=2e-3) and touch.end == log.t[-1]
    assert touch.depth == pytest.approx(0.25 * abs(unit[0]) + RADIUS, abs=1e-6)


def test_a_floor_and_a_ceiling_that_are_clear_do_not_touch(ball):
    assert not slide(ball, HalfSpace((0, 0, 1), -0.06), HalfSpace((0, 0, -1), -0.06)).touches
    assert {t.second for t in slide(ball, HalfSpace((0, 0, 1), -0.04, name="floor")).touches} == {"floor"}


def test_workspace_walls_are_in_the_replay(ball):
    inside, outside = (slide(ball, workspace=Box((2 * reach, 1, 1), name="cell")) for reach in (1.06, 1.02))
    assert not inside.touches
    (touch,) = outside.touches
    assert touch.second == "cell +x" and touch.depth == pytest.approx(0.03, abs=1e-6)


def test_a_moving_obstacle_is_met_where_both_are_at_the_same_time(ball):
    """A sphere that crosses the way at x = 0.5 with 0.4 m/s: there when the ball is, or half a second too early."""
    meets, misses = (Sphere(0.05, Moving(at(0.5, -0.4 * when), velocity=(0, 0.4, 0)), name="part") for when in (1.0, 0.5))
    (touch,) = slide(ball, meets).touches
    # The distance √((0.5 s)² + (0.4 s)²) with s = t − 1 is 0.1 at s = ∓0.1 / √0.41.
    half = 0.1 / np.sqrt(0.41)
    assert touch.begin == pytest.approx(1 - half, abs=2e-3) and touch.end == pytest.approx(1 + half, abs=2e-3)
    assert touch.depth == pytest.approx(0.1, abs=1e-4) and touch.time == pytest.approx(1.0, abs=2e-3)
    assert not slide(ball, misses).touches
    assert slide(ball, Sphere(0.05, at(0.5))).touches, "at rest in the way it would be hit"


def test_an_obstacle_that_turns_is_placed_as_it_turns(ball):
    """A rod that turns about z by a right angle, sampled once; the moments of contact by exact distances."""

    def pose(t):
        c, s = np.cos(0.25 * np.pi * t), np.sin(0.25 * np.pi * t)
        turned = np.eye(4)
        turned[:2, :2], turned[:3, 3] = [[c, -s], [s, c]], at(0.5, 0.1)
        return turned

    rod = Box((0.9, 0.02, 0.02), Moving(pose, times=2.0))
    log = slide(ball, rod)
    rows = slice(None, None, 20)
    distance = CollisionScene(ball, [rod]).distances(log.q[rows], log.t[rows])[:, 0]
    np.testing.assert_array_equal(log.contacts[rows] > 0, distance < -1e-4)
    assert 100 < log.contact_steps < len(log.t) - 100


def test_what_is_attached_touches_under_its_name(ball):
    tool = Attached(Box((0.02, 0.02, 0.3), at(0, 0, 0.15)), frame=ball.tool_frame, name="wand")
    shelf = Box((0.1, 0.1, 0.02), at(0.5, 0, 0.2), name="shelf")
    assert not slide(ball, shelf).touches
    (touch,) = slide(ball, shelf, attached=[tool]).touches
    assert (touch.first, touch.second) == ("wand", "shelf")
    assert touch.begin == pytest.approx(2 * 0.44, abs=2e-3)


def test_contacts_of_a_real_arm_are_those_of_exact_distances(panda):
    """MuJoCo's overlaps along a motion through clutter against ``coal``'s signed distances, pair by pair."""
    folded = np.array([1.2, 1.0, 0.3, -2.6, 0.0, 0.4, 0.8])
    motion = eo.baseline(eo.Problem(panda, HOME, folded, 1.5))
    hand = panda.placement("panda_hand", motion(0.4)).translation
    obstacles = [
        Box((0.3, 0.3, 0.3), at(0.5, 0.3, 0.5), name="crate"),
        Cylinder(0.06, 0.8, at(0.3, -0.3, 0.4), name="post"),
        Sphere(0.1, Moving(hand - at(0, 0.4), velocity=(0, 1.0, 0)), name="part"),
        HalfSpace((0, 0, 1), 0.02, name="table"),
    ]
    problem = eo.Problem(panda, HOME, folded, 1.5, obstacles=obstacles, torque_limits=np.inf)
    log = replay_trajectory(problem, motion, physics_step=1e-3)
    pairs = self_collision_pairs(panda).checked
    scene = CollisionScene(panda, obstacles, pairs)
    distance = scene.distances(log.q, log.t, cutoff=0.01)
    seen = {(touch.first, touch.second) for touch in log.touches}
    truth = {pair for pair, least in zip(scene.pairs, distance.min(axis=0), strict=True) if least < -1e-3}
    grazed = {pair for pair, least in zip(scene.pairs, distance.min(axis=0), strict=True) if least < -1e-5}
    assert truth <= seen <= grazed
    assert {"crate", "part"} <= {second for _, second in seen}
    for touch in log.touches:
        rows = [k for k, pair in enumerate(scene.pairs) if pair == (touch.first, touch.second)]
        there = np.flatnonzero((log.t >= touch.begin) & (log.t <= touch.end))
        # MuJoCo's depths agree to 1 µm; coal's search ends up to 0.1 mm too deep at single steps where a mesh is deep in a box.
        assert distance[np.ix_(there, rows)].min() == pytest.approx(-touch.depth, abs=2e-4)


def test_links_that_fold_onto_each_other_are_counted_and_exert_no_force(panda):
    folded = np.array([0.0, 1.0, 0.0, -3.05, 0.0, -0.0, 0.8])
    problem = eo.Problem(panda, HOME, folded, 1.0)
    motion = eo.baseline(problem)
    free, watched = replay_trajectory(problem, motion, collisions=False), replay_trajectory(problem, motion)
    assert free.contacts is None and free.touches == ()
    assert watched.contacts.max() > 0 and watched.contacts[0] == 0
    np.testing.assert_array_equal(free.q, watched.q)
    allowed = eo.Problem(panda, HOME, folded, 1.0, self_collision=False)
    assert not replay_trajectory(allowed, motion).touches


def test_neighbouring_links_do_not_count(panda):
    problem = eo.Problem(panda, HOME, HOME + 0.1, 0.5)
    log = replay_trajectory(problem, eo.baseline(problem))
    assert log.contacts is not None and log.contact_steps == 0


def test_a_robot_without_geometry_says_that_contacts_were_not_looked_for(tmp_path):
    robot = eo.load_robot(factory.write(tmp_path, factory.pendulum()))
    problem = eo.Problem(robot, [0.0], [0.5], 1.0)
    log = replay_trajectory(problem, eo.baseline(problem))
    assert log.contacts is None and "no link has collision geometry" in log.settings["contacts"]
    with pytest.raises(InputError, match="no link has collision geometry"):
        replay_trajectory(problem, eo.baseline(problem), collisions=True)
