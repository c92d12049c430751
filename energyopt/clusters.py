"""A ``dask.distributed.Client`` as an executor of `concurrent.futures`; dask itself is not imported here.

The executor that clients make themselves loses a call whose result went with its worker before it was fetched, and which is
given up when it is made again: its future never ends. Here the client's callback thread fetches results, or what became of them.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future, InvalidStateError
from contextlib import suppress
from functools import partial
from typing import Any


class Cluster(Executor):
    """The workers of a client, which stays open."""

    def __init__(self, client: Any):
        self._client = client

    @staticmethod
    def suits(value: Any) -> bool:
        """Whether a value looks like a client."""
        return all(callable(getattr(value, name, None)) for name in ("nthreads", "submit", "scheduler_info", "gather"))

    @property
    def threads(self) -> int:
        """Of all workers there are now."""
        return sum(self._client.nthreads().values())

    def submit(self, function: Callable, /, *arguments: Any) -> Future:
        remote = self._client.submit(function, *arguments, pure=False)
        future: Future = Future()
        future.add_done_callback(partial(_left, remote))
        remote.add_done_callback(partial(_fetched, future))
        return future


def _left(remote: Any, _: Future) -> None:
    """The cluster forgets the call: it does not begin it any more, or does not keep its result."""
    remote.release()


def _fetched(future: Future, remote: Any) -> None:
    with suppress(InvalidStateError):  # cancelled meanwhile
        if remote.status == "cancelled":
            if future.cancel():
                future.set_running_or_notify_cancel()
            return
        try:
            result = remote.result()
        except BaseException as error:
            future.set_exception(error)
        else:
            future.set_result(result)
