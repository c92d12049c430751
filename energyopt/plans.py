"""Plan: a motion, how it was found, and what an independent check says of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np

from energyopt.optima import Optimum
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.problem import Problem
from energyopt.readable import Readable

if TYPE_CHECKING:
    from pathlib import Path


class Status(str, Enum):
    """How planning ended. Only `SOLVED` is a success; every other value says why there is none."""

    SOLVED = "SOLVED"
    """The solver converged and the independent dense check holds."""
    INFEASIBLE = "INFEASIBLE"
    """The solver converged to a point of local infeasibility, or restoration failed."""
    LIMITS_VIOLATED = "LIMITS_VIOLATED"
    """The solver reported success, but the dense check found a limit broken."""
    ITERATION_LIMIT = "ITERATION_LIMIT"
    """The solver ran out of iterations."""
    TIME_LIMIT = "TIME_LIMIT"
    """The time limit passed."""
    INTERRUPTED = "INTERRUPTED"
    """Ctrl-C; the best motion so far is kept."""
    NUMERICAL_ERROR = "NUMERICAL_ERROR"
    """The solver met NaN, a failed step computation, or an internal error."""


@dataclass(frozen=True)
class Violations:
    """How far the dense check found each limit exceeded (0 where it holds), and the margins left.

    Attributes:
        amount: by limit name, worst excess in that limit's unit; `torque_percent` in % of the torque limit.
        margin: by limit name, the smallest distance to the limit in % of the limit (negative: exceeded).
        worst: by limit name, (joint name, time [s]) where the margin is smallest; for ``clearance`` the closest pair.
        distance: least distance of that pair [m], over the whole motion; None where nothing is kept apart.
    """

    amount: dict[str, float]
    margin: dict[str, float] = field(default_factory=dict)
    worst: dict[str, tuple[str, float]] = field(default_factory=dict)
    distance: float | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Readable):
    """The result of `plan`; ``str()`` tells it in a few lines.

    Attributes:
        problem: what was asked.
        status: how it ended; `message` says it in a sentence.
        trajectory: the motion; callable (t, order) → (N, nv).
        objective: J recomputed by numeric Pinocchio on a fine Gauss grid.
        cost_terms: J by term, e.g. {"torque_squared": …, "velocity_squared": …}, weighted as in J.
        max_violation: by limit, worst excess in its unit: position, velocity, acceleration, jerk,
            torque_percent, torque_rate (only limits that are set), goal where the goal is Cartesian, clearance where
            there is something to stay clear of.
        violations: the same with margins and places.
        discretization_error: estimated relative gap of J to the continuous optimum near this motion; None where not estimated.
        iterations: solver iterations, all refinements together.
        time_s: compile, guess (paths around obstacles included), build, solve, verify [s].
        seed: seed of the guess that led here.
        options: every option used (parameterisation and solver).
        notes: what the user should know, one sentence each.
        optima: the distinct local optima that guesses led to, before refinement, best first.
    """

    problem: Problem
    status: Status
    message: str
    trajectory: Trajectory
    objective: float
    cost_terms: dict[str, float]
    violations: Violations
    discretization_error: float | None
    iterations: int
    time_s: dict[str, float]
    seed: int
    options: dict[str, Any]
    notes: tuple[str, ...] = ()
    optima: tuple[Optimum, ...] = ()

    def in_brief(self) -> str:
        return f"{self.status.value}, {self.problem.robot.name}, {self.duration:.6g} s, J {self.objective:.6g}"

    def __str__(self) -> str:
        from energyopt.plan_text import plan_table

        return plan_table(self)

    @property
    def solved(self) -> bool:
        return self.status is Status.SOLVED

    @property
    def max_violation(self) -> dict[str, float]:
        return self.violations.amount

    @property
    def duration(self) -> float:
        return self.trajectory.duration

    @property
    def build_s(self) -> float:
        return self.time_s["build"]

    @property
    def compile_s(self) -> float:
        return self.time_s["compile"]

    @property
    def solve_s(self) -> float:
        return self.time_s["solve"]

    def torque(self, t: np.ndarray | float) -> np.ndarray:
        """Joint torques [N·m] along the motion by numeric Pinocchio, shape (N, nv) or (nv,)."""
        trajectory = self.trajectory
        return self.problem.robot.torque(trajectory(t), trajectory(t, 1), trajectory(t, 2))

    def save(self, path: str | Path) -> None:
        """Write the plan to an .npz file that `energyopt.load_plan` reads back bit for bit."""
        from energyopt.io import save_plan

        save_plan(self, path)
