"""Multipliers kept from one solve for the next on the same knots: of bounds, of linear rows and of torque rows.

Torque rows that were added since start with none. A solve that starts at the optimum of the last one, with its multipliers, has
nothing to do but what the new rows ask for. (With the stiff penalties of clearance it took more iterations than without.)
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
        torque: by the keys of `Cuts.torque` and `Cuts.rates`.
    """

    bounds: np.ndarray
    linear: np.ndarray
    others: np.ndarray
    torque: dict

    @classmethod
    def of(cls, program: NonlinearProgram, cuts: Cuts, result: SolverResult) -> Duals | None:
        """Those that a solve ended with; None where the solver does not tell."""
        if result.bound_multipliers is None:
            return None
        linear, torque, others = _parts(program, result.multipliers)
        return cls(result.bound_multipliers, linear, others, dict(zip(_keys(cuts), torque, strict=True)))

    def to(self, program: NonlinearProgram, cuts: Cuts) -> tuple[np.ndarray, np.ndarray] | None:
        """As `SolverOptions.multipliers` of another program on the same knots; None where the two do not match."""
        linear, _, others = _parts(program, np.zeros(program.rows))
        if program.size != len(self.bounds) or len(linear) != len(self.linear) or len(others) != len(self.others):
            return None
        torque = [self.torque.get(key, 0.0) for key in _keys(cuts)]
        return np.concatenate([self.linear, torque, self.others]), self.bounds


def _keys(cuts: Cuts) -> list[tuple]:
    """Of the rows of torques and rates, in the program's order."""
    return [*sorted(cuts.torque), *sorted(cuts.rates)]


def _parts(program: NonlinearProgram, multipliers: np.ndarray) -> list[np.ndarray]:
    linear = len(program.layout.linear.lower)
    return np.split(multipliers, [linear, linear + len(program.layout.torque.lower)])
