"""Angles of a problem file as radians. This is the only place where degrees exist.

With ``angles = "deg"`` every angle, angular velocity, acceleration and jerk of the file is in degrees; lengths of sliding
joints stay metres, and torques, friction and weights keep their units (N·m, N·m·s/rad …).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from energyopt.dynamics.body import joint_axis
from energyopt.robots import RobotModel

ANGULAR = ("position", "velocity", "acceleration", "jerk")
"""Limits that are angles or their derivatives."""
DEGREE = float(np.pi / 180.0)


def joint_factors(robot: RobotModel, angles: str) -> np.ndarray:
    """What the file's joint positions and derivatives are multiplied with, shape (nv,)."""
    if angles == "rad":
        return np.ones(robot.nv)
    kinds = [joint_axis(robot.model, i + 1)[0] for i in range(robot.nv)]
    return np.array([1.0 if kind == "prismatic" else DEGREE for kind in kinds])


def convert(value: Any, names: tuple[str, ...], factors: np.ndarray) -> Any:
    """A number, a list or a table by joint (of numbers or pairs), converted; wrong lengths are left for others to report."""
    if np.all(factors == 1.0):
        return value
    if isinstance(value, Mapping) and set(value) <= {"lower", "upper"}:
        return {side: convert(v, names, factors) for side, v in value.items()}
    if isinstance(value, Mapping):
        by_name = dict(zip(names, factors, strict=True))
        return {joint: (np.asarray(v, float) * by_name.get(joint, 1.0)).tolist() for joint, v in value.items()}
    array = np.asarray(value, dtype=float)
    fits = array.ndim == 0 or array.shape == factors.shape
    return (array * factors).tolist() if fits else value
