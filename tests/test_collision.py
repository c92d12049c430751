"""Distances of an arm's spheres: compiled and NumPy kernels agree, and derivatives are those of differences."""

import numpy as np
import pinocchio as pin
import pytest
from scenes import chain_of_spheres, surroundings

import energyopt as eo
from energyopt.collision import Hinge, Scene, pair_kernels
from energyopt.collision.kernels import CompiledPairs
from energyopt.collision.numpy_kernels import NumpyPairs
from energyopt.geometry.robot_spheres import SphereModel, centers

SAME = 1e-9
"""Relative to the largest entry: the same sums in another order."""
DIFFERENCES = 2e-6
"""Relative, against central differences."""
STEP = 1e-6
SAMPLES = 30


@pytest.fixture(scope="module")
def setting():
    arm, rng = chain_of_spheres(), np.random.default_rng(3)
    obstacles = surroundings()
    scene = Scene.of(
        arm,
        obstacles,
        np.linspace(0.0, 2.0, SAMPLES),
        required=rng.uniform(0.0, 0.02, (arm.spheres, len(obstacles))),
        required_self=rng.uniform(-0.01, 0.02, (arm.spheres, arm.spheres)),
        hinge=Hinge(100.0, 0.03),
        potential=eo.RepulsivePotential(0.01, 0.2),
    )
    return arm, scene, rng.uniform(-1.5, 1.5, (SAMPLES, arm.nv))


def kernels_of(arm, obstacles):
    """Both kinds, the compiled ones where there is a compiler."""
    found = [NumpyPairs(arm)]
    compiled = pair_kernels(arm, obstacles)
    return [*found, compiled] if isinstance(compiled, CompiledPairs) else found


def random_pairs(arm, scene, count=300):
    rng = np.random.default_rng(4)
    sample = rng.integers(0, SAMPLES, count)
    pair = np.stack([rng.integers(0, arm.spheres, count), rng.integers(-arm.spheres, len(scene.obstacles), count)], axis=1)
    other = pair[:, 0] != -1 - pair[:, 1]
    return sample[other], pair[other]


def test_compiled_and_numpy_kernels_give_the_same_numbers(setting):
    arm, scene, q = setting
    both = kernels_of(arm, scene.obstacles)
    if len(both) == 1:
        pytest.skip("no C compiler")
    sample, pair = random_pairs(arm, scene)
    multiplier = np.random.default_rng(5).normal(size=len(pair))
    answers = []
    for kernels in both:
        placed = kernels.place(scene, q)
        least, where = placed.least(0.1)
        near = least < 0.1
        penalty = placed.penalty()
        pairs = placed.pairs(sample, pair)
        bends = placed.bends(sample, pair, multiplier)
        answers.append([placed.centers(), *penalty, *pairs, bends, np.where(near, least, 0.0), where[near]])
    for ours, theirs in zip(*answers, strict=True):
        assert np.abs(ours - theirs).max() <= SAME * max(np.abs(theirs).max(), 1.0)


def test_centres_are_those_of_the_sphere_model(setting):
    arm, scene, q = setting
    links = tuple(arm.links[arm.link_of(s)] for s in range(arm.spheres))
    model = SphereModel(arm.model, links, arm.sphere_joint, arm.center, arm.radius, ())
    for kernels in kernels_of(arm, scene.obstacles):
        assert np.allclose(kernels.place(scene, q).centers(), centers(model, q), rtol=0, atol=1e-13)


def test_distances_are_those_of_the_shapes(setting):
    arm, scene, q = setting
    sample, pair = random_pairs(arm, scene)
    placed = pair_kernels(arm, scene.obstacles).place(scene, q)
    distance, _ = placed.pairs(sample, pair)
    center = placed.centers()
    for d, k, (a, b) in zip(distance, sample, pair, strict=True):
        if b < 0:
            expected = np.linalg.norm(center[k, a] - center[k, -1 - b]) - arm.radius[a] - arm.radius[-1 - b]
        else:
            expected = scene.obstacles[b].distance(center[k, a][None], scene.times[k])[0] - arm.radius[a]
        assert d == pytest.approx(expected, abs=1e-12)


def test_where_nothing_is_near_the_least_distances_are_those_of_balls_around_links(setting):
    """And never above the true ones."""
    arm, scene, q = setting
    for kernels in kernels_of(arm, scene.obstacles):
        placed = kernels.place(scene, q)
        assert np.all(placed.least(-1e3)[0] <= placed.least(1e3)[0] + 1e-12)


def test_gradients_and_curvatures_are_those_of_differences(setting):
    """The median over samples: at a few of them a nearest feature changes within the step."""
    arm, scene, q = setting
    sample, pair = random_pairs(arm, scene)
    multiplier = np.random.default_rng(6).normal(size=len(pair))
    for kernels in kernels_of(arm, scene.obstacles):
        at = lambda q, kernels=kernels: kernels.place(scene, q)
        _, slope, bend = at(q).penalty()
        bends = at(q).bends(sample, pair, multiplier)
        for v in range(arm.nv):
            shift = STEP * np.eye(arm.nv)[v]
            (up, up_slope, _), (down, down_slope, _) = at(q + shift).penalty(), at(q - shift).penalty()
            _off(slope[:, v], (up.sum(axis=1) - down.sum(axis=1)) / (2 * STEP))
            _off(bend[:, v], (up_slope - down_slope) / (2 * STEP))
            (d_up, g_up), (d_down, g_down) = at(q + shift).pairs(sample, pair), at(q - shift).pairs(sample, pair)
            _off(at(q).pairs(sample, pair)[1][:, v], (d_up - d_down) / (2 * STEP))
            total = np.zeros((SAMPLES, arm.nv))
            np.add.at(total, sample, multiplier[:, None] * (g_up - g_down) / (2 * STEP))
            _off(bends[:, v], total)


def _off(exact, differences):
    scale = max(np.abs(differences).max(), 1e-12)
    error = np.abs(exact - differences).reshape(len(exact), -1).max(axis=1) / scale
    assert np.median(error) < DIFFERENCES
    assert np.mean(error > 1e-3) < 0.05


def test_the_hinge_is_twice_continuously_differentiable():
    hinge, h = Hinge(7.0, 0.02), 1e-7
    missing = np.concatenate([np.linspace(-0.01, 0.06, 141), [0.0, 0.02]])
    energy, first, second = hinge.derivatives(missing)
    up, down = hinge.derivatives(missing + h), hinge.derivatives(missing - h)
    assert np.abs(-first - (up[0] - down[0]) / (2 * h)).max() < 1e-8
    assert np.abs(second + (up[1] - down[1]) / (2 * h)).max() < 1e-4
    assert np.all(energy[missing <= 0] == 0) and np.abs(up[2] - down[2]).max() <= 2 * h * 7.0 / 0.02 * (1 + 1e-6)


def test_a_shape_the_c_code_does_not_know_is_evaluated_in_numpy():
    class Odd(eo.Box):
        kind = "odd"

    arm = chain_of_spheres()
    assert pair_kernels(arm, (Odd((0.1, 0.1, 0.1)),)).kind == "interpreted"


def test_frames_bound_by_a_workspace_are_points():
    arm = chain_of_spheres()
    more = arm.with_points({"frame tip": (3, np.array([0.1, 0.2, 0.3]))})
    scene = Scene.of(more, (eo.HalfSpace((0, 0, 1), -5.0),), [0.0])
    q = np.array([[0.3, -0.2, 0.5]])
    placed = pair_kernels(more, scene.obstacles).place(scene, q)
    data = more.model.createData()
    pin.forwardKinematics(more.model, data, q[0])
    height = data.oMi[3].act(np.array([0.1, 0.2, 0.3]))[2] + 5.0
    assert placed.pairs(np.array([0]), np.array([[more.spheres - 1, 0]]))[0][0] == pytest.approx(height, abs=1e-12)
