"""Numbers that describe a motion, planned or replayed.

    mechanical_abs_J       Σ ∫ |τ q̇| dt             every joint pays for driving and for braking (cuRobo's motion energy)
    mechanical_positive_J  Σ ∫ max(τ q̇, 0) dt       braking is free
    torque_squared         ∫ Σ τ² dt   [N²·m²·s]    ∝ copper losses of the motors
    velocity_squared       ∫ Σ q̇² dt   [rad²/s]
    log_dimensionless_jerk −ln( T³ / v_peak² · ∫ ‖d³q/dt³‖² dt ),  v = ‖q̇‖

The last is the smoothness measure of Hogan and Sternad (J. Motor Behavior 41, 2009), with the peak speed and the
logarithm of Balasubramanian et al. (IEEE Trans. Biomedical Engineering 59, 2012), for the motion in joint space. It is
independent of duration and amplitude; larger (nearer to zero) is smoother; the minimum-jerk motion between two rests has
−ln(720 · 64/225) = −5.32. Only what lies within [0, T] counts: a cubic, which leaves rest with a step of acceleration, has
−ln(144 · 4/9) = −4.16.

Powers have kinks where they change sign, so energies are trapezoidal sums on a grid that resolves each smooth span from
inside; their error is estimated from the grid of half as many points and stated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.readable import Readable
from energyopt.robots.model import RobotModel
from energyopt.sampling import gauss_grid, sample_spans

if TYPE_CHECKING:
    from energyopt.simulation.log import ReplayLog

ACCELERATION_JUMP = 1e-6
"""Jump of an acceleration, relative to its peak, from which the jerk counts as infinite."""


@dataclass(frozen=True, eq=False)
class Spread:
    """Peak and root mean square of a quantity, one value a joint, shape (nv,)."""

    peak: np.ndarray
    rms: np.ndarray

    @property
    def largest(self) -> float:
        """Peak over all joints."""
        return float(self.peak.max())

    @property
    def rms_norm(self) -> float:
        """Root mean square of the vector's length."""
        return float(np.linalg.norm(self.rms))


@dataclass(frozen=True, eq=False, repr=False)
class MetricSeries(Readable):
    """A motion over time, N rows; at a break of the motion a time may come twice, with the values on both sides.

    Attributes:
        t: times [s]. power: Σ|τ q̇| [W]. cumulative_energy: its integral so far [J].
        acceleration: ‖q̈‖ [rad/s²]. velocity: ‖q̇‖ [rad/s]; each of shape (N,).
        joint_power: τ q̇ with its sign [W], shape (N, nv).
    """

    t: np.ndarray
    power: np.ndarray
    cumulative_energy: np.ndarray
    acceleration: np.ndarray
    velocity: np.ndarray
    joint_power: np.ndarray

    def in_brief(self) -> str:
        return f"{self.t.size} times, {self.t[0]:g} to {self.t[-1]:.6g} s"


@dataclass(frozen=True, eq=False, repr=False)
class Metrics(Readable):
    """The numbers of the module's text, and spreads.

    Attributes:
        duration_s: T. mechanical_abs_J, mechanical_positive_J, torque_squared, velocity_squared: see the module.
        energy_error_J: estimated error of the two energies.
        joint_energy_J: ∫|τ q̇| dt of every joint, shape (nv,).
        velocity, acceleration, jerk, torque: spreads [rad/s, rad/s², rad/s³, N·m]; jerk is infinite where an acceleration jumps.
        peak_speed: largest ‖q̇‖ [rad/s].
        log_dimensionless_jerk: smoothness; −inf where an acceleration jumps, None for a motion that stands still.
        series: the same over time.
    """

    duration_s: float
    mechanical_abs_J: float
    mechanical_positive_J: float
    energy_error_J: float
    joint_energy_J: np.ndarray
    torque_squared: float
    velocity_squared: float
    velocity: Spread
    acceleration: Spread
    jerk: Spread
    torque: Spread
    peak_speed: float
    log_dimensionless_jerk: float | None
    series: MetricSeries

    def in_brief(self) -> str:
        return f"{self.duration_s:.6g} s, ∫Στ² {self.torque_squared:.6g} N²m²s, Σ∫|τq̇| {self.mechanical_abs_J:.4g} J"

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers for a report or JSON file; a value that is infinite or undefined becomes None."""
        numbers: dict[str, Any] = {
            key: getattr(self, key)
            for key in (
                "duration_s", "mechanical_abs_J", "mechanical_positive_J", "energy_error_J", "torque_squared",
                "velocity_squared", "peak_speed", "log_dimensionless_jerk",
            )
        }  # fmt: skip
        for key in ("velocity", "acceleration", "jerk", "torque"):
            spread = getattr(self, key)
            numbers[f"peak_{key}"], numbers[f"rms_{key}"] = spread.largest, spread.rms_norm
        return {key: _finite(value) for key, value in numbers.items()}


def metrics(robot: RobotModel | Problem, trajectory: Trajectory, n: int = 2000) -> Metrics:
    """The metrics of a planned motion.

    Args:
        robot: whose torques; a problem stands for its robot.
        trajectory: the motion.
        n: number of samples, at least.
    """
    robot = robot.robot if isinstance(robot, Problem) else robot
    spans = len(trajectory.breaks) - 1
    # An even number of intervals a span, so that every second point is a grid of its own.
    samples = sample_spans(trajectory, max(8, 2 * -(-n // (2 * spans))))
    q, v, a, jerk = (samples.derivative(order) for order in range(4))
    tau = robot.torque(*(samples.flat(order) for order in range(3))).reshape(q.shape)
    if _acceleration_jumps(a):
        jerk = np.full_like(jerk, np.inf)
    nodes, weights = gauss_grid(trajectory)
    torques = robot.torque(*(trajectory(nodes, order) for order in range(3)))
    squares = weights @ torques**2, weights @ trajectory(nodes, 1) ** 2
    return _from_samples(samples.t, v, a, jerk, tau, squares)


def metrics_of_log(log: ReplayLog) -> Metrics:
    """The metrics of a replay; its jerk is the difference quotient of the simulated accelerations.

    Step noise makes that jerk larger than the plan's; compare replays with replays.
    """
    jerk = np.gradient(log.a, log.t, axis=0)
    squares = np.trapezoid(log.tau**2, log.t, axis=0), np.trapezoid(log.v**2, log.t, axis=0)
    return _from_samples(log.t[None], log.v[None], log.a[None], jerk[None], log.tau[None], squares)


def _from_samples(
    t: np.ndarray, v: np.ndarray, a: np.ndarray, jerk: np.ndarray, tau: np.ndarray, squares: tuple[np.ndarray, np.ndarray]
) -> Metrics:
    """Metrics from samples of spans: ``t`` (K, S), the others (K, S, nv), ``squares`` ∫τ² and ∫q̇² a joint."""
    flat_t, nv = t.ravel(), v.shape[2]
    flat_v, flat_a, flat_j, flat_tau = (x.reshape(-1, nv) for x in (v, a, jerk, tau))
    power = flat_tau * flat_v
    joint_energy = np.trapezoid(np.abs(power), flat_t, axis=0)
    every_second = np.unique(np.append(np.arange(0, t.shape[1], 2), t.shape[1] - 1))
    coarse = np.trapezoid(np.abs(tau * v)[:, every_second], t[:, every_second, None], axis=1).sum()
    speed, duration = np.linalg.norm(flat_v, axis=1), float(flat_t[-1])
    total = np.abs(power).sum(axis=1)
    steps = np.diff(flat_t)
    return Metrics(
        duration_s=duration,
        mechanical_abs_J=float(joint_energy.sum()),
        mechanical_positive_J=float(np.trapezoid(np.maximum(power, 0.0), flat_t, axis=0).sum()),
        # Halving the step quarters a trapezoidal error: the difference of the two sums is three times what is left.
        energy_error_J=float(abs(joint_energy.sum() - coarse) / 3.0),
        joint_energy_J=joint_energy,
        torque_squared=float(squares[0].sum()),
        velocity_squared=float(squares[1].sum()),
        velocity=_spread(flat_t, flat_v),
        acceleration=_spread(flat_t, flat_a),
        jerk=_spread(flat_t, flat_j),
        torque=_spread(flat_t, flat_tau),
        peak_speed=float(speed.max()),
        log_dimensionless_jerk=_log_dimensionless_jerk(flat_t, flat_j, float(speed.max()), duration),
        series=MetricSeries(
            t=flat_t,
            power=total,
            cumulative_energy=np.append(0.0, np.cumsum(0.5 * (total[1:] + total[:-1]) * steps)),
            acceleration=np.linalg.norm(flat_a, axis=1),
            velocity=speed,
            joint_power=power,
        ),
    )


def _spread(t: np.ndarray, values: np.ndarray) -> Spread:
    with np.errstate(invalid="ignore"):
        mean = np.trapezoid(values**2, t, axis=0) / t[-1]
    return Spread(np.abs(values).max(axis=0), np.sqrt(np.where(np.isnan(mean), np.inf, mean)))


def _log_dimensionless_jerk(t: np.ndarray, jerk: np.ndarray, peak_speed: float, duration: float) -> float | None:
    if peak_speed < 1e-9:
        return None
    if not np.all(np.isfinite(jerk)):
        return -np.inf
    squared = float(np.trapezoid(np.sum(jerk**2, axis=1), t))
    # A motion of constant acceleration has no jerk at all; the smallest number keeps the logarithm finite.
    return float(-np.log(max(duration**3 / peak_speed**2 * squared, np.finfo(float).tiny)))


def _acceleration_jumps(a: np.ndarray) -> bool:
    jump = np.abs(a[1:, 0] - a[:-1, -1])
    return bool(jump.size and jump.max() > ACCELERATION_JUMP * max(np.abs(a).max(), 1e-12))


def _finite(value: float | None) -> float | None:
    return value if value is not None and np.isfinite(value) else None
