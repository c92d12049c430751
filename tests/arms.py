"""Robots that several test files share, loaded once a process, and random states of them."""

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import urdf_factory as factory

import energyopt as eo

UNALIGNED = np.array([2.0, -3.0, 6.0]) / 7.0
"""A unit axis along none of the coordinate axes."""


@cache
def _folder():
    return tempfile.TemporaryDirectory(prefix="energyopt-tests-")


@cache
def catalogue_robot(name):
    return eo.load_robot(name)


def from_urdf(text, **options):
    """The robot of a URDF text; ``options`` are those of `load_robot`."""
    return eo.load_robot(factory.write(Path(_folder().name), text), **options)


@cache
def pendulum(mass=1.0, length=1.0, inertia=0.0):
    return from_urdf(factory.pendulum(mass, length, inertia))


@cache
def two_link():
    """Two thin rods in the vertical plane."""
    return from_urdf(factory.planar_arm([0.5, 0.4], [2.0, 1.5], velocity=10.0, effort=100.0))


@cache
def rubbing_two_link():
    """The same with Coulomb friction of a tenth of the largest holding torque."""
    return from_urdf(factory.planar_arm([0.5, 0.4], [2.0, 1.5], velocity=10.0, effort=100.0), coulomb_friction=(1.4, 0.4))


@cache
def sliders(n=1, masses=None):
    return from_urdf(factory.sliders(n, masses), gravity=(0, 0, 0))


@cache
def mixed_chain(**options):
    """Revolute about an unaligned axis, prismatic along another, revolute about z, with asymmetric bodies."""
    text = factory.chain(
        axes=[UNALIGNED, (0.6, 0.0, 0.8), (0, 0, 1)],
        origins=[(0.1, 0.2, 0.3), (0.3, -0.1, 0.05), (0.0, 0.25, 0.1)],
        rpys=[(0.3, -0.4, 0.5), (0, 0, 0), (0, 0, 0)],
        types=["revolute", "prismatic", "revolute"],
        masses=[3.0, 2.0, 1.0],
        centers=[(0.1, 0.02, -0.03), (0.05, -0.1, 0.2), (-0.04, 0.06, 0.08)],
        inertias=[tilted(0.05, 0.06, 0.02), tilted(0.03, 0.01, 0.03), tilted(0.01, 0.012, 0.02)],
        tool=(0.1, 0.2, -0.1),
    )
    return from_urdf(text, **options)


@cache
def rubbing_chain():
    """`mixed_chain` with rotors, viscous and Coulomb friction."""
    return mixed_chain(armature=(0.3, 0.5, 0.1), viscous_friction=(0.4, 2.0, 0.1), coulomb_friction=(1.5, 3.0, 0.5))


def tilted(*moments):
    """A full inertia matrix with the given principal moments."""
    turn = np.linalg.qr(np.array([[1.0, 0.2, 0.3], [-0.1, 1.0, 0.4], [0.2, -0.5, 1.0]]))[0]
    return turn @ np.diag(moments) @ turn.T


def random_states(robot, count, seed=0):
    """Positions inside the limits, velocities inside ±3 and accelerations inside ±10, each (count, nv)."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(robot.limits.lower, robot.limits.upper, (count, robot.nv))
    return q, rng.uniform(-3.0, 3.0, q.shape), rng.uniform(-10.0, 10.0, q.shape)


def relative(value, expected):
    """Largest difference as a share of the largest expected number."""
    value, expected = np.asarray(value), np.asarray(expected)
    assert value.shape == expected.shape
    return float(np.max(np.abs(value - expected)) / np.max(np.abs(expected)))
