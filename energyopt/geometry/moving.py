"""Moving: a pose that is a function of planned time.

Three ways to say it:

- a pose with constant velocities v [m/s] and ω [rad/s], both in the axes of the robot's base:
  x(t) = x₀ + v t, R(t) = exp([ω]× t) R₀;
- poses at stated times: position linear, orientation by the shortest turn at constant rate (slerp) between two of them;
- a function of t, called once at each of the given times and then forgotten: position by a cubic spline, orientation by a
  rotation spline (both twice continuously differentiable), so that derivatives in t are smooth for a free duration.

Before the first and after the last stated time the pose stands still.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from energyopt.errors import GeometryError
from energyopt.geometry.values import pose_matrix, vector
from energyopt.robots.messages import shown

MAX_TIMES = 100_000
EVEN_SAMPLES = 201
"""Samples of a function when only the last time is given."""


@dataclass(frozen=True)
class PoseDerivatives:
    """A pose and its first two derivatives in time, one row a time.

    Attributes:
        rotation, position: R (N, 3, 3) and x [m] (N, 3).
        rotation_rate, velocity: Ṙ [1/s] and ẋ [m/s]; rotation_acceleration, acceleration: R̈ [1/s²] and ẍ [m/s²].
    """

    rotation: np.ndarray
    position: np.ndarray
    rotation_rate: np.ndarray
    velocity: np.ndarray
    rotation_acceleration: np.ndarray
    acceleration: np.ndarray


@dataclass(frozen=True, eq=False)
class Moving:
    """The pose of a moving shape.

    Attributes:
        pose: with velocities, the pose at t = 0; with ``times``, one pose a time, or a function t → pose that is called
            once at each of them. A pose is a 4×4 matrix, a ``pin.SE3`` or a position xyz. Stored as (4, 4) or (K, 4, 4).
        velocity: of the shape's origin [m/s], shape (3,); angular_velocity: [rad/s], shape (3,); in the base's axes.
        times: increasing [s], shape (K,); for a function also one number, the end of 201 even samples from 0.
        smooth: twice differentiable interpolation of poses at times; a function always has it.

    Raises:
        GeometryError: a value is malformed, or velocities and times are both given.
    """

    pose: Any
    velocity: ArrayLike = (0.0, 0.0, 0.0)
    angular_velocity: ArrayLike = (0.0, 0.0, 0.0)
    times: ArrayLike | None = None
    smooth: bool = False

    def __post_init__(self):
        put = lambda key, value: object.__setattr__(self, key, value)
        for key in ("velocity", "angular_velocity"):
            put(key, vector(f"Moving: {key}", getattr(self, key), (3,)))
        if not isinstance(self.smooth, (bool, np.bool_)):
            raise GeometryError(f"Moving: smooth is {shown(self.smooth)}; expected True or False")
        if self.times is None:
            if callable(self.pose):
                raise GeometryError("Moving: pose is a function and times is missing; give the times at which to sample it")
            put("pose", pose_matrix("Moving: pose", self.pose))
            return
        if np.any(self.velocity) or np.any(self.angular_velocity):
            raise GeometryError("Moving: both times and a velocity are given; expected one of them")
        put("times", _times(self.times, callable(self.pose)))
        put("smooth", bool(self.smooth) or callable(self.pose))
        put("pose", _poses(self.pose, self.times))

    def at(self, t: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (N, 3, 3) and position [m] (N, 3) at times ``t`` [s], shape (N,)."""
        motion = self.derivatives(t)
        return motion.rotation, motion.position

    def derivatives(self, t: ArrayLike) -> PoseDerivatives:
        """Pose and derivatives at times ``t`` [s], shape (N,); from the right where a waypoint makes them jump."""
        t = np.atleast_1d(np.asarray(t, dtype=float))
        if self.times is None:
            return self._constant(t)
        moving = (t >= self.times[0]) & (t < self.times[-1])
        inside = np.clip(t, self.times[0], self.times[-1])
        rotation, omega, alpha, position, velocity, acceleration = self._smooth(inside) if self.smooth else self._linear(inside)
        for rate in (omega, alpha, velocity, acceleration):
            rate[~moving] = 0.0
        return _assemble(rotation, omega, alpha, position, velocity, acceleration)

    def speed_bound(self, reach: float) -> float:
        """Upper bound [m/s] of the speed of points at most ``reach`` [m] away from the shape's origin, for all times.

        Exact up to the triangle inequality for velocities and linear waypoints. For smooth interpolation the speed of the
        origin is bounded by its Bernstein coefficients; the turning rate, which has no such form, by 20 samples a span plus 5 %.
        """
        if self.times is None:
            return float(np.linalg.norm(self.velocity) + reach * np.linalg.norm(self.angular_velocity))
        if not self.smooth:
            omega, velocity = self._segment_rates
            return float((np.linalg.norm(velocity, axis=1) + reach * np.linalg.norm(omega, axis=1)).max())
        positions, rotations = self._splines
        speed = np.linalg.norm(_velocity_controls(positions), axis=-1).max()
        fine = np.interp(np.linspace(0, len(self.times) - 1, 20 * (len(self.times) - 1) + 1), range(len(self.times)), self.times)
        return float(speed + 1.05 * reach * np.linalg.norm(rotations(fine, 1), axis=-1).max())

    def _constant(self, t: np.ndarray) -> PoseDerivatives:
        turn = Rotation.from_rotvec(t[:, None] * self.angular_velocity).as_matrix()
        rows = lambda value: np.broadcast_to(value, (len(t), 3)).copy()
        position = self.pose[:3, 3] + t[:, None] * self.velocity
        none = np.zeros((len(t), 3))
        return _assemble(turn @ self.pose[:3, :3], rows(self.angular_velocity), none, position, rows(self.velocity), none)

    def _linear(self, t: np.ndarray) -> tuple[np.ndarray, ...]:
        k = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        omega, velocity = (rates[k] for rates in self._segment_rates)
        since = (t - self.times[k])[:, None]
        rotation = Rotation.from_rotvec(since * omega).as_matrix() @ self.pose[k, :3, :3]
        none = np.zeros((len(t), 3))
        return rotation, omega.copy(), none, self.pose[k, :3, 3] + since * velocity, velocity.copy(), none.copy()

    def _smooth(self, t: np.ndarray) -> tuple[np.ndarray, ...]:
        positions, rotations = self._splines
        turned = rotations(t)
        rotation = turned.as_matrix()
        omega, alpha = ((rotation @ rotations(t, order)[..., None])[..., 0] for order in (1, 2))
        return rotation, omega, alpha, positions(t), positions(t, 1), positions(t, 2)

    @cached_property
    def _segment_rates(self) -> tuple[np.ndarray, np.ndarray]:
        """ω and v of each interval between waypoints, shape (K − 1, 3), in the base's axes."""
        width = np.diff(self.times)[:, None]
        turns = Rotation.from_matrix(self.pose[1:, :3, :3] @ self.pose[:-1, :3, :3].transpose(0, 2, 1)).as_rotvec()
        return turns / width, np.diff(self.pose[:, :3, 3], axis=0) / width

    @cached_property
    def _splines(self) -> tuple[CubicSpline, RotationSpline]:
        rotations = RotationSpline(self.times, Rotation.from_matrix(self.pose[:, :3, :3]))
        return CubicSpline(self.times, self.pose[:, :3, 3]), rotations


def _assemble(rotation, omega, alpha, position, velocity, acceleration) -> PoseDerivatives:
    """Ṙ = [ω]× R and R̈ = ([α]× + [ω]×²) R, with ω and α in the base's axes."""
    spin = _cross(omega)
    return PoseDerivatives(rotation, position, spin @ rotation, velocity, (_cross(alpha) + spin @ spin) @ rotation, acceleration)


def _cross(w: np.ndarray) -> np.ndarray:
    matrix = np.zeros((len(w), 3, 3))
    matrix[:, 2, 1], matrix[:, 0, 2], matrix[:, 1, 0] = w.T
    return matrix - matrix.transpose(0, 2, 1)


def _velocity_controls(spline: CubicSpline) -> np.ndarray:
    """Bernstein coefficients of the velocity on every span, shape (K − 1, 3, 3); their hull holds the velocity."""
    cubic, square, slope = (spline.c[k] for k in range(3)) if len(spline.c) == 4 else (0 * spline.c[-1], *spline.c[-3:-1])
    h = np.diff(spline.x)[:, None]
    return np.stack([slope, slope + square * h, slope + 2 * square * h + 3 * cubic * h**2], axis=1)


def _times(value: Any, function: bool) -> np.ndarray:
    if function and np.ndim(value) == 0:
        end = float(vector("Moving: times", value, ()))
        if end <= 0:
            raise GeometryError(f"Moving: times is {end:g} s; expected the positive time until which the function is sampled")
        value = np.linspace(0.0, end, EVEN_SAMPLES)
    try:
        count = len(value)
    except TypeError:
        count = 0
    if not 2 <= count <= MAX_TIMES:
        raise GeometryError(f"Moving: times is {shown(value)}; expected 2 to {MAX_TIMES} increasing times [s]")
    times = vector("Moving: times", value, (count,))
    fall = np.flatnonzero(np.diff(times) <= 0)
    if fall.size:
        k = fall[0] + 1
        raise GeometryError(f"Moving: times[{k}] is {times[k]:g} s after {times[k - 1]:g} s; expected increasing times")
    return times


def _poses(value: Callable | Sequence, times: np.ndarray) -> np.ndarray:
    if callable(value):
        values = [_call(value, float(t)) for t in times]
    else:
        try:
            values = list(value)
        except TypeError:
            values = []
        if len(values) != len(times):
            raise GeometryError(f"Moving: pose holds {len(values)} poses; expected one a time, {len(times)}")
    poses = np.array([pose_matrix(f"Moving: pose at {t:g} s", v) for t, v in zip(times, values, strict=True)])
    poses.flags.writeable = False
    return poses


def _call(function: Callable, t: float) -> Any:
    try:
        return function(t)
    except Exception as error:  # whatever the caller's function raises
        said = " ".join(f"{type(error).__name__}: {error}".split())[:160]
        raise GeometryError(f"Moving: the function of the pose failed at t = {t:g} s: {said}") from error
