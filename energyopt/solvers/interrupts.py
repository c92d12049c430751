"""Ctrl-C during long work: whatever has been reached is kept."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

POLL = 0.02
"""Seconds between two looks at whether an end is wanted."""
GRACE = 0.06
"""Seconds for a solve to stop by itself; an iteration of a large program may take longer than that."""

Result = TypeVar("Result")


class Interrupts:
    """A context in which SIGINT is remembered: calling the object tells whether it came.

    It raises KeyboardInterrupt as usual, at once, except inside `held`, where it only is remembered. A second one raises
    everywhere. Outside the main thread, where Python delivers no signals, the context does nothing.
    """

    def __init__(self):
        self._seen, self._holders, self._previous = False, 0, None

    def __call__(self) -> bool:
        return self._seen

    @contextmanager
    def held(self) -> Iterator[None]:
        """Where an exception would lose what was reached, or be swallowed by the code that calls back into Python."""
        self._holders += 1
        try:
            yield
        finally:
            self._holders -= 1

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            self._previous = signal.signal(signal.SIGINT, self._notice)
        return self

    def __exit__(self, *_) -> None:
        if self._previous is not None:
            signal.signal(signal.SIGINT, self._previous)

    def _notice(self, *_) -> None:
        first, self._seen = not self._seen, True
        if not (first and self._holders):
            raise KeyboardInterrupt


def unless_stopped(work: Callable[[], Result], stop: Callable[[], bool] | None) -> Result | None:
    """Do some work that is mostly one library call, or leave it where an end is wanted and it does not come.

    In the main thread the work is given to another one, so that signals are heard meanwhile: Python's handlers wait for the
    end of a library call. Work that is left goes on until it looks at ``stop`` itself.

    Returns:
        what ``work`` returns; None where it was left.

    Raises:
        whatever ``work`` raises.
    """
    if stop is None or threading.current_thread() is not threading.main_thread():
        return work()
    done, found = threading.Event(), {}

    def do() -> None:
        try:
            found["result"] = work()
        except BaseException as error:
            found["error"] = error
        finally:
            done.set()

    threading.Thread(target=do).start()
    while not done.wait(POLL):
        if stop() and not done.wait(GRACE):
            return None
    if "error" in found:
        raise found["error"]
    return found["result"]
