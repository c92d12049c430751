"""What the motors of a replayed arm do: planned torque, corrected for where the arm is, and feedback.

    τ = τ_plan(t) + ρ(q, q̇, q̈_plan + k_p (q_plan − q) + k_d (q̇_plan − q̇)) − ρ(q_plan, q̇_plan, q̈_plan),

cut to the torque limits; ρ is the rigid-body torque by the planned robot's model: the controller knows no other, whatever arm
is simulated (computed-torque control: Luh, Walker and Paul, IEEE Trans. Automatic Control 25, 1980). With M the mass matrix in
ρ, the feedback is M times the correction, and the error of an arm that is the planned one obeys ë + k_d ė + k_p e ≈ 0 in every
joint. Nothing of it can go: constant gains that suit the shoulder make a light wrist diverge, and at ρ(q_plan, …) alone gravity
pulls a link that stands upright away from its plan with the stiffness −M⁻¹ ∂g/∂q: g/l for a pendulum, 2500 1/s² for a hand
whose mass is 4 mm from the axis of its wrist, more than any usual gain. The difference vanishes on the planned motion.

A motor holds its torque for a step, so the feed-forward is the planned torque at the step's start with the step's mean
acceleration (q̇_plan(t + h) − q̇_plan(t)) / h. Friction is fed forward at the planned velocity only: at the actual one it would
take away the damping that friction is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem_values import real
from energyopt.robots.model import RobotModel


@dataclass(frozen=True)
class Feedback:
    """Gains of the error dynamics: ``stiffness`` k_p [1/s²], ``damping`` k_d [1/s]; 400 and 40 are critically damped.

    Raises:
        InputError: a gain that is no finite number ≥ 0.
    """

    stiffness: float = 400.0
    damping: float = 40.0

    def __post_init__(self):
        for key in ("stiffness", "damping"):
            gain = real(key, getattr(self, key), lambda k: 0.0 <= k < np.inf, "one finite number ≥ 0")
            object.__setattr__(self, key, gain)


@dataclass(frozen=True, eq=False)
class ComputedTorque:
    """The control law at a row of instants.

    Attributes:
        robot: the arm planned for.
        gains: of the feedback.
        limit: largest |τ| [N·m], shape (nv,).
        q, v, a: planned position [rad], velocity [rad/s] and mean acceleration of the step [rad/s²], shape (N, nv).
        forward: planned torque at that acceleration [N·m], shape (N, nv).
        rigid: the part of it that is no friction, shape (N, nv).
    """

    robot: RobotModel
    gains: Feedback
    limit: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    forward: np.ndarray
    rigid: np.ndarray

    @classmethod
    def along(
        cls, robot: RobotModel, trajectory: Trajectory, times: np.ndarray, gains: Feedback, limit: np.ndarray
    ) -> ComputedTorque:
        """The law that follows a motion at evenly spaced ``times`` [s], shape (N,)."""
        q, v, a = (trajectory(times, order) for order in range(3))
        mean = np.vstack([np.diff(v, axis=0) / (times[1] - times[0]), a[-1:]])
        forward = robot.torque(q, v, mean)
        return cls(robot, gains, limit, q, v, mean, forward, forward - robot.dynamics.friction(v))

    def acceleration(self, k: int, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The correction k_p (q_plan − q) + k_d (q̇_plan − q̇) [rad/s²] at the k-th instant, shape (nv,)."""
        return self.gains.stiffness * (self.q[k] - q) + self.gains.damping * (self.v[k] - v)

    def torque(self, k: int, q: np.ndarray, v: np.ndarray, correction: np.ndarray) -> np.ndarray:
        """τ [N·m] at the k-th instant in the state ``q``, ``v``, with the correction of `acceleration`; shape (nv,)."""
        change = pin.rnea(self.robot.model, self._data, q, v, self.a[k] + correction) - self.rigid[k]
        return np.minimum(np.maximum(self.forward[k] + change, -self.limit), self.limit)

    @cached_property
    def _data(self) -> pin.Data:
        return self.robot.model.createData()


@dataclass(frozen=True)
class Friction:
    """Friction of the simulated arm, d q̇ + f tanh(q̇/v_s), as MuJoCo is told of it.

    MuJoCo's Euler integrator treats damping c q̇ implicitly; with c = d + f (1 − tanh²(q̇/v_s)) / v_s, the slope at the present
    velocity, given to it as damping and the rest as an applied torque, the torque is exact and a steep Coulomb friction
    cannot make the step unstable.
    """

    viscous: np.ndarray
    coulomb: np.ndarray
    smoothing: float

    @classmethod
    def of(cls, plant: RobotModel) -> Friction:
        dynamics = plant.dynamics
        return cls(dynamics.viscous_friction, dynamics.coulomb_friction, dynamics.coulomb_velocity)

    def torque(self, v: np.ndarray) -> np.ndarray:
        return self.viscous * v + self.coulomb * np.tanh(v / self.smoothing)

    @property
    def present(self) -> bool:
        """Whether there is any."""
        return bool(self.viscous.any() or self.coulomb.any())

    def slope(self, v: np.ndarray) -> np.ndarray:
        """∂torque/∂v."""
        return self.viscous + self.coulomb * (1.0 - np.tanh(v / self.smoothing) ** 2) / self.smoothing
