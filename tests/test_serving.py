"""Nothing a call does, raises or prints comes between a worker process and its parent."""

import os
import subprocess
import sys
import time
import zlib

import pytest

import energyopt as eo
from energyopt import workers
from energyopt.serving import WorkerError, WorkerLost, sendable

MODULE = """
import os, sys

class Odd(Exception):
    def __init__(self, one, two):
        super().__init__(f"{one} and {two}")

class Closed(Exception):
    def __reduce__(self):
        raise TypeError("not to be sent")

def odd():
    raise Odd("this", "that")

def closed():
    raise Closed("in here")

def loud():
    os.system("echo from a shell")
    print("from Python", flush=True)
    return "said"

def function():
    return lambda: None

def reads():
    return sys.stdin.read() + os.popen("cat").read()
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A module that only this process's search path leads to."""
    (tmp_path / "only_here.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    import only_here

    yield only_here
    del sys.modules["only_here"]


def answers(function, arguments=((),)):
    """What one worker answered, in order; nothing where it takes too long."""
    latest = time.monotonic() + 30.0
    found = dict(workers.call_all(function, arguments, 1, lambda: time.monotonic() > latest))
    return [found[k] for k in sorted(found)]


def test_a_worker_finds_modules_where_this_process_does_and_not_in_the_current_folder(module, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "queue.py").write_text("raise RuntimeError('the wrong queue')")
    monkeypatch.chdir(tmp_path / "here")
    assert answers(module.loud) == ["said"]


def test_what_a_call_prints_goes_to_standard_error(module, capfd):
    assert answers(module.loud) == ["said"]
    assert capfd.readouterr().err == "from a shell\nfrom Python\n"


def test_what_a_process_prints_before_it_begins_is_no_answer(tmp_path, monkeypatch):
    (tmp_path / "sitecustomize.py").write_text("print('a banner ' * 20000, flush=True)")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))
    assert answers(divmod, [(7, 3), (8, 3)]) == [(2, 1), (2, 2)]


def test_a_call_that_reads_the_input_finds_none_and_takes_no_other_call(module):
    assert answers(module.reads, [(), ()]) == ["", ""]


def test_an_error_that_cannot_be_sent_or_read_keeps_its_words(module):
    for function, said in ((module.odd, "Odd: this and that"), (module.closed, "Closed: in here")):
        (answer,) = answers(function)
        assert type(answer) is WorkerError and str(answer) == said
    (answer,) = answers(module.function)
    assert type(answer) is WorkerError and str(answer).startswith("an answer cannot be sent: ")


def test_an_error_that_can_be_sent_is_the_same_and_another_keeps_its_notes(module):
    plain, odd = ValueError("plain"), module.Odd(1, 2)
    odd.add_note("seen here")
    assert sendable(plain) is plain and sendable(odd).__notes__ == ["seen here"]


def test_arguments_that_cannot_be_sent_are_bad_input():
    (answer,) = answers(len, [(lambda: None,)])
    assert isinstance(answer, eo.InputError) and "cannot be sent to another process" in str(answer)


def test_a_call_that_leaves_python_is_lost_and_tells_its_exit_code():
    found = answers(sys.exit, [(3,), (4,)])
    assert all(isinstance(answer, WorkerLost) for answer in found)
    assert ["with the code 3" in str(found[0]), "with the code 4" in str(found[1])] == [True, True]


def test_arguments_and_answers_may_be_larger_than_any_pipe():
    data = bytes(range(256)) * 2**15
    assert answers(zlib.adler32, [(data,)]) == [zlib.adler32(data)]
    assert [len(answer) for answer in answers(os.urandom, [(2**23,)] * 2)] == [2**23] * 2


def test_a_process_without_standard_error_has_workers_too(module, tmp_path):
    code = (
        "from energyopt import workers; import only_here\n"
        "open('answer', 'w').write(repr(list(workers.call_all(only_here.loud, [()], 1))))"
    )
    path = os.pathsep.join([str(tmp_path), str(workers.Path(workers.__file__).parents[1])])
    command = ["sh", "-c", 'exec "$@" 2>&-', "sh", sys.executable, "-c", code]
    subprocess.run(command, cwd=tmp_path, env=os.environ | {"PYTHONPATH": path}, timeout=60, check=True)
    assert (tmp_path / "answer").read_text() == "[(0, 'said')]"


@pytest.mark.parametrize("allowed", [0, 1])
def test_where_the_system_refuses_processes_every_call_has_an_answer_all_the_same(allowed, monkeypatch, caplog):
    whole, made = workers.Worker, []

    def refused():
        if len(made) == allowed:
            raise BlockingIOError(11, "Resource temporarily unavailable")
        made.append(whole())
        return made[-1]

    monkeypatch.setattr(workers, "Worker", refused)
    found = dict(workers.call_all(divmod, [(k, 3) for k in range(4)], 3))
    assert sorted(found) == [0, 1, 2, 3] and caplog.text.count("can be started") == 1
    if allowed:
        assert all(found[k] == divmod(k, 3) for k in range(4))
    else:
        assert all(type(answer) is WorkerError for answer in found.values())
