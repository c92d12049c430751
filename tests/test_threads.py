"""Independent work goes to as many threads, or processes, as this process may use processors; what fails ends the rest."""

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
    monkeypatch.setattr(fanout, "call_all", lambda function, calls, processes, stop: asked.append(processes) or iter(()))
    searcher = SimpleNamespace(options=SearchOptions())
    fanout.search_in_processes(searcher, iter(()), SimpleNamespace(tried=[], put_in_order=lambda *_: None), lambda: False)
    assert asked == [2]
