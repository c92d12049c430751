"""Our own interior-point method, in C (`interior.c`): IPOPT's algorithm on a linear algebra made for programs along a time line.

An iteration costs little more than the program's derivatives: where those are compiled too, no Python runs between them. It
knows no restoration of feasibility; a solve that would need one ends without an answer, and IPOPT takes over from the same
start. IPOPT also takes programs with many equality rows, and those whose Hessian would fill the profile.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from contextlib import nullcontext
from functools import cache

import numpy as np

from energyopt.solvers.interrupts import Interrupts, unless_stopped
from energyopt.solvers.native import library_path
from energyopt.solvers.result import DEFAULT, VIOLATION, Outcome, Progress, SolverOptions, SolverResult, scaling

MOST_ITERATIONS = 200
"""Where more are needed something is wrong with the program or the start."""
MOST_EQUALITIES = 32
"""Without exchanges of pivots digits are lost with each equality row: collocation, which has hundreds, is for IPOPT."""
SLICE = 0.02
"""Seconds between two looks at whether an end is wanted."""
SWIFT = 1000
"""Unknowns up to which an iteration takes a few milliseconds, where no Python runs in it."""
WARM = 1e-3
"""Least initial barrier parameter where no multipliers are known. From good starts, given with smaller ones, steps with
predictor and corrector lower it at their own pace, in fewer iterations than from below, where limits that cease to hold are left
slowly."""
PUSH, TRUSTED = 1e-2, 10.0
"""Share of an interval by which the start is moved away from its ends, and the same over the barrier parameter where that is
small: such a start is nearly optimal, and often stands on its limits."""

_STATUS = (
    "running", "converged", "acceptable", "iteration limit", "no step", "not a number", "singular", "too wide", "no memory",
)  # fmt: skip
_OUTCOMES = {"converged": Outcome.CONVERGED, "acceptable": Outcome.ACCEPTABLE, "iteration limit": Outcome.ITERATION_LIMIT}
_CALLS = ("state", "gradient", "jacobian", "hessian")
_NUMBERS = ("objective", "error", "violation", "barrier", "step", "shift", "iterations", *_CALLS)

_Pointer, _Long, _Double = ctypes.c_void_p, ctypes.c_long, ctypes.c_double
_FUNCTIONS = {
    "state": ctypes.CFUNCTYPE(None, _Pointer, _Pointer),
    "objective": ctypes.CFUNCTYPE(_Double, _Pointer),
    "constraints": ctypes.CFUNCTYPE(None, _Pointer, _Pointer, _Pointer),
    "gradient": ctypes.CFUNCTYPE(None, _Pointer, _Pointer),
    "jacobian": ctypes.CFUNCTYPE(None, _Pointer, _Pointer),
    "hessian": ctypes.CFUNCTYPE(None, _Pointer, _Double, _Pointer, _Pointer),
}


class _Functions(ctypes.Structure):
    _fields_ = [(name, _Pointer) for name in (*_FUNCTIONS, "context")]


class _Program(ctypes.Structure):
    _arrays = ("lower", "upper", "row_lower", "row_upper", "jac_start", "jac_row", "hess_start", "hess_row")
    _fields_ = [("n", _Long), ("m", _Long), *((name, _Pointer) for name in _arrays), ("call", _Functions)]


class _Options(ctypes.Structure):
    _fields_ = [
        *((name, _Double) for name in ("tolerance", "violation", "barrier", "scale", "push")),
        ("iterations", _Long),
        ("warm", _Long),
        ("row_guess", _Pointer),
        ("bound_guess", _Pointer),
    ]


def solve(
    program,
    x0: np.ndarray,
    options: SolverOptions = DEFAULT,
    progress: Progress | None = None,
    stop: Callable[[], bool] | None = None,
) -> SolverResult | None:
    """Minimise a program from ``x0``, as `ipopt.solve` does; None where the program is of another kind, or there is no C.

    The outcome is FAILED where the method came to no end: the program may be infeasible.
    """
    if not _suits(program):
        return None
    run = _Run(program, np.ascontiguousarray(x0, float), options, progress, stop)
    with stop.held() if isinstance(stop, Interrupts) else nullcontext():
        if program.size <= SWIFT and hasattr(program.evaluator, "native"):
            return run.result()  # looks at `stop` often enough by itself
        return unless_stopped(run.result, stop) or run.left()


def _suits(program) -> bool:
    equalities = np.count_nonzero(program.row_lower == program.row_upper)
    if library_path(*_SOURCES) is None or not program.size or equalities > min(MOST_EQUALITIES, program.size):
        return False
    return bool(np.all(program.lower < program.upper) and np.all(program.row_lower <= program.row_upper))


_SOURCES = ("skyline.c", "interior_system.c", "interior_steps.c", "interior.c")


@cache
def _library() -> ctypes.CDLL:
    library = ctypes.CDLL(library_path(*_SOURCES))
    library.eo_interior_new.restype = _Pointer
    library.eo_interior_new.argtypes = (_Pointer, _Pointer, _Pointer)
    library.eo_interior_run.restype = _Long
    library.eo_interior_run.argtypes = (_Pointer, _Long, _Double)
    library.eo_interior_read.argtypes = (_Pointer, _Pointer, _Pointer, _Pointer, _Pointer)
    library.eo_interior_free.argtypes = (_Pointer,)
    library.eo_interior_free.restype = library.eo_interior_read.restype = None
    return library


class _Run:
    """One solve, in slices of time between which an end can be asked for."""

    def __init__(self, program, x0, options: SolverOptions, progress, stop):
        self._program, self._x0, self._options, self._progress, self._stop = program, x0, options, progress, stop
        self._limit = min(options.iterations, MOST_ITERATIONS)
        self._deadline = None if options.time_limit is None else time.monotonic() + options.time_limit
        self._x, self._multipliers, self._numbers = x0.copy(), np.zeros(program.rows), np.zeros(len(_NUMBERS))
        self._bounds = np.zeros(program.size)
        self._last = None

    def result(self) -> SolverResult:
        functions = _native(self._program) or _Callbacks(self._program)
        arrays = _arrays(self._program)
        struct = _Program(self._program.size, self._program.rows, *(a.ctypes.data for a in arrays), functions.struct)
        options, scale = self._options, scaling(self._program, self._x0)
        push = min(PUSH, TRUSTED * options.barrier)
        warm = options.barrier < SolverOptions.barrier
        floor = options.barrier if options.multipliers else max(options.barrier, WARM)
        guesses = [np.ascontiguousarray(guess, float) for guess in options.multipliers or ()]
        given = (options.tolerance, VIOLATION, floor, scale, push, self._limit, warm,
                 *(map(_address, guesses) if guesses else (None, None)))  # fmt: skip
        handle = _library().eo_interior_new(ctypes.byref(struct), ctypes.byref(_Options(*given)), _address(self._x0))
        try:
            reason, outcome = self._advance(handle)
        finally:
            _library().eo_interior_free(handle)
        if functions.error is not None:
            raise functions.error
        return self._answer(outcome, reason)

    def left(self) -> SolverResult:
        """What was reached when the solve was left in the middle of an iteration."""
        x, objective, iterations = self._last or (self._x0, np.inf, 0)
        none = np.zeros(self._program.rows)
        return SolverResult(x, none, Outcome.INTERRUPTED, "interrupted", objective, iterations, solver="interior")

    def _advance(self, handle: int) -> tuple[str, Outcome]:
        library, count = _library(), 1 if self._progress else self._limit
        status = library.eo_interior_run(handle, 0, SLICE)
        while True:
            self._read(handle)
            if _STATUS[status] != "running":
                return _STATUS[status], _OUTCOMES.get(_STATUS[status], Outcome.FAILED)
            if self._deadline is not None and time.monotonic() > self._deadline:
                return "time limit", Outcome.TIME_LIMIT
            if self._stop is not None and self._stop():
                return "interrupted", Outcome.INTERRUPTED
            status = library.eo_interior_run(handle, count, SLICE)

    def _read(self, handle: int) -> None:
        arrays = self._x, self._multipliers, self._bounds, self._numbers
        _library().eo_interior_read(handle, *map(_address, arrays))
        self._last = self._x.copy(), self._numbers[0], int(self._numbers[_NUMBERS.index("iterations")])
        if self._progress is not None:
            objective, iteration = self._last[1:]
            self._progress(iteration, float(objective), float(self._numbers[_NUMBERS.index("violation")]))

    def _answer(self, outcome: Outcome, reason: str) -> SolverResult:
        numbers = dict(zip(_NUMBERS, self._numbers, strict=True))
        calls = {name: int(numbers[name]) for name in _CALLS}
        x, objective = self._x, float(numbers["objective"])
        if not np.all(np.isfinite(x)):
            x, outcome = self._x0, Outcome.FAILED
        counts = int(numbers["iterations"]), calls, "interior", self._bounds
        return SolverResult(x, self._multipliers, outcome, reason, objective, *counts)


class _Native:
    """The functions of an evaluator that are compiled."""

    error = None

    def __init__(self, evaluator):
        context, addresses = evaluator.native
        self.struct = _Functions(*(addresses[name] for name in _FUNCTIONS), context)
        self._kept = evaluator


def _native(program) -> _Native | None:
    return _Native(program.evaluator) if hasattr(program.evaluator, "native") else None


class _Callbacks:
    """The functions of any evaluator, called back from C. What they raise is kept, and ends the solve as if J were no number."""

    def __init__(self, program):
        self._evaluator, self._x = program.evaluator, np.zeros(program.size)
        self._sizes = program.size, program.rows, len(program.jacobian_pattern[1]), len(program.hessian_pattern[1])
        self.error: BaseException | None = None
        self._kept = [kind(self._guarded(getattr(self, f"_{name}"))) for name, kind in _FUNCTIONS.items()]
        self.struct = _Functions(*(ctypes.cast(function, _Pointer).value for function in self._kept), None)

    def _guarded(self, function):
        def call(context, *arguments):
            if self.error is None:
                try:
                    return function(*arguments)
                except BaseException as error:
                    self.error = error
            return np.nan if function == self._objective else None

        return call

    def _state(self, x):
        self._x[:] = _view(x, self._sizes[0])
        self._evaluator.move(self._x)

    def _objective(self):
        return float(self._evaluator.objective())

    def _constraints(self, x, g):
        self._evaluator.constraints(self._x, _view(g, self._sizes[1]))

    def _gradient(self, g):
        self._evaluator.gradient(_view(g, self._sizes[0]))

    def _jacobian(self, values):
        self._evaluator.jacobian(_view(values, self._sizes[2]))

    def _hessian(self, sigma, multipliers, values):
        self._evaluator.hessian(sigma, _view(multipliers, self._sizes[1]), _view(values, self._sizes[3]))


def _arrays(program) -> list[np.ndarray]:
    reals = program.lower, program.upper, program.row_lower, program.row_upper
    integers = *program.jacobian_pattern, *program.hessian_pattern
    return [np.ascontiguousarray(a, float) for a in reals] + [np.ascontiguousarray(a, np.intc) for a in integers]


def _address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


def _view(address: int | None, count: int) -> np.ndarray:
    """``count`` doubles that C owns."""
    return np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(_Double)), (count,)) if count else np.zeros(0)
