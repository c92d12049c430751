"""What is neither linear in the unknowns nor a torque: Cartesian goals, waypoints at times to be chosen, clearance, more costs.

Each is one class in a file of its own, with further unknowns (maybe none), rows, a share of the objective, and exact first and
second derivatives; `extended.ExtendedEvaluator` puts them beside the rows of the main program.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np


class ExtraRows(Protocol):
    """Rows between ``row_lower`` and ``row_upper``, maybe with further unknowns and a share of the objective."""

    variables: int
    lower: np.ndarray
    upper: np.ndarray
    row_lower: np.ndarray
    row_upper: np.ndarray

    def guess(self, coefficients: np.ndarray) -> np.ndarray: ...

    def jacobian_pattern(self) -> tuple[np.ndarray, np.ndarray]: ...

    def hessian_pattern(self) -> tuple[np.ndarray, np.ndarray]: ...

    def evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...

    def objective(self) -> float: ...

    def gradient(self) -> np.ndarray | None:
        """Of the objective, with respect to the unknowns of the motion; None where it has none."""

    def curvature(self, x: np.ndarray, sigma: float, multipliers: np.ndarray) -> np.ndarray: ...

    def stretch(self, theta: float) -> None:
        """Before an evaluation: the motion takes exp(theta) times as long as its space says."""

    def in_theta(self, x: np.ndarray, sigma: float, multipliers: np.ndarray) -> ThetaTerms:
        """Derivatives that involve theta, at the point evaluated last; see `stretch`."""


@dataclass(frozen=True, eq=False)
class ThetaTerms:
    """What an extra has to do with theta.

    Attributes:
        slope: of its objective; rows: of its rows; crossed: ∂²L/∂θ∂x, as long as the part of x it touches; bent: ∂²L/∂θ².
    """

    slope: float = 0.0
    rows: np.ndarray | float = 0.0
    crossed: np.ndarray = field(default_factory=lambda: np.zeros(0))
    bent: float = 0.0


class Priceless:
    """No share of the objective, and nothing to do with the duration: times count as shares of it."""

    def stretch(self, theta: float) -> None:
        pass

    def in_theta(self, x: np.ndarray, sigma: float, multipliers: np.ndarray) -> ThetaTerms:
        return ThetaTerms()

    def objective(self) -> float:
        return 0.0

    def gradient(self) -> None:
        return None
