"""Worker processes: functions of energyopt called in other processes, one thread each.

``multiprocessing`` imports the caller's script anew in every process it spawns, which runs scripts without an
``if __name__ == "__main__"`` twice. These workers only `serving.serve`, with the module search path of this process: whatever can
be imported here can be there. Pickled calls and answers go through pipes, between a process and its own children only.
Inside `no_more_processes`, as in the workers themselves, calls are made where they are asked for.
"""

from __future__ import annotations

import logging
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

from energyopt.errors import InputError
from energyopt.serving import WorkerError, WorkerLost, alone, pickled, read, skip_to_begin, write

log = logging.getLogger("energyopt")

LOOK = 0.05
"""Seconds between two looks at whether an end is wanted."""
DYING = 1.0
"""Seconds for a process whose answer is missing to end by itself, and so tell how."""
_SINGLE = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_SERVE = "import sys; sys.path[:] = sys.argv[1:]; from energyopt.serving import serve; serve()"


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def call_all(
    function: Callable,
    arguments: Iterable[tuple],
    processes: int,
    stop: Callable[[], bool] = lambda: False,
    kept: list[Worker] | None = None,
) -> Iterator[tuple[int, Any]]:
    """Call a function of a module for each tuple of arguments, in worker processes.

    Args:
        function: at the top level of a module of this package.
        arguments: tuples of what can be pickled; the next is asked for when a worker has nothing to do.
        processes: how many workers, at most.
        stop: ends everything, workers included, once it is true.
        kept: workers of earlier calls, which are used first; those that have nothing to do in the end are left in it, for later
            calls, and are the caller's to end.

    Yields:
        (number of the tuple, what the function returned) in the order they end; in place of a result the exception it raised, or
        a `WorkerError`.
    """
    if alone():
        yield from _call_here(function, arguments, stop)
        return
    name, numbered = name_of(function), enumerate(arguments)
    answers: queue.SimpleQueue = queue.SimpleQueue()
    idle: list[Worker] = [] if kept is None else kept
    workers, busy = [*idle], 0
    try:
        while not stop():
            while (idle or len(workers) < processes) and (call := next(numbered, None)) is not None:
                if not idle and not _hired(workers, idle):
                    processes, numbered = len(workers), chain([call], numbered)
                    continue
                threading.Thread(target=_ask, args=(idle.pop(), name, call, answers), daemon=True).start()
                busy += 1
            if not busy:
                break
            try:
                worker, number, answer = answers.get(timeout=LOOK)
            except queue.Empty:
                continue
            busy -= 1
            idle.append(worker)
            yield number, answer
        for number, _ in numbered if processes == 0 else ():
            if stop():
                return
            yield number, WorkerError("no worker process can be started")
    finally:
        for worker in workers:
            if kept is None or worker not in idle:
                worker.end()


def _hired(workers: list[Worker], idle: list[Worker]) -> bool:
    """Whether there is one more worker now; the system may refuse it."""
    try:
        workers.append(Worker())
    except OSError as error:
        log.warning("energyopt: %d worker processes are all that can be started: %s", len(workers), error)
        return False
    idle.append(workers[-1])
    return True


def _call_here(function: Callable, arguments: Iterable[tuple], stop: Callable[[], bool]) -> Iterator[tuple[int, Any]]:
    """`call_all` without processes."""
    for number, some in enumerate(arguments):
        if stop():
            return
        try:
            answer = function(*some)
        except Exception as error:
            answer = error
        yield number, answer


def name_of(function: Callable) -> tuple[str, str]:
    """Module and name of a function, which is how a worker finds it."""
    return function.__module__, function.__qualname__


class Worker:
    """One process and the pipes to it; where it has died, the next call gets a new one."""

    def __init__(self):
        self._process: subprocess.Popen | None = None
        self._ended, self._changing = False, threading.Lock()
        self._start()

    def _start(self) -> None:
        self._begun = False
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _SERVE, *_search_path()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=None if sys.__stderr__ else subprocess.DEVNULL,  # services may have none
            env=os.environ | _SINGLE,
            start_new_session=True,  # Ctrl-C is the parent's business
        )

    def call(self, name: tuple[str, str], arguments: tuple) -> Any:
        """What the function returned, or the error it raised; an `InputError` or `WorkerError` where it could not be called."""
        try:
            data = pickled((name, arguments))
        except Exception as error:  # whatever the objects in it raise
            return InputError(f"the arguments cannot be sent to another process: {error}; functions must be those of a module")
        try:
            self._revive()
            answer = self._answer(data)
        except Exception as error:  # closed pipes are a ValueError; an answer may be larger than the memory
            return WorkerLost(f"a worker process ended{self._how()}: {error}")
        try:
            return pickle.loads(answer)
        except Exception as error:
            return WorkerError(f"an answer cannot be read: {error}")

    def _answer(self, data: bytes) -> bytes:
        if not self._begun:
            skip_to_begin(self._process.stdout)
            self._begun = True
        write(self._process.stdin, data)
        return read(self._process.stdout)

    def _how(self) -> str:
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(DYING)
        self._process.kill()
        code = self._process.wait()
        return f" by signal {-code}" if code < 0 else f" with the code {code}"

    def _revive(self) -> None:
        with self._changing:
            if self._process.poll() is not None and not self._ended:
                self._close()
                self._start()

    def end(self) -> None:
        """Kill the process; what it was doing is lost."""
        with self._changing:
            self._ended = True
            self._close()

    def _close(self) -> None:
        self._process.kill()
        self._process.wait()
        _end_session(self._process.pid)
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                pipe.close()


def _end_session(leader: int) -> None:
    """Kill what the leader of a session has left running, such as compilers; where there is no /proc they end by themselves."""
    for status in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError, ValueError, IndexError):  # most have nothing to do with us, and some end meanwhile
            if int(status.read_text().rpartition(")")[2].split()[3]) == leader:
                os.kill(int(status.parent.name), signal.SIGKILL)


def _search_path() -> list[str]:
    """Where this process looks for modules, absolute; and where it has energyopt from, should an import hook have found it."""
    root, path = str(Path(__file__).resolve().parent.parent), [os.path.abspath(p) for p in sys.path if isinstance(p, str)]
    return path if root in path else [root, *path]


def _ask(worker: Worker, name: tuple[str, str], call: tuple[int, tuple], answers: queue.SimpleQueue) -> None:
    answers.put((worker, call[0], worker.call(name, call[1])))
