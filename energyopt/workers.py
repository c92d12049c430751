"""Worker processes: functions of energyopt called in other processes, one thread each.

``multiprocessing`` imports the caller's script anew in every process it spawns, which runs scripts without an
``if __name__ == "__main__"`` twice. These workers are plain ``python -m energyopt.workers`` instead: they read pickled calls from
their standard input and write pickled results to their standard output. Pickles pass between a process and its own children only.
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
from contextlib import suppress
from pathlib import Path
from typing import Any

LOOK = 0.05
"""Seconds between two looks at whether an end is wanted."""
_SINGLE = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class WorkerError(RuntimeError):
    """A worker ended without an answer."""


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
    name, numbered = (function.__module__, function.__qualname__), enumerate(arguments)
    answers: queue.SimpleQueue = queue.SimpleQueue()
    idle: list[_Worker] = []
    workers: list[_Worker] = []
    busy = 0
    try:
        while not stop():
            while (idle or len(workers) < processes) and (call := next(numbered, None)) is not None:
                if not idle:
                    workers.append(_Worker())
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


class _Worker:
    """One process and the pipes to it; where it dies, the next call gets a new one."""

    def __init__(self):
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
        try:
            _write(self._process.stdin, (name, arguments))
            return _read(self._process.stdout)
        except (OSError, EOFError, ValueError) as error:
            self.end()
            self._start()
            return WorkerError(f"a worker process ended: {error}")

    def end(self) -> None:
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                pipe.close()


def _ask(worker: _Worker, name: tuple[str, str], call: tuple[int, tuple], answers: queue.SimpleQueue) -> None:
    answers.put((worker, call[0], worker.call(name, call[1])))


def _write(pipe, value: Any) -> None:
    data = pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)
    pipe.write(struct.pack("<Q", len(data)) + data)
    pipe.flush()


def _read(pipe) -> Any:
    head = pipe.read(8)
    if len(head) < 8:
        raise EOFError("its answer is missing")
    size = struct.unpack("<Q", head)[0]
    data = pipe.read(size)
    if len(data) < size:
        raise EOFError("its answer is cut short")
    return pickle.loads(data)


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
    while True:
        try:
            (module, name), arguments = _read(sys.stdin.buffer)
        except EOFError:
            return
        try:
            result = getattr(importlib.import_module(module), name)(*arguments)
        except Exception as error:
            result = error
        try:
            _write(answers, result)
        except (pickle.PicklingError, TypeError, AttributeError) as error:
            _write(answers, WorkerError(f"an answer cannot be sent: {error}"))


if __name__ == "__main__":
    _serve()
