"""The clock from which the stages of a plan are timed: wall time, unless another one is put in its place.

Deadlines are not its business: they are times of `time.monotonic`, whatever stages are timed by.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_read: Callable[[], float] = time.perf_counter


def now() -> float:
    """Seconds since a moment that does not matter."""
    return _read()


@contextmanager
def timed_by(clock: Callable[[], float]) -> Iterator[None]:
    """While this runs, the stages of plans made in this process are timed by another clock, such as `time.process_time`."""
    global _read
    kept, _read = _read, clock
    try:
        yield
    finally:
        _read = kept
