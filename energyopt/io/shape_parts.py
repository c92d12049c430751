"""Shapes as numbers and plain values, and back: obstacles, workspaces and what is attached, inside a plan file.

All numbers of all shapes stand in one row, one array after another; a description of each shape says its kind and name and how
many numbers belong to which of its fields. A mesh is stored by its corners, a moving pose by its poses and times.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from typing import Any

import numpy as np

from energyopt.errors import FileError
from energyopt.geometry import Attached, Moving, RepulsivePotential, Workspace
from energyopt.geometry.shapes import SHAPES, Shape
from energyopt.problem import Problem

_DERIVED = ("pose", "name", "path", "folder", "scale")
"""Fields of shapes that are stored otherwise, or no more than what a shape was made from."""
MOST_SHAPES = 100_000


def avoidance_arrays(problem: Problem, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """Put the numbers of what a problem keeps clear of into ``arrays``; returns what is no number.

    Raises:
        FileError: a shape of a kind that energyopt does not know.
    """
    row: list[np.ndarray] = []
    meta = {
        "obstacles": [_described(shape, row) for shape in problem.obstacles],
        "workspace": [_described(item.region, row) | {"frames": list(item.frames)} for item in problem.workspace],
        "attached": [_described(item.shape, row) | {"frame": item.frame, "as": item.name} for item in problem.attached],
        "self_collision": bool(problem.self_collision),
    }
    arrays["problem.clearance"] = np.array(problem.clearance)
    if row:
        arrays["problem.shapes"] = np.concatenate([part.ravel() for part in row])
    if problem.potential is not None:
        own = problem.potential
        arrays["problem.potential"] = np.array([own.gain, own.safe_distance, own.minimum_distance])
    return meta


def avoidance_from_arrays(meta: dict[str, Any], arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """Keyword arguments of `Problem` from `avoidance_arrays`.

    Raises:
        GeometryError: a value makes no sense.
        KeyError, TypeError, ValueError: something is missing or has another shape.
    """
    row = _Row(_floats(arrays.get("shapes", np.zeros(0))))
    found = {
        "obstacles": [row.shape(item) for item in _list(meta["obstacles"])],
        "workspace": [Workspace(row.shape(item), list(map(str, item["frames"]))) for item in _list(meta["workspace"])],
        "attached": [Attached(row.shape(item), str(item["frame"]), str(item["as"])) for item in _list(meta["attached"])],
        "self_collision": meta["self_collision"],
        "clearance": float(_floats(arrays["clearance"]).reshape(())),
    }
    row.end()
    if "potential" in arrays:
        found["potential"] = RepulsivePotential(*_floats(arrays["potential"]).reshape(3).tolist())
    return found


def _described(shape: Shape, row: list[np.ndarray]) -> dict[str, Any]:
    """What a shape is, and the sizes of its arrays, which are appended to ``row``."""
    if SHAPES.get(shape.kind) is not type(shape):
        raise FileError(f"'{shape.name or shape.kind}' is a {type(shape).__name__}; a file can hold {', '.join(SHAPES)}")
    own = {field.name: getattr(shape, field.name) for field in fields(shape) if field.name not in _DERIVED}
    meta: dict[str, Any] = {"kind": shape.kind, "name": shape.name, "own": _stored(own, row)}
    if not shape.moves:
        return meta | {"pose": _stored({"pose": shape.pose}, row)}
    pose = shape.pose
    if pose.times is None:
        moves = {"pose": pose.pose, "velocity": pose.velocity, "angular_velocity": pose.angular_velocity}
        return meta | {"moving": _stored(moves, row)}
    return meta | {"moving": _stored({"pose": pose.pose, "times": pose.times}, row), "smooth": pose.smooth}


def _stored(values: dict[str, Any], row: list[np.ndarray]) -> dict[str, list[int]]:
    arrays = {key: np.asarray(value, dtype=float) for key, value in values.items() if value is not None}
    row.extend(arrays.values())
    return {key: list(array.shape) for key, array in arrays.items()}


class _Row:
    """Takes arrays from a row of numbers, one after another."""

    def __init__(self, numbers: np.ndarray):
        self._numbers, self._at = numbers, 0

    def shape(self, meta: dict[str, Any]) -> Shape:
        """The next shape."""
        kind, name = SHAPES[str(meta["kind"])], str(meta["name"])
        known = {field.name for field in fields(kind) if field.name not in _DERIVED}
        if not set(meta["own"]) <= known:
            raise ValueError(f"a {kind.kind} has no {', '.join(sorted(set(meta['own']) - known))}")
        own = self._arrays(meta["own"])
        if "moving" not in meta:
            return kind(**own, pose=self._arrays(meta["pose"])["pose"], name=name)
        moves = self._arrays(meta["moving"])
        if not set(moves) <= {"pose", "velocity", "angular_velocity", "times"}:
            raise ValueError(f"a moving pose has no {', '.join(moves)}")
        return kind(**own, pose=Moving(**moves, smooth=meta.get("smooth", False)), name=name)

    def end(self) -> None:
        """Everything must have been taken."""
        if self._at != len(self._numbers):
            raise ValueError(f"problem.shapes holds {len(self._numbers)} numbers; its shapes have {self._at}")

    def _arrays(self, sizes: dict[str, list[int]]) -> dict[str, np.ndarray]:
        return {str(key): self._next([int(n) for n in size]) for key, size in sizes.items()}

    def _next(self, size: Iterable[int]) -> np.ndarray:
        size = tuple(size)
        count = int(np.prod(size, dtype=object)) if size else 1
        if min(size, default=0) < 0 or len(size) > 3 or self._at + count > len(self._numbers):
            raise ValueError(f"problem.shapes holds {len(self._numbers)} numbers; a shape wants {size} more at {self._at}")
        self._at += count
        return self._numbers[self._at - count : self._at].reshape(size)


def _list(value: Any) -> list[dict[str, Any]]:
    if not isinstance(value, list) or len(value) > MOST_SHAPES or not all(isinstance(item, dict) for item in value):
        raise ValueError("its shapes are no list of tables")
    return value


def _floats(array: np.ndarray) -> np.ndarray:
    if array.dtype != np.float64 or not np.isfinite(array).all() or array.ndim > 1:
        raise ValueError("the numbers of its shapes are no finite row of numbers")
    return array
