"""What is where: shapes and their distances, the bodies of a robot, its cover by spheres, what it may not touch."""

from energyopt.geometry.bodies import Attached
from energyopt.geometry.moving import Moving
from energyopt.geometry.potential import RepulsivePotential
from energyopt.geometry.shapes import Box, Capsule, ConvexMesh, Cylinder, HalfSpace, Sphere
from energyopt.geometry.workspace import Workspace

__all__ = [
    "Attached",
    "Box",
    "Capsule",
    "ConvexMesh",
    "Cylinder",
    "HalfSpace",
    "Moving",
    "RepulsivePotential",
    "Sphere",
    "Workspace",
]
