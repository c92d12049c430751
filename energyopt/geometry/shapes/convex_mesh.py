"""ConvexMesh: the convex hull of a mesh file's corners (STL or OBJ), or of given points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from energyopt.errors import GeometryError
from energyopt.geometry.hull import Hull
from energyopt.geometry.mesh_files import read_mesh
from energyopt.geometry.shapes.shape import Distances, Shape
from energyopt.geometry.values import LARGEST, vector
from energyopt.robots.messages import shown

MAX_MESH_BYTES = 20_000_000
MAX_HULL_VERTICES = 5000
SUFFIXES = (".stl", ".obj")


@dataclass(frozen=True, eq=False)
class ConvexMesh(Shape):
    """The convex hull of a mesh. Holes and hollows are filled: give a concave object as several meshes.

    Outside φ is C¹; its curvature jumps where the nearest feature changes between face, edge and corner. Inside it is piecewise
    linear, with kinks where two faces are equally near; there the first face counts.

    Attributes:
        path: an STL or OBJ file of at most 20 MB.
        pose: 4×4, ``pin.SE3``, xyz, or `Moving`; the origin by default.
        name: for reports.
        scale: factor on the coordinates, one or three: 0.001 for a file in millimetres. Applied once, then stored as 1.
        folder: where given, ``path`` is relative to it and must stay inside.
        points: corners, shape (N, 3); where given, no file is read. The hull's corners [m] are stored here, so that the
            shape does not depend on the file any more.

    Raises:
        GeometryError: the file is missing, too large, outside its folder, damaged or flat, or a value is malformed.
    """

    path: str | Path | None = None
    pose: Any = None
    name: str = ""
    scale: ArrayLike = 1.0
    folder: str | Path | None = None
    points: ArrayLike | None = None

    kind: ClassVar[str] = "mesh"

    def __post_init__(self):
        where = "mesh" if self.path is None else f"mesh {shown(str(self.path))}"
        scale = vector("mesh: scale", np.full(3, self.scale) if np.ndim(self.scale) == 0 else self.scale, (3,))
        if np.any(scale == 0):
            raise GeometryError(f"mesh: scale is {scale.tolist()}; expected factors other than zero")
        points = scale * (self._read(where) if self.points is None else _point_table(self.points))
        hull = Hull.of_points(points, where)
        if len(hull.vertices) > MAX_HULL_VERTICES:
            raise GeometryError(f"{where}: its hull has {len(hull.vertices)} corners; reduce it to at most {MAX_HULL_VERTICES}")
        if np.abs(hull.vertices).max() > LARGEST:
            raise GeometryError(f"{where}: reaches {np.abs(hull.vertices).max():g} m; a file in millimetres wants scale=0.001")
        hull.vertices.flags.writeable = False
        self._set(scale=1.0, points=hull.vertices, hull=hull)

    @property
    def bounding_radius(self) -> float:
        return float(np.linalg.norm(self.points, axis=1).max())

    def local_distance(self, y: np.ndarray) -> np.ndarray:
        return self.hull.distance(y)

    def local_derivatives(self, y: np.ndarray) -> Distances:
        return self.hull.derivatives(y)

    def enclosing_points(self) -> np.ndarray:
        return self.points

    def coal_geometry(self):
        import coal

        corners, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        for corner in self.hull.vertices:
            corners.append(corner)
        for triangle in self.hull.triangles:
            faces.append(coal.Triangle(*map(int, triangle)))
        return coal.Convex(corners, faces)

    def _read(self, where: str) -> np.ndarray:
        """Corners in the file's own unit."""
        if not isinstance(self.path, (str, Path)):
            raise GeometryError(f"mesh: path is {shown(self.path)}; expected the path of an STL or OBJ file")
        return read_mesh(_contained(Path(self.path), self.folder, where), MAX_MESH_BYTES, where, SUFFIXES)[0]


def _contained(path: Path, folder: str | Path | None, where: str) -> Path:
    """The file, which must be inside ``folder`` where one is given, symbolic links followed."""
    if folder is None:
        return path
    try:
        root = Path(folder).resolve()
        real = (root / path).resolve()
    except (OSError, ValueError, RuntimeError):
        raise GeometryError(f"{where}: is not a usable path") from None
    if not real.is_relative_to(root):
        raise GeometryError(f"{where}: leads outside the folder {folder!s:.200}; put the mesh beside the file that names it")
    return real


def _point_table(value: ArrayLike) -> np.ndarray:
    shape = np.shape(value)
    if len(shape) != 2 or shape[1] != 3:
        raise GeometryError(f"mesh: points have the shape {shape}; expected rows xyz, (N, 3)")
    return vector("mesh: points", value, shape)
