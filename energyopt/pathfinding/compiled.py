"""The compiled form of `overlaps`: ``overlaps.c``, built once into the user's cache and called through ctypes."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import lru_cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from energyopt.dynamics import compiler
from energyopt.dynamics.body import joint_axis
from energyopt.geometry.shapes import Box, Capsule, ConvexMesh, Cylinder, HalfSpace, Shape, Sphere

if TYPE_CHECKING:
    import pinocchio as pin

    from energyopt.pathfinding.overlaps import Balls

MOST = 256
"""Joints or links beyond which the routine has no room."""
_FLAGS = ("-O2", "-ftree-vectorize", "-fno-math-errno", "-fno-trapping-math", "-march=native", "-std=gnu11")
_SIZES: dict[type[Shape], Callable[[Any], tuple[float, ...]]] = {
    Sphere: lambda shape: (shape.radius,),
    Capsule: lambda shape: (shape.radius, 0.5 * shape.length),
    Box: lambda shape: tuple(0.5 * shape.size),
    Cylinder: lambda shape: (shape.radius, 0.5 * shape.length),
    HalfSpace: lambda shape: (*shape.normal, shape.offset),
    ConvexMesh: lambda shape: (),
}
"""Up to four numbers a shape, in the order in which ``overlaps.c`` numbers the kinds."""
_FIELDS = (
    *("joints", "links", "obstacles", "link_pairs"),
    *("parent", "slides", "column", "placement", "axis"),
    *("joint", "first", "around", "ball"),
    *("kind", "first_plane", "size", "plane"),
    *("pair", "columns"),
)


class _Scene(ctypes.Structure):
    """The structure ``Scene`` of ``overlaps.c``: counts are numbers, all others addresses of arrays."""

    _fields_ = [
        (name, ctypes.c_int64 if name in ("joints", "links", "obstacles", "link_pairs", "columns") else ctypes.c_void_p)
        for name in _FIELDS
    ]


class CompiledOverlaps:
    """A robot's balls among obstacles, in the form the compiled routine reads."""

    def __init__(self, routine: Any, arrays: dict[str, np.ndarray], counts: dict[str, int]):
        self._routine, self._arrays, self._columns = routine, arrays, counts["columns"]
        addresses = {name: array.ctypes.data for name, array in arrays.items()}
        self._scene = _Scene(**counts, **addresses)

    @classmethod
    def make(cls, model: pin.Model, balls: Balls, obstacles: tuple[Shape, ...], pairs: np.ndarray) -> CompiledOverlaps | None:
        """None where there is no compiler, or the robot is too large for the routine."""
        routine = _routine()
        if routine is None or max(model.njoints, len(balls.links)) > MOST:
            return None
        counts = {"joints": model.njoints, "links": len(balls.links), "obstacles": len(obstacles), "link_pairs": len(pairs)}
        counts["columns"] = len(balls.links) * len(obstacles) + len(pairs)
        arrays = {**_joint_arrays(model), **_obstacle_arrays(obstacles), "pair": np.ascontiguousarray(pairs, np.int64)}
        arrays |= {"joint": balls.joint, "first": balls.first, "around": balls.around, "ball": balls.ball}
        return cls(routine, {name: _plain(array) for name, array in arrays.items()}, counts)

    def near(self, q: np.ndarray, poses: np.ndarray, margin: float) -> np.ndarray:
        """As `Overlaps.near`; ``poses`` of the obstacles, shape (1 or N, O, 12)."""
        q = _plain(np.asarray(q, dtype=float))
        flags, work = np.empty((len(q), self._columns), np.uint8), np.empty((len(self._arrays["ball"]), 3))
        stride = poses[0].size if len(poses) > 1 else 0
        self._routine(
            ctypes.byref(self._scene), len(q), q.ctypes.data, q.shape[1], poses.ctypes.data, stride, margin,
            work.ctypes.data, flags.ctypes.data,
        )  # fmt: skip
        return flags.view(bool)


def _joint_arrays(model: pin.Model) -> dict[str, np.ndarray]:
    count = model.njoints
    parent, slides, column = (np.zeros(count, np.int64) for _ in range(3))
    placement, axis = np.zeros((count, 12)), np.zeros((count, 3))
    for j in range(1, count):
        kind, axis[j] = joint_axis(model, j)
        parent[j], slides[j], column[j] = model.parents[j], kind == "prismatic", model.joints[j].idx_v
        place = model.jointPlacements[j]
        placement[j] = np.append(place.rotation.ravel(), place.translation)
    return {"parent": parent, "slides": slides, "column": column, "placement": placement, "axis": axis}


def _obstacle_arrays(obstacles: tuple[Shape, ...]) -> dict[str, np.ndarray]:
    """Kinds, sizes and planes; a shape the routine does not know becomes a ball around it, which errs on the safe side."""
    kinds = list(_SIZES)
    kind, size, planes = np.zeros(len(obstacles), np.int64), np.zeros((len(obstacles), 4)), [np.empty((0, 4))]
    for k, obstacle in enumerate(obstacles):
        known = type(obstacle) in _SIZES
        kind[k] = kinds.index(type(obstacle) if known else Sphere)
        values = _SIZES[type(obstacle)](obstacle) if known else (obstacle.bounding_radius,)
        size[k, : len(values)] = values
        is_hull = type(obstacle) is ConvexMesh
        planes.append(np.column_stack([obstacle.hull.normals, obstacle.hull.offsets]) if is_hull else np.empty((0, 4)))
    return {"kind": kind, "size": size, "first_plane": np.cumsum([len(p) for p in planes]), "plane": np.concatenate(planes)}


def _plain(array: np.ndarray) -> np.ndarray:
    """Contiguous, of doubles or 64-bit integers."""
    return np.ascontiguousarray(array, np.int64 if array.dtype.kind in "iu" else float)


@lru_cache(maxsize=1)
def _routine() -> Any:
    """The function ``overlaps`` of the compiled library; None without a compiler."""
    if compiler.find_compiler() is None:
        return None
    text = (files("energyopt.pathfinding") / "overlaps.c").read_text()
    key = compiler.library_key(text, *_FLAGS)
    path = compiler.cached_library(key) or compiler.compile_library(key, {"overlaps": (text, _FLAGS)})
    try:
        routine = ctypes.CDLL(str(path)).overlaps
    except (OSError, AttributeError):
        return None
    size, address = ctypes.c_int64, ctypes.c_void_p
    routine.argtypes = [address, size, address, size, address, size, ctypes.c_double, address, address]
    routine.restype = None
    return routine
