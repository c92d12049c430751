"""The numbers of an arm as inputs of its kernels: other payloads, frictions, gravities give what Pinocchio gives, uncompiled."""

import arms
import numpy as np
import pinocchio as pin
import pytest

import energyopt as eo
from energyopt.dynamics.kernels import kernels_of
from energyopt.dynamics.parameters import body_numbers, felt_inertias, moved, numbers_of, structure_of
from energyopt.robots.variation import Variation, varied_dynamics

TORQUE = 1e-9
"""Relative, against `pin.rnea`, whose rotations have π as rounded in URDF files."""
ROUNDING = 1e-11
"""Relative: sums in another order."""
ROBOTS = {
    "two links": arms.two_link,
    "unaligned, prismatic": arms.mixed_chain,
    "ur5": lambda: arms.catalogue_robot("ur5"),
    "panda": lambda: arms.catalogue_robot("panda"),
    "xarm7": lambda: arms.catalogue_robot("xarm7"),
}


@pytest.fixture(scope="module", params=ROBOTS)
def robot(request):
    return ROBOTS[request.param]()


def variants(robot):
    """Dynamics that differ from the robot's in nothing but numbers."""
    rng = np.random.default_rng(4)
    heavier = eo.Payload(1.3, center=(0.05, -0.02, 0.1), inertia=(0.01, 0.02, 0.015))
    masses, friction = rng.uniform(0.5, 2.0, (2, robot.nv))
    yield varied_dynamics(robot, Variation(payload=heavier))
    yield varied_dynamics(robot, Variation(masses=masses))
    model = pin.Model(robot.model)
    model.armature = rng.uniform(0.0, 0.5, robot.nv)
    model.gravity.linear *= 0.4
    rubbing = varied_dynamics(robot, Variation(friction=friction))
    yield type(rubbing)(model, rng.uniform(0.0, 2.0, robot.nv), rubbing.coulomb_friction, rubbing.coulomb_velocity)


@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "interpreted"])
def test_variants_have_the_torques_of_pinocchio_without_compiling(robot, compiled):
    own = kernels_of(robot.dynamics, compiled)
    states = np.concatenate(arms.random_states(robot, 40, seed=1), axis=1)
    for dynamics in variants(robot):
        kernels = kernels_of(dynamics, compiled)
        assert kernels.kind == own.kind and kernels.theta is not own.theta
        if own.kind == "compiled":
            assert kernels.library is own.library
        assert arms.relative(kernels.torque(states), dynamics.torque(*np.split(states, 3, axis=1))) < TORQUE
    expected = robot.torque(*np.split(states, 3, axis=1))
    assert arms.relative(own.torque(states), expected) < TORQUE  # and the others have left it alone


def test_derivatives_of_variants_equal_those_of_the_interpreted_graph(robot):
    rng, (q, v, a) = np.random.default_rng(2), arms.random_states(robot, 9, seed=3)
    z, (p, mu) = np.concatenate([q, v, a], axis=1), rng.normal(size=(2, 9, robot.nv))
    for dynamics in variants(robot):
        mine, other = kernels_of(dynamics), kernels_of(dynamics, compiled=False)
        assert arms.relative(mine.jacobian(z)[1], other.jacobian(z)[1]) < ROUNDING
        assert arms.relative(mine.adjoint(z, p, mu)[1], other.adjoint(z, p, mu)[1]) < ROUNDING
        assert arms.relative(mine.hessian(z, p, mu), other.hessian(z, p, mu)) < ROUNDING


def test_torques_are_linear_in_inertias_armature_and_friction(robot):
    """τ(θ₀ + δ) = τ(θ₀) + τ(δ), gravity being the same in all three."""
    structure, rng = structure_of(robot.dynamics), np.random.default_rng(5)
    states, kernels = np.concatenate(arms.random_states(robot, 6, seed=6), axis=1), kernels_of(robot.dynamics)
    theta = numbers_of(robot.dynamics, structure)
    change = rng.normal(size=structure.size)
    for name in ("sharpness", "gravity"):
        change[structure.slices[name]] = theta[structure.slices[name]]
    both = np.where(change == theta, theta, theta + change)
    torque = lambda numbers: kernels.with_numbers(numbers).torque(states)
    assert arms.relative(torque(both), torque(theta) + torque(change)) < ROUNDING


def test_bodies_in_another_frame_are_what_pinocchio_makes_of_them():
    pin.seed(7)
    for _ in range(5):
        placement, body = pin.SE3.Random(), pin.Inertia.Random()
        found = moved(body.toDynamicParameters(), placement.rotation, placement.translation)
        assert arms.relative(found, placement.act(body).toDynamicParameters()) < ROUNDING


def test_what_is_not_felt_is_not_an_input():
    """A pendulum feels the moment of inertia about its axis and where its mass hangs; a slider its mass."""
    pendulum, slider = arms.pendulum(), arms.sliders()
    felt = felt_inertias(body_numbers(pendulum.model), structure_of(pendulum.dynamics))[0]
    assert felt[0] == 0.0 and felt[2] == 0.0 and felt[6] != 0.0  # axis y: I_yy = m l²
    felt = felt_inertias(body_numbers(slider.model), structure_of(slider.dynamics))[0]
    assert felt[0] == 1.0 and not np.any(felt[4:])


def test_symmetric_links_have_fewer_inputs_but_the_last_has_all():
    ur5, panda = (structure_of(arms.catalogue_robot(name).dynamics) for name in ("ur5", "panda"))
    assert ur5.kept[-1].sum() == panda.kept[-1].sum() == 7
    assert ur5.kept[:-1].sum(axis=1).mean() < 6 < panda.kept[:-1].sum(axis=1).mean()
