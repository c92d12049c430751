"""The kernel cache: what decides the key, who may read it, and what happens when compiler, folder or library fail."""

import json
import logging
import os
import stat
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import arms
import numpy as np
import pytest
import urdf_factory as factory

import energyopt as eo
from energyopt.dynamics import compiler, kernels
from energyopt.dynamics.parameters import structure_of

SAME_PLAN = 1e-8
"""Relative: kernels differ by rounding, and the solver stops at the same tolerance."""

needs_compiler = pytest.mark.skipif(compiler.find_compiler() is None, reason="no C compiler")
STATES = np.array([[0.3, -0.5, 2.0], [1.0, 0.2, -1.0]])


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    """A process that has compiled nothing yet, with an empty cache; calling it forgets again."""

    def forget(**environment):
        for name in ("CC", "ENERGYOPT_CC", "XDG_CACHE_HOME"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setenv("ENERGYOPT_CACHE", str(tmp_path / "cache"))
        for name, value in environment.items():
            monkeypatch.setenv(name, value) if value is not None else monkeypatch.delenv(name, raising=False)
        monkeypatch.setattr(kernels, "_LOADED", {})
        monkeypatch.setattr(compiler, "_FAILURES", {})
        monkeypatch.setattr(tempfile, "tempdir", None)
        compiler.find_compiler.cache_clear()
        compiler.cache_folder.cache_clear()
        compiler._compiler_version.cache_clear()

    forget()
    yield forget
    monkeypatch.undo()
    for cached in (compiler.find_compiler, compiler.cache_folder, compiler._compiler_version):
        cached.cache_clear()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The library of the pendulum, as this machine compiles it."""
    caches = compiler.find_compiler, compiler.cache_folder, compiler._compiler_version
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ENERGYOPT_CACHE", str(tmp_path_factory.mktemp("made")))
        for name in ("CC", "ENERGYOPT_CC", "XDG_CACHE_HOME"):
            patch.delenv(name, raising=False)
        patch.setattr(kernels, "_LOADED", {})
        for cached in caches:  # tests before this one may have looked for another compiler
            cached.cache_clear()
        path = library(arms.pendulum())
    for cached in caches:
        cached.cache_clear()
    return path


def library(robot):
    """The library that the kernels of a robot were loaded from."""
    return Path(kernels.kernels_of(robot.dynamics).library._name)


def right_torque(robot, found):
    return arms.relative(found.torque(STATES), robot.torque(*np.split(STATES, 3, axis=1))) < 1e-10


def reach(robot):
    return eo.Problem(robot, [-1.2], [1.0], 1.5)


@needs_compiler
def test_the_digest_changes_with_everything_the_torque_depends_on():
    text, pendulum = factory.pendulum(), lambda text, **options: arms.from_urdf(text, **options).dynamics.digest
    variants = [
        pendulum(text), pendulum(factory.pendulum(1.1)), pendulum(factory.pendulum(1.0, 1.1)), pendulum(text, armature=0.1),
        pendulum(text, viscous_friction=0.1), pendulum(text, coulomb_friction=0.1), pendulum(text, gravity=(0, 0, -1.6)),
        pendulum(text, coulomb_friction=0.1, coulomb_velocity=0.2), pendulum(text, payload=eo.Payload(0.5)),
        pendulum(factory.planar_arm([1.0], [1.0], centers=[1.0], inertias=[0.0], axis=(0, 0, 1))),
        pendulum(factory.sliders()),
    ]  # fmt: skip
    assert len(set(variants)) == len(variants)
    assert pendulum(text) == variants[0]


@needs_compiler
def test_numbers_share_a_library_and_structures_do_not():
    """Payload, masses, friction, armature and the strength of gravity are inputs of the code; where things are is not."""
    text = factory.planar_arm([0.5, 0.4], [2.0, 1.5])
    same = [
        arms.from_urdf(text), arms.from_urdf(text, payload=eo.Payload(0.5, center=(0.1, 0.2, 0.3))),
        arms.from_urdf(factory.planar_arm([0.5, 0.4], [1.0, 3.0])), arms.from_urdf(text, armature=0.1),
        arms.from_urdf(text, viscous_friction=0.1), arms.from_urdf(text, gravity=(0, 0, -1.6)),
    ]  # fmt: skip
    assert len({structure_of(robot.dynamics).digest for robot in same}) == 1
    other = [
        arms.from_urdf(factory.planar_arm([0.4, 0.4], [2.0, 1.5])), arms.from_urdf(text, gravity=(0, 1, -9.8)),
        arms.from_urdf(factory.planar_arm([0.5, 0.4], [2.0, 1.5], axis=(0, 0, 1))), arms.from_urdf(text, coulomb_friction=0.1),
        arms.from_urdf(factory.sliders(2)),
    ]  # fmt: skip
    digests = [structure_of(robot.dynamics).digest for robot in (same[0], *other)]
    assert len(set(digests)) == len(digests)


@needs_compiler
def test_limits_and_names_do_not_change_the_key():
    one, other = (arms.from_urdf(factory.pendulum(**options)) for options in ({}, {"effort": 3.0, "velocity": 1.0}))
    assert one.dynamics.digest == other.dynamics.digest


@needs_compiler
def test_the_key_changes_with_the_compiler(fresh, tmp_path):
    keys = [compiler.library_key("arm")]
    path = wrapper(tmp_path, 'exec cc "$@"')
    fresh(ENERGYOPT_CC=path)
    keys.append(compiler.library_key("arm"))
    assert keys[0] != keys[1]


@needs_compiler
def test_folder_and_library_are_their_owners_alone(fresh):
    path = library(arms.pendulum())
    assert path.parent == compiler.cache_folder()
    for place in (path, path.parent):
        assert not place.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO)
    assert [p.name for p in path.parent.iterdir()] == [path.name], "nothing but the library is left in the folder"


@needs_compiler
def test_what_a_killed_compilation_left_is_removed_after_a_day_and_a_running_one_is_left_alone(fresh):
    folder = compiler.cache_folder()
    killed, running = folder / "compile-killed", folder / "compile-running"
    for work in (killed, running):
        put(work / "sample.c", b"", 0o600)
    yesterday = time.time() - compiler.FORSAKEN - 60.0
    os.utime(killed, (yesterday, yesterday))
    path = library(arms.pendulum())
    assert {p.name for p in folder.iterdir()} == {path.name, running.name}


@needs_compiler
def test_a_cached_library_is_loaded_without_compiling(fresh, tmp_path, made):
    path = put(tmp_path / "cache" / made.name, made.read_bytes(), 0o700)
    before = path.stat()
    found = kernels.kernels_of(arms.pendulum().dynamics)
    assert found.kind == "compiled" and found.compile_s == 0
    assert library(arms.pendulum()) == path and path.stat().st_mtime_ns == before.st_mtime_ns


@needs_compiler
@pytest.mark.parametrize("damage", ["half", "one bit"])
def test_a_damaged_library_is_compiled_again(fresh, tmp_path, made, damage):
    """Loading half a library would end the process, so it must not even be tried."""
    content = made.read_bytes()
    flipped = bytearray(content)
    flipped[len(content) // 2] ^= 1
    damaged = {"half": content[: len(content) // 2], "one bit": bytes(flipped)}[damage]
    put(tmp_path / "cache" / made.name, damaged, 0o700)
    found = kernels.kernels_of(arms.pendulum().dynamics)
    assert found.kind == "compiled" and found.compile_s > 0 and right_torque(arms.pendulum(), found)
    assert [path.read_bytes() == damaged for path in (tmp_path / "cache").iterdir()] == [False]


@needs_compiler
def test_a_library_others_could_have_written_is_not_loaded(fresh, tmp_path, made):
    path = tmp_path / "cache" / made.name
    for mode in (0o702, 0o770):
        put(path, made.read_bytes(), mode)
        assert compiler.cached_library(made.name.split("-")[1]) is None
    found = kernels.kernels_of(arms.pendulum().dynamics)
    assert found.compile_s > 0 and right_torque(arms.pendulum(), found)
    assert not library(arms.pendulum()).stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO)


def put(path, content, mode):
    path.parent.mkdir(mode=0o700, exist_ok=True)
    path.write_bytes(content)
    path.chmod(mode)
    return path


@needs_compiler
def test_a_folder_others_can_write_is_not_used(fresh, tmp_path):
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(0o777)
    fresh(XDG_CACHE_HOME=str(tmp_path / "home"))
    assert compiler.cache_folder() == tmp_path / "home" / "energyopt"


@needs_compiler
def test_where_no_cache_can_be_written_a_temporary_folder_serves(fresh, tmp_path):
    """A home below a plain file: nothing can be made there, whoever runs this."""
    (tmp_path / "file").touch()
    (tmp_path / "tmp").mkdir()
    home = tmp_path / "file"
    fresh(ENERGYOPT_CACHE=None, HOME=str(home), XDG_CACHE_HOME=str(home / "cache"), TMPDIR=str(tmp_path / "tmp"))
    found = kernels.kernels_of(arms.pendulum().dynamics)
    assert found.kind == "compiled" and right_torque(arms.pendulum(), found)
    assert library(arms.pendulum()).is_relative_to(tmp_path / "tmp")


@needs_compiler
@pytest.mark.skipif(os.geteuid() == 0, reason="root writes everywhere")
def test_a_read_only_home_is_tolerated(fresh, tmp_path):
    home = tmp_path / "home"
    home.mkdir(mode=0o500)
    fresh(ENERGYOPT_CACHE=None, HOME=str(home), TMPDIR=str(tmp_path))
    assert right_torque(arms.pendulum(), kernels.kernels_of(arms.pendulum().dynamics))


def wrapper(folder, script):
    """A compiler that is a shell script; with ``$@`` the real one can be called."""
    path = folder / "compiler"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return str(path)


def test_without_a_compiler_one_notice_and_the_same_plan(fresh, caplog):
    robot = arms.pendulum()
    usual = eo.plan(reach(robot), eo.BSpline(control_points=14, accuracy=None))
    fresh(ENERGYOPT_CC="none")
    with caplog.at_level(logging.WARNING, "energyopt"):
        plans = [eo.plan(reach(robot), eo.BSpline(control_points=14, accuracy=None)) for _ in range(2)]
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "no C compiler (switched off by ENERGYOPT_CC=none)" in caplog.text and "slower" in caplog.text
    assert all("no C compiler (switched off by ENERGYOPT_CC=none): kernels ran" in " ".join(plan.notes) for plan in plans)
    assert all(plan.options["kernels"] == "interpreted" and plan.solved for plan in plans)
    assert plans[0].objective == pytest.approx(usual.objective, rel=SAME_PLAN)
    t = np.linspace(0.0, 1.5, 50)
    np.testing.assert_allclose(plans[0].trajectory(t), usual.trajectory(t), atol=1e-5)  # J is flat: error² there


FAILS_LATE = """case "$*" in *probe*) exec cc "$@";; esac
echo "kernels.c: error: out of ideas" >&2; exit 1"""


@needs_compiler
def test_a_compiler_that_fails_on_the_kernels_is_named_once_and_done_without(fresh, tmp_path, caplog):
    """It passes the small probe, so only the real compilation finds out."""
    fresh(ENERGYOPT_CC=wrapper(tmp_path, FAILS_LATE))
    with caplog.at_level(logging.WARNING, "energyopt"):
        plan = eo.plan(reach(arms.pendulum()))
    assert plan.solved and plan.options["kernels"] == "interpreted"
    assert len(caplog.records) == 1 and "out of ideas" in caplog.text
    note = next(note for note in plan.notes if "interpreted" in note)
    assert "compiler' failed (kernels.c: error: out of ideas)" in note and "no C compiler" not in note
    assert not list(compiler.cache_folder().glob("*.so"))


def test_a_compiler_that_never_works_is_named_and_passed_over(fresh, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(compiler, "find_spec", lambda name: None)
    fresh(ENERGYOPT_CC=wrapper(tmp_path, "echo 'no licence: error' >&2; exit 1"), PATH=str(tmp_path))
    with caplog.at_level(logging.WARNING, "energyopt"):
        assert compiler.find_compiler() is None and compiler.find_compiler() is None
    assert len(caplog.records) == 1
    assert all(word in caplog.text for word in ("ENERGYOPT_CC is", "compiles no C file: no licence", "no other compiler"))
    assert kernels.kernels_of(arms.pendulum().dynamics).kind == "interpreted"


@needs_compiler
@pytest.mark.parametrize("variable", ["ENERGYOPT_CC", "CC"])
def test_a_compiler_that_is_not_there_is_named_once_and_another_used(fresh, caplog, variable):
    fresh(**{variable: "no-such-cc -O9"})
    with caplog.at_level(logging.WARNING, "energyopt"):
        found = [compiler.find_compiler() for _ in range(2)]
    assert found[0] == found[1] and found[0] is not None
    assert len(caplog.records) == 1
    assert f"{variable} is 'no-such-cc -O9', which is no program that can be run; '{' '.join(found[0])}' is used" in caplog.text


def test_one_compilation_at_a_time_whoever_comes_while_the_lock_is_let_go(tmp_path):
    """A file that was removed while others waited for it locks nobody out who comes later."""
    path, inside, most = tmp_path / "lock", [], []

    def compile_once(_):
        with compiler._lock(path):
            inside.append(1)
            most.append(len(inside))
            time.sleep(0.002)
            inside.pop()

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(compile_once, range(64)))
    assert max(most) == 1 and len(most) == 64 and not path.exists()


PROGRAM = """
import json, sys, energyopt as eo
from energyopt.dynamics.kernels import kernels_of
robot = eo.load_robot(sys.argv[1])
print("ready", flush=True)
sys.stdin.readline()
kernels = kernels_of(robot.dynamics)
plan = eo.plan(eo.Problem(robot, [-1.2], [1.0], 1.5))
print(json.dumps([kernels.kind, plan.status.value, plan.objective.hex()]), flush=True)
"""


@needs_compiler
def test_two_processes_compile_at_the_same_time_and_plan_the_same_bits(tmp_path):
    """An objective equal to the last bit also shows that plans do not depend on the process."""
    path = factory.write(tmp_path, factory.pendulum(1.3))
    environment = os.environ | {"ENERGYOPT_CACHE": str(tmp_path / "cache"), "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    start = lambda: subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(path)], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    processes = [start(), start()]
    assert [p.stdout.readline() for p in processes] == ["ready\n"] * 2
    for p in processes:
        p.stdin.write("go\n")
        p.stdin.flush()
    found = [json.loads(p.communicate(timeout=60)[0]) for p in processes]
    assert found[0][:2] == ["compiled", "SOLVED"] and found[0] == found[1]
    assert len(list((tmp_path / "cache").iterdir())) == 3  # the arm's kernels, the solver and its look ahead, each once
