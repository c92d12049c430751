"""Worker processes (`workers`) as an executor of `concurrent.futures`."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import suppress
from typing import Any

from energyopt.workers import Worker, WorkerLost, name_of


class Workers(Executor):
    """As many processes as calls need, at most ``processes``; functions are those of a module of this package.

    A process that dies is replaced, and its call made once more: what killed it may have been meant for another. Where the
    second dies too, the future holds a `WorkerLost`.
    """

    def __init__(self, processes: int):
        self._most, self._calls = processes, queue.SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._workers: list[Worker] = []
        self._closed = False

    def submit(self, function: Callable, /, *arguments: Any) -> Future:
        if self._closed:
            raise RuntimeError("these workers have ended")
        future: Future = Future()
        self._calls.put((future, name_of(function), arguments))
        if len(self._threads) < self._most:
            self._workers.append(Worker())
            self._threads.append(threading.Thread(target=self._answer, args=(self._workers[-1],), daemon=True))
            self._threads[-1].start()
        return future

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
        self._closed = True
        if cancel_futures or not wait:
            self._cancel()
        for _ in self._threads:
            self._calls.put(None)
        for thread in self._threads if wait else ():
            thread.join()
        for worker in self._workers:
            worker.end()

    def _cancel(self) -> None:
        with suppress(queue.Empty):
            while True:
                asked = self._calls.get_nowait()
                if asked is not None:
                    asked[0].cancel()
