"""A progress bar on standard error, where that is a terminal: one line, drawn ten times a second at most, and gone at the end."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

BETWEEN = 0.1
"""Seconds between two drawings, at least."""
WIDTH = 30
Counter = Callable[[int, int, int | None], None]
"""Called with (done, failed, total) whenever something ends; the total is None where nobody knows it."""
_ERASE = "\r\x1b[K"


class Bar:
    """How many of ``total`` are done, how many failed, how long the rest will take; without a total, how many a second."""

    def __init__(self, stream: TextIO | None = None):
        self._stream = sys.stderr if stream is None else stream
        self._began, self._drawn = time.monotonic(), -BETWEEN

    def __call__(self, done: int, failed: int, total: int | None) -> None:
        now = time.monotonic()
        if now - self._drawn < BETWEEN and done != total:
            return
        self._drawn = now
        columns = shutil.get_terminal_size().columns
        self._stream.write(_ERASE + line(done, failed, total, now - self._began)[: columns - 1])
        self._stream.flush()

    def clear(self) -> None:
        """Leave the line as it was."""
        self._drawn = -BETWEEN
        self._stream.write(_ERASE)
        self._stream.flush()


class Tally:
    """Counts what ends, and tells it.

    Args:
        progress: what to tell; True draws a bar, where standard error is a terminal.
        total: how many there are.
    """

    def __init__(self, progress: bool | Counter, total: int | None):
        self._bar = Bar() if progress is True and sys.stderr is not None and sys.stderr.isatty() else None
        self._show, self._total = self._bar or (progress if callable(progress) else None), total
        self.done = self.failed = 0

    def __call__(self, good: bool) -> None:
        self.done, self.failed = self.done + 1, self.failed + (not good)
        if self._show is not None:
            self._show(self.done, self.failed, self._total)

    def clear(self) -> None:
        """Make room for other text on the terminal; the next call draws the bar anew."""
        if self._bar is not None:
            self._bar.clear()


@contextmanager
def told(progress: bool | Counter, total: int | None) -> Iterator[Tally]:
    """A tally to be called with whether it is good, whenever something ends; its bar goes with the block."""
    tally = Tally(progress, total)
    try:
        yield tally
    finally:
        tally.clear()


def line(done: int, failed: int, total: int | None, seconds: float) -> str:
    """One line of text; the rest is expected to take as long, each, as what is done."""
    words = [f"{failed} failed"] if failed else []
    if not total:
        words.append(f"{done / seconds:.3g} a second" if done and seconds > 0 else "")
        return f"  {done} done  " + ", ".join(filter(None, words))
    full = WIDTH * min(done, total) // total
    if done:
        words.append(f"{clock(seconds)} done" if done >= total else f"{clock(seconds * (total - done) / done)} left")
    return f"  [{'=' * full}{' ' * (WIDTH - full)}] {done}/{total}  " + ", ".join(words)


def clock(seconds: float) -> str:
    """Minutes and seconds, or hours: 0:07, 12:30, 3:00:00."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
