"""`robustness`: energy and limits of one motion for every arm between given bounds.

Torque is affine in payload mass m, mass deviation μ and friction deviation φ (C. G. Atkeson, C. H. An, J. M. Hollerbach,
"Estimation of inertial parameters of manipulator loads and links", Int. J. Robotics Research 5, 1986):

    τ(m, μ, φ) = τ₀ + m τ_load + μ τ_bodies + φ τ_friction

Four passes of inverse dynamics give the torques of all cases. |τ|, τ², |τ q̇| and max(τ q̇, 0) are convex in τ, and so is what
drives draw (gears included: η² ≤ 1, and regeneration ≤ 1): their largest values between the bounds are at corners, and no arm
between them asks more. The least may lie inside; seeded draws show it, and how the energy is spread.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from energyopt.arguments import check_plan
from energyopt.energy import electrical_energy
from energyopt.limit_checks import torque_findings
from energyopt.parameterizations.trajectory import Trajectory
from energyopt.plans import Plan
from energyopt.problem import Problem
from energyopt.problem_values import whole
from energyopt.readable import Readable
from energyopt.robots.model import RobotModel
from energyopt.robots.payload import Payload
from energyopt.robots.variation import payload_body, varied_dynamics
from energyopt.robust.uncertainty import Case, Uncertainty
from energyopt.sampling import LEAST_SPANS, Samples, sample_spans
from energyopt.verification import RELATIVE_TOLERANCES, TOLERANCES, excessive, verify

GRID = 3000
"""Samples of a motion for energies, at least."""
MOST_SAMPLES = 100_000
ENERGIES = ("mechanical_abs_J", "mechanical_positive_J", "electrical_J", "torque_squared")


@dataclass(frozen=True, eq=False)
class CaseResult:
    """One case: energies as in `metrics`, and the largest share of its torque limit that each joint uses [%], shape (nv,)."""

    case: Case
    mechanical_abs_J: float
    mechanical_positive_J: float
    electrical_J: float | None
    torque_squared: float
    torque_share: np.ndarray


@dataclass(frozen=True)
class LimitUse:
    """The worst use of one limit.

    Attributes:
        share: of the limit [%]; of a position, of half its range. holds: whether that is within the tolerance of plans.
        joint, time: where and when [s]. case: in which corner; None where it is the same in all.
    """

    share: float
    holds: bool
    joint: str
    time: float
    case: Case | None


@dataclass(frozen=True, eq=False, repr=False)
class Robustness(Readable):
    """What `robustness` found; ``str()`` is a table.

    Attributes:
        uncertainty: the bounds. nominal: the arm as modelled. corners, samples: of the bounds, and drawn between them.
        limits: worst use of every limit that is set.
        seed: of the draws.
    """

    uncertainty: Uncertainty
    nominal: CaseResult
    corners: tuple[CaseResult, ...]
    samples: tuple[CaseResult, ...]
    limits: dict[str, LimitUse]
    seed: int
    joint_names: tuple[str, ...]

    @property
    def holds(self) -> bool:
        """Whether every limit holds in every corner, and so in every arm between them."""
        return all(use.holds for use in self.limits.values())

    def spread(self, energy: str) -> tuple[float, float] | None:
        """Least and largest of one of `ENERGIES` over nominal case, corners and samples; None where it is unknown."""
        values = [getattr(result, energy) for result in (self.nominal, *self.corners, *self.samples)]
        return None if values[0] is None else (min(values), max(values))

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        from energyopt.robust.text import robustness_dict

        return robustness_dict(self)

    def in_brief(self) -> str:
        return f"{self.uncertainty}: {'every limit holds' if self.holds else 'NOT every limit holds'}"

    def __str__(self) -> str:
        from energyopt.robust.text import robustness_table

        return robustness_table(self)


def robustness(
    plan: Plan,
    payload: float | tuple[float, float] | None = None,
    masses: float = 0.0,
    friction: float = 0.0,
    *,
    load: Payload | None = None,
    samples: int = 100,
    seed: int = 0,
) -> Robustness:
    """The energies and limit uses of a plan for arms that differ from their model.

    Args:
        plan: the motion; it stays what it is, only the torques for it change.
        payload, masses, friction, load: the bounds, see `Uncertainty`.
        samples: cases drawn between the bounds.
        seed: of the draws.

    Returns:
        Robustness: energies by case, and ``holds``; ``str()`` is a table.

    Raises:
        InputError: no plan, a bound or number that makes no sense, uncertain friction of a robot without any.
    """
    check_plan("robustness", plan)
    return evaluate(plan.problem, plan.trajectory, Uncertainty(payload, masses, friction, load), samples, seed)


def evaluate(problem: Problem, trajectory: Trajectory, uncertainty: Uncertainty, samples: int = 100, seed: int = 0) -> Robustness:
    """`robustness` of any motion."""
    whole("samples", samples, 0, MOST_SAMPLES)
    whole("seed", seed, 0, 2**63 - 1, "a whole number, 0 or more")
    uncertainty.check(problem.robot)
    per_span = max(8, -(-GRID // max(len(trajectory.breaks) - 1, LEAST_SPANS)))
    torques = TorqueFamily.along(problem.robot, sample_spans(trajectory, per_span), uncertainty)
    corners, draws = uncertainty.corners(), uncertainty.draw(samples, seed)
    limit = problem.limits.torque
    return Robustness(
        uncertainty=uncertainty,
        nominal=torques.result(Case(), limit),
        corners=tuple(torques.result(case, limit) for case in corners),
        samples=tuple(torques.result(case, limit) for case in draws),
        limits=_limit_uses(problem, trajectory, uncertainty, corners),
        seed=seed,
        joint_names=problem.robot.joint_names,
    )


@dataclass(frozen=True, eq=False)
class TorqueFamily:
    """Torques of one motion for all cases.

    Attributes:
        robot: as modelled. t: times [s], shape (N,). v: velocities, shape (N, nv).
        base, load, bodies, friction: τ₀ [N·m], and its derivatives by payload [N·m/kg], masses and friction [N·m], shape (N, nv).
    """

    robot: RobotModel
    t: np.ndarray
    v: np.ndarray
    base: np.ndarray
    load: np.ndarray
    bodies: np.ndarray
    friction: np.ndarray

    @classmethod
    def along(cls, robot: RobotModel, samples: Samples, uncertainty: Uncertainty) -> TorqueFamily:
        """The torques of a sampled motion."""
        q, v, a = (samples.flat(order) for order in range(3))
        base, friction = robot.torque(q, v, a), robot.dynamics.friction(v)
        load = _load_torque(robot, uncertainty.body(1.0), q, v, a) if uncertainty.payload[1] else np.zeros_like(base)
        bodies = base - friction - robot.dynamics.armature * a
        return cls(robot, samples.t.ravel(), v, base, load, bodies, friction)

    def torque(self, case: Case) -> np.ndarray:
        """τ of one case [N·m], shape (N, nv)."""
        return self.base + case.payload * self.load + 0.01 * case.masses * self.bodies + 0.01 * case.friction * self.friction

    def result(self, case: Case, limit: np.ndarray) -> CaseResult:
        """Energies of one case, and shares of the torque limits [N·m], shape (nv,)."""
        tau = self.torque(case)
        power, drives = tau * self.v, self.robot.actuators
        return CaseResult(
            case=case,
            mechanical_abs_J=float(np.trapezoid(np.abs(power), self.t, axis=0).sum()),
            mechanical_positive_J=float(np.trapezoid(np.maximum(power, 0.0), self.t, axis=0).sum()),
            electrical_J=None if drives is None else electrical_energy(drives, self.t, tau, self.v),
            torque_squared=float(np.trapezoid(tau**2, self.t, axis=0).sum()),
            torque_share=100.0 * np.abs(tau).max(axis=0) / limit,
        )


def corner_problem(problem: Problem, uncertainty: Uncertainty, case: Case) -> Problem:
    """The problem with the robot of a case; its dynamics count, its URDF stays."""
    dynamics = varied_dynamics(problem.robot, uncertainty.variation(case))
    return replace(problem, robot=replace(problem.robot, dynamics=dynamics))


def _load_torque(robot: RobotModel, body: Payload, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Torque for a payload alone, on an arm without mass [N·m], shape (N, nv)."""
    model = pin.Model(robot.model)
    model.armature = np.zeros(model.nv)
    for joint in range(model.njoints):
        model.inertias[joint] = pin.Inertia.Zero()
    joint, inertia = payload_body(robot, body)
    if joint:
        model.inertias[joint] = inertia
    data = model.createData()
    return np.array([pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)])


def _limit_uses(
    problem: Problem, trajectory: Trajectory, uncertainty: Uncertainty, corners: tuple[Case, ...]
) -> dict[str, LimitUse]:
    """The worst use of every limit over the corners, by the same dense check that plans pass."""
    nominal = verify(problem, trajectory, distances=False)
    broken = excessive(nominal)
    uses = {
        name: LimitUse(100.0 - margin, name not in broken, *nominal.worst[name], None) for name, margin in nominal.margin.items()
    }
    for name in ("torque_percent", "torque_rate"):
        uses.pop(name, None)
    samples = sample_spans(trajectory)
    for case in corners:
        for found in torque_findings(corner_problem(problem, uncertainty, case), samples):
            share = 100.0 - found.margin
            if found.name not in uses or share > uses[found.name].share:
                uses[found.name] = LimitUse(share, share <= 100.0 + _slack(found.name), found.joint, found.time, case)
    return uses


def _slack(name: str) -> float:
    """Excess [%] that the dense check lets pass."""
    return RELATIVE_TOLERANCES.get(name, TOLERANCES["torque_percent"])
