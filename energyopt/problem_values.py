"""Values that users give, checked one by one: each function gives a clean value or a one-line `ProblemError` that names it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from energyopt.errors import ProblemError

DURATION_RANGE = (1e-3, 1e4)
"""Durations [s] accepted: outside, the numbers of J leave the range of double precision."""
LONGEST_TEXT = 4000


def shown(value: Any) -> str:
    """A value for a message: on one line, and not too long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else f"{text[:79]}…"


def whole(key: str, value: Any, low: int, high: int, expected: str = "") -> int:
    """A whole number from ``low`` to ``high``; True, 3.0 and "3" are none."""
    if isinstance(value, bool) or not isinstance(value, Integral) or not low <= value <= high:
        raise ProblemError(f"{key} is {shown(value)}: expected {expected or f'a whole number, {low} to {high}'}")
    return int(value)


def real(key: str, value: Any, accepts: Callable[[float], bool], expected: str) -> float:
    """One number that ``accepts`` accepts; ``expected`` says it in words."""
    try:
        number = float(value) if isinstance(value, Real) and not isinstance(value, bool) else None
    except OverflowError:  # a whole number of hundreds of digits
        number = None
    if number is None or not accepts(number):
        raise ProblemError(f"{key} is {shown(value)}: expected {expected}")
    return number


def vector(key: str, value: ArrayLike, joints: Sequence[str] | int, scalar: bool = True, also: str = "") -> np.ndarray:
    """A finite float vector, one number a joint; one number fills it where ``scalar``. Read-only.

    Args:
        key: name of the value, for messages; limits may be infinite.
        value: what the user gave.
        joints: names of the joints, or how many numbers where they belong to no joints.
        scalar: whether one number may stand for all.
        also: what else may stand there, for messages.
    """
    size = joints if isinstance(joints, int) else len(joints)
    expected = f"{size} numbers" + ("" if isinstance(joints, int) else f", one for each of {_listed(joints)}") + also
    array = numbers(key, value, f"one number or {expected}" if scalar else expected)
    if array.ndim == 0 and scalar:
        array = np.full(size, float(array))
    if array.shape != (size,):
        got = {0: "one number", 1: f"{array.size} numbers"}.get(array.ndim, f"an array of shape {array.shape}")
        raise ProblemError(f"{key}: expected {expected}, got {got}")
    bad = np.flatnonzero(np.isnan(array) | (np.isinf(array) if not key.endswith("limits") else False))
    if bad.size:
        raise ProblemError(f"{_entry(key, bad[0], joints)} is {array[bad[0]]}: expected a finite number")
    array.flags.writeable = False
    return array


def _listed(joints: Sequence[str]) -> str:
    return ", ".join(joints) if len(joints) <= 7 else f"{', '.join(joints[:3])} … {joints[-1]}"


def _entry(key: str, i: int, joints: Sequence[str] | int) -> str:
    return f"{key}[{i}]" + ("" if isinstance(joints, int) else f" (joint '{joints[i]}')")


def numbers(key: str, value: ArrayLike, expected: str) -> np.ndarray:
    """Any array of real numbers as floats; None, texts, truth values and ragged lists are none."""
    try:
        array = np.array(value)
    except Exception:  # an object that says it is an array, and is none, may raise anything
        array = np.array(None)
    if array.dtype.kind not in "iuf":
        raise ProblemError(f"{key} is {shown(value)}: expected {expected}")
    return array.astype(float)


def instances(key: str, value: Any, kind: type, expected: str) -> tuple:
    """A list of objects of one kind, as a tuple; one object alone is a list of one."""
    if isinstance(value, kind):
        return (value,)
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise ProblemError(f"{key} is {shown(value)}: expected a list of {expected}")
    for k, item in enumerate(value):
        if not isinstance(item, kind):
            raise ProblemError(f"{key}[{k}] is {shown(item)}: expected {expected}")
    return tuple(value)


def configuration(key: str, value: ArrayLike) -> np.ndarray:
    """Finite joint positions of an arm not known yet, shape (n,). Read-only."""
    array = numbers(key, value, "a list of joint positions")
    return vector(key, array, array.size, scalar=False)


def non_negative(key: str, value: ArrayLike, joints: Sequence[str]) -> np.ndarray:
    """A vector of weights ≥ 0."""
    array = vector(key, value, joints)
    bad = np.flatnonzero(array < 0)
    if bad.size:
        i = bad[0]
        raise ProblemError(f"{_entry(key, i, joints)} is {array[i]:g}: expected a number ≥ 0 (a negative weight rewards waste)")
    return array


def positive(key: str, value: ArrayLike, joints: Sequence[str]) -> np.ndarray:
    """A vector of limits > 0."""
    array = vector(key, value, joints)
    bad = np.flatnonzero(array <= 0)
    if bad.size:
        i, remedy = bad[0], "leave it out for the robot's own limit"
        raise ProblemError(f"{_entry(key, i, joints)} is {array[i]:g}: expected a number > 0 ({remedy})")
    return array


def interval(key: str, value: tuple[ArrayLike, ArrayLike], joints: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """A pair of vectors, the first below the second."""
    try:
        low, high = None if isinstance(value, (Mapping, str)) else value
    except (TypeError, ValueError):
        raise ProblemError(f"{key} is {shown(value)}: expected a pair (lower, upper)") from None
    lower, upper = vector(key, low, joints), vector(key, high, joints)
    bad = np.flatnonzero(lower >= upper)
    if bad.size:
        i = bad[0]
        raise ProblemError(f"{_entry(key, i, joints)}: lower {lower[i]:g} is not below upper {upper[i]:g}")
    return lower, upper


def duration(value: float | tuple[float, float]) -> float | tuple[float, float]:
    """T [s], one number inside `DURATION_RANGE`, or two, the first below the second."""
    low, high = DURATION_RANGE
    expected = f"one number of seconds, {low:g} to {high:g}, or two, (least, most)"
    inside = lambda key, t: real(key, t, lambda t: low <= t <= high, expected)
    if isinstance(value, (tuple, list, np.ndarray)) and len(value) == 2:
        least, most = (inside("duration", t) for t in np.asarray(value, dtype=object))
        if not least < most:
            raise ProblemError(f"duration is ({least:g}, {most:g}): expected the least below the most; give one number to fix it")
        return least, most
    return inside("duration", value)


def rotation(value: ArrayLike) -> np.ndarray:
    """A rotation matrix, shape (3, 3), from one or from a unit quaternion (w, x, y, z)."""
    expected = "a 3×3 rotation matrix or a unit quaternion (w, x, y, z)"
    array = numbers("goal rotation", value, expected)
    if array.shape == (4,):
        norm = np.linalg.norm(array)
        if not abs(norm - 1.0) < 1e-3:
            raise ProblemError(f"goal rotation: quaternion (w, x, y, z) has norm {norm:g}, expected 1")
        w, x, y, z = array / norm
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
    if array.shape != (3, 3) or not np.allclose(array @ array.T, np.eye(3), atol=1e-6) or np.linalg.det(array) < 0:
        raise ProblemError(f"goal rotation is {shown(value)}: expected {expected}")
    return array


def seconds(key: str, value: float) -> float:
    """One finite number of seconds."""
    return real(key, value, np.isfinite, "one finite number of seconds")


def text(key: str, value: str, meaning: str) -> str:
    """A text that is not too long."""
    if not isinstance(value, str) or len(value) > LONGEST_TEXT:
        raise ProblemError(f"{key} is {shown(value)}: expected {meaning}, a text")
    return value


def waypoints(values: Sequence, joints: Sequence[str], duration: float, kind: Callable) -> tuple:
    """Waypoints as ``kind(position, time)``, their times rising inside (0, duration).

    Args:
        values: instances of ``kind``, positions [rad] of shape (nv,), or pairs (position, time [s]).
        joints: names of the joints.
        duration: T [s].
        kind: the class of a waypoint.
    """
    try:
        listed = list(values)
    except TypeError:
        expected = f"a list of configurations of {len(joints)} numbers"
        raise ProblemError(f"waypoints is {shown(values)}: expected {expected}") from None
    made, latest = [], 0.0
    for k, value in enumerate(listed):
        key = f"waypoints[{k}]"
        if isinstance(value, kind):
            position, time = value.position, value.time
        elif isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], (Sequence, np.ndarray)):
            position, time = value
        else:
            position, time = value, None
        position = vector(key, position, joints, scalar=False)
        if time is not None:
            time = seconds(f"{key}.time", time)
            if not latest < time < duration:
                raise ProblemError(
                    f"{key}: time {time:g} s is not between {latest:g} s (what comes before) and the duration {duration:g} s"
                )
            latest = time
        made.append(kind(position, time))
    return tuple(made)
