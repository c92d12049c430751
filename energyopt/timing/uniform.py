"""A fixed motion made slower or faster as a whole: its cost in closed form, and the durations its limits allow.

With s = t/T and q(t) = p(s), 0 ≤ s ≤ 1, the joint torques are

    τ = a(s)/T² + b(s)/T + g(s),     a = M(p) p'' + C(p, p') p' + I_a p'',   b = d p',   g gravity,   d viscous friction,

so that, with w the weights of torques, λ those of velocities and ⟨x, y⟩ = ∫₀¹ Σ x y ds,

    J(T) = ∫₀ᵀ (Σ w τ² + Σ λ q̇²) dt = A/T³ + B/T² + C/T + D + E T,
    A = ⟨wa, a⟩,   B = 2⟨wa, b⟩,   C = ⟨wb, b⟩ + 2⟨wa, g⟩ + ⟨λp', p'⟩,   D = 2⟨wb, g⟩,   E = ⟨wg, g⟩ + r,

r being what every second costs besides (such as a potential, which only depends on the place). A cheapest duration is an end
of the range or a root of E T⁴ − C T² − 2B T − 3A = −T⁴ J'(T).

Coulomb friction f tanh(q̇/v_s) is no power of T: there J(T) is the same sum with g + f tanh(p'/(v_s T)) in place of g, by
quadrature at every T, and the cheapest duration is found by a bounded search from a grid of durations. (With a sharp sign
function in its place f sign(p') would join g, and the closed form hold; the smoothed one differs where |q̇| is not above v_s.)

A limit of torque is a quadratic inequality in x = 1/T at every s, those of velocity, acceleration and jerk bound T from below.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize_scalar

from energyopt.errors import InputError
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem_values import DURATION_RANGE, non_negative, real
from energyopt.robots.model import Limits, RobotModel
from energyopt.sampling import gauss_grid
from energyopt.timing.slowness import allowed_durations, torque_terms

GAUSS, COULOMB_GAUSS = 8, 40
"""Gauss nodes a span, without and with Coulomb friction."""
GRID = 400
"""Durations among which a cheapest one is looked for where there is Coulomb friction."""


@dataclass(frozen=True, eq=False)
class UniformScaling:
    """A motion of any duration; made by `uniform_scaling`.

    Attributes:
        motion: the motion that is scaled.
        robot: whose torques count.
        velocity_weight, torque_weights: λ and w of J, shape (nv,).
        rate: r, cost a second besides [N²·m²].
    """

    motion: Trajectory
    robot: RobotModel
    velocity_weight: np.ndarray
    torque_weights: np.ndarray
    rate: float = field(default=0.0)

    @cached_property
    def coefficients(self) -> np.ndarray:
        """(A, B, C, D, E) of the module's text; all of J where there is no Coulomb friction."""
        s, (a, b, g), p = self._nodes
        inner = lambda x, y, weights: float(s @ (x * y) @ weights)
        w, speed = self.torque_weights, inner(p, p, self.velocity_weight)
        return np.array([
            inner(a, a, w), 2 * inner(a, b, w), inner(b, b, w) + 2 * inner(a, g, w) + speed,
            2 * inner(b, g, w), inner(g, g, w) + self.rate,
        ])  # fmt: skip

    @property
    def closed_form(self) -> bool:
        """Whether the coefficients say all: without Coulomb friction."""
        return not np.any(self.robot.dynamics.coulomb_friction)

    def objective(self, T: float) -> float:
        """J of the motion made to take ``T`` [s]."""
        return self._cost(_seconds("duration", T))[0]

    def slope(self, T: float) -> float:
        """dJ/dT [N²·m²]."""
        return self._cost(_seconds("duration", T))[1]

    def trajectory(self, T: float) -> Trajectory:
        """The motion made to take ``T`` [s]."""
        return self.motion.stretched(_seconds("duration", T))

    def least_duration(self, limits: Limits | None = None) -> float:
        """The shortest T [s] at which every limit of velocity, acceleration, jerk and torque holds; see `allowed`.

        Raises:
            InputError: no duration holds them.
        """
        return float(self.allowed(limits)[0, 0])

    def allowed(self, limits: Limits | None = None) -> np.ndarray:
        """All durations [s] at which the limits hold, as intervals: rows (shortest, longest), shape (K, 2), rising.

        Args:
            limits: in place of the robot's own; those of position and torque rate are not looked at.

        Raises:
            InputError: no duration holds them; names the joint that cannot be held.
        """
        return allowed_durations(self.motion, self.robot, limits or self.robot.limits)

    def cheapest(self, bounds: tuple[float, float] | None = None, limits: Limits | None = None) -> float:
        """The duration [s] of least J.

        Args:
            bounds: (shortest, longest) [s]; by default what the limits allow.
            limits: must hold too; in place of the robot's own. With ``bounds`` and without ``limits`` none are looked at.

        Raises:
            InputError: the bounds make no sense, no duration in them holds the limits, or J falls however slow the motion is.
        """
        low, high = _bounds(bounds)
        allowed = self.allowed(limits) if bounds is None or limits is not None else np.array([[low, high]])
        ranges = np.clip(allowed, low, high)
        ranges = ranges[(ranges[:, 0] < ranges[:, 1]) | (allowed[:, 0] == ranges[:, 0])]
        if not len(ranges):
            raise InputError(f"bounds ({low:g}, {high:g}) s: the limits hold from {allowed[0, 0]:.4g} s on; allow more time")
        found = min((self._cheapest(*r) for r in ranges), key=self.objective)
        if found >= DURATION_RANGE[1] and (bounds is None or high > found):
            raise InputError(
                "cheapest: J falls with every second more (nothing has to be held up); give bounds=(shortest, longest)"
            )
        return found

    def _cheapest(self, low: float, high: float) -> float:
        if not self.closed_form:
            return self._searched(low, high)
        a, b, c, _, e = self.coefficients
        # Roots in T/scale: the coefficients of a fast motion and of a slow one differ by orders of magnitude.
        scale = np.sqrt(low * high)
        roots = np.roots([e * scale**4, 0.0, -c * scale**2, -2 * b * scale, -3 * a]) * scale
        inside = [x.real for x in roots if abs(x.imag) <= 1e-6 * abs(x) and low < x.real < high]
        return float(min([low, high, *inside], key=self.objective))

    def _searched(self, low: float, high: float) -> float:
        grid = np.geomspace(low, high, GRID)
        k = int(np.argmin([self.objective(T) for T in grid]))
        around = grid[max(k - 1, 0)], grid[min(k + 1, GRID - 1)]
        found = minimize_scalar(self.objective, bounds=around, method="bounded", options={"xatol": 1e-9 * grid[k]})
        return float(min([low, high, found.x], key=self.objective))

    def _cost(self, T: float) -> tuple[float, float]:
        """J and dJ/dT."""
        if self.closed_form:
            powers = T ** np.array([-3.0, -2.0, -1.0, 0.0, 1.0])
            factors = np.array([-3.0, -2.0, -1.0, 0.0, 1.0])
            return float(self.coefficients @ powers), float(self.coefficients * factors @ powers) / T
        s, (a, b, g), p = self._nodes
        f, smoothing = self.robot.dynamics.coulomb_friction, self.robot.dynamics.coulomb_velocity
        sign = np.tanh(p / (smoothing * T))
        tau = a / T**2 + b / T + g + f * sign
        change = -2 * a / T**3 - b / T**2 - f * (1 - sign**2) * p / (smoothing * T**2)
        rate = tau**2 @ self.torque_weights + (p / T) ** 2 @ self.velocity_weight + self.rate
        drift = 2 * (tau * change) @ self.torque_weights - 2 * p**2 @ self.velocity_weight / T**3
        return T * float(s @ rate), float(s @ (rate + T * drift))

    @cached_property
    def _nodes(self) -> tuple[np.ndarray, tuple[np.ndarray, ...], np.ndarray]:
        """Weights of the quadrature in s (N,), the terms a, b, g and the rate p', each (N, nv)."""
        t, weights = gauss_grid(self.motion, GAUSS if self.closed_form else COULOMB_GAUSS)
        T = self.motion.duration
        states = [self.motion(t, order) for order in range(3)]
        return weights / T, torque_terms(T, self.robot, *states), T * states[1]


def uniform_scaling(
    motion: Trajectory, robot: RobotModel, velocity_weight: ArrayLike = 0.1, torque_weights: ArrayLike = 1.0, rate: float = 0.0
) -> UniformScaling:
    """What a motion costs at every duration, in closed form; which is the cheapest, which the shortest.

    Args:
        motion: any motion, such as ``plan.trajectory`` or `baseline`'s.
        robot: the arm.
        velocity_weight: λ of J, one number or one a joint. torque_weights: w.
        rate: cost of every second besides [N²·m²].

    Returns:
        UniformScaling: `objective` of a duration, the `cheapest` and the `least_duration`.

    Raises:
        InputError: the motion is none, or of another arm; a weight makes no sense.
    """
    if not isinstance(motion, Trajectory) or not isinstance(robot, RobotModel) or motion.nv != robot.nv:
        raise InputError("uniform_scaling: expected a trajectory, such as plan.trajectory, and the robot whose joints it moves")
    weights = (non_negative(key, x, robot.joint_names) for key, x in
               (("velocity_weight", velocity_weight), ("torque_weights", torque_weights)))  # fmt: skip
    return UniformScaling(motion, robot, *weights, real("rate", rate, lambda r: 0 <= r < np.inf, "a number ≥ 0"))


def _seconds(key: str, T: float) -> float:
    low, high = DURATION_RANGE
    return real(key, T, lambda t: low <= t <= high, f"one number of seconds, {low:g} to {high:g}")


def _bounds(bounds: tuple[float, float] | None) -> tuple[float, float]:
    if bounds is None:
        return DURATION_RANGE
    expected = "a pair (shortest, longest) of seconds, such as (0.5, 4.0)"
    try:
        low, high = bounds
    except (TypeError, ValueError):
        raise InputError(f"bounds is {bounds!r:.80}: expected {expected}") from None
    low, high = _seconds("bounds[0]", low), _seconds("bounds[1]", high)
    if low > high:
        raise InputError(f"bounds ({low:g}, {high:g}) s: the first is above the second; expected {expected}")
    return low, high
