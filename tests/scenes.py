"""A chain of spheres and one obstacle of every kind, for tests of distances."""

import arms
import numpy as np
import pinocchio as pin

import energyopt as eo
from energyopt.collision import SphereArm
from energyopt.geometry.robot_spheres import SphereModel


def chain_of_spheres() -> SphereArm:
    """Three joints, one of which slides, on axes that are not aligned, with spheres on every link."""
    robot = arms.rubbing_chain()
    rng = np.random.default_rng(1)
    joint = np.repeat([0, 1, 2, 3], [2, 3, 4, 5])
    names = tuple(np.array(["base", "one", "two", "three"])[joint])
    spheres = SphereModel(robot.model, names, joint, rng.uniform(-0.3, 0.3, (14, 3)), rng.uniform(0.02, 0.1, 14), ())
    return SphereArm.of(spheres, [("base", "two"), ("base", "three"), ("one", "three")])


def random_pose(rng) -> np.ndarray:
    turn = pin.exp3(rng.normal(size=3))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, rng.uniform(-0.7, 0.7, 3)
    return pose


def surroundings() -> tuple:
    rng = np.random.default_rng(2)
    return (
        eo.Sphere(0.1, random_pose(rng)),
        eo.Capsule(0.05, 0.3, random_pose(rng)),
        eo.Box((0.2, 0.3, 0.1), random_pose(rng)),
        eo.Cylinder(0.1, 0.3, random_pose(rng)),
        eo.HalfSpace((0.2, 0.1, 1.0), -0.4),
        eo.ConvexMesh(points=0.15 * rng.normal(size=(20, 3)), pose=random_pose(rng)),
        eo.Box((0.1, 0.2, 0.1), eo.Moving(random_pose(rng), velocity=(0.1, 0.2, 0.0), angular_velocity=(1.0, 0.0, 0.3))),
    )
