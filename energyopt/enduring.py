"""Calls that outlive the workers they are made on.

A worker that dies takes with it all it had been given, and executors do not say which of those killed it: a pool of processes
gives up whatever it holds, a dask cluster whatever was on too many workers that died. So each lost call is made once more, in a
process that holds nothing else. What kills that one too is the call itself, and it alone fails.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, InvalidStateError
from contextlib import suppress
from typing import Any

from energyopt.pool import Workers
from energyopt.workers import Worker, cores, name_of

log = logging.getLogger("energyopt")

MOST_LOSSES = 20
"""Losses after which a call that never killed its own process is given up: the workers must be dying of something else."""
_LOST = ("KilledWorker", "WorkerDied", "CommClosedError")
"""Errors of dask.distributed that say that a worker is gone, by name: it is not imported here."""


def is_loss(error: BaseException | None) -> bool:
    """Whether an executor says by this error that a worker is gone."""
    return isinstance(error, BrokenExecutor) or type(error).__name__ in _LOST


def call_apart(name: tuple[str, str], arguments: tuple) -> Any:
    """In a worker: what a function returns that is called in a process of its own.

    Raises:
        WorkerLost: that process ended. Otherwise what the function raises.
    """
    worker = Worker()
    try:
        answer = worker.call(name, arguments)
    finally:
        worker.end()
    if isinstance(answer, Exception):
        raise answer
    return answer


class Enduring(Executor):
    """An executor of the caller, which stays open; functions are those of a module of this package.

    Calls lost with their worker are made again, each in a process of its own beside the workers; where the whole executor is
    broken, all that is left goes to worker processes of this package, which end with `shutdown`.
    """

    def __init__(self, executor: Executor):
        self._executor, self._own, self._changing = executor, None, threading.Lock()
        self._closed = False

    def submit(self, function: Callable, /, *arguments: Any) -> Future:
        return _Call(self._begun, function, arguments)

    def _begun(self, function: Callable, arguments: tuple, losses: int) -> Future:
        if self._closed:
            raise RuntimeError("nobody waits for this call any more")
        try:
            if losses:
                return self._executor.submit(call_apart, name_of(function), arguments)
            return self._executor.submit(function, *arguments)
        except BrokenExecutor as error:
            return self._own_workers(error).submit(function, *arguments)

    def _own_workers(self, error: BrokenExecutor) -> Workers:
        with self._changing:
            if self._own is None and not self._closed:
                count = min(cores(), getattr(self._executor, "_max_workers", None) or cores())
                log.warning("energyopt: the executor is broken (%s); worker processes (%d) take its place", error, count)
                self._own = Workers(count)
            if self._own is None:
                raise error
            return self._own

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes that took the place of a broken executor; that itself is the caller's."""
        with self._changing:
            self._closed = True
            if self._own is not None:
                self._own.shutdown(wait, cancel_futures=cancel_futures)


class _Call(Future):
    """One call, made again where its worker was lost."""

    def __init__(self, begin: Callable[[Callable, tuple, int], Future], function: Callable, arguments: tuple):
        super().__init__()
        self._begin, self._what, self._losses = begin, (function, arguments), 0
        self._attempt: Future | None = None
        self._start()

    def _start(self) -> None:
        self._attempt = attempt = self._begin(*self._what, self._losses)
        if self.cancelled():  # while it was begun
            attempt.cancel()
        attempt.add_done_callback(self._ended)

    def _ended(self, attempt: Future) -> None:
        self._attempt = None  # nor does it hold the result twice
        error = None if attempt.cancelled() else attempt.exception()
        if is_loss(error) and self._losses < MOST_LOSSES and not self.done():
            # In a thread: this is called by one that the executor needs for itself.
            threading.Thread(target=self._again, daemon=True).start()
            return
        self._what = None
        with suppress(InvalidStateError):  # cancelled meanwhile
            if attempt.cancelled():
                super().cancel()
                self.set_running_or_notify_cancel()
            elif error is not None:
                self.set_exception(error)
            else:
                self.set_result(attempt.result())

    def _again(self) -> None:
        if self.done():  # cancelled meanwhile
            return
        self._losses += 1
        try:
            self._start()
        except Exception as error:
            with suppress(InvalidStateError):
                self.set_exception(error)

    def cancel(self) -> bool:
        cancelled = super().cancel()
        attempt = self._attempt  # not before: until then another may have begun
        if cancelled and attempt is not None:
            attempt.cancel()
        return cancelled
