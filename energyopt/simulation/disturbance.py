"""What stands between a controller and its arm: delay and sensor noise.

measured  q + n_q, q̇ + n_v   with n_q, n_v independent normal numbers at every step and joint
applied   τ(t) = u(t − d h)   where u(t) is what the controller computes from the measurement at t; before its first
                              command arrives, the motors hold that of t = 0
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from energyopt.problem_values import real, whole

MOST_DELAY = 10_000
"""Steps: ten seconds of the largest step."""


@dataclass(frozen=True)
class Disturbance:
    """Delay and noise of a control loop; as it is made by default there is none.

    Attributes:
        delay: physics steps from a measurement to the torque that answers it.
        position_noise: standard deviation of measured positions [rad or m]; velocity_noise: of velocities [rad/s or m/s].
        seed: of the noise.

    Raises:
        InputError: a number that makes no sense.
    """

    delay: int = 0
    position_noise: float = 0.0
    velocity_noise: float = 0.0
    seed: int = 0

    def __post_init__(self):
        whole("delay", self.delay, 0, MOST_DELAY, f"a whole number of physics steps, 0 to {MOST_DELAY}")
        whole("seed", self.seed, 0, 2**63 - 1, "a whole number, 0 or more")
        for key in ("position_noise", "velocity_noise"):
            value = real(key, getattr(self, key), lambda x: 0.0 <= x < 1e3, "a standard deviation, 0 or more, in rad (rad/s)")
            object.__setattr__(self, key, value)

    @property
    def noisy(self) -> bool:
        return self.position_noise > 0 or self.velocity_noise > 0

    def noise(self, steps: int, nv: int) -> tuple[np.ndarray, np.ndarray]:
        """n_q [rad] and n_v [rad/s] of every step, each of shape (steps, nv)."""
        draw = np.random.default_rng(self.seed).standard_normal((2, steps, nv))
        return self.position_noise * draw[0], self.velocity_noise * draw[1]
