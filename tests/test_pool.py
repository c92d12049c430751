"""The pool of worker processes keeps to its number whoever asks, and ends with what it is for."""

import os
import threading
import time
from typing import ClassVar

import pytest

from energyopt import pool
from energyopt.pool import Workers


class Slow:
    """In place of a `Worker`: slow to start, and in trouble if two threads use it at once."""

    made: ClassVar[list] = []

    def __init__(self):
        time.sleep(0.03)
        self.busy, self.shared = threading.Lock(), False
        Slow.made.append(self)

    def call(self, name, arguments):
        self.shared |= not self.busy.acquire(blocking=False)
        time.sleep(0.002)
        self.busy.release()
        return arguments[0]

    def end(self):
        pass


def test_calls_from_many_threads_at_once_start_no_more_workers_than_allowed(monkeypatch):
    monkeypatch.setattr(pool, "Worker", Slow)
    monkeypatch.setattr(Slow, "made", [])
    workers, futures = Workers(3), {}
    together = threading.Barrier(32, timeout=20.0)

    def ask(k):
        together.wait()
        futures[k] = workers.submit(abs, k)

    threads = [threading.Thread(target=ask, args=(k,)) for k in range(32)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=20.0)
    assert {k: future.result(timeout=20.0) for k, future in futures.items()} == {k: k for k in range(32)}
    assert len(Slow.made) == 3 and not any(worker.shared for worker in Slow.made)
    workers.shutdown()


def test_an_error_in_its_block_waits_for_no_call():
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt), Workers(1) as workers:
        running, waiting = workers.submit(time.sleep, 60.0), workers.submit(abs, -1)
        time.sleep(0.2)
        raise KeyboardInterrupt
    assert time.monotonic() - began < 20.0
    assert waiting.cancelled() and isinstance(running.exception(timeout=20.0), pool.WorkerLost)


def test_its_block_waits_for_calls_where_nothing_is_wrong():
    with Workers(1) as workers:
        calls = [workers.submit(divmod, k, 3) for k in range(3)]
    assert [call.result(timeout=0.0) for call in calls] == [divmod(k, 3) for k in range(3)]


def test_where_the_system_refuses_more_processes_those_there_are_do_the_work(monkeypatch, caplog):
    whole, allowed = pool.Worker, [True]

    def refused():
        if not allowed:
            raise BlockingIOError(11, "Resource temporarily unavailable")
        allowed.clear()
        return whole()

    monkeypatch.setattr(pool, "Worker", refused)
    with Workers(4) as workers:
        calls = [workers.submit(os.getpid) for _ in range(6)]
        assert len({call.result(timeout=60.0) for call in calls}) == 1
    assert caplog.text.count("1 worker processes are all") == 1
    with Workers(4) as workers, pytest.raises(BlockingIOError):
        workers.submit(os.getpid)
