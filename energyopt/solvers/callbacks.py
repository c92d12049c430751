"""A program's functions as CasADi sees them: callbacks that work on CasADi's own buffers.

A program has `size`, `rows`, bounds, `jacobian_pattern`, `hessian_pattern` and an `evaluator` with `move(x)`, `objective`,
`constraints`, `gradient`, `jacobian` and `hessian`; the motion is evaluated once for each new x.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import casadi as ca
import numpy as np

from energyopt.solvers.result import Progress, violation


class Call(ca.Callback):
    """A CasADi function whose value is computed by ``evaluate(inputs, outputs)`` on NumPy views of CasADi's own buffers."""

    def __init__(self, name: str, inputs: dict, outputs: dict, evaluate: Callable):
        ca.Callback.__init__(self)
        self._inputs, self._outputs, self._evaluate = list(inputs.items()), list(outputs.items()), evaluate
        self.construct(name, {})

    def get_n_in(self):
        return len(self._inputs)

    def get_n_out(self):
        return len(self._outputs)

    def get_name_in(self, i):
        return self._inputs[i][0]

    def get_name_out(self, i):
        return self._outputs[i][0]

    def get_sparsity_in(self, i):
        return self._inputs[i][1]

    def get_sparsity_out(self, i):
        return self._outputs[i][1]

    def has_eval_buffer(self):
        return True

    def eval_buffer(self, arguments, results):
        self._evaluate(arguments, results)
        return 0


class ProgramFunctions:
    """The five functions of a program as CasADi sees them. The motion is evaluated once for each new x."""

    def __init__(self, program):
        self._evaluator = program.evaluator
        self._x, self._seen = np.zeros(program.size), None
        self.calls = dict.fromkeys(("state", "gradient", "jacobian", "hessian"), 0)
        dense, n, m = ca.Sparsity.dense, program.size, program.rows
        x, f, g = {"x": dense(n), "p": ca.Sparsity(0, 0)}, {"f": dense(1)}, {"g": dense(m)}
        jacobian = _sparsity(m, n, program.jacobian_pattern)
        hessian = _sparsity(n, n, program.hessian_pattern)
        weights = {"lam_f": dense(1), "lam_g": dense(m)}
        self.problem = Call("program", x, f | g, self._problem)
        self.gradient = Call("slope", x, f | {"grad_f_x": dense(n)}, self._gradient)
        self.jacobian = Call("row_jacobian", x, g | {"jac_g_x": jacobian}, self._jacobian)
        self.hessian = Call("curvature", x | weights, {"triu_hess_gamma_x_x": hessian}, self._hessian)

    def _move(self, buffer) -> np.ndarray:
        seen = bytes(buffer)
        if seen != self._seen:
            self._seen, self._x[:] = seen, np.frombuffer(buffer)
            self._evaluator.move(self._x)
            self.calls["state"] += 1
        return self._x

    def _problem(self, arguments, results):
        x = self._move(arguments[0])
        if results[0] is not None:
            np.frombuffer(results[0])[0] = self._evaluator.objective()
        if results[1] is not None:
            self._evaluator.constraints(x, np.frombuffer(results[1]))

    def _gradient(self, arguments, results):
        self._move(arguments[0])
        self.calls["gradient"] += 1
        if results[0] is not None:
            np.frombuffer(results[0])[0] = self._evaluator.objective()
        if results[1] is not None:
            self._evaluator.gradient(np.frombuffer(results[1]))

    def _jacobian(self, arguments, results):
        x = self._move(arguments[0])
        self.calls["jacobian"] += 1
        if results[0] is not None:
            self._evaluator.constraints(x, np.frombuffer(results[0]))
        if results[1] is not None:
            self._evaluator.jacobian(np.frombuffer(results[1]))

    def _hessian(self, arguments, results):
        self._move(arguments[0])
        self.calls["hessian"] += 1
        multipliers = np.frombuffer(arguments[3]) if arguments[3] is not None and len(arguments[3]) else np.zeros(0)
        self._evaluator.hessian(float(np.frombuffer(arguments[2])[0]), multipliers, np.frombuffer(results[0]))


STALL_ITERATIONS = 40
STALL_CHANGE = 1e-6
"""A feasible solve whose objective has not changed by this share of the first in so many iterations is at its end: where the
optimum is not unique (joints that cost nothing), the gradient falls too slowly to meet a tolerance."""
STALL_VIOLATION = 1e-9


class Monitor(ca.Callback):
    """IPOPT's view from outside, once an iteration: reports progress, and stops it on request or where it stalls.

    An exception raised by ``progress`` ends the solve and is kept in ``error``; ``last`` is the last iterate, its objective and
    its number, None before there is one.
    """

    def __init__(self, program, progress: Progress | None, time_limit: float | None, stop: Callable[[], bool] | None):
        ca.Callback.__init__(self)
        self._program, self._progress, self._stop = program, progress, stop
        self._deadline = None if time_limit is None else time.monotonic() + time_limit
        self._objectives: list[float] = []
        self.interrupted = self.out_of_time = self.stalled = False
        self.error: BaseException | None = None
        self.last: tuple[np.ndarray, float, int] | None = None
        n, m = program.size, program.rows
        self._sizes = {"x": n, "f": 1, "g": m, "lam_x": n, "lam_g": m, "lam_p": 0}
        self.construct("monitor", {})

    @property
    def stopped(self) -> bool:
        """Whether the solve was ended from outside."""
        return self.interrupted or self.out_of_time or self.error is not None

    def get_n_in(self):
        return ca.nlpsol_n_out()

    def get_n_out(self):
        return 1

    def get_name_in(self, i):
        return ca.nlpsol_out(i)

    def get_name_out(self, i):
        return "stop"

    def get_sparsity_in(self, i):
        size = self._sizes[ca.nlpsol_out(i)]
        return ca.Sparsity.dense(size, 1) if size else ca.Sparsity(0, 0)

    def has_eval_buffer(self):
        return True

    def eval_buffer(self, arguments, results):
        self._objectives.append(float(np.frombuffer(arguments[1])[0]))
        self.last = (np.array(np.frombuffer(arguments[0])), self._objectives[-1], len(self._objectives) - 1)
        try:
            self._report(arguments)
        except BaseException as error:  # CasADi would print and swallow it; `solve` raises it again once IPOPT has ended
            self.error = error
        if self._unchanged() and self._violation(arguments) <= STALL_VIOLATION:
            self.stalled = True
        if self._deadline is not None and time.monotonic() > self._deadline:
            self.out_of_time = True
        if self._stop is not None and self._stop():
            self.interrupted = True
        if results[0] is not None:
            np.frombuffer(results[0])[0] = float(self.stopped or self.stalled)
        return 0

    def _report(self, arguments) -> None:
        if self._progress is not None:
            self._progress(len(self._objectives) - 1, self._objectives[-1], self._violation(arguments))

    def _unchanged(self) -> bool:
        recent = self._objectives[-STALL_ITERATIONS:]
        return len(self._objectives) > STALL_ITERATIONS and max(recent) - min(recent) <= STALL_CHANGE * abs(self._objectives[0])

    def _violation(self, arguments) -> float:
        g = np.frombuffer(arguments[2]) if self._program.rows else np.zeros(0)
        return violation(self._program, np.frombuffer(arguments[0]), g)


def _sparsity(rows: int, columns: int, pattern: tuple[np.ndarray, np.ndarray]) -> ca.Sparsity:
    start, row = pattern
    return ca.Sparsity(rows, columns, start.tolist(), row.tolist())
