"""Kernels: machine code, virtual machine and finite differences give the same torques, derivatives and Hessians."""

import arms
import numpy as np
import pinocchio as pin
import pytest

from energyopt.dynamics.kernels import kernels_of

SAME_GRAPH = 1e-12
"""Relative: the same operations in another order of rounding."""
ANALYTIC = 1e-10
"""Relative, against another algorithm's analytic derivatives."""
DIFFERENCES = 1e-6
"""Relative, against central differences."""
COUNTS = [1, 3, 8, 17]
"""Fewer samples than lanes, a multiple of the lanes, and one more than two multiples of eight."""

ROBOTS = {
    "pendulum": arms.pendulum,
    "slider": arms.sliders,
    "unaligned, prismatic, rubbing": arms.rubbing_chain,
    "ur5": lambda: arms.catalogue_robot("ur5"),
    "panda": lambda: arms.catalogue_robot("panda"),
}


@pytest.fixture(scope="module", params=ROBOTS)
def robot(request):
    return ROBOTS[request.param]()


@pytest.fixture(scope="module")
def kernels(robot):
    found = kernels_of(robot.dynamics)
    if found.kind != "compiled":
        pytest.skip("no C compiler")
    return found


@pytest.fixture(scope="module")
def interpreted(robot):
    return kernels_of(robot.dynamics, compiled=False)


def arguments(robot, count, seed=0):
    """States, weights and multipliers; velocities small enough that Coulomb friction is not saturated everywhere."""
    q, v, a = arms.random_states(robot, count, seed)
    rng = np.random.default_rng(seed + 1)
    v[::2] *= 0.02
    return np.concatenate([q, v, a], axis=1), rng.uniform(0.0, 2.0, q.shape), rng.normal(size=q.shape)


@pytest.mark.parametrize("count", COUNTS)
def test_compiled_and_interpreted_kernels_give_the_same_numbers(robot, kernels, interpreted, count):
    z, p, mu = arguments(robot, count)
    assert arms.relative(kernels.torque(z), interpreted.torque(z)) < SAME_GRAPH
    pairs = [
        (kernels.adjoint(z, p, mu), interpreted.adjoint(z, p, mu)),
        (kernels.jacobian(z), interpreted.jacobian(z)),
        ((kernels.hessian(z, p, mu),), (interpreted.hessian(z, p, mu),)),
    ]
    for mine, other in pairs:
        for value, expected in zip(mine, other, strict=True):
            assert arms.relative(value, expected) < SAME_GRAPH


def test_a_sample_does_not_depend_on_its_neighbours(robot, kernels):
    z, p, mu = arguments(robot, 17)
    together = kernels.hessian(z, p, mu)
    for k in (0, 7, 16):
        np.testing.assert_array_equal(kernels.hessian(z[k : k + 1], p[k : k + 1], mu[k : k + 1])[0], together[k])


def test_torques_equal_numeric_pinocchio(robot, interpreted):
    z = arguments(robot, 17)[0]
    assert arms.relative(interpreted.torque(z), robot.torque(*np.split(z, 3, axis=1))) < ANALYTIC


def test_the_jacobian_equals_pinocchios_analytic_derivatives(robot, interpreted):
    """J. Carpentier, N. Mansard, "Analytical derivatives of rigid body dynamics algorithms", 2018, through `pin`."""
    z, nv = arguments(robot, 17)[0], robot.nv
    dynamics, data = robot.dynamics, robot.model.createData()
    J = interpreted.jacobian(z)[1]
    for row, found in zip(z, J, strict=True):
        q, v, a = np.split(row, 3)
        by_q, by_v, by_a = (np.array(m) for m in pin.computeRNEADerivatives(robot.model, data, q, v, a))
        by_a = np.triu(by_a) + np.triu(by_a, 1).T
        slope = dynamics.coulomb_friction / dynamics.coulomb_velocity / np.cosh(v / dynamics.coulomb_velocity) ** 2
        expected = np.concatenate([by_q, by_v + np.diag(dynamics.viscous_friction + slope), by_a], axis=1)
        assert expected.shape == (nv, 3 * nv)
        assert arms.relative(found, expected) < ANALYTIC


def test_the_adjoint_is_the_gradient_of_the_weighted_squares(robot, interpreted):
    """g = ∇(½ Σ pτ² + Σ μτ), with τ differenced by numeric Pinocchio."""
    z, p, mu = arguments(robot, 8)
    value = lambda z: np.sum(0.5 * p * (t := robot.torque(*np.split(z, 3, axis=1))) ** 2 + mu * t, axis=1)
    assert arms.relative(interpreted.adjoint(z, p, mu)[1], differences(value, z)) < DIFFERENCES


def test_the_hessian_is_the_derivative_of_the_adjoint(robot, interpreted):
    z, p, mu = arguments(robot, 8)
    H = interpreted.hessian(z, p, mu)
    assert arms.relative(H, H.transpose(0, 2, 1)) < SAME_GRAPH
    assert arms.relative(H, differences(lambda z: interpreted.adjoint(z, p, mu)[1], z)) < DIFFERENCES


def differences(function, z, step=2e-4):
    """Central differences of fourth order of a function of each row, (N, ...) → (N, ..., Z): error h⁴/30 · |f⁽⁵⁾|.

    Coulomb friction changes over 0.05 rad/s, so the step is a small part of that.
    """
    columns = []
    for k in range(z.shape[1]):
        h = np.zeros(z.shape[1])
        h[k] = step
        columns.append((8 * (function(z + h) - function(z - h)) - (function(z + 2 * h) - function(z - 2 * h))) / (12 * step))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("scale", [1e2, 9e4, 1e7])
def test_sine_and_cosine_hold_at_any_angle(scale):
    """A pendulum's torque is a sine of its angle; beyond 1e5 rad the C library's functions take over."""
    pendulum = arms.pendulum()
    kernels = kernels_of(pendulum.dynamics)
    q = np.concatenate([scale * np.random.default_rng(0).uniform(-1.0, 1.0, 200), np.pi / 4 * np.arange(-20, 21), [0.0]])
    z = np.stack([q, np.zeros_like(q), np.zeros_like(q)], axis=1)
    largest = abs(float(pendulum.torque(*np.array([[np.pi / 2], [0.0], [0.0]]))[0]))
    expected = pendulum.torque(q[:, None], z[:, 1:2], z[:, 2:])
    assert np.abs(kernels.torque(z) - expected).max() < 1e-15 * max(largest, 1.0) * 20
