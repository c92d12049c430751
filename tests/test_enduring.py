"""Calls lost with their worker are made again, alone; what kills that worker too, and nothing else, fails."""

import os
import threading
import time
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future

import pytest

from energyopt import enduring, workers
from energyopt.enduring import MOST_LOSSES, Enduring, call_apart, is_loss


class KilledWorker(Exception):
    """As dask.distributed names it."""


class Cluster(Executor):
    """One worker that holds as many calls as it gets before `work`; what ends the process ends them all, as on a cluster that
    gives up at the first death."""

    def __init__(self):
        self.held, self.submitted = [], []

    def submit(self, function, /, *arguments):
        future = Future()
        self.held.append((future, function, arguments))
        self.submitted.append(function)
        return future

    def work(self):
        held, self.held = self.held, []
        if any(function is os._exit for _, function, _ in held):
            for future, *_ in held:
                if future.set_running_or_notify_cancel():
                    future.set_exception(KilledWorker("gone"))
            return
        for future, function, arguments in held:
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(function(*arguments))
            except Exception as error:
                future.set_exception(error)

    def work_until(self, futures):
        deadline = time.monotonic() + 120.0
        while not all(future.done() for future in futures) and time.monotonic() < deadline:
            self.work()
            time.sleep(0.01)


def test_of_all_that_a_worker_held_only_what_kills_is_given_up():
    cluster = Cluster()
    enduring = Enduring(cluster)
    calls = [
        enduring.submit(divmod, 7, 3),
        enduring.submit(os._exit, 5),
        enduring.submit(divmod, 9, 4),
        enduring.submit(divmod, 1, 0),
    ]
    cluster.work_until(calls)
    assert calls[0].result() == (2, 1) and calls[2].result() == (2, 1)
    with pytest.raises(workers.WorkerLost, match="ended with the code 5"):
        calls[1].result()
    with pytest.raises(ZeroDivisionError):
        calls[3].result()
    assert cluster.submitted.count(call_apart) == 4, "once each, and never beside another"


def test_calls_that_no_worker_is_lost_with_are_made_once():
    cluster = Cluster()
    calls = [Enduring(cluster).submit(divmod, k, 3) for k in range(3)]
    cluster.work_until(calls)
    assert [call.result() for call in calls] == [divmod(k, 3) for k in range(3)] and len(cluster.submitted) == 3


def test_workers_that_die_of_something_else_are_not_tried_for_ever():
    class Dying(Cluster):
        def work(self):
            held, self.held = self.held, []
            for future, *_ in held:
                future.set_exception(KilledWorker("gone again"))

    cluster = Dying()
    call = Enduring(cluster).submit(divmod, 7, 3)
    cluster.work_until([call])
    assert is_loss(call.exception()) and len(cluster.submitted) == MOST_LOSSES + 1


def test_a_call_that_is_cancelled_is_not_made_again():
    cluster = Cluster()
    enduring = Enduring(cluster)
    kept, deadly = enduring.submit(divmod, 7, 3), enduring.submit(os._exit, 5)
    assert kept.cancel() and cluster.held[0][0].cancelled()
    cluster.work_until([deadly])
    assert cluster.submitted.count(call_apart) == 1
    with pytest.raises(CancelledError):
        kept.result()


def test_a_call_cancelled_between_its_loss_and_the_next_attempt_is_not_made_again(monkeypatch):
    class Later:
        """A thread that begins when it is told to."""

        def __init__(self, target, daemon):
            later.append(target)

        def start(self):
            pass

    later, cluster = [], Cluster()
    call = Enduring(cluster).submit(divmod, 7, 3)
    monkeypatch.setattr(enduring.threading, "Thread", Later)
    cluster.held[0][0].set_exception(KilledWorker("gone"))
    assert call.cancel()
    for begin in later:
        begin()
    assert len(later) == 1 and cluster.submitted == [divmod]


def test_an_attempt_whose_call_is_cancelled_while_it_is_submitted_is_cancelled():
    class Slow(Cluster):
        def submit(self, function, /, *arguments):
            if self.submitted:
                submitting.set()
                assert cancelled.wait(20.0)
            future = super().submit(function, *arguments)
            given.set()
            return future

    submitting, cancelled, given, cluster = *(threading.Event() for _ in range(3)), Slow()
    call = Enduring(cluster).submit(divmod, 7, 3)
    given.clear()
    cluster.held[0][0].set_exception(KilledWorker("gone"))
    assert submitting.wait(20.0) and call.cancel()
    cancelled.set()
    assert given.wait(20.0) and len(cluster.held) == 2
    deadline = time.monotonic() + 20.0
    while not cluster.held[1][0].cancelled() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert cluster.held[1][0].cancelled()


def test_what_the_executor_cancels_is_cancelled():
    cluster = Cluster()
    call = Enduring(cluster).submit(divmod, 7, 3)
    cluster.held[0][0].cancel()
    cluster.held[0][0].set_running_or_notify_cancel()
    with pytest.raises(CancelledError):
        call.result(timeout=20.0)


def test_many_calls_lost_at_once_start_no_more_processes_than_the_executor_had(monkeypatch):
    """Each is made again in a thread of its own."""

    class Breaking(Cluster):
        _max_workers = 2

        def submit(self, function, /, *arguments):
            if self.held and self.held[0][0].done():
                raise BrokenExecutor("all of it")
            return super().submit(function, *arguments)

    monkeypatch.setattr(enduring, "cores", lambda: 64)
    cluster = Breaking()
    endures = Enduring(cluster)
    calls = [endures.submit(os.getpid) for _ in range(64)]
    for future, *_ in cluster.held:
        future.set_exception(BrokenExecutor("all of it"))
    try:
        pids = {call.result(timeout=60.0) for call in calls}
        assert 1 <= len(pids) <= 2 == len(endures._own._workers) and os.getpid() not in pids
    finally:
        endures.shutdown(wait=False)


def test_processes_in_place_of_a_broken_executor_end_with_it():
    class Broken(Executor):
        def submit(self, function, /, *arguments):
            raise BrokenExecutor("all of it")

    enduring = Enduring(Broken())
    pid = enduring.submit(os.getpid).result(timeout=60.0)
    assert pid != os.getpid() and os.path.exists(f"/proc/{pid}")
    enduring.shutdown(wait=False, cancel_futures=True)
    assert not os.path.exists(f"/proc/{pid}")
    with pytest.raises(RuntimeError, match="nobody waits"):
        enduring.submit(os.getpid)
