"""MotionSpace: the motions that one choice of coefficients can describe, for one duration.

Every parameterisation of energyopt is linear in its coefficients: q(t) = Σ_j B_j(t) c_j with vectors c_j of one number a
joint and the same B_j for all joints. What distinguishes them is which B_j, which linear equations tie the coefficients
(defects), how the boundary conditions fix some of them, and for which times bounds on derivatives can be guaranteed.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from energyopt.parameterizations.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class BoundaryState:
    """Position, velocity and acceleration at an end of the motion, each (nv,); position None where it is unknown."""

    position: np.ndarray | None
    velocity: np.ndarray
    acceleration: np.ndarray


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Which coefficients are unknown: c_j = offset_j + x[block_j], block −1 where nothing is.

    Attributes:
        block: shape (size,), values −1 … count − 1; several coefficients may share a block.
        offset: shape (size, nv).
        count: number of blocks of nv unknowns.
        goal: the block that is the unknown end position; None where the end is given.
    """

    block: np.ndarray
    offset: np.ndarray
    count: int
    goal: int | None = None


@dataclass(frozen=True, eq=False)
class Rows:
    """A sparse matrix of ``count`` rows over the coefficients: entry (row, column) is the sum of its values."""

    count: int
    row: np.ndarray
    column: np.ndarray
    value: np.ndarray

    @classmethod
    def banded(cls, columns: np.ndarray, values: np.ndarray) -> Rows:
        """From (R, L) column indices and values, a row each."""
        count, width = columns.shape
        return cls(count, np.repeat(np.arange(count), width), columns.ravel(), values.ravel())

    @classmethod
    def stacked(cls, parts: list[Rows]) -> Rows:
        """The rows of several, one after another."""
        first = np.cumsum([0, *(part.count for part in parts)])
        row = [part.row + f for part, f in zip(parts, first, strict=False)]
        columns, values = [part.column for part in parts], [part.value for part in parts]
        empty = np.zeros(0, int)
        return cls(
            int(first[-1]),
            np.concatenate([empty, *row]),
            np.concatenate([empty, *columns]),
            np.concatenate([np.zeros(0), *values]),
        )

    def __matmul__(self, coefficients: np.ndarray) -> np.ndarray:
        """The product with coefficients (size, nv), shape (count, nv)."""
        product = np.zeros((self.count, coefficients.shape[1]))
        np.add.at(product, self.row, self.value[:, None] * coefficients[self.column])
        return product


class MotionSpace(ABC):
    """A finite-dimensional space of motions over [0, duration].

    Attributes:
        duration: T [s].
        size: number of coefficients a joint.
        everywhere: whether the rows of `bounding_rows` hold a derivative inside its limits for all t, not only at samples.
    """

    duration: float
    size: int
    everywhere: bool

    @abstractmethod
    def basis(self, t: np.ndarray, orders: int = 3) -> tuple[np.ndarray, np.ndarray]:
        """Values of the basis and its time derivatives at times ``t`` (N,).

        Returns:
            columns: (N, L) the coefficients that matter at each time; values: (N, orders, L).
        """

    @abstractmethod
    def quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and weights [s] of the sum that stands for ∫ … dt, both (N,)."""

    def quadrature_basis(self) -> tuple[np.ndarray, np.ndarray]:
        """`basis` at the quadrature times."""
        return self.basis(self.quadrature()[0])

    @abstractmethod
    def unknowns(self, start: BoundaryState, goal: BoundaryState) -> Unknowns:
        """Fix the coefficients that the boundary conditions determine."""

    @abstractmethod
    def closed_unknowns(self, position: np.ndarray) -> Unknowns:
        """The coefficients of cycles through ``position`` (nv,), whose velocity and acceleration there are unknown.

        Where sharing coefficients does not make both ends equal, `closing_rows` do.
        """

    def closing_rows(self) -> Rows:
        """Rows whose product with the coefficients of a cycle has to vanish."""
        return Rows.stacked([])

    @abstractmethod
    def bounding_rows(self, order: int) -> Rows:
        """If all rows times the coefficients lie in an interval, so does the derivative of this order."""

    def defects(self) -> Rows:
        """Rows whose product with the coefficients has to vanish."""
        return Rows.stacked([])

    @abstractmethod
    def trajectory(self, coefficients: np.ndarray) -> Trajectory:
        """The motion of coefficients (size, nv)."""

    @abstractmethod
    def interpolate(self, trajectory: Trajectory) -> np.ndarray:
        """Coefficients (size, nv) of a motion near ``trajectory``; exact where the space contains it."""

    @abstractmethod
    def stretched(self, duration: float) -> MotionSpace:
        """The same motions, run through in another time."""

    def rows_at(self, t: np.ndarray, order: int) -> Rows:
        """Rows that give the derivative of this order at the times ``t`` (N,)."""
        columns, values = self.basis(np.asarray(t, float), order + 1)
        return Rows.banded(columns, values[:, order])
