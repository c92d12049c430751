"""Independent work goes to as many threads, or processes, as this process may use processors; what fails ends the rest."""

import os
import signal
import threading
import time
from types import SimpleNamespace

import pytest

from energyopt import fanout, threads, workers
from energyopt.search_state import SearchOptions
from energyopt.serving import WorkerLost


@pytest.fixture
def two_of_64(monkeypatch):
    """A machine of 64 processors, two of which are ours, as in a container."""
    monkeypatch.setattr(workers.os, "cpu_count", lambda: 64)
    monkeypatch.setattr(workers.os, "sched_getaffinity", lambda pid: {0, 1}, raising=False)


def test_linear_algebra_keeps_to_one_thread_until_the_last_caller_is_done(monkeypatch):
    """And has as many as before afterwards, whoever leaves first."""
    now = [4]

    class Limit:
        def __init__(self, limits, user_api):
            assert user_api == "blas"
            self.before, now[0] = now[0], limits

        def restore_original_limits(self):
            now[0] = self.before

    monkeypatch.setattr(threads, "_controller", lambda: SimpleNamespace(limit=Limit))
    first, second = threads.single_thread(), threads.single_thread()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert now == [1]
    second.__exit__(None, None, None)
    assert now == [4]


def test_no_more_threads_run_than_there_are_processors_for_us(two_of_64):
    running, most = set(), []

    def work(item, wanted):
        running.add(item)
        time.sleep(0.02)
        most.append(len(running))
        running.remove(item)
        return -item

    assert threads.side_by_side(work, range(8)) == [-k for k in range(8)] and max(most) == 2


def test_a_guess_that_ends_its_process_is_left_out_and_not_tried_in_this_one(caplog, monkeypatch):
    answers = [(0, WorkerLost("a worker process ended by signal 11")), (1, RuntimeError("no pickle"))]
    monkeypatch.setattr(fanout, "call_all", lambda function, calls, *_: iter(answers[: len(list(calls))]))
    added = []
    found = SimpleNamespace(tried=[], add=lambda search, attempt: added.append(search), put_in_order=lambda *_: None)
    here = lambda attempt: SimpleNamespace(name=attempt.name, outcome=None, objective=1.0, depth=0.0)
    searcher = SimpleNamespace(options=SearchOptions(), search=here, problem=None, durations=None, parameterization=None)
    fanout.search_in_processes(searcher, (SimpleNamespace(name=name) for name in "ab"), found, lambda: False, [])
    assert [search.name for search in added] == ["b"]
    assert "ended by signal 11; guess 'a' is left out" in caplog.text


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
