"""Evaluators: objective, constraints and exact derivatives of a laid-out program at a point x.

`CompiledEvaluator` lets the C of the arm's kernels do the assembly as well; `NumpyEvaluator` does the same sums with NumPy
over any kernels. Both write into arrays given by the solver. The integrand is the layout's squares, or a sum of cost terms
(`StageCosts`) whose derivatives in (τ, q̇, q̈) are evaluated with NumPy and handed to the same sums.
"""

from __future__ import annotations

import ctypes

import numpy as np

from energyopt.dynamics.kernels import CompiledKernels, Kernels
from energyopt.transcription.layout import Layout
from energyopt.transcription.stage_costs import StageCosts


def make_evaluator(layout: Layout, kernels: Kernels, costs: StageCosts | None = None) -> Evaluator:
    """The fastest evaluator that these kernels allow. ``costs``: what is integrated in place of the layout's squares."""
    made = CompiledEvaluator if isinstance(kernels, CompiledKernels) else NumpyEvaluator
    return made(layout, kernels, costs)


class Evaluator:
    """What the two have in common.

    Attributes:
        layout: of the program; kernels: of the arm; costs: what is integrated, None for the layout's squares.
        arrays: by name in `samples.c`, the numbers in use. They may be changed between calls (see `stretch`).
        direction: of each sample's state, (N, 3 nv), or None; turned: the Hessian of the sample's share in the Lagrangian
            times it, after a call of `hessian`. After one of `gradient`, ``arrays["gradient"]`` is the derivative of the
            objective's share of each sample in its state.
    """

    def __init__(self, layout: Layout, kernels: Kernels, costs: StageCosts | None):
        self.layout, self.kernels, self.costs = layout, kernels, costs
        self.arrays = _arrays(layout)
        self.direction: np.ndarray | None = None
        self.turned = np.zeros_like(self.arrays["state"])

    @property
    def state(self) -> np.ndarray:
        """z = (q, q̇, q̈) at all samples, (N, 3 nv)."""
        return self.arrays["state"]

    @property
    def torque(self) -> np.ndarray:
        """τ there, (N, nv)."""
        return self.arrays["torque"]

    def row_multipliers(self, multipliers: np.ndarray) -> np.ndarray:
        """Multipliers of the torque rows, gathered at the samples they speak of, (entries,)."""
        return self.arrays["entry_scale"] * multipliers[self.arrays["entry_row"]]

    def at_samples(self, entries: np.ndarray) -> np.ndarray:
        """One number an entry of the torque rows, summed at samples and joints, (N, nv)."""
        torque, shape = self.layout.torque, self.torque.shape
        return np.bincount(torque.sample * shape[1] + torque.joint, entries, minlength=shape[0] * shape[1]).reshape(shape)

    def _first(self) -> np.ndarray | None:
        return None if self.costs is None else self.costs.first(self.state, self.torque, self.arrays["weight"])


class NumpyEvaluator(Evaluator):
    """The sums of `samples.c` in NumPy."""

    def move(self, x: np.ndarray) -> None:
        """Evaluate the motion of the unknowns ``x`` (size,) at all samples."""
        P, A = self.layout, self.arrays
        padded = np.concatenate([x.reshape(-1, P.nv), np.zeros((1, P.nv))])
        coefficients = A["offset"] + padded[P.unknowns.block]
        self.state[:] = np.einsum("kol,kli->koi", A["basis"], coefficients[P.column]).reshape(len(P.weight), -1)
        self.torque[:] = self.kernels.torque(self.state)

    def objective(self) -> float:
        A = self.arrays
        if self.costs is not None:
            return self.costs.value(self.state, self.torque, A["weight"])
        return float(A["weight"] @ (self.torque**2 @ A["torque_weight"] + self.state**2 @ A["state_weight"]))

    def constraints(self, x: np.ndarray, out: np.ndarray) -> None:
        P, A = self.layout, self.arrays
        first = len(P.linear.lower)
        products = A["row_value"] * x[P.linear.column]
        out[:first] = A["row_offset"] + np.bincount(P.linear.row, products, minlength=first)
        values = A["entry_scale"] * self.torque[P.torque.sample, P.torque.joint]
        out[first:] = np.bincount(P.torque.row, values, minlength=len(P.torque.lower))

    def gradient(self, out: np.ndarray) -> None:
        P, g = self.layout, self._sample_gradient()
        self.arrays["gradient"][:] = g
        local = np.einsum("kol,koi->kli", self.arrays["basis"], g.reshape(len(g), 3, P.nv))
        total = np.zeros((P.unknowns.count + 1, P.nv))
        np.add.at(total, P.unknowns.block[P.column], local)
        out[:] = total[:-1].ravel()

    def jacobian(self, out: np.ndarray) -> None:
        P, A = self.layout, self.arrays
        out[:] = A["jac_constant"]
        if not len(P.torque.row):
            return
        J = self.kernels.jacobian(self.state[P.demand])[1]
        rows = J[P.entry_demand, P.torque.joint].reshape(-1, 3, P.nv)
        local = np.einsum("eol,eoi->eli", A["basis"][P.torque.sample], rows) * A["entry_scale"][:, None, None]
        there = P.entry_target >= 0
        np.add.at(out, P.entry_target[there], local.reshape(len(local), -1)[there])

    def hessian(self, sigma: float, multipliers: np.ndarray, out: np.ndarray) -> None:
        basis, H = self.arrays["basis"], self._sample_hessians(sigma, multipliers)
        if self.direction is not None:
            self.turned[:] = np.einsum("kab,kb->ka", H, self.direction)
        nv = self.layout.nv
        local = np.einsum("kol,koipj,kpm->klmij", basis, H.reshape(-1, 3, nv, 3, nv), basis, optimize=True)
        out[:] = np.bincount(self._targets.ravel(), local.ravel(), minlength=len(out) + 1)[:-1]

    def _sample_gradient(self) -> np.ndarray:
        """Derivative of the objective's share of each sample in its state, (N, 3 nv)."""
        A, nv = self.arrays, self.layout.nv
        first = self._first()
        if first is None:
            power = 2.0 * A["weight"][:, None] * A["torque_weight"]
            g = self.kernels.adjoint(self.state, power, np.zeros_like(self.torque))[1]
            return g + 2.0 * A["weight"][:, None] * A["state_weight"] * self.state
        g = self.kernels.adjoint(self.state, np.zeros_like(self.torque), first[:, :nv])[1]
        g[:, nv:] += first[:, nv:]
        return g

    def _sample_hessians(self, sigma: float, multipliers: np.ndarray) -> np.ndarray:
        """Of each sample's share in the Lagrangian, (N, 3 nv, 3 nv)."""
        A, nv = self.arrays, self.layout.nv
        mu = self.at_samples(self.row_multipliers(multipliers))
        diagonal = np.arange(3 * nv)
        if self.costs is None:
            power = 2.0 * sigma * A["weight"][:, None] * A["torque_weight"]
            H = self.kernels.hessian(self.state, power, mu)
            H[:, diagonal, diagonal] += 2.0 * sigma * A["weight"][:, None] * A["state_weight"]
            return H
        second, mixed = self.costs.second(self.state, self.torque, A["weight"])
        power = sigma * second[:, :nv]
        H = self.kernels.hessian(self.state, power, sigma * self._first()[:, :nv] - power * self.torque + mu)
        J = self.kernels.jacobian(self.state)[1]
        cross = np.zeros_like(H)
        cross[:, nv : 2 * nv] = sigma * second[:, nv : 2 * nv, None] * J
        H += cross + cross.transpose(0, 2, 1)
        H[:, diagonal[nv:], diagonal[nv:]] += sigma * second[:, 2 * nv :]
        if mixed is not None:
            d = np.einsum("ki,kia->ka", mixed[:, 1 : 1 + nv], J)
            d[:, nv : 2 * nv] += mixed[:, 1 + nv :]
            H += sigma * mixed[:, 0, None, None] * d[:, :, None] * d[:, None, :]
        return H

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


class _Program(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_long) for name in (
            "samples", "local", "coefficients", "blocks", "linear_rows", "torque_rows", "entries", "demanded",
            "jac_nonzeros", "hess_nonzeros")),
        *((name, ctypes.c_void_p) for name in (
            "basis", "column", "block", "offset", "weight", "torque_weight", "state_weight", "row_start", "row_column",
            "row_value", "row_offset", "entry_row", "entry_sample", "entry_joint", "entry_scale", "demand", "entry_demand",
            "entry_target", "jac_constant", "hess_column", "hess_place", "coefficient", "state", "torque", "multiplier",
            "power", "jacobian", "gradient", "cost_first", "cost_second", "cost_mixed", "direction",
            "turned", "theta")),
    ]  # fmt: skip


class CompiledEvaluator(Evaluator):
    """The same numbers from `samples.c`."""

    def __init__(self, layout: Layout, kernels: CompiledKernels, costs: StageCosts | None = None):
        super().__init__(layout, kernels, costs)
        self._library = kernels.library
        numbers = {
            "samples": len(layout.weight), "local": layout.column.shape[1], "coefficients": len(layout.unknowns.block),
            "blocks": layout.unknowns.count, "linear_rows": len(layout.linear.lower), "torque_rows": len(layout.torque.lower),
            "entries": len(layout.torque.row), "demanded": len(layout.demand), "jac_nonzeros": len(layout.jac_row),
            "hess_nonzeros": len(layout.hess_row),
        }  # fmt: skip
        self._program = _Program(**numbers, **{name: array.ctypes.data for name, array in self.arrays.items()})
        self._pointer = ctypes.byref(self._program)
        self._held: dict[str, np.ndarray] = {}
        self._hand("theta", kernels.theta)

    @property
    def native(self) -> tuple[int, dict[str, int]]:
        """Addresses of the C struct and, by name, of the functions that take it: a solver in C needs no Python to call them.

        Raises:
            AttributeError: the cost terms are evaluated in Python.
        """
        if self.costs is not None:
            raise AttributeError("native: cost terms other than squares are evaluated in Python")
        return ctypes.addressof(self._program), self.addresses("eo_program")

    def addresses(self, family: str) -> dict[str, int]:
        """Of the functions of a family in the compiled library, by what they give."""
        names = ("state", "objective", "constraints", "gradient", "jacobian", "hessian")
        address = lambda name: ctypes.cast(getattr(self._library, f"{family}_{name}"), ctypes.c_void_p).value
        return {name: address(name) for name in names}

    def keep_turned(self) -> None:
        """Let C find the place of `turned` before the first Hessian."""
        self._hand("turned", self.turned)

    def move(self, x: np.ndarray) -> None:
        self._library.eo_program_state(self._pointer, _pointer(x))

    def objective(self) -> float:
        if self.costs is not None:
            return self.costs.value(self.state, self.torque, self.arrays["weight"])
        return self._library.eo_program_objective(self._pointer)

    def constraints(self, x: np.ndarray, out: np.ndarray) -> None:
        self._library.eo_program_constraints(self._pointer, _pointer(x), _pointer(out))

    def gradient(self, out: np.ndarray) -> None:
        if self.costs is not None:
            self._hand("cost_first", self._first())
        self._library.eo_program_gradient(self._pointer, _pointer(out))

    def jacobian(self, out: np.ndarray) -> None:
        self._library.eo_program_jacobian(self._pointer, _pointer(out))

    def hessian(self, sigma: float, multipliers: np.ndarray, out: np.ndarray) -> None:
        if self.costs is not None:
            second, mixed = self.costs.second(self.state, self.torque, self.arrays["weight"])
            for name, values in (("cost_first", self._first()), ("cost_second", second), ("cost_mixed", mixed)):
                self._hand(name, values)
        self._hand("direction", self.direction)
        self._hand("turned", self.turned)
        self._library.eo_program_hessian(self._pointer, ctypes.c_double(sigma), _pointer(multipliers), _pointer(out))

    def _hand(self, name: str, values: np.ndarray | None) -> None:
        """Let a field of the C struct point to an array, and keep the array alive."""
        held = None if values is None else np.ascontiguousarray(values, dtype=float)
        self._held[name] = held
        setattr(self._program, name, None if held is None else held.ctypes.data)


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.__array_interface__["data"][0])


def _arrays(P: Layout) -> dict[str, np.ndarray]:
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
