"""Is a plan what it claims to be? Everything recomputed, compared, and judged against named thresholds.

- the dense check of every limit and condition (`verification`);
- MuJoCo's inverse dynamics along the motion against the planned torque;
- ordinary motions of the same duration: saving = 1 − J / J_baseline, and the same for the joules. A repulsive potential is left
  out of both J: it is no effort, and a baseline through an obstacle has any amount of it;
- where there is a replay: tracking of joints and tool, energy gap, limits met by the simulated motion, and contacts, where
  they were looked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from energyopt.arguments import check_log, check_plan
from energyopt.baselines import BASELINES, baseline
from energyopt.energy import EnergyAccount, electrical_energy, energy_account
from energyopt.metrics import Metrics, metrics, metrics_of_log
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.plans import Plan, Violations
from energyopt.problem import Problem
from energyopt.readable import Readable
from energyopt.robots.model import RobotModel
from energyopt.verification import cost, describe, excessive, is_valid, limits_hold, verify

if TYPE_CHECKING:
    from energyopt.simulation.contacts import Contact
    from energyopt.simulation.log import ReplayLog

THRESHOLDS = {
    "conditions broken": (0.0, ""),
    "inverse dynamics, MuJoCo": (1e-6, "relative"),
    "loss to a valid baseline": (0.1, "%"),
    "joint tracking, largest": (5e-3, "rad"),
    "tool tracking, largest": (5e-3, "m"),
    "energy gap, replay": (1.0, "%"),
    "replay beyond limits": (1.0, "% of limit"),
    "replay with contact": (0.0, "steps"),
}
"""Largest value that passes, and its unit; those of the replay leave room for its time step, not for a wrong model."""


@dataclass(frozen=True)
class Check:
    """One verdict: passed if ``value`` ≤ ``threshold``."""

    name: str
    value: float
    threshold: float
    unit: str

    @property
    def passed(self) -> bool:
        return bool(self.value <= self.threshold)


@dataclass(frozen=True, eq=False, repr=False)
class BaselineComparison(Readable):
    """An ordinary motion of the same duration beside the plan.

    Attributes:
        objective: its J; cost_terms: by term. metrics: of the motion.
        saving_percent: 100 (1 − J_plan / J), both without the potential; energy_saving_percent: the same for Σ∫|τq̇|dt; None
            where it costs nothing. electrical_saving_percent: the same for the electrical input.
        account: where its joules go; None where the robot's drives are unknown.
        within_limits: whether it holds every limit and keeps clear of everything. valid: whether it meets every condition of
            the problem besides.
        violations: of its own dense check.
    """

    objective: float
    cost_terms: dict[str, float]
    metrics: Metrics
    saving_percent: float | None
    energy_saving_percent: float | None
    within_limits: bool
    valid: bool
    violations: Violations
    account: EnergyAccount | None = None
    electrical_saving_percent: float | None = None

    def in_brief(self) -> str:
        return f"J {self.objective:.6g}, {self.metrics.mechanical_abs_J:.4g} J, {'valid' if self.valid else 'NOT valid'}"


@dataclass(frozen=True)
class Tracking:
    """Replayed against planned motion: joints [rad] (RMS of one joint, and largest), tool position [m] and turn [rad]."""

    joint_rms: float
    joint_max: float
    tool_rms: float
    tool_max: float
    tool_turn_max: float


@dataclass(frozen=True, eq=False, repr=False)
class ValidationReport(Readable):
    """What `validate` found; ``str()`` is a short table.

    Attributes:
        objective, cost_terms: J of the plan, recomputed. violations: of the dense check.
        plan_metrics, replay_metrics: numbers of both motions; the second None without a replay.
        account: where the plan's joules go. replay_electrical_J: input of the replayed arm; None without replay or drives.
        inverse_dynamics_error: largest relative torque difference to MuJoCo.
        baselines: by name. tracking: None without a replay.
        energy_gap_percent: 100 (E_replay − E_plan) / E_plan for Σ∫|τq̇|dt; None without a replay.
        saturated_steps: replay steps with a motor at its torque limit; None without a replay.
        touches: contacts in the replay; None where they were not looked for.
        checks: the verdicts.
    """

    objective: float
    cost_terms: dict[str, float]
    violations: Violations
    plan_metrics: Metrics
    replay_metrics: Metrics | None
    inverse_dynamics_error: float
    baselines: dict[str, BaselineComparison]
    tracking: Tracking | None
    energy_gap_percent: float | None
    saturated_steps: int | None
    touches: tuple[Contact, ...] | None
    checks: tuple[Check, ...]
    account: EnergyAccount
    replay_electrical_J: float | None = None

    @property
    def passed(self) -> bool:
        return all(check.passed for check in self.checks)

    def in_brief(self) -> str:
        return verdict(self)

    def as_dict(self) -> dict[str, Any]:
        """Plain finite numbers, under the names of the summary file."""
        from energyopt.validation_text import report_dict

        return report_dict(self)

    def __str__(self) -> str:
        from energyopt.validation_text import report_table

        return report_table(self)


def validate(plan: Plan, log: ReplayLog | None = None) -> ValidationReport:
    """Check a plan, and its replay where there is one.

    Args:
        plan: the plan.
        log: from `replay`.

    Returns:
        ValidationReport: ``passed``, and ``str(report)`` for the table.

    Raises:
        InputError: no plan, or a log of another arm.
    """
    check_plan("validate", plan)
    check_log(plan, log)
    return validate_motion(plan.problem, plan.trajectory, log)


def validate_motion(
    problem: Problem, trajectory: Trajectory, log: ReplayLog | None = None, claims_least: bool = True
) -> ValidationReport:
    """`validate` for any motion that claims to solve a problem, at least cost or not."""
    from energyopt.simulation.inverse import check_inverse_dynamics

    violations, terms = verify(problem, trajectory), cost(problem, trajectory)
    ours, objective = metrics(problem, trajectory), sum(terms.values())
    inverse_error = check_inverse_dynamics(problem.robot, trajectory)
    account = energy_account(trajectory, problem.robot)
    compared = compare_baselines(problem, trajectory, terms, ours, account.electrical_J)
    losses = [-saving for b in compared.values() if b.valid and (saving := _saving(objective, b.objective)) is not None]
    values = {
        "conditions broken": float(len(excessive(violations))),
        "inverse dynamics, MuJoCo": inverse_error,
    }
    if claims_least:
        values["loss to a valid baseline"] = max([0.0, *losses])
    tracking = gap = theirs = None
    if log is not None:
        theirs, tracking = metrics_of_log(log), tracking_errors(problem.robot, log)
        gap = 100.0 * (theirs.mechanical_abs_J - ours.mechanical_abs_J) / max(ours.mechanical_abs_J, 1e-3)
        values |= {
            "joint tracking, largest": tracking.joint_max,
            "tool tracking, largest": tracking.tool_max,
            "energy gap, replay": abs(gap),
            "replay beyond limits": _replay_excess(problem, log),
        }
        if log.contacts is not None:
            values["replay with contact"] = float(log.contact_steps)
    return ValidationReport(
        objective=objective,
        cost_terms=terms,
        violations=violations,
        plan_metrics=ours,
        replay_metrics=theirs,
        inverse_dynamics_error=inverse_error,
        baselines=compared,
        tracking=tracking,
        energy_gap_percent=gap,
        saturated_steps=None if log is None else log.saturated_steps,
        touches=None if log is None or log.contacts is None else log.touches,
        checks=tuple(Check(name, value, *THRESHOLDS[name]) for name, value in values.items()),
        account=account,
        replay_electrical_J=None if log is None else _replayed_joules(problem.robot, log),
    )


def compare_baselines(
    problem: Problem, trajectory: Trajectory, our_terms: dict[str, float], ours: Metrics, electrical: float | None = None
) -> dict[str, BaselineComparison]:
    """Every kind of `BASELINES` to the configuration the motion ends in, beside the motion's terms of J, metrics and joules."""
    compared = {}
    for kind in BASELINES:
        motion = baseline(problem, kind, goal=trajectory(trajectory.duration))
        terms, violations, theirs = cost(problem, motion), verify(problem, motion), metrics(problem, motion, n=800)
        account = None if electrical is None else energy_account(motion, problem.robot)
        compared[kind] = BaselineComparison(
            objective=sum(terms.values()),
            cost_terms=terms,
            metrics=theirs,
            saving_percent=_saving(_effort(our_terms), _effort(terms)),
            energy_saving_percent=_saving(ours.mechanical_abs_J, theirs.mechanical_abs_J),
            within_limits=limits_hold(violations) and "clearance" not in excessive(violations),
            valid=is_valid(violations),
            violations=violations,
            account=account,
            electrical_saving_percent=None if account is None else _saving(electrical, account.electrical_J),
        )
    return compared


def tracking_errors(robot: RobotModel, log: ReplayLog, rows: int = 1000) -> Tracking:
    """Joint errors over every step, tool errors over at most ``rows`` of them."""
    picked = np.unique(np.linspace(0, len(log.t) - 1, min(rows, len(log.t))).astype(int))
    apart, turned = np.empty(len(picked)), np.empty(len(picked))
    model, frame = robot.model, robot.frame_id(robot.tool_frame) if robot.tool_frame else robot.model.nframes - 1
    data = model.createData()
    for k, row in enumerate(picked):
        poses = []
        for q in (log.q[row], log.q_ref[row]):
            pin.forwardKinematics(model, data, q)
            poses.append(pin.updateFramePlacement(model, data, frame).copy())
        apart[k] = np.linalg.norm(poses[0].translation - poses[1].translation)
        turned[k] = np.linalg.norm(pin.log3(poses[0].rotation.T @ poses[1].rotation))
    return Tracking(
        joint_rms=log.tracking_rms,
        joint_max=log.tracking_max,
        tool_rms=float(np.sqrt(np.mean(apart**2))),
        tool_max=float(apart.max()),
        tool_turn_max=float(turned.max()),
    )


def verdict(report: ValidationReport) -> str:
    """One sentence: valid, or the first thing that is not."""
    failed = [check for check in report.checks if not check.passed]
    if not failed:
        return f"valid: {describe(report.violations)}"
    first = failed[0]
    if first.name == "conditions broken":
        return f"NOT valid: {describe(report.violations)}"
    if first.name == "replay with contact" and report.touches:
        deepest = max(report.touches, key=lambda touch: touch.depth)
        return f"NOT valid: the replay touches something: {deepest}"
    return f"NOT valid: {first.name} is {first.value:.3g} {first.unit}, expected at most {first.threshold:g}"


def _effort(terms: dict[str, float]) -> float:
    """J without the potential."""
    return sum(value for name, value in terms.items() if name != "potential")


def _saving(ours: float, theirs: float) -> float | None:
    return 100.0 * (1.0 - ours / theirs) if theirs > 1e-12 else None


def _replayed_joules(robot: RobotModel, log: ReplayLog) -> float | None:
    """Electrical input of a replay; None where the drives are unknown."""
    return None if robot.actuators is None else electrical_energy(robot.actuators, log.t, log.tau, log.v)


def _replay_excess(problem: Problem, log: ReplayLog) -> float:
    """Largest excess of the simulated positions (in % of the range) and velocities (in % of the limit), 0 at least."""
    limits = problem.limits
    with np.errstate(invalid="ignore"):
        width = np.where(np.isfinite(limits.upper - limits.lower), limits.upper - limits.lower, 1.0)
        beyond = np.maximum(log.q - limits.upper, limits.lower - log.q) / width
        fast = np.abs(log.v) / limits.velocity - 1.0
    return 100.0 * max(0.0, float(beyond.max()), float(fast.max()))
