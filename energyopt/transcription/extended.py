"""The evaluator of a program with extras."""

from __future__ import annotations

import numpy as np

from energyopt.transcription.extras import ExtraRows


class ExtendedEvaluator:
    """A program's evaluator with extra rows and unknowns behind its own."""

    def __init__(self, base, size: int, rows: int, base_patterns: tuple, extras: list[ExtraRows]):
        self._base, self._size, self._rows, self.extras = base, size, rows, extras
        self._counts = [len(extra.row_lower) for extra in extras]
        total = size + sum(extra.variables for extra in extras)
        first = rows + np.cumsum([0, *self._counts])
        jacobians = [extra.jacobian_pattern() for extra in extras]
        (jac_start, jac_row), (hess_start, hess_row) = base_patterns
        parts = [(jac_row, _columns(jac_start))] + [(r + f, c) for (r, c), f in zip(jacobians, first, strict=False)]
        self.jacobian_pattern, self._jac_place = _merged(parts, int(first[-1]), total)
        parts = [(hess_row, _columns(hess_start)), *(extra.hessian_pattern() for extra in extras)]
        self.hessian_pattern, self._hess_place = _merged(parts, total, total)
        self._jac_base, self._hess_base = np.zeros(len(jac_row)), np.zeros(len(hess_row))

    def move(self, x):
        self._x = x
        self._base.move(x[: self._size])
        self._values = [extra.evaluate(x) for extra in self.extras]

    def objective(self):
        return self._base.objective() + sum(extra.objective() for extra in self.extras)

    def constraints(self, x, out):
        own = np.empty(self._rows)
        self._base.constraints(x[: self._size], own)
        out[:] = np.concatenate([own, *(v for v, _ in self._values)])

    def gradient(self, out):
        own = np.empty(self._size)
        self._base.gradient(own)
        out[: self._size], out[self._size :] = own, 0.0
        for extra in self.extras:
            slope = extra.gradient()
            if slope is not None:
                out[: len(slope)] += slope

    def jacobian(self, out):
        self._base.jacobian(self._jac_base)
        values = np.concatenate([self._jac_base, *(j for _, j in self._values)])
        out[:] = np.bincount(self._jac_place, values, minlength=len(out))

    def hessian(self, sigma, multipliers, out):
        self._base.hessian(sigma, multipliers[: self._rows].copy(), self._hess_base)
        parts, first = [self._hess_base], self._rows
        for extra, count in zip(self.extras, self._counts, strict=True):
            parts.append(extra.curvature(self._x, sigma, multipliers[first : first + count]))
            first += count
        out[:] = np.bincount(self._hess_place, np.concatenate(parts), minlength=len(out))


def _columns(start: np.ndarray) -> np.ndarray:
    return np.repeat(np.arange(len(start) - 1), np.diff(start))


def _merged(parts: list, rows: int, columns: int) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """One compressed-column pattern of several, and the place in it of each of their entries."""
    row, column = (np.concatenate([np.asarray(part[k], np.int64) for part in parts]) for k in (0, 1))
    keys, place = np.unique(column * rows + row, return_inverse=True)
    return (np.searchsorted(keys, np.arange(columns + 1, dtype=np.int64) * rows), keys % rows), place
