"""Threads: linear algebra on one, since the matrices of a plan are small and several threads on them mostly wait for one another;
independent work on as many as there are cores."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from typing import TypeVar

from threadpoolctl import ThreadpoolController

from energyopt.workers import cores

Item = TypeVar("Item")
Result = TypeVar("Result")


class _SingleThread:
    """The limit is the whole process's: the first thread inside sets it, and the last one to leave takes it back."""

    def __init__(self):
        self._inside, self._limit, self._changing = 0, None, threading.Lock()

    @contextmanager
    def __call__(self) -> Iterator[None]:
        with self._changing:
            if not self._inside:
                self._limit = _controller().limit(limits=1, user_api="blas")
            self._inside += 1
        try:
            yield
        finally:
            with self._changing:
                self._inside -= 1
                if not self._inside:
                    self._limit.restore_original_limits()


single_thread = _SingleThread()
"""A context in which NumPy's and SciPy's linear algebra keeps to one thread, in any number of threads of the caller."""


@cache
def _controller() -> ThreadpoolController:
    """Knows the libraries that are loaded when it is made, so it is made once NumPy and SciPy are."""
    import scipy.linalg  # noqa: F401

    return ThreadpoolController()


class Unwanted(Exception):
    """Raised in work whose result nobody waits for any more."""


Wanted = Callable[[], None]
"""To be called now and then by long work: raises `Unwanted` where it may end."""


def always_wanted() -> None:
    """A `Wanted` that never raises."""


def side_by_side(work: Callable[[Item, Wanted], Result], items: Iterable[Item]) -> list[Result]:
    """Results of ``work`` for each item, in order, computed by as many threads as there are cores.

    Where one fails, or Ctrl-C comes, what has not begun never does, and what has is told by its second argument; this returns
    when all threads have ended.

    Raises:
        what ``work`` raised: of the first item, in their order, that failed by itself.
    """
    left = threading.Event()

    def wanted() -> None:
        if left.is_set():
            raise Unwanted

    def begun(item: Item) -> Result:
        wanted()
        try:
            return work(item, wanted)
        except BaseException:  # here, not where results are collected: this thread takes the next item at once
            left.set()
            raise

    with ThreadPoolExecutor(max_workers=cores()) as pool:
        try:
            jobs = [pool.submit(begun, item) for item in items]
            wait(jobs)
        except BaseException:  # KeyboardInterrupt is one
            left.set()
            raise
    errors = [error for job in jobs if (error := job.exception()) is not None]
    if errors:
        raise min(errors, key=lambda error: isinstance(error, Unwanted))
    return [job.result() for job in jobs]
