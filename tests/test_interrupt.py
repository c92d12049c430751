"""Ctrl-C in the middle of a solve: over within half a second, the best motion kept, exit code 130."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import arms
import numpy as np
import pytest

import energyopt as eo
from energyopt.solvers.interrupts import Interrupts, unless_stopped

pytestmark = pytest.mark.alone
LATEST = 0.5
"""Seconds from the signal to the end."""
SLACK = 0.3
"""What a machine with much else to do may take to end a process."""

SCRIPT = """
import json, sys, time
import energyopt as eo
robot = eo.load_robot("panda")
problem = eo.Problem(robot, robot.home, robot.home + 0.4, 1.5)
heard = []
def progress(phase, iteration, objective, violation):
    if not heard:
        print("solving", flush=True)
    heard.append(iteration)
plan = eo.plan(problem, METHOD, verbose=progress, throw=THROW)
moved = plan.trajectory(1.5) - robot.home
print(json.dumps([plan.status.value, plan.message, len(heard), plan.objective, moved.tolist()]), flush=True)
"""
METHODS = {
    "one long solve": "eo.HermiteSimpson(200)",
    "long iterations": "eo.HermiteSimpson(400)",
    "thousands of starts": "eo.BSpline(control_points=12, accuracy=None), starts=100_000",
    "endless refinement": "eo.BSpline(degree=5, accuracy=1e-9), starts=50",
}


CTRL_C = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
"""It is ignored where the tests run in the background."""


def environment():
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [str(Path(eo.__file__).parents[1]), *sys.path]))}


def start(*command, **variables):
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, *command], env=environment() | variables, **pipes)


@pytest.mark.parametrize("method, throw", [(method, throw % 2) for throw, method in enumerate(METHODS)])
def test_a_solve_ends_soon_after_ctrl_c_and_keeps_its_motion(method, throw):
    """Whether or not the plan would throw: what the user has stopped is no failure."""
    process = start("-c", SCRIPT.replace("METHOD", METHODS[method]).replace("THROW", str(bool(throw))))
    assert process.stdout.readline() == "solving\n"
    time.sleep(0.15)
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    line = process.stdout.readline()
    took = time.monotonic() - began
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 0 and not errors, errors
    status, message, heard, objective, moved = json.loads(line)
    assert status == "INTERRUPTED" and "interrupted" in message and heard > 0
    assert np.isfinite(objective) and took < LATEST + SLACK
    np.testing.assert_allclose(moved, 0.4, atol=1e-6)


BLOCKED = """
import sys; sys.path.insert(0, {tests!r})
import energyopt as eo, test_obstacles as t
from energyopt.pathfinding.guesses import SEARCHERS
searcher = SEARCHERS["rrt"]
def search(*arguments):
    print("searching", flush=True)
    return searcher(*arguments)
SEARCHERS["rrt"] = search
plan = eo.plan(t.task(*t.cage()), eo.BSpline(accuracy=None))
print(plan.status.value, plan.message, flush=True)
"""


def test_looking_for_a_path_ends_soon_after_ctrl_c():
    process = start("-c", BLOCKED.format(tests=str(Path(__file__).parent)))
    assert process.stdout.readline() == "searching\n"
    time.sleep(0.3)
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    line = process.stdout.readline()
    took = time.monotonic() - began
    _, errors = process.communicate(timeout=30)
    assert line.startswith("INTERRUPTED") and "contact not looked for; 1 guess tried: straight" in line, line + errors
    assert took < LATEST + SLACK


def test_ctrl_c_in_the_last_moment_of_a_solve_begins_no_search_for_a_path(monkeypatch):
    """Inside a solve the signal is only remembered; what follows may take seconds, and does not ask whether it came."""
    from test_obstacles import cage, task

    from energyopt.pathfinding import PathSearch
    from energyopt.pathfinding.guesses import SEARCHERS
    from energyopt.solvers import interior

    solve, solves, searches, last = interior.solve, [], [], None

    def solved(program, x0, options, progress, stop):
        result = solve(program, x0, options, progress, stop)
        solves.append(result.outcome)
        if len(solves) == last:
            with stop.held():
                signal.raise_signal(signal.SIGINT)
        return result

    def no_path(*_):
        searches.append(len(solves))
        return PathSearch(None, "not looked for", 0, 0.0)

    monkeypatch.setattr(interior, "solve", solved)
    monkeypatch.setitem(SEARCHERS, "rrt", no_path)
    eo.plan(task(*cage()), eo.BSpline(accuracy=None), throw=False)
    last, before = searches[0], solves[: searches[0]]
    solves.clear(), searches.clear()
    plan = eo.plan(task(*cage()), eo.BSpline(accuracy=None))
    assert plan.status is eo.Status.INTERRUPTED and solves == before and not searches


TOLD = """
try:
    {}
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


def until_told(process, wait):
    """Seconds from SIGINT, sent after some, until the script says that it has been interrupted."""
    time.sleep(wait)
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    line = process.stdout.readline()
    took = time.monotonic() - began
    _, errors = process.communicate(timeout=30)
    assert line == "interrupted\n" and not errors, line + errors
    return took


def runs(pid):
    """Whether a process is there; one that has ended stays in the table until its parent asks how."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


SLOW = """#!/bin/sh
case "$*" in *probe*|*--version*) exec cc "$@";; esac
sleep 60 & echo $! >> NOTES; wait"""


def test_ctrl_c_while_kernels_are_compiled_ends_the_compilers(tmp_path):
    """Several at once, in threads, each with processes of its own; nothing of them is left."""
    notes, slow = tmp_path / "notes", tmp_path / "slow-cc"
    slow.write_text(SLOW.replace("NOTES", str(notes)))
    slow.chmod(0o755)
    cache = tmp_path / "cache"
    code = "import energyopt as eo; problem = eo.load_problem('panda_reach')\n" + TOLD.format("eo.plan(problem)")
    process = start("-c", CTRL_C + code, ENERGYOPT_CC=str(slow), ENERGYOPT_CACHE=str(cache))
    deadline = time.monotonic() + 60.0
    while not (notes.exists() and notes.read_text()) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert until_told(process, 0.3) < LATEST + SLACK
    assert not any(map(runs, notes.read_text().split()))
    assert not list(cache.glob("compile-*"))


def test_ctrl_c_while_an_arm_is_covered_by_spheres_waits_for_no_link(tmp_path):
    """The arm's meshes have not been seen before: covering them takes several seconds."""
    code = (
        "import energyopt as eo\n"
        "from energyopt.geometry import cache, robot_spheres as spheres\n"
        "cache._shipped, cover = (lambda name: None), spheres.cover_bodies\n"
        "arm, said = eo.load_robot('baxter'), iter([b'covering\\n'])\n"
        "spheres.cover_bodies = lambda *given: (os.write(1, next(said, b'')), cover(*given))[1]\n"
    )
    code = "import os\n" + code + TOLD.format("spheres.robot_spheres(arm)")
    process = start("-c", CTRL_C + code, ENERGYOPT_CACHE=str(tmp_path))
    assert process.stdout.readline() == "covering\n"
    assert until_told(process, 1.0) < LATEST + SLACK


def test_afterwards_ctrl_c_is_pythons_own_again():
    before = signal.getsignal(signal.SIGINT)
    eo.plan(eo.Problem(arms.pendulum(), [-1.2], [1.0], 1.5))
    assert signal.getsignal(signal.SIGINT) is before


def test_a_plan_in_another_thread_works_without_signals():
    found = []
    worker = threading.Thread(target=lambda: found.append(eo.plan(eo.Problem(arms.pendulum(), [-1.2], [1.0], 1.5))))
    worker.start()
    worker.join(timeout=60)
    assert found and found[0].solved


def interrupt(process, wait):
    """Send SIGINT after so many seconds; returns exit code, what was said on standard error, and seconds until the end."""
    time.sleep(wait)
    assert process.poll() is None, process.stderr.read()
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    return process.returncode, errors, time.monotonic() - began


LONG = """
[robot]
name = "panda"
[problem]
start = "home"
goal = [0.4, -0.4, 0.4, -2.0, 0.4, 2.0, 1.2]
duration = 1.5
[method]
control_points = 12
accuracy = false
starts = 10000
"""


@pytest.mark.parametrize("wait", [0.7, 1.5, 3.0, 5.0])
@pytest.mark.parametrize("cold", [False, True])
def test_the_command_line_ends_with_130_soon_after_ctrl_c_at_every_stage(tmp_path, monkeypatch, wait, cold):
    """During imports, while kernels are compiled (where the cache is empty), guesses made, and in the first of many solves."""
    if cold:
        monkeypatch.setenv("ENERGYOPT_CACHE", str(tmp_path / "cache"))
    (tmp_path / "long.toml").write_text(LONG)
    out = tmp_path / "o"
    process = start("-m", "energyopt", "plan", str(tmp_path / "long.toml"), "--no-replay", "--quiet", "--out", str(out))
    code, errors, took = interrupt(process, wait)
    assert code == 130 and "Traceback" not in errors, errors
    assert took < LATEST + SLACK
    assert not list(out.glob("*.tmp")) if out.exists() else True
    if (out / "plan.npz").exists():
        assert eo.load_plan(out / "plan.npz").status is eo.Status.INTERRUPTED


RUN = """
from pathlib import Path
from energyopt import io, stopping, workflow
def progress(phase, iteration, objective, violation):
    print(iteration, flush=True)
def command():
    problem, options = io.load_task(PROBLEM, {})
    return int(workflow.run(problem, options, Path(OUT), verbose=progress).valid)
stopping.run(command)
"""


def test_what_was_found_is_saved_as_interrupted(tmp_path):
    (tmp_path / "long.toml").write_text(LONG)
    out = tmp_path / "o"
    process = start("-c", RUN.replace("PROBLEM", repr(str(tmp_path / "long.toml"))).replace("OUT", repr(str(out))))
    for _ in range(40):
        assert process.stdout.readline().strip().isdigit()
    code, _, took = interrupt(process, 0.05)
    assert code == 130 and took < LATEST + SLACK
    plan = eo.load_plan(out / "plan.npz")
    assert plan.status is eo.Status.INTERRUPTED and plan.violations.amount["boundary"] < 1e-6


def test_a_library_call_that_lasts_does_not_keep_the_command_line_alive():
    """Python runs no signal handler meanwhile; the second thread ends the process."""
    script = "import hashlib; from energyopt import stopping as s; "
    script += "s.run(lambda: print('in', flush=True) or hashlib.pbkdf2_hmac('sha256', b'', b'', 10**9))"
    process = start("-c", script)
    assert process.stdout.readline() == "in\n"
    code, errors, took = interrupt(process, 0.1)
    assert code == 130 and not errors and took < LATEST + SLACK


@pytest.mark.parametrize("does, code", [("return 3", 3), ("exit(2)", 2), ("pass", 0), ("raise KeyboardInterrupt", 130)])
def test_without_a_signal_the_exit_code_is_the_commands_own(does, code):
    process = start("-c", f"from energyopt import stopping\ndef command():\n    {does}\nstopping.run(command)")
    process.communicate(timeout=30)
    assert process.returncode == code


QUIET = """
import signal, time
from energyopt import stopping
def command():
    heard = []
    signal.signal(signal.SIGINT, lambda *_: heard.append(1))
    signal.raise_signal(signal.SIGINT)
    time.sleep(0.05)
    return int(not heard)
stopping.run(command)
"""


def test_a_command_that_keeps_the_signal_to_itself_ends_with_130():
    """As one does that returns what it has of a motion without looking at its status."""
    process = start("-c", QUIET)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130 and not errors


def test_outside_a_solve_ctrl_c_raises_and_inside_it_is_remembered():
    with Interrupts() as interrupted:
        with interrupted.held():
            signal.raise_signal(signal.SIGINT)
        assert interrupted()
        with pytest.raises(KeyboardInterrupt), interrupted.held():
            signal.raise_signal(signal.SIGINT)  # the second one is meant
    with pytest.raises(KeyboardInterrupt), Interrupts():
        signal.raise_signal(signal.SIGINT)


def test_work_that_does_not_stop_is_left_and_other_work_is_waited_for():
    assert unless_stopped(lambda: 5, lambda: False) == 5
    assert unless_stopped(lambda: 5, None) == 5
    with pytest.raises(ZeroDivisionError):
        unless_stopped(lambda: 1 / 0, lambda: False)
    released = threading.Event()
    began = time.monotonic()
    assert unless_stopped(lambda: released.wait(20), lambda: True) is None
    assert time.monotonic() - began < LATEST
    released.set()


def test_ctrl_c_between_two_solves_keeps_the_best_of_those_before(monkeypatch):
    """Here while the second guess is made: the first motion had converged."""
    from energyopt import searcher

    problem, search = eo.Problem(arms.pendulum(), [-1.2], [1.0], 1.5), searcher.Searcher.search

    def searched_then_interrupted(self, *arguments):
        if self.current is not None:
            signal.raise_signal(signal.SIGINT)
        return search(self, *arguments)

    whole = eo.plan(problem, eo.BSpline(accuracy=None))
    monkeypatch.setattr(searcher.Searcher, "search", searched_then_interrupted)
    plan = eo.plan(problem, eo.BSpline(accuracy=None), starts=5)
    assert plan.status is eo.Status.INTERRUPTED and plan.objective == pytest.approx(whole.objective, rel=1e-9)


def test_ctrl_c_before_there_is_any_motion_is_a_keyboard_interrupt(monkeypatch):
    from energyopt import attempts

    monkeypatch.setattr(attempts, "goals", lambda *_: signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        eo.plan(eo.Problem(arms.pendulum(), [-1.2], [1.0], 1.5))
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
