"""Ctrl-C during long work: remembered, so that what has been reached can be kept."""

from __future__ import annotations

import signal
import threading


class Interrupts:
    """A context in which SIGINT sets a flag in place of raising KeyboardInterrupt.

    CasADi swallows the exception inside a solve, and between solves it would lose the best motion. Calling the object
    tells whether SIGINT came. A second one while the first is being handled raises as usual. Outside the main thread, where
    Python delivers no signals, the context does nothing.
    """

    def __init__(self):
        self._seen = False

    def __call__(self) -> bool:
        return self._seen

    def __enter__(self) -> Interrupts:
        self._previous = None
        if threading.current_thread() is threading.main_thread():
            self._previous = signal.signal(signal.SIGINT, self._notice)
        return self

    def __exit__(self, *_) -> None:
        if self._previous is not None:
            signal.signal(signal.SIGINT, self._previous)

    def _notice(self, *_) -> None:
        if self._seen:
            raise KeyboardInterrupt
        self._seen = True
