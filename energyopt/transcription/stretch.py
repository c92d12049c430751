"""The duration as an unknown: T = T₀ e^θ, θ the last unknown of the program, with exact first and second derivatives.

A motion space over [0, T₀] describes the path in s = t/T; on a motion e^θ times as long derivatives of order o are e^{−oθ} of
what the space says, and quadrature weights e^θ. What the boundary states fix, offsets of the coefficients, has parts from
position, velocity and acceleration that grow with e^{pθ}, p = 0, 1, 2, so that velocities at the ends stay what was asked.
So the derivative of order o of a sample is

    z_o = e^{−oθ} B_o x + Σ_p e^{(p−o)θ} B_o part_p,      ∂z_o/∂θ = ż_o,   ∂²z_o/∂θ² = z̈_o,   ∂²z_o/∂θ∂x = −o ∂z_o/∂x,

and with g_k, H_k gradient and Hessian of a sample's share in the Lagrangian, of which σℓ_k has the weight e^θ and torque rates
the factor e^{−θ}, the Hessian has the border ∂²L/∂θ∂x = Bᵀ(Hż − o g + σ∇ℓ − ∇rates) and the corner written in `hessian`.
Rows are kept as e^{−oθ}(…) between their limits. The rest of the program does not know of it: its arrays are rewritten.
"""

from __future__ import annotations

import ctypes

import numpy as np

from energyopt.parameterizations.space import BoundaryState, MotionSpace
from energyopt.transcription.evaluators import CompiledEvaluator, Evaluator
from energyopt.transcription.extras import ExtraRows

ORDERS = np.arange(3)


def offset_parts(space: MotionSpace, start: BoundaryState, goal: BoundaryState) -> np.ndarray:
    """Offsets of the coefficients by what they come from: position, velocity, acceleration at the ends, (3, size, nv)."""
    nothing = np.zeros_like(start.velocity)

    def only(state: BoundaryState, kind: int) -> BoundaryState:
        position = state.position if kind == 0 or state.position is None else nothing
        return BoundaryState(
            position, *(value if kind == k else nothing for k, value in ((1, state.velocity), (2, state.acceleration)))
        )

    return np.array([space.unknowns(only(start, kind), only(goal, kind)).offset for kind in range(3)])


class CompiledStretch:
    """The numbers of `stretch.c`."""

    def __init__(self, base: CompiledEvaluator, numbers: dict[str, np.ndarray], row_offset: np.ndarray):
        """``numbers``: the base's arrays for θ = 0; ``row_offset``: the offset of its linear rows then."""
        P, A = base.layout, base.arrays
        self._kept = {
            **numbers,
            "row_offset": np.ascontiguousarray(row_offset, dtype=float),
            **{f"now_{name}": A[name] for name in (*NUMBERS, "row_offset", "jac_constant")},
            "row_order": np.ascontiguousarray(P.linear.order, dtype=np.intc),
            "entry_rate": np.ascontiguousarray(P.torque.rate, dtype=np.intc),
            "jac_linear": np.ascontiguousarray(P.jac_linear, dtype=np.intc),
            "scratch": np.zeros(max(P.size, 1)),
            "lagged": np.zeros_like(A["state"]),
        }
        address, _ = base.native
        base.keep_turned()
        self._struct = _Stretched(address, *(self._kept[name].ctypes.data for name in _FIELDS))
        self._base = base

    @property
    def native(self) -> tuple[int, dict[str, int]]:
        return ctypes.addressof(self._struct), self._base.addresses("eo_stretched")


NUMBERS = ("basis", "weight", "row_value", "entry_scale")
"""Arrays of a program that change with θ, but for those that follow from them."""
_FIELDS = (
    *("basis", "weight", "row_value", "row_offset", "entry_scale"),
    *("now_basis", "now_weight", "now_row_value", "now_row_offset", "now_entry_scale", "now_jac_constant"),
    *("row_order", "entry_rate", "jac_linear", "scratch", "lagged"),
)


class _Stretched(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("program", *_FIELDS)]


class StretchedEvaluator:
    """The evaluator of a program with θ behind its unknowns.

    ``base`` evaluates the layout, ``inner`` the program without θ (``base``, or what extends it), ``parts`` are `offset_parts`.
    """

    def __init__(
        self, base: Evaluator, inner, extras: list[ExtraRows], sizes: tuple[int, int], patterns: tuple, parts: np.ndarray
    ):
        """``sizes``: unknowns and rows without θ; ``patterns``: their Jacobian's and Hessian's."""
        self._base, self._inner, self._extras, self._parts = base, inner, extras, parts
        self._n, self._m = sizes
        self._own = len(base.layout.linear.lower), base.layout.rows
        (jac_start, jac_row), (hess_start, hess_row) = patterns
        self.jacobian_pattern = np.append(jac_start, jac_start[-1] + self._m), np.append(jac_row, np.arange(self._m))
        self.hessian_pattern = np.append(hess_start, hess_start[-1] + self._n + 1), np.append(hess_row, np.arange(self._n + 1))
        P = base.layout
        self._numbers = {name: base.arrays[name].copy() for name in NUMBERS}
        self._still, self._compiled = not np.any(parts[1:]), None
        self._row_parts = P.linear.parts
        self._ends = np.einsum("kol,pkli->pkoi", P.basis, parts[:, P.column])

    @property
    def native(self) -> tuple[int, dict[str, int]]:
        """As that of a compiled evaluator, by `stretch.c`.

        Raises:
            AttributeError: something is evaluated in Python.
        """
        if self._extras or not self._still or not hasattr(self._base, "native"):
            raise AttributeError("native: extra terms, or motions that start or end at speed, are evaluated in Python")
        if self._compiled is None:
            self._compiled = CompiledStretch(self._base, self._numbers, self._row_parts[0])
        return self._compiled.native

    def move(self, x):
        self._x, self._theta = x, float(x[-1])
        self._rates = self._sampled = self._jacobian = self._slopes = None
        self._stretch(self._theta)
        for extra in self._extras:
            extra.stretch(self._theta)
        self._inner.move(x[:-1])

    def objective(self):
        return self._inner.objective()

    def constraints(self, x, out):
        self._inner.constraints(x[:-1], out)

    def gradient(self, out):
        self._inner.gradient(out[:-1])
        base = self._base
        self._sampled = base.arrays["gradient"]
        out[-1] = base.objective() + float(np.vdot(self._sampled, self._speed))
        out[-1] += sum(extra.in_theta(self._x[:-1], 1.0, np.zeros(len(extra.row_lower))).slope for extra in self._extras)

    def jacobian(self, out):
        first = len(out) - self._m
        self._inner.jacobian(out[:first])
        column, (linear, own) = out[first:], self._own
        column[:linear] = self._linear_slopes()[0]
        column[linear:own] = self._torque_slopes()
        for rows, extra in self._extra_rows():
            column[rows] = extra.in_theta(self._x[:-1], 0.0, np.zeros(rows.stop - rows.start)).rows

    def hessian(self, sigma, multipliers, out):
        base, n = self._base, self._n
        first = len(out) - n - 1
        base.direction = self._speed
        self._inner.hessian(sigma, multipliers[: self._m], out[:first])
        linear, own = self._own
        if self._sampled is None:
            self._inner.gradient(np.empty(n))
            self._sampled = base.arrays["gradient"]
        objective = sigma * self._sampled
        rows, rates = self._row_gradients(multipliers[:own])
        crossed, z = out[first:], (len(objective), 3, -1)
        crossed[:] = 0.0
        y = base.turned + objective + rates - np.repeat(ORDERS, base.layout.nv) * (objective + rows)
        self._gather(y.reshape(z), crossed)
        bend = np.vdot(self._speed, base.turned) + np.vdot(objective + rows, self._change)
        bend += 2.0 * np.vdot(objective + rates, self._speed) + sigma * base.objective()
        bend += self._rate_bend(multipliers[:own]) + multipliers[:linear] @ self._linear_slopes()[1]
        P, lambdas = base.layout.linear, multipliers[:linear]
        crossed[:n] += np.bincount(P.column, (-P.order * lambdas)[P.row] * base.arrays["row_value"], minlength=n)
        for rows_of, extra in self._extra_rows():
            terms = extra.in_theta(self._x[:-1], sigma, multipliers[rows_of])
            crossed[: len(terms.crossed)] += terms.crossed
            bend += terms.bent
        crossed[n] = bend

    @property
    def _speed(self) -> np.ndarray:
        """ż, (N, 3 nv)."""
        return self._state_rates()[0]

    @property
    def _change(self) -> np.ndarray:
        """z̈, (N, 3 nv)."""
        return self._state_rates()[1]

    def _state_rates(self) -> tuple[np.ndarray, np.ndarray]:
        if self._rates is None:
            z = self._base.state.reshape(-1, 3, self._base.layout.nv)
            if self._still:
                speed, change = -ORDERS[:, None] * z, ORDERS[:, None] ** 2 * z
            else:
                powers = np.arange(3)[:, None] - ORDERS  # p − o
                ends = np.exp(powers * self._theta)[:, None, :, None] * self._ends
                own = z - ends.sum(axis=0)
                speed = -ORDERS[:, None] * own + np.einsum("po,pkoi->koi", powers, ends)
                change = ORDERS[:, None] ** 2 * own + np.einsum("po,pkoi->koi", powers**2, ends)
            self._rates = speed.reshape(len(z), -1), change.reshape(len(z), -1)
        return self._rates

    def _entry_jacobian(self) -> np.ndarray:
        """∂τ/∂z of the sample and joint of each entry of the torque rows, (entries, 3 nv)."""
        if self._jacobian is None:
            base, P = self._base, self._base.layout
            J = base.kernels.jacobian(base.state[P.demand])[1]
            self._jacobian = base.arrays["entry_scale"][:, None] * J[P.entry_demand, P.torque.joint]
        return self._jacobian

    def _stretch(self, theta: float) -> None:
        """Rewrite the arrays of the base program."""
        A, P, N = self._base.arrays, self._base.layout, self._numbers
        powers = np.exp(-theta * np.arange(4))
        A["basis"][:] = N["basis"] * powers[:3, None]
        A["weight"][:] = N["weight"] / powers[1]
        A["row_value"][:] = N["row_value"] * powers[P.linear.order][P.linear.row]
        A["entry_scale"][:] = np.where(P.torque.rate, powers[1], 1.0) * N["entry_scale"]
        A["jac_constant"][P.jac_linear] = A["row_value"]
        grown = np.exp(theta * np.arange(3))
        if not self._still:
            A["offset"][:] = np.einsum("p,pji->ji", grown, self._parts)
        A["row_offset"][:] = powers[P.linear.order] * (grown @ self._row_parts)

    def _linear_slopes(self) -> tuple[np.ndarray, np.ndarray]:
        """First and second derivative of the linear rows in θ."""
        if self._slopes is not None:
            return self._slopes
        P, A = self._base.layout.linear, self._base.arrays
        own = np.bincount(P.row, A["row_value"] * self._x[P.column], minlength=len(P.lower))
        powers = np.arange(3)[:, None] - P.order  # p − o
        ends = np.exp(powers * self._theta) * self._row_parts
        self._slopes = -P.order * own + (powers * ends).sum(axis=0), P.order**2 * own + (powers**2 * ends).sum(axis=0)
        return self._slopes

    def _torque_slopes(self) -> np.ndarray:
        base, T = self._base, self._base.layout.torque
        if not len(T.row):
            return np.zeros(0)
        rise = np.einsum("ea,ea->e", self._entry_jacobian(), self._speed[T.sample])
        rise -= base.arrays["entry_scale"] * T.rate * base.torque[T.sample, T.joint]
        return np.bincount(T.row, rise, minlength=len(T.lower))

    def _row_gradients(self, multipliers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of μᵀτ in each sample's state, and of its derivative in the factor of the rates, both (N, 3 nv)."""
        base, T = self._base, self._base.layout.torque
        rows, rates = np.zeros_like(base.state), np.zeros_like(base.state)
        if len(T.row):
            shares = multipliers[base.arrays["entry_row"]][:, None] * self._entry_jacobian()
            np.add.at(rows, T.sample, shares)
            np.subtract.at(rates, T.sample, T.rate[:, None] * shares)
        return rows, rates

    def _rate_bend(self, multipliers: np.ndarray) -> float:
        base, T = self._base, self._base.layout.torque
        return float((T.rate * base.row_multipliers(multipliers)) @ base.torque[T.sample, T.joint])

    def _gather(self, y: np.ndarray, out: np.ndarray) -> None:
        """Add Bᵀ y of all samples, y (N, 3, nv)."""
        P = self._base.layout
        local = np.einsum("kol,koi->kli", self._base.arrays["basis"], y).reshape(-1, P.nv)
        block = P.unknowns.block[P.column].ravel()
        known = block >= 0
        place = (block[known, None] * P.nv + np.arange(P.nv)).ravel()
        out[: P.size] += np.bincount(place, local[known].ravel(), minlength=P.size)

    def _extra_rows(self):
        """The rows of each extra, and the extra."""
        first = self._own[1]
        for extra in self._extras:
            yield slice(first, first + len(extra.row_lower)), extra
            first += len(extra.row_lower)
