"""Poses in problem files: position [m] and orientation, as a quaternion w, x, y, z or as roll, pitch, yaw."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from energyopt.io.toml_text import Document, shown
from energyopt.io.units import DEGREE
from energyopt.problem_values import rotation as rotation_matrix
from energyopt.robots.preparation import rotation_from_rpy

MOST_TURNED = 3 * np.pi
"""Roll, pitch and yaw [rad] beyond this are not meant."""
NORM_SLACK = 1e-3
"""How far from 1 the norm of a quaternion may be."""


def rotation_of(document: Document, key: str, entry: Mapping[str, Any], angles: str) -> np.ndarray | None:
    """The orientation that a table gives, shape (3, 3); None where it gives none.

    Args:
        document: the file; key: of the table, for messages; entry: the table.
        angles: "rad" or "deg".

    Raises:
        ProblemError: both ways are given, or the numbers are no orientation.
    """
    if "quaternion" in entry and "rpy" in entry:
        raise document.error(key, "has both quaternion and rpy; expected one of them, or neither")
    if "rpy" in entry:
        if angles == "rad" and np.max(np.abs(entry["rpy"])) > MOST_TURNED:
            reason = 'looks like degrees, expected radians: angles = "deg" at the top of the file reads them so'
            raise document.error(f"{key}.rpy", f"is {shown(entry['rpy'])}; {reason}")
        return rotation_from_rpy((np.array(entry["rpy"], float) * (DEGREE if angles == "deg" else 1.0)).tolist())
    if "quaternion" not in entry:
        return None
    norm = float(np.linalg.norm(entry["quaternion"]))
    if not abs(norm - 1.0) < NORM_SLACK:
        raise document.error(f"{key}.quaternion", f"is {shown(entry['quaternion'])}, of norm {norm:.4g}; expected norm 1")
    return rotation_matrix(entry["quaternion"])


def pose_of(document: Document, key: str, entry: Mapping[str, Any], angles: str) -> np.ndarray:
    """The pose that a table gives, shape (4, 4); what it leaves out is that of the origin.

    Raises:
        ProblemError: as `rotation_of`.
    """
    pose, rotation = np.eye(4), rotation_of(document, key, entry, angles)
    if rotation is not None:
        pose[:3, :3] = rotation
    pose[:3, 3] = entry.get("position", (0.0, 0.0, 0.0))
    return pose
