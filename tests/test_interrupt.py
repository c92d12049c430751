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

LATEST = 0.5
"""Seconds from the signal to the end, on a machine that has something else to do too."""

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
    "thousands of starts": "eo.BSpline(control_points=12, accuracy=None), starts=100_000",
    "endless refinement": "eo.BSpline(degree=5, accuracy=1e-9), starts=50",
}


def environment():
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [str(Path(eo.__file__).parents[1]), *sys.path]))}


def start(*command):
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, *command], env=environment(), **pipes)


@pytest.mark.parametrize("method, throw", [(method, throw) for throw, method in enumerate(METHODS)])
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
    assert np.isfinite(objective) and took < LATEST
    np.testing.assert_allclose(moved, 0.4, atol=1e-6)


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


def test_the_command_line_ends_with_130_soon_after_ctrl_c(tmp_path):
    problem = tmp_path / "long.toml"
    problem.write_text(
        '[robot]\nname = "panda"\n[problem]\nstart = "home"\ngoal = [0.4, -0.4, 0.4, -2.0, 0.4, 2.0, 1.2]\nduration = 1.5\n'
        "[method]\ncontrol_points = 12\naccuracy = false\nstarts = 10000\n"
    )
    process = start("-m", "energyopt", "plan", str(problem), "--no-replay", "--quiet")
    time.sleep(3.0)  # ten thousand starts last minutes; the imports a second or two
    assert process.poll() is None, process.stderr.read()
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    took = time.monotonic() - began
    assert process.returncode == 130 and "Traceback" not in errors
    assert took < LATEST + 1.0, "half a second, and what it takes Python to leave"
