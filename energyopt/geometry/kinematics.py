"""Where the joints of an arm are, for many configurations at once.

world_T_joint(q) = world_T_parent · placement · motion(qᵢ), with motion a turn about, or a slide along, the joint's axis.
Plain NumPy over all configurations together: the reference for compiled kernels, and quick enough for checks.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from energyopt.dynamics.body import joint_axis
from energyopt.errors import GeometryError


@lru_cache(maxsize=32)
def joint_axes(model: pin.Model) -> tuple[tuple[str, np.ndarray], ...]:
    """Kind and axis of every joint (see `joint_axis`), an entry for the fixed world first."""
    return (("fixed", np.zeros(3)), *(joint_axis(model, j) for j in range(1, model.njoints)))


def configurations(model: pin.Model, q: ArrayLike) -> np.ndarray:
    """Configurations as float rows, shape (N, nv).

    Raises:
        GeometryError: another shape.
    """
    q = np.atleast_2d(np.asarray(q, dtype=float))
    if q.ndim != 2 or q.shape[1] != model.nv:
        raise GeometryError(f"q has the shape {q.shape}; expected rows of {model.nv} joint positions")
    return q


def joint_placements(model: pin.Model, q: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """world_T_joint of every joint, the fixed world first: R (N, J, 3, 3) and p [m] (N, J, 3), for ``q`` (N, nv) [rad]."""
    q = configurations(model, q)
    rotation, position = np.empty((len(q), model.njoints, 3, 3)), np.empty((len(q), model.njoints, 3))
    rotation[:, 0], position[:, 0] = np.eye(3), 0.0
    for j in range(1, model.njoints):
        parent, place = model.parents[j], model.jointPlacements[j]
        kind, axis = joint_axes(model)[j]
        angle = q[:, model.joints[j].idx_v]
        rotation[:, j] = rotation[:, parent] @ place.rotation
        position[:, j] = position[:, parent] + rotation[:, parent] @ place.translation
        if kind == "prismatic":
            position[:, j] += angle[:, None] * (rotation[:, j] @ axis)
        else:
            rotation[:, j] = rotation[:, j] @ _turns(axis, angle)
    return rotation, position


def point_jacobians(
    model: pin.Model, rotation: np.ndarray, position: np.ndarray, joint: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Derivatives ∂p/∂q [m/rad], shape (N, S, 3, nv), of points fixed to joints.

    A joint that turns moves a point by axis × (point − joint), one that slides by its axis.

    Args:
        rotation, position: from `joint_placements`.
        joint: index of the joint each point is fixed to, shape (S,); points: where they are in the world [m], (N, S, 3).
    """
    jacobian = np.zeros((model.nv, *points.shape))
    for j in range(1, model.njoints):
        kind, axis = joint_axes(model)[j]
        moved = np.flatnonzero([j in model.supports[int(k)] for k in joint])
        direction = (rotation[:, j] @ axis)[:, None]
        if kind == "revolute":
            direction = np.cross(direction, points[:, moved] - position[:, j, None])
        jacobian[model.joints[j].idx_v][:, moved] = direction
    return np.moveaxis(jacobian, 0, -1)


def travel_bounds(model: pin.Model, joint: np.ndarray, center: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Bounds of how far a unit of each joint's motion can move a ball that is fixed to a joint, whatever the configuration.

    The speed of any point of ball b is at most Σ_v bound[b, v] |q̇_v|: a slide moves it by 1; a turn about joint v by its
    distance from that axis, which is at most the summed lengths of the links in between plus |center| + radius.

    Args:
        joint: index of the joint each ball is fixed to, shape (B,); center: in that joint's frame [m], shape (B, 3);
        radius: [m], shape (B,).

    Returns:
        [m/rad], or dimensionless for joints that slide, shape (B, nv).
    """
    bounds = np.zeros((len(joint), model.nv))
    for b, (j, c, r) in enumerate(zip(joint.tolist(), center, radius, strict=True)):
        reach = float(np.linalg.norm(c) + r)
        while j > 0:
            v = model.joints[j].idx_v
            kind, axis = joint_axes(model)[j]
            if kind == "prismatic":
                bounds[b, v] = 1.0
                reach += max(abs(model.lowerPositionLimit[v]), abs(model.upperPositionLimit[v]))
            else:
                # On the ball's own joint the distance from the axis itself is known.
                own = j == joint[b]
                bounds[b, v] = np.linalg.norm(np.cross(axis, c)) + r if own else reach
            reach += float(np.linalg.norm(model.jointPlacements[j].translation))
            j = model.parents[j]
    return bounds


def _turns(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotations about one unit axis by many angles (Rodrigues, 1840), shape (N, 3, 3)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + s * cross + (1 - c) * (cross @ cross)
