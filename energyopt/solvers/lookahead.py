"""What one Newton step would gain: with gradient g, Hessian H and the gradients A of the limits that are near, the step

    (H + ρAᵀA) d = g,   ρ → ∞,

along those limits lowers the objective by gᵀd − ½ dᵀHd. Unknowns are scaled to a curvature of one, rows to a length of one;
unknowns near a bound are held. Where the curvature is not positive it is raised until it is.

`lookahead.c` does it within the profile of the matrix; without a compiler the same is done by sparse factors.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import SuperLU, splu

from energyopt.solvers.native import library_path

NEAR = 1e-2
"""A limit is near where less than this share of its interval is left."""
STIFFNESS = 1e5
"""ρ for rows of length one and a Hessian with ones on its diagonal."""
SHIFTS = np.array([0.0, 1e-2, 1e-1, 1.0, 10.0])
"""Added to that diagonal, in turn, until the curvature is positive."""


@dataclass(frozen=True, eq=False)
class Point:
    """A program at unknowns x, all arrays as `NonlinearProgram` has them.

    Attributes:
        bounds: of x, (n,) each; row_bounds: of the rows, (m,) each.
        jacobian_pattern, hessian_pattern: column starts and rows; the Hessian's upper triangle.
        x, rows: (n,), (m,); gradient: (n,); jacobian, hessian: values in the order of the patterns.
        free: unknowns from this one on are held.
    """

    bounds: tuple[np.ndarray, np.ndarray]
    row_bounds: tuple[np.ndarray, np.ndarray]
    jacobian_pattern: tuple[np.ndarray, np.ndarray]
    hessian_pattern: tuple[np.ndarray, np.ndarray]
    x: np.ndarray
    rows: np.ndarray
    gradient: np.ndarray
    jacobian: np.ndarray
    hessian: np.ndarray
    free: int


@dataclass(frozen=True, eq=False)
class Step:
    """What a step promises: the gain, |gⱼdⱼ| of each unknown (n,), and whether the curvature was positive as it is."""

    gain: float
    shares: np.ndarray
    convex: bool


def point_of(program, x: np.ndarray, free: int) -> Point:
    """Evaluate a program, without multipliers: the Hessian is that of the objective."""
    evaluator, (n, m) = program.evaluator, (program.size, program.rows)
    gradient, rows = np.empty(n), np.empty(m)
    jacobian, hessian = np.empty(len(program.jacobian_pattern[1])), np.empty(len(program.hessian_pattern[1]))
    x = np.ascontiguousarray(x, float)
    evaluator.move(x)
    evaluator.gradient(gradient)
    evaluator.hessian(1.0, np.zeros(m), hessian)
    evaluator.constraints(x, rows)
    evaluator.jacobian(jacobian)
    bounds = (program.lower, program.upper), (program.row_lower, program.row_upper)
    return Point(*bounds, program.jacobian_pattern, program.hessian_pattern, x, rows, gradient, jacobian, hessian, free)


def newton_step(point: Point) -> Step | None:
    """The step from a point; None where the curvature is not a number, say."""
    path = library_path("skyline.c", "lookahead.c")
    return step_by_factors(point) if path is None else _step_in_c(point, _library(path))


_Pointer, _Long, _Double = ctypes.c_void_p, ctypes.c_long, ctypes.c_double


class _Point(ctypes.Structure):
    _names = (
        "lower", "upper", "row_lower", "row_upper", "jac_start", "jac_row", "hess_start", "hess_row",
        "x", "g", "gradient", "jacobian", "hessian",
    )  # fmt: skip
    _fields_ = [
        *(("n", _Long), ("m", _Long)), *((name, _Pointer) for name in _names), ("known", _Long),
        *(("near", _Double), ("stiffness", _Double), ("shifts", _Pointer), ("tries", _Long)),
    ]  # fmt: skip


@cache
def _library(path: str) -> ctypes.CDLL:
    library = ctypes.CDLL(path)
    library.eo_newton_gain.restype = _Long
    return library


def _step_in_c(point: Point, library: ctypes.CDLL) -> Step | None:
    n, m, free = len(point.x), len(point.rows), point.free
    reals, integers = (*point.bounds, *point.row_bounds), (*point.jacobian_pattern, *point.hessian_pattern)
    values = point.x, point.rows, point.gradient, point.jacobian, point.hessian
    arrays = [np.ascontiguousarray(a, float) for a in reals] + [np.ascontiguousarray(a, np.intc) for a in integers] + [*values]
    struct = _Point(n, m, *(a.ctypes.data for a in arrays), free, NEAR, STIFFNESS, SHIFTS.ctypes.data, len(SHIFTS))
    gain, shares = _Double(), np.zeros(n)
    found = library.eo_newton_gain(ctypes.byref(struct), ctypes.byref(gain), _Pointer(shares.ctypes.data))
    return None if found < 0 else Step(gain.value, shares, SHIFTS[found] == 0.0)


def step_by_factors(point: Point) -> Step | None:
    """The same by SciPy's sparse factors."""
    n, m = len(point.x), len(point.rows)
    start, row = point.hessian_pattern
    column = np.repeat(np.arange(n), np.diff(start))
    curvature = np.abs(np.bincount(column[row == column], point.hessian[row == column], minlength=n))
    held = _near(point.x, *point.bounds)
    held[point.free :] = True
    size = np.where(held, 0.0, 1.0 / np.sqrt(np.maximum(curvature, 1e-300)))
    upper = csc_array((point.hessian * size[row] * size[column], row, start), shape=(n, n))
    hessian = upper + upper.T - diags_array(upper.diagonal())
    near = _near(point.rows, *point.row_bounds)
    rows = _unit_rows(point.jacobian * near[point.jacobian_pattern[1]], point.jacobian_pattern, size, m)
    stiff, gradient = hessian + STIFFNESS * (rows.T @ rows), size * point.gradient
    for shift in SHIFTS:
        factors = _factored(stiff + diags_array(np.where(held, 1.0, shift)))
        if factors is not None:
            d = factors.solve(gradient)
            return Step(float(gradient @ d - 0.5 * d @ (hessian @ d)), np.abs(gradient * d), shift == 0.0)
    return None


def _near(values: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    width = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
    return np.minimum(upper - values, values - lower) <= NEAR * width


def _unit_rows(jacobian: np.ndarray, pattern: tuple[np.ndarray, np.ndarray], size: np.ndarray, count: int) -> csc_array:
    """Rows in unknowns of the given sizes, each of length one (or zero)."""
    start, row = pattern
    values = jacobian * np.repeat(size, np.diff(start))
    length = np.sqrt(np.bincount(row, values**2, minlength=count))
    return csc_array((values / np.where(length > 0, length, 1.0)[row], row, start), shape=(count, len(size)))


def _factored(matrix: csc_array) -> SuperLU | None:
    """L U of a symmetric matrix in its own order, without exchanges, so that its pivots have the signs of its eigenvalues; None
    where one is not positive. (LAPACK's banded Cholesky starts threads, which wait for each other on a busy machine.)
    """
    try:
        factors = splu(csc_array(matrix), "NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True, "Equil": False})
    except RuntimeError:  # singular
        return None
    exchanged = np.any(factors.perm_r != np.arange(matrix.shape[0]))
    return None if exchanged or not np.all(factors.U.diagonal() > 0.0) else factors
