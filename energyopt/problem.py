"""Problem: what is asked of the planner, validated when made, and immutable.

minimise ∫₀ᵀ ( Σ wᵢ τᵢ² + Σ λᵢ q̇ᵢ² ) dt   over all motions q(t), 0 ≤ t ≤ T, with
q(0), q̇(0), q̈(0) given;  q(T) given or the tool in a given pose;  q̇(T), q̈(T) given;  waypoints passed;
position, velocity, acceleration, jerk, torque and torque rate inside their limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from energyopt.errors import ProblemError
from energyopt.robots.model import Limits, RobotModel

DURATION_RANGE = (1e-3, 1e4)
"""Durations [s] accepted: outside, the numbers of J leave the range of double precision."""


@dataclass(frozen=True, eq=False)
class FramePose:
    """A Cartesian goal: where a frame has to be; the redundancy of the arm is left to the optimiser.

    Attributes:
        frame: name of a link, joint or frame of the robot.
        position: of the frame's origin in the robot's base [m], shape (3,).
        rotation: 3×3 matrix or unit quaternion (w, x, y, z); None leaves the orientation free.
    """

    frame: str
    position: np.ndarray
    rotation: np.ndarray | None = None

    def __post_init__(self):
        object.__setattr__(self, "position", _vector("goal position", self.position, 3))
        if self.rotation is not None:
            object.__setattr__(self, "rotation", _rotation(self.rotation))


@dataclass(frozen=True, eq=False)
class Waypoint:
    """A configuration to pass through.

    Attributes:
        position: joint positions [rad], shape (nv,).
        time: when [s]; None lets the optimiser choose, in the order the waypoints are listed.
    """

    position: np.ndarray
    time: float | None = None


@dataclass(frozen=True, eq=False)
class Problem:
    """One planning problem. Arrays have shape (nv,); a single number stands for all joints.

    Attributes:
        robot: the arm.
        start: joint positions at t = 0 [rad].
        goal: joint positions at t = T [rad], or a `FramePose`.
        duration: T [s].
        velocity_weight: λ, one number or one a joint [N²·m²·s²/rad²].
        torque_weights: w, dimensionless.
        waypoints: configurations to pass through: `Waypoint`, an array, or a pair (array, time).
        start_velocity, goal_velocity: [rad/s]; start_acceleration, goal_acceleration: [rad/s²]; zero by default.
        position_limits: (lower, upper) [rad]; velocity_limits [rad/s]; acceleration_limits [rad/s²];
            jerk_limits [rad/s³]; torque_limits [N·m]; torque_rate_limits [N·m/s]: in place of the robot's own.
        name: for reports.

    Raises:
        ProblemError: a value is malformed; the message names it, what was expected, and what to do.
    """

    robot: RobotModel
    start: ArrayLike
    goal: ArrayLike | FramePose
    duration: float
    velocity_weight: ArrayLike = 0.1
    torque_weights: ArrayLike = 1.0
    waypoints: Sequence = ()
    start_velocity: ArrayLike = 0.0
    goal_velocity: ArrayLike = 0.0
    start_acceleration: ArrayLike = 0.0
    goal_acceleration: ArrayLike = 0.0
    position_limits: tuple[ArrayLike, ArrayLike] | None = None
    velocity_limits: ArrayLike | None = None
    acceleration_limits: ArrayLike | None = None
    jerk_limits: ArrayLike | None = None
    torque_limits: ArrayLike | None = None
    torque_rate_limits: ArrayLike | None = None
    name: str = ""

    def __post_init__(self):
        if not isinstance(self.robot, RobotModel):
            raise ProblemError(f"robot: expected a robot from energyopt.load_robot, got {type(self.robot).__name__}")
        nv = self.robot.nv
        put = lambda key, value: object.__setattr__(self, key, value)
        put("start", _vector("start", self.start, nv, scalar=False))
        if isinstance(self.goal, FramePose):
            self.robot.frame_id(self.goal.frame)
        else:
            put("goal", _vector("goal", self.goal, nv, scalar=False))
        put("duration", _duration(self.duration))
        for key in ("start_velocity", "goal_velocity", "start_acceleration", "goal_acceleration"):
            put(key, _vector(key, getattr(self, key), nv))
        for key in ("velocity_weight", "torque_weights"):
            put(key, _non_negative(key, getattr(self, key), nv))
        if not (np.any(self.torque_weights > 0) or np.any(self.velocity_weight > 0)):
            raise ProblemError("torque_weights and velocity_weight are all zero: every motion costs nothing; make one positive")
        put("waypoints", _waypoints(self.waypoints, nv, self.duration))
        _ = self.limits

    @cached_property
    def limits(self) -> Limits:
        """The limits in force: the problem's own where given, else the robot's."""
        robot, nv = self.robot.limits, self.robot.nv
        lower, upper = robot.lower, robot.upper
        if self.position_limits is not None:
            lower, upper = _interval("position_limits", self.position_limits, nv)
        own = {}
        for kind in ("velocity", "torque", "acceleration", "jerk", "torque_rate"):
            value = getattr(self, f"{kind}_limits")
            own[kind] = getattr(robot, kind) if value is None else _positive(f"{kind}_limits", value, nv)
        return Limits(lower=lower, upper=upper, **own)

    @property
    def goal_position(self) -> np.ndarray | None:
        """The goal as joint positions; None where it is Cartesian."""
        return None if isinstance(self.goal, FramePose) else self.goal


def _vector(key: str, value: ArrayLike, size: int, scalar: bool = True) -> np.ndarray:
    """A finite float vector of the given size; one number fills it where ``scalar``. Read-only."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise ProblemError(f"{key}: expected {size} numbers, got {value!r}") from None
    if array.ndim == 0 and scalar:
        array = np.full(size, float(array))
    if array.shape != (size,):
        got = f"{array.size} numbers" if array.ndim == 1 else f"an array of shape {array.shape}"
        raise ProblemError(f"{key}: expected {size} numbers, got {got}")
    bad = np.flatnonzero(np.isnan(array) | (np.isinf(array) if not key.endswith("limits") else False))
    if bad.size:
        raise ProblemError(f"{key}[{bad[0]}] is {array[bad[0]]}: expected a finite number")
    array.flags.writeable = False
    return array


def _non_negative(key: str, value: ArrayLike, size: int) -> np.ndarray:
    array = _vector(key, value, size)
    bad = np.flatnonzero(array < 0)
    if bad.size:
        raise ProblemError(f"{key}[{bad[0]}] is {array[bad[0]]:g}: expected a number ≥ 0 (a negative weight rewards waste)")
    return array


def _positive(key: str, value: ArrayLike, size: int) -> np.ndarray:
    array = _vector(key, value, size)
    bad = np.flatnonzero(array <= 0)
    if bad.size:
        raise ProblemError(
            f"{key}[{bad[0]}] is {array[bad[0]]:g}: expected a number > 0 (leave the key out for no limit of its own)"
        )
    return array


def _interval(key: str, value: tuple[ArrayLike, ArrayLike], size: int) -> tuple[np.ndarray, np.ndarray]:
    try:
        low, high = value
    except (TypeError, ValueError):
        raise ProblemError(f"{key}: expected a pair (lower, upper), got {value!r}") from None
    lower, upper = _vector(f"{key}", low, size), _vector(f"{key}", high, size)
    bad = np.flatnonzero(lower >= upper)
    if bad.size:
        i = bad[0]
        raise ProblemError(f"{key}[{i}]: lower {lower[i]:g} is not below upper {upper[i]:g}")
    return lower, upper


def _duration(value: float) -> float:
    low, high = DURATION_RANGE
    try:
        duration = float(value)
    except (TypeError, ValueError):
        raise ProblemError(f"duration: expected seconds, one number, got {value!r}") from None
    if not low <= duration <= high:
        raise ProblemError(f"duration is {duration:g} s: expected between {low:g} and {high:g} s")
    return duration


def _rotation(value: ArrayLike) -> np.ndarray:
    array = np.array(value, dtype=float)
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
        raise ProblemError("goal rotation: expected a 3×3 rotation matrix or a unit quaternion (w, x, y, z)")
    return array


def _waypoints(values: Sequence, nv: int, duration: float) -> tuple[Waypoint, ...]:
    made, latest = [], 0.0
    for k, value in enumerate(values):
        key = f"waypoints[{k}]"
        if isinstance(value, Waypoint):
            position, time = value.position, value.time
        elif isinstance(value, tuple) and len(value) == 2 and np.ndim(value[0]) == 1:
            position, time = value
        else:
            position, time = value, None
        position = _vector(key, position, nv, scalar=False)
        if time is not None:
            time = float(time)
            if not latest < time < duration:
                raise ProblemError(
                    f"{key}: time {time:g} s is not between {latest:g} s (what comes before) and the duration {duration:g} s"
                )
            latest = time
        made.append(Waypoint(position, time))
    return tuple(made)
