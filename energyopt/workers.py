"""Worker processes: functions of energyopt called in other processes, one thread each.

``multiprocessing`` imports the caller's script anew in every process it spawns, which runs scripts without an
``if __name__ == "__main__"`` twice. These workers are plain ``python -m energyopt.workers`` instead: they read pickled calls from
their standard input and write pickled results to their standard output. Pickles pass between a process and its own children only.
Inside `no_more_processes`, as in the workers themselves, calls are made where they are asked for.
"""

from __future__ import annotations

import importlib
import os
import pickle
import queue
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any

LOOK = 0.05
"""Seconds between two looks at whether an end is wanted."""
_SINGLE = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_ALONE: ContextVar[bool] = ContextVar("alone", default=False)


class WorkerError(RuntimeError):
    """A worker gave no answer."""


class WorkerLost(WorkerError):
    """A worker process ended, or was ended, in the middle of a call."""


@contextmanager
def no_more_processes() -> Iterator[None]:
    """In here `call_all` starts no processes: this one is a worker itself, and every core has its own already."""
    token = _ALONE.set(True)
    try:
        yield
    finally:
        _ALONE.reset(token)


def alone() -> bool:
    """Whether this is in there."""
    return _ALONE.get()


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def call_all(
    function: Callable, arguments: Iterable[tuple], processes: int, stop: Callable[[], bool] = lambda: False
) -> Iterator[tuple[int, Any]]:
    """Call a function of a module for each tuple of arguments, in worker processes.

    Args:
        function: at the top level of a module of this package.
        arguments: tuples of what can be pickled; the next is asked for when a worker has nothing to do.
        processes: how many workers, at most.
        stop: ends everything, workers included, once it is true.

    Yields:
        (number of the tuple, what the function returned) in the order they end; an exception it raised in place of a result.
    """
    if _ALONE.get():
        yield from _call_here(function, arguments, stop)
        return
    name, numbered = name_of(function), enumerate(arguments)
    answers: queue.SimpleQueue = queue.SimpleQueue()
    idle: list[Worker] = []
    workers: list[Worker] = []
    busy = 0
    try:
        while not stop():
            while (idle or len(workers) < processes) and (call := next(numbered, None)) is not None:
                if not idle:
                    workers.append(Worker())
                    idle.append(workers[-1])
                threading.Thread(target=_ask, args=(idle.pop(), name, call, answers), daemon=True).start()
                busy += 1
            if not busy:
                return
            try:
                worker, number, answer = answers.get(timeout=LOOK)
            except queue.Empty:
                continue
            busy -= 1
            idle.append(worker)
            yield number, answer
    finally:
        for worker in workers:
            worker.end()


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
        root = str(Path(__file__).resolve().parent.parent)
        path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
        self._process = subprocess.Popen(
            [sys.executable, "-m", "energyopt.workers"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | _SINGLE | {"PYTHONPATH": path},
            start_new_session=True,  # Ctrl-C is the parent's business
        )

    def call(self, name: tuple[str, str], arguments: tuple) -> Any:
        """What the function returned, or the error it raised, or a `WorkerError`."""
        try:
            data = _pickled((name, arguments))
        except Exception as error:  # whatever the objects in it raise
            return WorkerError(f"the arguments cannot be sent: {error}")
        try:
            self._revive()
            _write(self._process.stdin, data)
            answer = _read(self._process.stdout)
        except (OSError, EOFError, ValueError) as error:
            self._process.kill()
            return WorkerLost(f"a worker process ended{self._how()}: {error}")
        try:
            return pickle.loads(answer)
        except Exception as error:
            return WorkerError(f"an answer cannot be read: {error}")

    def _how(self) -> str:
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
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                pipe.close()


def _ask(worker: Worker, name: tuple[str, str], call: tuple[int, tuple], answers: queue.SimpleQueue) -> None:
    answers.put((worker, call[0], worker.call(name, call[1])))


def _pickled(value: Any) -> bytes:
    return pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)


def _write(pipe, data: bytes) -> None:
    pipe.write(struct.pack("<Q", len(data)) + data)
    pipe.flush()


def _read(pipe) -> bytes:
    head = pipe.read(8)
    if len(head) < 8:
        raise EOFError("its answer is missing")
    size = struct.unpack("<Q", head)[0]
    data = pipe.read(size)
    if len(data) < size:
        raise EOFError("its answer is cut short")
    return data


def _end_with(parent: int) -> None:
    """End this process, whatever it is doing, once its parent has."""
    while os.getppid() == parent:
        time.sleep(LOOK)
    os._exit(1)


def _serve() -> None:
    """Answer calls until the input ends; what a call prints goes to standard error."""
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    with importlib.import_module("energyopt.workers").no_more_processes():  # this module runs as __main__
        while True:
            try:
                call = _read(sys.stdin.buffer)
            except EOFError:
                return
            _write(answers, _answered(call))


def _answered(call: bytes) -> bytes:
    try:
        (module, name), arguments = pickle.loads(call)
        result = getattr(importlib.import_module(module), name)(*arguments)
    except Exception as error:
        result = error
    try:
        return _pickled(result)
    except Exception as error:
        # An error made here, in __main__, would be of a class the parent does not know.
        kind = importlib.import_module("energyopt.workers").WorkerError
        return _pickled(kind(f"an answer cannot be sent: {error}"))


if __name__ == "__main__":
    _serve()
