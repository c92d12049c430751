"""Worker processes (`workers`) as an executor of `concurrent.futures`."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import suppress
from typing import Any

from energyopt.serving import WorkerLost
from energyopt.workers import Worker, name_of

log = logging.getLogger("energyopt")


class Workers(Executor):
    """As many processes as calls need, at most ``processes``; functions are those of a module of this package.

    A process that dies is replaced, and its call made once more: what killed it may have been meant for another. Where the
    second dies too, the future holds a `WorkerLost`.
    """

    def __init__(self, processes: int):
        self._most, self._calls = processes, queue.SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._workers: list[Worker] = []
        self._changing = threading.Lock()
        self._closed = False

    def submit(self, function: Callable, /, *arguments: Any) -> Future:
        """Safe from any thread.

        Raises:
            RuntimeError: these workers have ended. OSError: the system allows not even one process.
        """
        future: Future = Future()
        with self._changing:
            if self._closed:
                raise RuntimeError("these workers have ended")
            if len(self._threads) < self._most:
                self._hire()
            self._calls.put((future, name_of(function), arguments))
        return future

    def _hire(self) -> None:
        worker = None
        try:
            worker = Worker()
            thread = threading.Thread(target=self._answer, args=(worker,), daemon=True)
            thread.start()
        except (OSError, RuntimeError) as error:  # no more processes, or threads
            if worker is not None:
                worker.end()
            if not self._threads:
                raise
            self._most = len(self._threads)
            log.warning("energyopt: %d worker processes are all that can be started: %s", self._most, error)
            return
        self._workers.append(worker)
        self._threads.append(thread)

    def _answer(self, worker: Worker) -> None:
        while (asked := self._calls.get()) is not None:
            future, *call = asked
            if not future.set_running_or_notify_cancel():
                continue
            answer = worker.call(*call)
            if isinstance(answer, WorkerLost) and not self._closed:
                answer = worker.call(*call)
            if isinstance(answer, Exception):
                future.set_exception(answer)
            else:
                future.set_result(answer)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: after all calls (``wait``), or at once."""
        with self._changing:
            self._closed = True
        if cancel_futures or not wait:
            self._cancel()
        for _ in self._threads:
            self._calls.put(None)
        try:
            for thread in self._threads if wait else ():
                thread.join()
        finally:  # Ctrl-C: nobody waits any more
            for worker in self._workers:
                worker.end()

    def __exit__(self, kind: type[BaseException] | None, *_: Any) -> None:
        """After an error, or Ctrl-C, in the block nobody waits for what is left."""
        self.shutdown(wait=kind is None)

    def _cancel(self) -> None:
        with suppress(queue.Empty):
            while True:
                asked = self._calls.get_nowait()
                if asked is not None:
                    asked[0].cancel()
