"""Numbers and poses that callers write, checked: each fault is one line that says what, where, and what was expected."""

from __future__ import annotations

from typing import Any

import numpy as np

from energyopt.errors import GeometryError
from energyopt.robots.messages import as_numbers, shown

LARGEST = 1e4
"""Lengths [m] above this are mistakes, most often millimetres taken for metres."""
ROTATION_SLACK = 1e-6
"""Largest |RᵀR − I| of an accepted rotation matrix; what is accepted is then projected onto the exact rotations."""
ROUNDING = 1e-14
"""The same for what a projection gives, which is left as it is: poses that are taken over stay the same to the last bit."""


def positive(where: str, value: Any) -> float:
    """A positive length [m], at most `LARGEST`.

    Raises:
        GeometryError: it is something else.
    """
    number = float(vector(where, value, ()))
    if not 0 < number <= LARGEST:
        raise GeometryError(f"{where} is {number:g}; expected a positive number of metres, at most {LARGEST:g}")
    return number


def non_negative(where: str, value: Any) -> float:
    """A length ≥ 0 [m], at most `LARGEST`.

    Raises:
        GeometryError: it is something else.
    """
    number = float(vector(where, value, ()))
    if not 0 <= number <= LARGEST:
        raise GeometryError(f"{where} is {number:g}; expected a number of metres from 0 to {LARGEST:g}")
    return number


def vector(where: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Finite floats of the given shape, read-only.

    Raises:
        GeometryError: another shape, not numbers, or not finite.
    """
    expected = "one number" if shape == () else f"{'×'.join(map(str, shape))} numbers"
    array = as_numbers(value)
    if array is None:
        raise GeometryError(f"{where} is {shown(value)}; expected {expected}")
    if array.shape != shape:
        raise GeometryError(f"{where} has the shape {array.shape}; expected {expected}")
    if not np.isfinite(array).all():
        raise GeometryError(f"{where} is {shown(array.tolist())}; expected finite numbers")
    array.flags.writeable = False
    return array


def label(where: str, value: Any) -> str:
    """A name: text on one line, at most 200 characters.

    Raises:
        GeometryError: it is something else.
    """
    if not isinstance(value, str) or len(value) > 200 or not value.isprintable():
        raise GeometryError(f"{where} is {shown(value)}; expected text of at most 200 printable characters")
    return value


def pose_matrix(where: str, value: Any) -> np.ndarray:
    """A pose as a 4×4 matrix, read-only, from a 4×4 matrix, a ``pin.SE3``, a position xyz, or None (the origin).

    Raises:
        GeometryError: another shape, not finite, or its upper left 3×3 block is no rotation.
    """
    if value is None:
        return pose_matrix(where, np.eye(4))
    value = getattr(value, "homogeneous", value)
    try:
        shape = np.shape(value)
    except ValueError:
        shape = None
    if shape == (3,):
        matrix = np.eye(4)
        matrix[:3, 3] = vector(f"{where} (xyz)", value, (3,))
    elif shape == (4, 4):
        matrix = vector(where, value, (4, 4)).copy()
        matrix[:3, :3] = _rotation(where, matrix[:3, :3])
        if np.abs(matrix[3] - (0, 0, 0, 1)).max() > ROTATION_SLACK:
            raise GeometryError(f"{where}: its last row is {shown(matrix[3].tolist())}; expected 0, 0, 0, 1")
        matrix[3] = (0, 0, 0, 1)
    else:
        raise GeometryError(f"{where} is {shown(value)}; expected a 4×4 matrix, a pin.SE3, a position xyz, or energyopt.Moving")
    if np.abs(matrix[:3, 3]).max() > LARGEST:
        raise GeometryError(f"{where}: its position is {shown(matrix[:3, 3].tolist())}; expected metres, at most {LARGEST:g}")
    matrix.flags.writeable = False
    return matrix


def _rotation(where: str, block: np.ndarray) -> np.ndarray:
    """The rotation nearest to a 3×3 matrix that already is one up to `ROTATION_SLACK` (from its polar decomposition)."""
    off = np.abs(block.T @ block - np.eye(3)).max()
    if off > ROTATION_SLACK or np.linalg.det(block) < 0:
        fault = f"|RᵀR − I| = {off:.2g}" if off > ROTATION_SLACK else "it mirrors (determinant −1)"
        raise GeometryError(f"{where}: its 3×3 block is no rotation, {fault}; expected orthonormal columns, right-handed")
    if off <= ROUNDING:
        return block
    left, _, right = np.linalg.svd(block)
    return left @ right
