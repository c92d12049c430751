"""Multipliers kept from one solve for the next on the same knots: of bounds, linear rows, torque rows and clearance rows.

Rows that were added since start with none. A solve that starts at the optimum of the last one, with its multipliers, has
nothing to do but what the new rows ask for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from energyopt.solvers import SolverResult
from energyopt.transcription.cuts import Cuts
from energyopt.transcription.program import NonlinearProgram


@dataclass(frozen=True, eq=False)
class Duals:
    """Multipliers by what they belong to.

    Attributes:
        bounds: of the unknowns, (n,); linear: of the linear rows; others: of rows such as those of a Cartesian goal.
        torque, clearance: by the keys of `Cuts`.
    """

    bounds: np.ndarray
    linear: np.ndarray
    others: np.ndarray
    torque: dict
    clearance: dict

    @classmethod
    def of(cls, program: NonlinearProgram, cuts: Cuts, result: SolverResult) -> Duals | None:
        """Those that a solve ended with; None where the solver does not tell."""
        if result.bound_multipliers is None:
            return None
        (linear, torque, others, clearance), (first, second) = _parts(program, cuts, result.multipliers), _keys(program, cuts)
        pairs = zip(first, torque, strict=True), zip(second, clearance, strict=True)
        return cls(result.bound_multipliers, linear, others, *map(dict, pairs))

    def to(self, program: NonlinearProgram, cuts: Cuts) -> tuple[np.ndarray, np.ndarray] | None:
        """As `SolverOptions.multipliers` of another program on the same knots; None where the two do not match."""
        linear, _, others, _ = _parts(program, cuts, np.zeros(program.rows))
        if program.size != len(self.bounds) or len(linear) != len(self.linear) or len(others) != len(self.others):
            return None
        first, second = _keys(program, cuts)
        torque, clearance = [self.torque.get(key, 0.0) for key in first], [self.clearance.get(key, 0.0) for key in second]
        return np.concatenate([self.linear, torque, self.others, clearance]), self.bounds


def _keys(program: NonlinearProgram, cuts: Cuts) -> tuple[list, list]:
    """Of the rows of torques and rates, and of clearance, in the program's order."""
    torque = [*sorted(cuts.torque), *sorted(cuts.rates)]
    fixed = len(program.layout.linear.lower) + len(torque)
    return torque, sorted(cuts.clearance) if program.rows >= fixed + len(cuts.clearance) else []


def _parts(program: NonlinearProgram, cuts: Cuts, multipliers: np.ndarray) -> list[np.ndarray]:
    torque, clearance = _keys(program, cuts)
    linear = len(program.layout.linear.lower)
    return np.split(multipliers, [linear, linear + len(torque), len(multipliers) - len(clearance)])
