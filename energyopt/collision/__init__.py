"""Distances between an arm made of spheres, obstacles and itself, at many instants at once, with derivatives in q."""

from energyopt.collision.arm import SphereArm
from energyopt.collision.kernels import PairKernels, pair_kernels
from energyopt.collision.scene import Hinge, Scene

__all__ = ["Hinge", "PairKernels", "Scene", "SphereArm", "pair_kernels"]
