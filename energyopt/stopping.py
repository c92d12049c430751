"""Ctrl-C on the command line: the process ends within half a second with exit code 130, whatever it is doing.

The first SIGINT raises KeyboardInterrupt in the main thread, as ever, or ends a solve with its motion kept (see
`solvers.Interrupts`). But Python runs no handler while the main thread is inside a library call, and some calls last longer. So a
second thread hears the signal as well, through the pipe of ``signal.set_wakeup_fd``, and ends the process where the main
thread has not by then. Files are never cut: what writes them holds `whole_files`.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import NoReturn

from energyopt.exit_codes import INTERRUPTED

PATIENCE = 0.33
"""Seconds from the signal to the end for whoever has something left to save."""
WRITING = 0.1
"""Seconds more, at most, for files that are being written. A slower disk lacks the last of them then, but none is cut."""

_files, _saying = threading.Lock(), threading.Lock()
_last_words: list[str] = []


@contextmanager
def whole_files() -> Iterator[None]:
    """Around the writing of files that belong together: the process does not end inside, if that takes no more than `WRITING`."""
    with _files:
        yield


def say_at_the_end(words: str) -> None:
    """What to say on standard error when Ctrl-C ends the process, in place of what was to be said before; "" says nothing."""
    with _saying:
        _last_words[:] = [words] if words else []


def _say_last_words() -> None:
    with _saying:
        words = _last_words.pop() if _last_words else ""
    if words:
        with suppress(OSError):  # nobody may be listening; not by sys.stderr, which the main thread may be holding
            os.write(2, f"{words}\n".encode())


def run(command: Callable[[], int]) -> NoReturn:
    """Run a command as the whole of this process, and leave with its exit code."""
    ear = _Ear()
    try:
        code = command()
    except SystemExit as leave:
        code = leave.code
    except BaseException as error:
        # A library may have made another error of the KeyboardInterrupt: an extension module, say, that was being imported.
        if not (ear.heard or isinstance(error, KeyboardInterrupt)):
            raise
        code = INTERRUPTED
    ear.leave(code)


class _Ear:
    """Hears SIGINT from its making to the end of the process."""

    def __init__(self):
        self.heard, self._raised = False, False
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        sys.unraisablehook = self._quiet(sys.unraisablehook)
        signal.signal(signal.SIGINT, self._raise)
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        threading.Thread(target=self._watch, args=(reading,), daemon=True).start()

    def _raise(self, *_) -> None:
        """The handler in the main thread; a second signal is not needed."""
        self.heard = True
        if not self._raised:
            self._raised = True
            raise KeyboardInterrupt

    def _quiet(self, usual: Callable) -> Callable:
        """Nothing is said of a KeyboardInterrupt that Python could not raise where it came; the other thread ends the process."""
        return lambda unraisable: None if unraisable.exc_type is KeyboardInterrupt else usual(unraisable)

    def _watch(self, reading: int) -> None:
        while signal.SIGINT not in os.read(reading, 64):
            pass
        self.heard = True  # whoever else handles the signal now, as a solve does, may keep it to himself
        time.sleep(PATIENCE)
        _files.acquire(timeout=WRITING)
        _say_last_words()
        os._exit(INTERRUPTED)

    def leave(self, code: int | str | None) -> NoReturn:
        """End the process: at once after Ctrl-C, since another thread may be inside a solve that nobody waits for."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if self.heard or code == INTERRUPTED:
            _say_last_words()
            for stream in (sys.stdout, sys.stderr):
                stream.flush()
            os._exit(INTERRUPTED)
        sys.exit(code)
