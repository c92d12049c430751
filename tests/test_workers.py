"""Worker processes answer calls, in order or not, and end when they are told to."""

import os
import subprocess
import sys
import time

import pytest

from energyopt import workers


def test_every_call_is_answered_once():
    found = dict(workers.call_all(os.path.join, [("a", str(k)) for k in range(5)], 2))
    assert found == {k: f"a/{k}" for k in range(5)}


def test_an_exception_is_an_answer_and_spoils_no_other():
    found = dict(workers.call_all(os.listdir, [("/nowhere/at/all",), ("/",)], 1))
    assert isinstance(found[0], FileNotFoundError) and found[1] == os.listdir("/")


def test_a_worker_that_dies_is_named():
    ((number, answer),) = workers.call_all(os._exit, [(3,)], 1)
    assert number == 0 and isinstance(answer, workers.WorkerError)


def test_stopping_ends_the_workers():
    began = time.monotonic()
    assert not list(workers.call_all(time.sleep, [(60.0,)], 1, stop=lambda: time.monotonic() > began + 0.3))
    assert time.monotonic() - began < 20.0


@pytest.mark.skipif(not os.path.exists("/proc/self/stat"), reason="sessions are read from /proc")
def test_what_a_worker_has_started_ends_with_it(tmp_path):
    """As a compiler does, which is in a process group of its own and would go on otherwise."""
    begun = tmp_path / "begun"
    command = f"import os, time; os.setpgid(0, 0); open({str(begun)!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    there = lambda: begun.exists() and begun.read_text()
    assert not list(workers.call_all(subprocess.call, [([sys.executable, "-c", command],)], 1, stop=there))
    status = f"/proc/{begun.read_text()}/stat"
    latest = time.monotonic() + 20.0
    while os.path.exists(status) and _state(status) not in "ZX" and time.monotonic() < latest:
        time.sleep(0.01)
    assert not os.path.exists(status) or _state(status) in "ZX"


def _state(status):
    try:
        with open(status) as file:
            return file.read().rpartition(")")[2].split()[0]
    except OSError:
        return "X"


def test_workers_that_are_kept_answer_later_calls_too_unless_they_were_stopped():
    kept = []
    (first,) = workers.call_all(os.getpid, [()], 1, kept=kept)
    (again,) = workers.call_all(os.getpid, [()], 2, kept=kept)
    assert again == first and len(kept) == 1 and os.path.exists(f"/proc/{first[1]}")
    began = time.monotonic()
    assert not list(workers.call_all(time.sleep, [(60.0,)], 1, lambda: time.monotonic() > began + 0.3, kept))
    assert not kept and not os.path.exists(f"/proc/{first[1]}")


def test_a_script_without_a_main_guard_is_not_run_twice(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "print('once')\nimport os\nfrom energyopt import workers\nprint(dict(workers.call_all(os.path.join, [('a', 'b')], 1)))\n"
    )
    run = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120, env=os.environ, check=False)
    assert run.stdout == "once\n{0: 'a/b'}\n", run.stderr


@pytest.mark.parametrize("processes", [1, 3])
def test_the_number_of_processes_does_not_change_the_answers(processes):
    assert sorted(workers.call_all(divmod, [(k, 3) for k in range(4)], processes)) == [(k, divmod(k, 3)) for k in range(4)]


def test_workers_end_with_their_parent(tmp_path):
    mark = tmp_path / "worker"
    code = (
        "import os, subprocess, sys, threading, time\n"
        "from energyopt import workers\n"
        "calls = workers.call_all(time.sleep, [(120.0,)], 1)\n"
        "threading.Thread(target=lambda: list(calls), daemon=True).start()\n"
        "children = lambda t: open(f'/proc/self/task/{t}/children').read().split()\n"
        "while not (kids := [c for t in os.listdir('/proc/self/task') for c in children(t)]): time.sleep(0.05)\n"
        "time.sleep(1.0)\n"
        f"open({str(mark)!r}, 'w').write(kids[0])\n"
        "os._exit(0)\n"
    )
    subprocess.run([sys.executable, "-c", code], timeout=120, check=True, env=os.environ)
    worker, deadline = mark.read_text(), time.monotonic() + 30.0
    while os.path.exists(f"/proc/{worker}") and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not os.path.exists(f"/proc/{worker}")
