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
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

LOOK = 0.05
"""Seconds between two looks at whether an end is wanted."""
_SINGLE = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class WorkerError(RuntimeError):
    """A worker ended without an answer."""


def call_all(
    function: Callable, arguments: Sequence[tuple], processes: int, stop: Callable[[], bool] = lambda: False
) -> Iterator[tuple[int, Any]]:
    """Call a function of a module for each tuple of arguments, in worker processes.

    Args:
        function: at the top level of a module of this package; arguments: tuples of what can be pickled.
        processes: how many workers, at most.
        stop: ends everything, workers included, once it is true.

    Yields:
        (number of the tuple, what the function returned) in the order they end; an exception it raised in place of a result.
    """
    waiting, answers = queue.SimpleQueue(), queue.SimpleQueue()
    for number in range(len(arguments)):
        waiting.put(number)
    workers = [_Worker() for _ in range(min(processes, len(arguments)))]
    name = (function.__module__, function.__qualname__)
    try:
        for worker in workers:
            threading.Thread(target=_feed, args=(worker, name, arguments, waiting, answers), daemon=True).start()
        left = len(arguments)
        while left and not stop():
            try:
                yield answers.get(timeout=LOOK)
                left -= 1
            except queue.Empty:
                continue
    finally:
        for worker in workers:
            worker.end()


class _Worker:
    """One process and the pipes to it."""

    def __init__(self):
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
            return WorkerError(f"a worker process ended: {error}")

    def end(self) -> None:
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                pipe.close()


def _feed(worker: _Worker, name: tuple[str, str], arguments: Sequence[tuple], waiting, answers) -> None:
    """Give one worker one call after another."""
    while True:
        try:
            number = waiting.get_nowait()
        except queue.Empty:
            return
        answers.put((number, worker.call(name, arguments[number])))


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
