"""Payload: a rigid body held by the robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from energyopt.errors import RobotError
from energyopt.robots.lint import inertia_fault
from energyopt.robots.messages import as_numbers, shown
from energyopt.robots.urdf_xml import LARGEST


@dataclass(frozen=True, eq=False)
class Payload:
    """A rigid body fixed to a frame of the robot.

    Attributes:
        mass: [kg], positive.
        center: centre of mass in the frame [m], shape (3,).
        inertia: about the centre of mass, in the axes of the frame [kg·m²]: a 3×3 matrix, six numbers
            (xx, xy, xz, yy, yz, zz), three principal moments, or None for a point mass.
        frame: a link, or a joint (then the link it moves); "" for the robot's tool frame.

    Raises:
        RobotError: a number is missing, not finite, or the inertia is impossible.
    """

    mass: float
    center: ArrayLike = (0.0, 0.0, 0.0)
    inertia: ArrayLike | None = None
    frame: str = ""

    def __post_init__(self):
        object.__setattr__(self, "mass", float(_numbers("mass", self.mass, ((),))))
        object.__setattr__(self, "center", _numbers("center", self.center, ((3,),)))
        object.__setattr__(self, "inertia", _matrix(np.zeros(3) if self.inertia is None else self.inertia))
        if not isinstance(self.frame, str):
            raise RobotError(f"payload: frame is {shown(self.frame)}; expected the name of a link or joint")
        if self.mass <= 0:
            raise RobotError(f"payload: mass is {self.mass:g} kg; expected a positive number")
        fault = inertia_fault(self.mass, self.inertia)
        if fault:
            raise RobotError(f"payload: {fault}")


def _numbers(key: str, value: ArrayLike, shapes: tuple[tuple[int, ...], ...]) -> np.ndarray:
    expected = " or ".join("one number" if not s else f"an array of shape {s}" for s in shapes)
    array = as_numbers(value)
    if array is None:
        raise RobotError(f"payload: {key} is {shown(value)}; expected {expected}")
    if array.shape not in shapes:
        raise RobotError(f"payload: {key} has shape {array.shape}; expected {expected}")
    if not np.all(np.abs(array) <= LARGEST):
        raise RobotError(f"payload: {key} is {shown(array.tolist())}; expected finite numbers, none beyond {LARGEST:g}")
    array.flags.writeable = False
    return array


def _matrix(value: ArrayLike) -> np.ndarray:
    array = _numbers("inertia", value, ((3, 3), (6,), (3,)))
    if array.shape == (3,):
        array = np.diag(array)
    elif array.shape == (6,):
        xx, xy, xz, yy, yz, zz = array
        array = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    elif np.abs(array - array.T).max() > 1e-9 * np.abs(array).max():
        raise RobotError(f"payload: inertia {shown(array.tolist())} is not symmetric; give the matrix about the centre of mass")
    array.flags.writeable = False
    return array
