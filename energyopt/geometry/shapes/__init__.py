"""Shapes of obstacles and of robot links. A new shape is one file here and one line in `SHAPES`."""

from energyopt.geometry.shapes.box import Box
from energyopt.geometry.shapes.capsule import Capsule
from energyopt.geometry.shapes.convex_mesh import ConvexMesh
from energyopt.geometry.shapes.cylinder import Cylinder
from energyopt.geometry.shapes.half_space import HalfSpace, workspace_walls
from energyopt.geometry.shapes.shape import Shape
from energyopt.geometry.shapes.sphere import Sphere

SHAPES: dict[str, type[Shape]] = {shape.kind: shape for shape in (Sphere, Capsule, Box, Cylinder, HalfSpace, ConvexMesh)}
"""Every shape by the word for it in problem files and messages."""

__all__ = ["SHAPES", "Box", "Capsule", "ConvexMesh", "Cylinder", "HalfSpace", "Shape", "Sphere", "workspace_walls"]
