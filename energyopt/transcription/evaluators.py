"""Evaluators: objective, constraints and exact derivatives of a laid-out program at a point x.

`CompiledEvaluator` lets the C of the arm's kernels do the assembly as well; `NumpyEvaluator` does the same sums with NumPy
over any kernels. Both write into arrays given by the solver.
"""

from __future__ import annotations

import ctypes

import numpy as np

from energyopt.dynamics.kernels import CompiledKernels, Kernels
from energyopt.transcription.layout import Layout


def make_evaluator(layout: Layout, kernels: Kernels) -> CompiledEvaluator | NumpyEvaluator:
    """The fastest evaluator that these kernels allow."""
    return CompiledEvaluator(layout, kernels) if isinstance(kernels, CompiledKernels) else NumpyEvaluator(layout, kernels)


class NumpyEvaluator:
    """The sums of `samples.c` in NumPy."""

    def __init__(self, layout: Layout, kernels: Kernels):
        self.layout, self.kernels = layout, kernels
        self._state = self._torque = None

    def move(self, x: np.ndarray) -> None:
        """Evaluate the motion of the unknowns ``x`` (size,) at all samples."""
        P, u = self.layout, self.layout.unknowns
        padded = np.concatenate([x.reshape(-1, P.nv), np.zeros((1, P.nv))])
        coefficients = u.offset + padded[u.block]
        self._state = np.einsum("kol,kli->koi", P.basis, coefficients[P.column]).reshape(len(P.weight), -1)
        self._torque = self.kernels.torque(self._state)

    def objective(self) -> float:
        P = self.layout
        return float(P.weight @ (self._torque**2 @ P.torque_weight + self._state**2 @ P.state_weight))

    def constraints(self, x: np.ndarray, out: np.ndarray) -> None:
        P = self.layout
        first = len(P.linear.lower)
        out[:first] = P.linear.evaluate(x)
        values = P.torque.scale * self._torque[P.torque.sample, P.torque.joint]
        out[first:] = np.bincount(P.torque.row, values, minlength=len(P.torque.lower))

    def gradient(self, out: np.ndarray) -> None:
        P = self.layout
        g = self.kernels.adjoint(self._state, self._power(1.0), np.zeros_like(self._torque))[1]
        g = g + 2.0 * P.weight[:, None] * P.state_weight * self._state
        local = np.einsum("kol,koi->kli", P.basis, g.reshape(len(g), 3, P.nv))
        total = np.zeros((P.unknowns.count + 1, P.nv))
        np.add.at(total, P.unknowns.block[P.column], local)
        out[:] = total[:-1].ravel()

    def jacobian(self, out: np.ndarray) -> None:
        P = self.layout
        out[:] = P.jac_constant
        if not len(P.torque.row):
            return
        J = self.kernels.jacobian(self._state[P.demand])[1]
        rows = J[P.entry_demand, P.torque.joint].reshape(-1, 3, P.nv)
        local = np.einsum("eol,eoi->eli", P.basis[P.torque.sample], rows) * P.torque.scale[:, None, None]
        there = P.entry_target >= 0
        np.add.at(out, P.entry_target[there], local.reshape(len(local), -1)[there])

    def hessian(self, sigma: float, multipliers: np.ndarray, out: np.ndarray) -> None:
        P, nv = self.layout, self.layout.nv
        mu = np.zeros_like(self._torque)
        scaled = P.torque.scale * multipliers[len(P.linear.lower) :][P.torque.row]
        np.add.at(mu, (P.torque.sample, P.torque.joint), scaled)
        H = self.kernels.hessian(self._state, self._power(sigma), mu)
        diagonal = np.arange(3 * nv)
        H[:, diagonal, diagonal] += 2.0 * sigma * P.weight[:, None] * P.state_weight
        H = H.reshape(-1, 3, nv, 3, nv)
        local = np.einsum("kol,koipj,kpm->klmij", P.basis, H, P.basis, optimize=True)
        out[:] = np.bincount(self._targets.ravel(), local.ravel(), minlength=len(out) + 1)[:-1]

    @property
    def _targets(self) -> np.ndarray:
        """Place of each entry of each sample's local Hessian; the last place takes what the upper triangle leaves out."""
        if not hasattr(self, "_target_cache"):
            P, nv = self.layout, self.layout.nv
            block = P.unknowns.block[P.column]
            A, B = block[:, :, None, None, None], block[:, None, :, None, None]
            i, j = np.arange(nv)[:, None], np.arange(nv)
            kept = (A >= 0) & (B >= 0) & ((A < B) | ((A == B) & (i <= j)))
            place = P.hess_start[np.maximum(B, 0) * nv + j] + P.hess_place[np.maximum(A, 0), np.maximum(B, 0)] + i
            self._target_cache = np.where(kept, place, len(P.hess_row))
        return self._target_cache

    def _power(self, sigma: float) -> np.ndarray:
        return 2.0 * sigma * self.layout.weight[:, None] * self.layout.torque_weight


class _Program(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_long) for name in (
            "samples", "local", "coefficients", "blocks", "linear_rows", "torque_rows", "entries", "demanded",
            "jac_nonzeros", "hess_nonzeros")),
        *((name, ctypes.c_void_p) for name in (
            "basis", "column", "block", "offset", "weight", "torque_weight", "state_weight", "row_start", "row_column",
            "row_value", "row_offset", "entry_row", "entry_sample", "entry_joint", "entry_scale", "demand", "entry_demand",
            "entry_target", "jac_constant", "hess_column", "hess_place", "coefficient", "state", "torque", "multiplier",
            "power", "jacobian", "gradient")),
    ]  # fmt: skip


class CompiledEvaluator:
    """The same numbers from `samples.c`."""

    def __init__(self, layout: Layout, kernels: CompiledKernels):
        self.layout = layout
        self._library = kernels.library
        self._arrays = _c_arrays(layout)
        numbers = {
            "samples": len(layout.weight), "local": layout.column.shape[1], "coefficients": len(layout.unknowns.block),
            "blocks": layout.unknowns.count, "linear_rows": len(layout.linear.lower), "torque_rows": len(layout.torque.lower),
            "entries": len(layout.torque.row), "demanded": len(layout.demand), "jac_nonzeros": len(layout.jac_row),
            "hess_nonzeros": len(layout.hess_row),
        }  # fmt: skip
        self._program = _Program(**numbers, **{name: array.ctypes.data for name, array in self._arrays.items()})
        self._pointer = ctypes.byref(self._program)

    @property
    def native(self) -> tuple[int, dict[str, int]]:
        """Addresses of the C struct and, by name, of the functions that take it: a solver in C needs no Python to call them."""
        names = ("state", "objective", "constraints", "gradient", "jacobian", "hessian")
        address = lambda name: ctypes.cast(getattr(self._library, f"eo_program_{name}"), ctypes.c_void_p).value
        return ctypes.addressof(self._program), {name: address(name) for name in names}

    def move(self, x: np.ndarray) -> None:
        self._library.eo_program_state(self._pointer, _pointer(x))

    def objective(self) -> float:
        return self._library.eo_program_objective(self._pointer)

    def constraints(self, x: np.ndarray, out: np.ndarray) -> None:
        self._library.eo_program_constraints(self._pointer, _pointer(x), _pointer(out))

    def gradient(self, out: np.ndarray) -> None:
        self._library.eo_program_gradient(self._pointer, _pointer(out))

    def jacobian(self, out: np.ndarray) -> None:
        self._library.eo_program_jacobian(self._pointer, _pointer(out))

    def hessian(self, sigma: float, multipliers: np.ndarray, out: np.ndarray) -> None:
        self._library.eo_program_hessian(self._pointer, ctypes.c_double(sigma), _pointer(multipliers), _pointer(out))


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.__array_interface__["data"][0])


def _c_arrays(P: Layout) -> dict[str, np.ndarray]:
    """By field of the C struct, a contiguous array of its type."""
    nv, samples, lanes = P.nv, len(P.weight), 8
    size = 3 * nv
    integers = {
        "column": P.column, "block": P.unknowns.block, "row_start": P.linear.start,
        "row_column": P.linear.column, "entry_row": len(P.linear.lower) + P.torque.row,
        "entry_sample": P.torque.sample, "entry_joint": P.torque.joint, "demand": P.demand,
        "entry_demand": P.entry_demand, "entry_target": P.entry_target, "hess_column": P.hess_start[:-1],
        "hess_place": P.hess_place,
    }  # fmt: skip
    reals = {
        "basis": P.basis, "offset": P.unknowns.offset, "weight": P.weight, "torque_weight": P.torque_weight,
        "state_weight": P.state_weight, "row_value": P.linear.value, "row_offset": P.linear.offset,
        "entry_scale": P.torque.scale, "jac_constant": P.jac_constant,
        "coefficient": np.zeros_like(P.unknowns.offset), "state": np.zeros((samples, size)),
        "torque": np.zeros((samples, nv)), "multiplier": np.zeros((samples, nv)), "power": np.zeros((samples, nv)),
        "jacobian": np.zeros((max(len(P.demand), lanes), nv * size)),
        "gradient": np.zeros((samples, size)),
    }  # fmt: skip
    arrays = {name: np.ascontiguousarray(a, dtype=np.intc) for name, a in integers.items()}
    return arrays | {name: np.ascontiguousarray(a, dtype=float) for name, a in reals.items()}
