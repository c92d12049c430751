"""What every cost term is: a weighted integral over the motion.

    J = Σ weight · ∫₀ᵀ φ(q̇, q̈, d³q/dt³, τ) dt

φ does not depend on q but through τ, is twice continuously differentiable everywhere, and couples no two joints, with one
exception: drives on one DC bus, whose term is a function h of the sum U of something of every joint. The second derivatives of φ
in (τ, q̇) are then a part for every joint plus h″(U) d dᵀ, d = ∂U/∂(τ, q̇): a matrix of rank one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from energyopt import problem_values as values
from energyopt.errors import ProblemError
from energyopt.robots.model import RobotModel


@dataclass(frozen=True, eq=False)
class Samples:
    """A motion at N times, each of shape (N, nv).

    Attributes:
        q: position [rad]; v: velocity [rad/s]; a: acceleration [rad/s²]; jerk: [rad/s³]; tau: joint torque [N·m].
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    jerk: np.ndarray
    tau: np.ndarray


@dataclass(frozen=True, eq=False)
class Integrand:
    """φ at N times, and its derivatives; None where φ has none.

    Attributes:
        value: φ, shape (N,).
        tau, v, a, jerk: first derivatives, shape (N, nv).
        tau_tau, tau_v, v_v, a_a, jerk_jerk: second derivatives within each joint, shape (N, nv).
        bus: h″, shape (N,), and bus_tau, bus_v: d, shape (N, nv): bus · d dᵀ is added to the second derivatives.
    """

    value: np.ndarray
    tau: np.ndarray | None = None
    v: np.ndarray | None = None
    a: np.ndarray | None = None
    jerk: np.ndarray | None = None
    tau_tau: np.ndarray | None = None
    tau_v: np.ndarray | None = None
    v_v: np.ndarray | None = None
    a_a: np.ndarray | None = None
    jerk_jerk: np.ndarray | None = None
    bus: np.ndarray | None = None
    bus_tau: np.ndarray | None = None
    bus_v: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class CostTerm(ABC):
    """A term of J; ``0.5 * term`` is the same with half the weight.

    Attributes:
        name: its key in ``plan.cost_terms``. unit: of ∫φ dt, before the weight. symbol: φ, for formulas.
        weight: factor in J, ≥ 0.

    Raises:
        ProblemError: a number is malformed; the message begins with the name of the term.
    """

    name: ClassVar[str]
    unit: ClassVar[str]
    symbol: ClassVar[str]
    uses: ClassVar[tuple[str, ...]]
    """Which fields of `Samples` φ depends on."""
    __array_ufunc__ = None  # so that a numpy number times a term is a term

    weight: float = field(default=1.0, kw_only=True)

    def __post_init__(self):
        weight = values.real(f"{self.name}: weight", self.weight, lambda w: 0 <= w < np.inf, "a number ≥ 0")
        object.__setattr__(self, "weight", weight)

    @abstractmethod
    def integrand(self, samples: Samples, order: int = 0) -> Integrand:
        """φ without the weight: its value, with first derivatives from order 1 on, and second ones from order 2 on."""

    def exact(self, samples: Samples) -> np.ndarray:
        """φ without the weight and without any smoothing, shape (N,)."""
        return self.integrand(samples).value

    def fitted(self, robot: RobotModel) -> CostTerm:
        """The term for this robot: one number a joint where one stood for all, its drives where the term needs them.

        Raises:
            ProblemError: another number of joints, or data the robot does not have.
        """
        return self

    def __rmul__(self, factor: float) -> CostTerm:
        if not isinstance(factor, Real):
            return NotImplemented
        return replace(
            self, weight=values.real(f"{self.name}: factor", factor, lambda w: 0 <= w < np.inf, "a number ≥ 0") * self.weight
        )


@dataclass(frozen=True, eq=False)
class SquaredTerm(CostTerm):
    """φ = Σ wᵢ xᵢ² for one quantity x of `Samples`.

    Attributes:
        weights: w, one number for all joints or one a joint, ≥ 0.
    """

    weights: ArrayLike = 1.0

    def __post_init__(self):
        super().__post_init__()
        key = f"{self.name}: weights"
        array = values.numbers(key, self.weights, "a number ≥ 0, or one a joint")
        bad = array[~((array >= 0) & np.isfinite(array))]
        if array.ndim > 1 or array.size == 0 or bad.size:
            got = f"{bad[0]:g}" if bad.size else f"an array of shape {array.shape}"
            raise ProblemError(f"{key} is {got}: expected a number ≥ 0, or one a joint")
        array.flags.writeable = False
        object.__setattr__(self, "weights", array)

    def integrand(self, samples: Samples, order: int = 0) -> Integrand:
        (key,) = self.uses
        x = getattr(samples, key)
        found: dict[str, Any] = {"value": np.sum(self.weights * x**2, axis=1)}
        if order >= 1:
            found[key] = 2.0 * self.weights * x
        if order >= 2:
            found[f"{key}_{key}"] = np.broadcast_to(2.0 * self.weights, x.shape)
        return Integrand(**found)

    def fitted(self, robot: RobotModel) -> CostTerm:
        return replace(self, weights=values.vector(f"{self.name}: weights", self.weights, robot.joint_names))


def formula(terms: Sequence[CostTerm]) -> str:
    """What is minimised, for people: such as "∫(supply power + 0.01 Στ²)dt"."""
    factor = lambda term: "" if term.weight == 1.0 else f"{term.weight:.4g} "
    weighted = lambda term: term.symbol.replace("Σ", "Σw") if np.any(getattr(term, "weights", 1.0) != 1.0) else term.symbol
    return f"∫({' + '.join(factor(term) + weighted(term) for term in terms)})dt"


def checked_costs(given: Any, robot: RobotModel) -> tuple[CostTerm, ...]:
    """The terms of J, each fitted to the robot.

    Args:
        given: one `CostTerm` or several, of different names. robot: the arm.

    Raises:
        ProblemError: no term, two of one name, all weights zero, or a term that does not fit the robot.
    """
    terms = tuple(term.fitted(robot) for term in values.instances("costs", given, CostTerm, "cost terms such as TorqueSquared()"))
    names = [term.name for term in terms]
    for k, name in enumerate(names):
        if name in names[:k]:
            raise ProblemError(f"costs[{k}] is a second {name}: expected each term once; add up the weights")
    if not any(term.weight > 0 and np.any(getattr(term, "weights", 1.0) > 0) for term in terms):
        raise ProblemError(f"costs: {_said(names)}: every motion costs nothing; make a weight positive")
    return terms


def _said(names: Sequence[str]) -> str:
    return f"the weights of {', '.join(names)} are all zero" if names else "there is none"
