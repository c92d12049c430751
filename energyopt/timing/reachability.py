"""How fast a path can be followed, and motions along it: the one place of time-optimal timing.

Along a curve q(s) a time law s(t) gives q̇ = q'ṡ and q̈ = q's̈ + q''ṡ². With x = ṡ² and u = s̈ the torques are linear in both
(J. E. Bobrow, S. Dubowsky and J. S. Gibson, "Time-Optimal Control of Robotic Manipulators Along Specified Paths", IJRR 4, 1985),

    τ = a(s) u + b(s) x + c(s) + friction,    a = M q',   b = M q'' + C(q, q') q',   c = g,

and so are the limits of τ and q̈; limits of q̇ bound x. On a grid, with u constant between s_i and s_{i+1}, x changes by 2 u Δs.
A backward pass finds for every s_i the largest x from which the end can still be reached at rest, a forward pass takes the
largest u that stays below (Q.-C. Pham and H. Pham, "A New Approach to Time-Optimal Path Parameterization Based on Reachability
Analysis", IEEE T-RO 34, 2018). Limits hold at both ends of every interval. Friction is counted between none and that at the
largest velocity, whichever is worse, and that velocity is one at which viscous friction takes no more than half of the torque
that is left: exact without friction, on the safe side with it. Limits of jerk and torque rate are not looked at.

A law made slower by a factor r has torques c + r²(τ − c): what holds at rest and at full speed holds in between.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from energyopt.errors import ProblemError
from energyopt.parameterizations.trajectory import PolynomialTrajectory, Trajectory
from energyopt.robots.model import Limits, RobotModel

INTERVALS = 240
"""Of the grid along a curve, at least."""


@dataclass(frozen=True, eq=False)
class TimeLaw:
    """How a curve is passed.

    Attributes:
        s: places on the curve, shape (N + 1,), from 0 to its length.
        speed: ṡ at these [1/s], shape (N + 1,).
        pull: s̈ between them [1/s²], shape (N,).
    """

    s: np.ndarray
    speed: np.ndarray
    pull: np.ndarray

    @property
    def times(self) -> np.ndarray:
        """When each place is passed [s], shape (N + 1,)."""
        return np.append(0.0, np.cumsum(2.0 * np.diff(self.s) / (self.speed[1:] + self.speed[:-1])))

    @property
    def duration(self) -> float:
        return float(self.times[-1])

    def places(self) -> PolynomialTrajectory:
        """s(t) as a motion of one joint, parabolas between the places."""
        pieces = np.stack([self.s[:-1], self.speed[:-1], 0.5 * self.pull], axis=1)
        return PolynomialTrajectory(self.times, pieces[:, :, None])

    def scaled(self, duration: float) -> TimeLaw:
        """The same law, slower or faster, to take ``duration`` [s]."""
        ratio = self.duration / duration
        return TimeLaw(self.s, ratio * self.speed, ratio**2 * self.pull)


def fastest(
    curve: Trajectory, robot: RobotModel, limits: Limits | None = None, start_speed: float = 0.0, goal_speed: float = 0.0
) -> TimeLaw:
    """The time law that takes the least time inside the limits of velocity, acceleration and torque.

    Args:
        curve: the path; its time is read as the place s. It must stand still nowhere (q' ≠ 0): see `paths.by_length`.
        robot: the arm.
        limits: in place of the robot's own.
        start_speed, goal_speed: ṡ at the ends [1/s].

    Raises:
        ProblemError: the arm cannot hold itself still somewhere on the path, nothing limits it, or it cannot have these speeds.
    """
    limits = limits or robot.limits
    s = curve.sample_times(max(1, -(-INTERVALS // (len(curve.breaks) - 1))))
    held = robot.torque(curve(s), *np.zeros((2, len(s), robot.nv)))
    _require_held(limits.torque - np.abs(held) - robot.dynamics.coulomb_friction, held, robot, limits)
    most = _most(curve(s, 1), held, robot, limits)
    places = _limit_rows(curve, s, held, robot, limits, most)
    rows = _interval_rows(s, *places)
    most = np.minimum(most, np.append(_bound_of_pairs(*rows), _bound_of_speed(*(row[-1] for row in places[1:]))))
    reachable = _backward(s, most, rows, goal_speed**2)
    if not np.all(np.isfinite(reachable[1:-1])):
        raise ProblemError("path: neither velocity nor torque nor acceleration is limited; give limits to find a least duration")
    _require_speeds(start_speed**2, goal_speed**2, reachable[0], most[-1])
    x = _forward(s, reachable, rows, start_speed**2)
    if not np.all(x[1:-1] > 0):
        raise ProblemError("path: the limits leave no speed at all somewhere on it; raise them, or look for another path")
    if x[-1] < (1 - 1e-6) * goal_speed**2:
        raise ProblemError(
            f"path: speed {goal_speed:g} at its end cannot be reached: at most {np.sqrt(x[-1]):.4g} within the limits"
        )
    speed = np.sqrt(x)
    return TimeLaw(s, speed, np.diff(x) / (2.0 * np.diff(s)))


def timed_smoothly(curve: Trajectory, duration: float) -> Trajectory:
    """A motion along a curve with s/length = 10 σ³ − 15 σ⁴ + 6 σ⁵, σ = t/duration [s]: no limits are looked at."""
    t = np.linspace(0.0, 1.0, 4 * len(curve.breaks) + 1)
    s = curve.duration * np.array([t**3 * (10 - 15 * t + 6 * t**2), 30 * (t * (1 - t)) ** 2, 60 * t * (1 - t) * (1 - 2 * t)])
    states = _states(curve, s[0], s[1] / duration, s[2] / duration**2)
    return _quintics(duration * t, [x[:-1] for x in states], [x[1:] for x in states])


def motion(curve: Trajectory, law: TimeLaw) -> PolynomialTrajectory:
    """q(s(t)) as quintics between the grid's places, with the positions, velocities and accelerations at both ends of each."""
    left = _states(curve, law.s[:-1], law.speed[:-1], law.pull)
    right = _states(curve, law.s[1:], law.speed[1:], law.pull)
    return _quintics(law.times, left, right)


def _most(first: np.ndarray, held: np.ndarray, robot: RobotModel, limits: Limits) -> np.ndarray:
    """The largest x at every place that velocity limits and viscous friction allow, shape (N + 1,)."""
    left = limits.torque - np.abs(held) - robot.dynamics.coulomb_friction
    with np.errstate(divide="ignore", invalid="ignore"):
        velocity = np.fmin(limits.velocity, 0.5 * left / robot.dynamics.viscous_friction)
        return np.min((velocity / np.abs(first)) ** 2, axis=1)


def _limit_rows(
    curve: Trajectory, s: np.ndarray, held: np.ndarray, robot: RobotModel, limits: Limits, most: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The limits at every place as α u + β x ≤ γ; three arrays of shape (N + 1, R)."""
    q, first, second = curve(s), curve(s, 1), curve(s, 2)
    rigid = lambda v, a: robot.torque(q, v, a) - robot.dynamics.friction(v)
    a, b = rigid(np.zeros_like(q), first) - held, rigid(first, second) - held
    rub = robot.dynamics.friction(first * np.sqrt(np.where(np.isfinite(most), most, 0.0))[:, None])
    up, down = limits.torque - held - np.maximum(rub, 0.0), limits.torque + held + np.minimum(rub, 0.0)
    most_pull = np.broadcast_to(limits.acceleration, q.shape)
    sides = [(a, b, up), (-a, -b, down), (first, second, most_pull), (-first, -second, most_pull)]
    alpha, beta, gamma = (np.concatenate([side[k] for side in sides], axis=1) for k in range(3))
    use = np.any(np.isfinite(gamma), axis=0)
    return alpha[:, use], beta[:, use], gamma[:, use]


def _require_held(room: np.ndarray, held: np.ndarray, robot: RobotModel, limits: Limits) -> None:
    if np.all(room > 0):
        return
    k, joint = np.unravel_index(np.argmin(room), room.shape)
    raise ProblemError(
        f"path: joint '{robot.joint_names[joint]}' needs {abs(held[k, joint]):.4g} N·m to be held and moved on the way, "
        f"its torque limit is {limits.torque[joint]:.4g}; raise it, or look for another path"
    )


def _require_speeds(first: float, last: float, most_first: float, most_last: float) -> None:
    for name, x, most in (("start", first, most_first), ("goal", last, most_last)):
        if x > most * (1 + 1e-9):
            raise ProblemError(f"path: {name} speed {np.sqrt(x):.4g} is more than the limits allow there, {np.sqrt(most):.4g}")


def _interval_rows(s: np.ndarray, alpha: np.ndarray, beta: np.ndarray, gamma: np.ndarray) -> tuple[np.ndarray, ...]:
    """The limits at both ends of every interval, in u and the x of its near end: at the far end that is x + 2 Δs u."""
    far = alpha[1:] + 2 * np.diff(s)[:, None] * beta[1:]
    return tuple(np.concatenate(both, axis=1) for both in ((alpha[:-1], far), (beta[:-1], beta[1:]), (gamma[:-1], gamma[1:])))


def _backward(s: np.ndarray, most: np.ndarray, rows: tuple[np.ndarray, ...], last: float) -> np.ndarray:
    """The largest x at every place from which the end can be reached with x = ``last``, shape (N + 1,).

    Of the limits α u + β x ≤ γ, every one with α > 0 and every one with α < 0 together bound x, whatever u is.
    """
    best = np.append(most[:-1], last)
    for i, (alpha, beta, gamma) in reversed(list(enumerate(zip(*rows, strict=True)))):
        # The limit that the place ahead sets, x + 2 Δs u ≤ best, with all that ask for a least u.
        step, down = 2.0 * (s[i + 1] - s[i]), alpha < 0
        weight = step * beta[down] - alpha[down]
        room = step * gamma[down] - alpha[down] * best[i + 1]
        binding = weight > 0
        best[i] = max(0.0, np.min(room[binding] / weight[binding], initial=best[i]))
    return best


def _bound_of_pairs(alpha: np.ndarray, beta: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    """The largest x of every interval for which there is a u, shape (N,)."""
    bound = np.full(len(alpha), np.inf)
    low, high = np.minimum(alpha, 0.0), np.maximum(alpha, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        for k in range(alpha.shape[1]):
            # Limit k as the one with α < 0; α = 0 needs no other and is counted with each of weight one.
            other = np.where(alpha[:, k, None] < 0, high, 1.0 * (alpha[:, k, None] == 0))
            weight = beta[:, k, None] * other - low[:, k, None] * beta * (high > 0)
            room = gamma[:, k, None] * other - low[:, k, None] * gamma * (high > 0)
            bound = np.minimum(bound, np.min(np.where((weight > 0) & (other > 0), room / weight, np.inf), axis=1))
    return bound


def _bound_of_speed(beta: np.ndarray, gamma: np.ndarray) -> float:
    """The largest x that β x ≤ γ allows with u = 0."""
    binding = beta > 0
    return float(np.min(gamma[binding] / beta[binding], initial=np.inf))


def _forward(s: np.ndarray, reachable: np.ndarray, rows: tuple[np.ndarray, ...], first: float) -> np.ndarray:
    """x at every place, shape (N + 1,), with the largest u everywhere."""
    x = np.full(len(s), first)
    for i, (alpha, beta, gamma) in enumerate(zip(*rows, strict=True)):
        step, up = 2.0 * (s[i + 1] - s[i]), alpha > 0
        u = np.min((gamma[up] - beta[up] * x[i]) / alpha[up], initial=(reachable[i + 1] - x[i]) / step)
        x[i + 1] = np.clip(x[i] + step * u, 0.0, reachable[i + 1])
    return x


def _states(curve: Trajectory, s: np.ndarray, speed: np.ndarray, pull: np.ndarray) -> list[np.ndarray]:
    first, second = curve(s, 1), curve(s, 2)
    return [curve(s), first * speed[:, None], first * pull[:, None] + second * speed[:, None] ** 2]


def _quintics(times: np.ndarray, left: list[np.ndarray], right: list[np.ndarray]) -> PolynomialTrajectory:
    """Pieces with given states (q, q̇, q̈), each (N, nv), at their two ends."""
    h = np.diff(times)[:, None]
    q, v, a = left
    c2 = 0.5 * a
    # What is left for the powers three to five to do at the far end, in units of the piece's time.
    p, dv, da = right[0] - (q + v * h + c2 * h**2), (right[1] - v - a * h) * h, (right[2] - a) * h**2
    c3, c4, c5 = 10 * p - 4 * dv + 0.5 * da, -15 * p + 7 * dv - da, 6 * p - 3 * dv + 0.5 * da
    return PolynomialTrajectory(times, np.stack([q, v, c2, c3 / h**3, c4 / h**4, c5 / h**5], axis=1))
