"""Several workers run the tests beside one another: as many as there are cores, each on one thread.

A test marked `alone` has the machine to itself: it begins when no other worker is inside a test, and none begins one meanwhile.
"""

import fcntl
import os
from contextlib import contextmanager
from pathlib import Path

import pytest

for _library in ("OMP", "OPENBLAS", "MKL"):  # read when NumPy is imported, and by the processes that tests start
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers():
    """For ``-n auto``: processors this process may use; the plugin would count those of the machine, or its cores only."""
    from energyopt.workers import cores

    return cores()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    if not hasattr(item.config, "workerinput"):  # the only process there is
        return (yield)
    common = item.config._tmp_path_factory.getbasetemp().parent
    with _turn(common, alone=item.get_closest_marker("alone") is not None):
        return (yield)


@contextmanager
def _turn(folder: Path, alone: bool):
    """Inside, no other worker is where one of the two wants to be alone.

    Any number may share the room. Whoever wants it alone keeps the door until it has left, so that nobody else comes in.
    """
    with open(folder / "door", "w") as door, open(folder / "room", "w") as room:
        fcntl.flock(door, fcntl.LOCK_EX)
        fcntl.flock(room, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
        if not alone:
            fcntl.flock(door, fcntl.LOCK_UN)
        try:
            yield
        finally:
            for file in (room, door):  # closing would not do where a test has forked
                fcntl.flock(file, fcntl.LOCK_UN)


class Workers:
    """How many searches worker processes have answered; `idle` keeps the next ones in this process."""

    def __init__(self, monkeypatch):
        from energyopt import fanout

        self.answers, self._patch = 0, monkeypatch
        received = fanout._received
        monkeypatch.setattr(fanout, "_received", lambda *arguments: self._counted(received, arguments))
        monkeypatch.setattr(fanout, "cores", lambda: 2)
        monkeypatch.setattr("energyopt.campaign.WORTH_PROCESSES", 0.0)

    def _counted(self, received, arguments):
        self.answers += 1
        return received(*arguments)

    @contextmanager
    def idle(self):
        with self._patch.context() as patch:
            patch.setattr("energyopt.campaign.WORTH_PROCESSES", float("inf"))
            yield


@pytest.fixture
def two_workers(monkeypatch):
    """Guesses are searched from in two worker processes, however short their searches."""
    return Workers(monkeypatch)
