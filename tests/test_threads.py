"""Independent work goes to as many threads, or processes, as this process may use processors; what fails ends the rest."""

import os
import signal
import threading
import time
from types import SimpleNamespace

import pytest

from energyopt import fanout, threads, workers
from energyopt.search_state import SearchOptions


@pytest.fixture
def two_of_64(monkeypatch):
    """A machine of 64 processors, two of which are ours, as in a container."""
    monkeypatch.setattr(workers.os, "cpu_count", lambda: 64)
    monkeypatch.setattr(workers.os, "sched_getaffinity", lambda pid: {0, 1}, raising=False)


def test_no_more_threads_run_than_there_are_processors_for_us(two_of_64):
    running, most = set(), []

    def work(item, wanted):
        running.add(item)
        time.sleep(0.02)
        most.append(len(running))
        running.remove(item)
        return -item

    assert threads.side_by_side(work, range(8)) == [-k for k in range(8)] and max(most) == 2


def test_no_more_processes_search_than_there_are_processors_for_us(two_of_64, monkeypatch):
    asked = []
    monkeypatch.setattr(fanout, "call_all", lambda function, calls, processes, *_: asked.append(processes) or iter(()))
    searcher = SimpleNamespace(options=SearchOptions())
    fanout.search_in_processes(searcher, iter(()), SimpleNamespace(tried=[], put_in_order=lambda *_: None), lambda: False, [])
    assert asked == [2]


def test_where_one_fails_the_others_are_told_and_what_has_not_begun_never_does(two_of_64):
    begun, told = [], []

    def work(item, wanted):
        begun.append(item)
        if item == 1:
            raise ValueError("one")
        latest = time.monotonic() + 5.0
        try:
            while time.monotonic() < latest:
                wanted()
                time.sleep(0.01)
        except threads.Unwanted:
            told.append(item)
            raise

    with pytest.raises(ValueError, match="one"):
        threads.side_by_side(work, range(100))
    assert sorted(begun) == [0, 1] and told == [0]


def test_of_several_that_fail_the_first_in_order_is_raised(two_of_64):
    both = threading.Barrier(2, timeout=20.0)

    def work(item, wanted):
        both.wait()
        time.sleep(0.1 if item == 0 else 0.0)
        raise ValueError(f"item {item}")

    with pytest.raises(ValueError, match="item 0"):
        threads.side_by_side(work, range(2))


def test_ctrl_c_is_told_to_all_and_begins_nothing_more(two_of_64):
    begun = []

    def work(item, wanted):
        begun.append(item)
        if item == 1:
            os.kill(os.getpid(), signal.SIGINT)
        while True:
            wanted()
            time.sleep(0.01)

    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            threads.side_by_side(work, range(100))
    finally:
        signal.signal(signal.SIGINT, previous)
    assert sorted(begun) == [0, 1]
