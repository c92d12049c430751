"""The arrays that describe a nonlinear program to its evaluators: samples, torque rows, and where each derivative goes.

Torque rows are linear combinations of sample torques, g = D τ: a torque limit is one entry of D, a limit on the torque rate
the difference of two neighbouring samples over the time between them. The sparsity of Jacobian and Hessian follows from
which blocks of unknowns each sample touches.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from energyopt.parameterizations.space import MotionSpace, Unknowns
from energyopt.transcription.linear import LinearRows


@dataclass(frozen=True, eq=False)
class TorqueRows:
    """lower ≤ D τ ≤ upper, D given by entries; samples are counted over quadrature and extra samples together.

    Attributes:
        times: extra samples [s], (E,), beyond those of the quadrature.
        row, sample, joint, scale: one entry of D each. rate: whether it divides by a time, as rates do.
        lower, upper: (R,) [N·m] or [N·m/s].
    """

    times: np.ndarray = field(default_factory=lambda: np.zeros(0))
    row: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    sample: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    joint: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    scale: np.ndarray = field(default_factory=lambda: np.zeros(0))
    lower: np.ndarray = field(default_factory=lambda: np.zeros(0))
    upper: np.ndarray = field(default_factory=lambda: np.zeros(0))
    rate: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))


@dataclass(frozen=True, eq=False)
class Layout:
    """Everything `samples.c` calls Program, but for the work arrays; see there for shapes."""

    nv: int
    basis: np.ndarray
    column: np.ndarray
    unknowns: Unknowns
    weight: np.ndarray
    torque_weight: np.ndarray
    state_weight: np.ndarray
    linear: LinearRows
    torque: TorqueRows
    jac_start: np.ndarray
    jac_row: np.ndarray
    jac_constant: np.ndarray
    jac_linear: np.ndarray
    entry_target: np.ndarray
    demand: np.ndarray
    entry_demand: np.ndarray
    hess_start: np.ndarray
    hess_row: np.ndarray
    hess_place: np.ndarray

    @property
    def size(self) -> int:
        return self.unknowns.count * self.nv

    @property
    def rows(self) -> int:
        return len(self.linear.lower) + len(self.torque.lower)


def make_layout(
    space: MotionSpace, unknowns: Unknowns, linear: LinearRows, torque: TorqueRows, weights: tuple[np.ndarray, np.ndarray]
) -> Layout:
    """Lay out a program. ``weights``: those of τ² (nv,) and of (q², q̇², q̈²) (3 nv,) in the cost."""
    nv = len(weights[0])
    column, basis = space.quadrature_basis()
    weight = space.quadrature()[1]
    if len(torque.times):
        more_columns, more_basis = space.basis(torque.times)
        column, basis = np.concatenate([column, more_columns]), np.concatenate([basis, more_basis])
        weight = np.concatenate([weight, np.zeros(len(torque.times))])
    local_block = unknowns.block[column]
    demand, entry_demand = np.unique(torque.sample, return_inverse=True)
    jacobian = _jacobian_pattern(linear, torque, local_block, nv)
    return Layout(
        nv, basis, column, unknowns, weight, *weights, linear, torque, *jacobian, demand, entry_demand,
        *_kept_pattern(local_block.astype(np.int64).tobytes(), local_block.shape, unknowns.count, nv),
    )  # fmt: skip


def _jacobian_pattern(linear: LinearRows, torque: TorqueRows, local_block: np.ndarray, nv: int):
    """Column starts, rows and constant values of the Jacobian, and the places in it of the linear rows' values and of each torque
    entry's derivatives."""
    first, size = len(linear.lower), len(linear.x_lower)
    blocks = local_block[torque.sample]
    columns = np.where(blocks[..., None] >= 0, blocks[..., None] * nv + np.arange(nv), -1).reshape(
        len(blocks), local_block.shape[1] * nv
    )
    rows = np.broadcast_to((first + torque.row)[:, None], columns.shape)
    there = columns >= 0
    every_row = np.concatenate([linear.row, rows[there]])
    every_column = np.concatenate([linear.column, columns[there]])
    total = first + len(torque.lower)
    key = every_column.astype(np.int64) * max(total, 1) + every_row
    places, inverse = np.unique(key, return_inverse=True)
    start = np.searchsorted(places, np.arange(size + 1, dtype=np.int64) * max(total, 1))
    constant = np.zeros(len(places))
    constant[inverse[: len(linear.value)]] = linear.value
    target = np.full(columns.shape, -1)
    target[there] = inverse[len(linear.value) :]
    return start, places % max(total, 1), constant, inverse[: len(linear.value)], target


@lru_cache(maxsize=8)
def _kept_pattern(local_block: bytes, shape: tuple[int, int], count: int, nv: int):
    """`_hessian_pattern`, kept: programs of one space share it."""
    return _hessian_pattern(np.frombuffer(local_block, np.int64).reshape(shape), count, nv)


def _hessian_pattern(local_block: np.ndarray, count: int, nv: int):
    """Upper triangle by block pairs: column starts (size + 1,), rows, and for blocks A ≤ B the offset of A in B's columns."""
    changes = np.any(local_block[1:] != local_block[:-1], axis=1)  # samples of one span touch the same blocks
    known = local_block[np.flatnonzero(np.append(True, changes))] if len(local_block) else local_block
    first, second = np.broadcast_arrays(known[:, :, None], known[:, None, :])
    kept = (first >= 0) & (first <= second)
    b, a = np.divmod(np.unique(second[kept] * np.int64(count) + first[kept]), max(count, 1))
    begin = np.searchsorted(b, np.arange(count + 1))
    place = np.full((count, count), -1, np.intc)
    place[a, b] = (np.arange(len(b)) - begin[b]) * nv
    # Block B's j-th column holds the blocks before B, whole, and of B itself, which is the last, j + 1 rows.
    length = np.maximum(np.diff(begin)[:, None] * nv + np.arange(1 - nv, 1), 0).ravel()
    start = np.concatenate([[0], np.cumsum(length)]).astype(np.intc)
    whole = (a[:, None] * nv + np.arange(nv)).ravel()  # the rows of each pair; a column is a part of them
    from_ = np.repeat((np.repeat(begin[:-1], nv) * nv - start[:-1]).astype(np.intc), length)
    return start, whole.astype(np.intc)[np.arange(start[-1], dtype=np.intc) + from_], place
