"""Tests that want the machine to themselves have it, however many workers run the others (see `conftest`)."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("xdist")

TESTS = """
import os, time
import pytest

def note(k, alone):
    began = time.monotonic()
    time.sleep(0.05)
    with open("notes", "a") as file:
        file.write(f"{k} {alone:d} {began} {time.monotonic()}\\n")

@pytest.mark.parametrize("k", range(24))
def test_beside_others(k):
    note(k, False)

@pytest.mark.alone
@pytest.mark.parametrize("k", range(6))
def test_alone(k):
    note(k, True)
"""


def test_no_other_test_runs_beside_one_that_is_alone(tmp_path):
    shutil.copy(Path(__file__).with_name("conftest.py"), tmp_path)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = alone\n")
    (tmp_path / "test_both.py").write_text(TESTS)
    command = [sys.executable, "-m", "pytest", "-q", "-n", "3", "--dist", "load", "-p", "no:cacheprovider"]
    done = subprocess.run(command, cwd=tmp_path, env=os.environ, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0 and "30 passed" in done.stdout, done.stdout + done.stderr
    spans = [line.split() for line in (tmp_path / "notes").read_text().splitlines()]
    times = [(bool(int(alone)), float(began), float(ended)) for _, alone, began, ended in spans]
    assert len(times) == 30
    for k, (alone, began, ended) in enumerate(times):
        beside = [other for j, other in enumerate(times) if j != k and other[1] < ended and began < other[2]]
        assert not (alone and beside), (began, ended, beside)
