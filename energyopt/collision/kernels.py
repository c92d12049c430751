"""Pair kernels: what the program of a plan needs to know of distances, in C where there is a compiler and in NumPy elsewhere.

`PairKernels.place` puts the arm at K configurations; the object it returns answers for them. Both kinds give the same numbers.
"""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Callable
from functools import lru_cache
from importlib.resources import files
from typing import Protocol

import numpy as np

from energyopt.collision.arm import SphereArm
from energyopt.collision.numpy_kernels import NumpyPairs
from energyopt.collision.scene import Scene
from energyopt.dynamics import compiler
from energyopt.geometry.shapes import Box, Capsule, ConvexMesh, Cylinder, HalfSpace, Shape, Sphere

log = logging.getLogger("energyopt")

MOST_JOINTS = 64
_FLAGS = ("-O2", "-march=native", "-std=gnu11")
_SOURCE = files("energyopt.collision") / "collision.c"


class Placed(Protocol):
    """The arm at the K instants of a scene. A pair is (a, b): sphere a with obstacle b ≥ 0, or with sphere −1 − b."""

    def centers(self) -> np.ndarray:
        """Centres of all spheres [m], shape (K, S, 3)."""

    def pairs(self, sample: np.ndarray, pair: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance [m] (R,) and its derivative in q (R, nv) of R pairs (R, 2), each at its instant (R,)."""

    def bends(self, sample: np.ndarray, pair: np.ndarray, multiplier: np.ndarray) -> np.ndarray:
        """Σ multiplier · ∂²d/∂q² at each instant, shape (K, nv, nv)."""

    def penalty(self, derivatives: bool = True) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        """Hinge and potential at each instant (K, 2), and the derivatives in q of their sum, (K, nv) and (K, nv, nv)."""

    def least(self, cutoff: float) -> tuple[np.ndarray, np.ndarray]:
        """Distance less requirement of every link and obstacle, then of every two links, and the pair of spheres it is found at.

        Beyond ``cutoff`` [m] a lower bound is given, and the pair is −1. Shapes (K, L·O + P) and (K, L·O + P, 2).
        """


class PairKernels(Protocol):
    """Makes `Placed`."""

    kind: str

    def place(self, scene: Scene, q: np.ndarray) -> Placed:
        """The arm at configurations ``q`` (K, nv), one an instant of the scene."""

    def prepare(self, scene: Scene) -> Callable[[np.ndarray], Placed]:
        """The same for many ``q``, one after another: what an earlier call gave does not hold any more after the next."""


def pair_kernels(arm: SphereArm, obstacles: tuple[Shape, ...]) -> PairKernels:
    """The fastest kernels there are for an arm and these kinds of obstacles."""
    known = all(type(obstacle) in _KINDS for obstacle in obstacles)
    library = _library() if known and len(arm.kind) <= MOST_JOINTS else None
    return NumpyPairs(arm) if library is None else CompiledPairs(arm, library)


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL | None:
    """The compiled `collision.c`; None without a compiler."""
    if compiler.find_compiler() is None:
        return None
    text = _SOURCE.read_text()
    key = compiler.library_key(text, *_FLAGS)
    path = compiler.cached_library(key) or compiler.compile_library(key, {"collision": (text, _FLAGS)})
    try:
        return None if path is None else ctypes.CDLL(str(path))
    except OSError as error:
        log.warning("energyopt: the compiled collision kernels do not load (%s); they run in NumPy (slower)", error)
        return None


_POINTER = ctypes.c_void_p
_ARM_ARRAYS = ("parent", "kind", "column", "placement", "axis", "sphere_joint", "link_start", "link_joint", "center", "radius",
               "link_center", "link_radius", "self_pair")  # fmt: skip
_SCENE_ARRAYS = ("kind", "face_start", "size", "reach", "face", "watched", "pose", "required", "required_self")


class _Arm(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_long) for name in ("joints", "nv", "spheres", "links", "self_pairs")),
        *((name, _POINTER) for name in _ARM_ARRAYS),
    ]


class _Scene(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_long) for name in ("obstacles", "samples")),
        *((name, _POINTER) for name in _SCENE_ARRAYS),
        *((name, ctypes.c_double) for name in ("margin", "band", "stiffness", "gain", "safe", "least")),
    ]


class _Placed(ctypes.Structure):
    _fields_ = [(name, _POINTER) for name in ("center", "link_center", "axis", "origin")]


class CompiledPairs:
    """The kernels of `collision.c`."""

    kind = "compiled"

    def __init__(self, arm: SphereArm, library: ctypes.CDLL):
        self.arm, self.library = arm, library
        self._arrays = {name: np.ascontiguousarray(getattr(arm, name)) for name in _ARM_ARRAYS}
        numbers = {"joints": len(arm.kind), "nv": arm.nv, "spheres": arm.spheres, "links": len(arm.links)}
        self.structure = _Arm(**numbers, self_pairs=len(arm.self_pair), **_addresses(self._arrays))

    def place(self, scene: Scene, q: np.ndarray) -> _CompiledPlaced:
        return _CompiledPlaced(self, scene, len(q)).at(q)

    def prepare(self, scene: Scene) -> Callable[[np.ndarray], _CompiledPlaced]:
        return _CompiledPlaced(self, scene, len(scene.times)).at


class _CompiledPlaced:
    def __init__(self, kernels: CompiledPairs, scene: Scene, count: int):
        arm = kernels.arm
        self._arm, self._library, self._count = arm, kernels.library, count
        shapes = {"center": arm.spheres, "link_center": len(arm.links), "axis": len(arm.kind), "origin": len(arm.kind)}
        self._arrays = {name: np.empty((count, size, 3)) for name, size in shapes.items()}
        self._scene_arrays, scene_structure = _scene_structure(scene, count)
        self._held = (kernels.structure, scene_structure, _Placed(**_addresses(self._arrays)))
        self._pointers = tuple(map(ctypes.byref, self._held))

    def at(self, q: np.ndarray) -> _CompiledPlaced:
        """The arm at configurations ``q`` (K, nv)."""
        q = np.ascontiguousarray(q, dtype=float)
        self._library.eo_clearance_place(self._pointers[0], ctypes.c_long(self._count), _address(q), self._pointers[2])
        return self

    def centers(self):
        return self._arrays["center"]

    def pairs(self, sample, pair):
        distance, gradient = np.empty(len(sample)), np.empty((len(sample), self._arm.nv))
        sample, pair = np.ascontiguousarray(sample, np.int64), np.ascontiguousarray(pair, np.int64)
        self._call("eo_clearance_pairs", ctypes.c_long(len(sample)), sample, pair, distance, gradient)
        return distance, gradient

    def bends(self, sample, pair, multiplier):
        result = np.zeros((self._count, self._arm.nv, self._arm.nv))
        sample, pair = np.ascontiguousarray(sample, np.int64), np.ascontiguousarray(pair, np.int64)
        self._call("eo_clearance_bends", ctypes.c_long(len(sample)), sample, pair, np.ascontiguousarray(multiplier), result)
        return result

    def penalty(self, derivatives=True):
        nv, energy = self._arm.nv, np.empty((self._count, 2))
        if not derivatives:
            self._call("eo_clearance_penalty", energy, None, None)
            return energy, None, None
        gradient, hessian = np.empty((self._count, nv)), np.empty((self._count, nv, nv))
        self._call("eo_clearance_penalty", energy, gradient, hessian)
        return energy, gradient, hessian

    def least(self, cutoff):
        obstacles = self._held[1].obstacles
        width = len(self._arm.links) * obstacles + len(self._arm.self_pair)
        least, pair = np.empty((self._count, width)), np.empty((self._count, width, 2), np.int64)
        self._call("eo_clearance_least", ctypes.c_double(cutoff), least, pair)
        return least, pair

    def _call(self, name: str, *arguments):
        values = [_address(a) if isinstance(a, np.ndarray) else a for a in arguments]
        getattr(self._library, name)(*self._pointers, *values)


_KINDS = {Sphere: 0, Capsule: 1, Box: 2, Cylinder: 3, HalfSpace: 4, ConvexMesh: 5}


def _scene_structure(scene: Scene, count: int) -> tuple[dict[str, np.ndarray], _Scene]:
    obstacles = scene.obstacles
    pose = np.ascontiguousarray(np.broadcast_to(scene.pose, (count, *scene.pose.shape[1:])))
    faces = [_faces(o) for o in obstacles]
    arrays = {
        "kind": np.array([_KINDS[type(o)] for o in obstacles], np.int64),
        "face_start": np.concatenate([[0], np.cumsum([len(f) for f in faces])]).astype(np.int64),
        "size": np.array([_size(o) for o in obstacles], dtype=float).reshape(-1, 4),
        "reach": np.array([o.bounding_radius for o in obstacles], dtype=float),
        "face": np.concatenate([np.empty((0, 13)), *faces]),
        "watched": scene.watched,
        "pose": pose,
        "required": scene.required,
        "required_self": scene.required_self,
    }
    felt = scene.potential
    numbers = {"gain": felt.gain, "safe": felt.safe_distance, "least": felt.minimum_distance} if felt else {}
    hinge = {"band": scene.hinge.band, "stiffness": scene.hinge.stiffness, "margin": scene.margin}
    return arrays, _Scene(obstacles=len(obstacles), samples=count, **_addresses(arrays), **hinge, **numbers)


def _size(shape: Shape) -> tuple[float, ...]:
    if isinstance(shape, Box):
        return (*shape.size, 0.0)
    if isinstance(shape, HalfSpace):
        return (*shape.normal, shape.offset)
    return (getattr(shape, "radius", 0.0), getattr(shape, "length", 0.0), 0.0, 0.0)


def _faces(shape: Shape) -> np.ndarray:
    """Normal, offset and three corners of each face of a mesh, shape (F, 13)."""
    if not isinstance(shape, ConvexMesh):
        return np.empty((0, 13))
    hull = shape.hull
    corners = hull.vertices[hull.triangles].reshape(-1, 9)
    return np.concatenate([hull.normals, hull.offsets[:, None], corners], axis=1)


def _address(array: np.ndarray | None) -> ctypes.c_void_p:
    return ctypes.c_void_p(None if array is None else array.ctypes.data)


def _addresses(arrays: dict[str, np.ndarray]) -> dict[str, int]:
    return {name: array.ctypes.data for name, array in arrays.items()}
