"""Where the work of a batch is done: worker processes of its own, an executor of the caller, or a dask cluster."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from energyopt.clusters import Cluster
from energyopt.enduring import Enduring
from energyopt.errors import InputError
from energyopt.pool import Workers
from energyopt.problem_values import shown, whole
from energyopt.workers import cores

IN_FLIGHT = 256
"""Jobs begun and not handed out yet, at most; four a worker where that is more."""
MOST_PROCESSES = 4096


@dataclass(frozen=True)
class Place:
    """Where work is done.

    Attributes:
        executor: of the caller, left open; None makes worker processes and ends them. processes: how many of those.
        window: jobs begun and not handed out, at most.
    """

    executor: Executor | None
    processes: int
    window: int

    @staticmethod
    def of(executor: Any, processes: int | None, total: int | None) -> Place:
        """Check what the caller gave.

        Raises:
            InputError: no executor, no number, or both.
        """
        if executor is None:
            most = (
                whole("processes", processes, 1, MOST_PROCESSES)
                if processes is not None
                else cores()
            )
            most = most if total is None else max(1, min(most, total))
            return Place(None, most, max(IN_FLIGHT, 4 * most))
        if processes is not None:
            raise InputError("executor and processes are both given: an executor has its own workers; leave out processes")
        if Cluster.suits(executor):
            cluster = Cluster(executor)
            return Place(cluster, 0, max(IN_FLIGHT, 4 * _threads(cluster)))
        if not isinstance(executor, Executor):
            expected = "an executor of concurrent.futures, or a dask.distributed.Client"
            raise InputError(f"executor is {shown(executor)}: expected {expected}")
        _check_open(executor)
        return Place(executor, 0, max(IN_FLIGHT, 4 * getattr(executor, "_max_workers", 0)))

    @contextmanager
    def open(self) -> Iterator[Executor]:
        """An executor; the processes of one made here end with the block, whatever they are doing."""
        if isinstance(self.executor, ThreadPoolExecutor):  # its workers do not die alone
            yield self.executor
            return
        workers = Workers(self.processes) if self.executor is None else Enduring(self.executor)
        try:
            yield workers
        finally:
            workers.shutdown(wait=False, cancel_futures=True)


def _threads(cluster: Cluster) -> int:
    try:
        return cluster.threads
    except Exception as error:  # whatever a client raises that is closed, or has lost its scheduler
        raise InputError("executor is a dask client that has no cluster; expected one that is connected") from error


def _check_open(executor: Executor) -> None:
    """Only a call tells; one that is broken is no problem (see `Enduring`)."""
    try:
        executor.submit(int)
    except BrokenExecutor:
        return
    except RuntimeError as error:
        raise InputError(f"executor takes no work: {error}; expected one that is open") from None
