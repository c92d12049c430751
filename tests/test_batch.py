"""plan_many gives every problem its own result, in order, wherever and by however many processes it is planned."""

import ast
import gc
import logging
import multiprocessing
import os
import signal
import subprocess
import sys
import time
import weakref
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from batch_problems import SPLINE, Deadly, DeadlyOnce, Spoiler, counting_compiler, moves, spoiled

import energyopt as eo
from energyopt.batch import FailureStatus

HERE = Path(__file__).resolve().parent


@pytest.fixture(scope="module")
def four():
    problems = list(moves(4))
    return problems, [eo.plan(problem, SPLINE) for problem in problems]


def same(plans, others):
    """Bit for bit the same motions."""
    t = np.linspace(0.0, 4.0, 33)
    return all(
        one.objective == other.objective and np.array_equal(one.trajectory(t), other.trajectory(t))
        for one, other in zip(plans, others, strict=True)
    )


@pytest.mark.parametrize("processes", [1, 3])
def test_results_are_those_of_plan_in_order_whatever_the_number_of_processes(four, processes):
    problems, alone = four
    plans = eo.plan_many(problems, SPLINE, processes=processes, progress=False)
    assert same(plans, alone) and [plan.problem for plan in plans] == problems
    assert all(plan.problem is problem for plan, problem in zip(plans, problems, strict=True)), "nothing comes back twice"


def test_a_problem_that_fails_spoils_no_other(four):
    (first, second, *_), alone = four
    impossible, broken = replace(first, duration=0.01), spoiled(first, "waypoints", 7)
    results = eo.plan_many([first, "no problem", impossible, broken, second], SPLINE, processes=2, progress=False)
    assert same([results[0], results[4]], alone[:2])
    assert [result.status.value for result in results[1:4]] == ["BAD_INPUT", "BAD_INPUT", "ERROR"]
    assert [result.number for result in results[1:4]] == [1, 2, 3] and not any(result.solved for result in results[1:4])
    assert "expected one energyopt.Problem" in results[1].message and "needs at least" in results[2].message
    assert isinstance(results[2].error, eo.InputError) and results[2].problem is impossible
    assert results[3].message.startswith("TypeError: ") and "Traceback" in results[3].error.__notes__[0]
    assert not any("\n" in result.message for result in results[1:4])


def test_a_plan_without_solution_is_a_result_too(four):
    (problem, *_), _ = four
    (result,) = eo.plan_many([problem], SPLINE, iterations=1, processes=1, progress=False)
    assert isinstance(result, eo.Plan) and result.status is eo.Status.ITERATION_LIMIT


def test_throwing_raises_at_the_first_that_fails(four):
    (problem, *_), _ = four
    with pytest.raises(eo.NoSolutionFound) as caught:
        eo.plan_many([problem], SPLINE, iterations=1, processes=1, progress=False, throw=True)
    assert caught.value.plan.problem is problem
    with pytest.raises(eo.InputError, match="needs at least"):
        eo.plan_many([replace(problem, duration=0.01)], SPLINE, processes=1, progress=False, throw=True)


def test_a_worker_that_dies_is_replaced_and_its_problem_tried_once_more(four, tmp_path):
    (first, second, *_), alone = four
    fatal, once = spoiled(first, "name", Deadly()), spoiled(first, "name", DeadlyOnce(tmp_path / "mark"))
    results = eo.plan_many([first, fatal, once, second], SPLINE, processes=1, progress=False)
    assert same([results[0], results[2], results[3]], [alone[0], alone[0], alone[1]]) and (tmp_path / "mark").exists()
    assert results[1].status is FailureStatus.WORKER_LOST and "ended with the code 7" in results[1].message


def test_thousands_are_drawn_as_they_are_needed(monkeypatch):
    monkeypatch.setattr("energyopt.places.IN_FLIGHT", 5)
    drawn = []

    def source():
        for problem in moves(10**9):
            drawn.append(problem.name)
            yield problem

    results = eo.plan_each(source(), SPLINE, processes=1, progress=False)
    for k in range(12):
        assert next(results).problem.name == f"move {k}" and len(drawn) <= k + 6
    results.close()


def test_results_that_nobody_keeps_are_gone():
    seen = []
    gc.collect()
    gc.disable()  # what waits for the collector of cycles is not gone
    try:
        for plan in eo.plan_each(moves(6), SPLINE, processes=1, progress=False):
            assert sum(one() is not None for one in seen) <= 1
            seen.append(weakref.ref(plan))
    finally:
        gc.enable()
    assert len(seen) == 6


def test_an_iterable_that_fails_ends_the_batch_with_its_reason(four):
    problems, alone = four

    def source():
        yield problems[0]
        raise OSError("the disk is gone")

    plan, failure = eo.plan_many(source(), SPLINE, processes=1, progress=False)
    assert same([plan], alone[:1])
    assert failure.status is FailureStatus.BAD_INPUT and failure.problem is None
    assert failure.message.endswith("OSError: the disk is gone")


def test_no_problems_give_no_results():
    assert eo.plan_many([], progress=False) == []


def test_progress_is_told_how_many_ended_and_failed(four):
    problems, told = four[0], []
    eo.plan_many([*problems, "none"], SPLINE, processes=2, progress=lambda *now: told.append(now))
    assert [now[0] for now in told] == [1, 2, 3, 4, 5] and told[-1] == (5, 1, 5)
    eo.plan_many(iter(problems[:1]), SPLINE, processes=1, progress=lambda *now: told.append(now))
    assert told[-1] == (1, 0, None), "an iterator does not tell its length"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"problems": 5}, "expected an iterable"),
        ({"problems": np.array(3)}, "expected an iterable"),
        ({"guess": 3}, "guess is 3: expected a Trajectory, a Plan, or None"),
        ({"processes": 10**9}, "a whole number, 1 to 4096"),
        ({"processes": 0}, "processes is 0"),
        ({"processes": 2, "executor": ThreadPoolExecutor(1)}, "both given"),
        ({"executor": "threads"}, "an executor of concurrent.futures, or a dask.distributed.Client"),
        ({"progress": 3}, "progress is 3"),
        ({"verbose": True}, "no option 'verbose'"),
        ({"seed": -1}, "seed is -1"),
        ({"parameterization": "spline"}, "parameterization is 'spline'"),
    ],
)
def test_arguments_that_make_no_sense_are_refused_before_anything_starts(arguments, said):
    with pytest.raises(eo.InputError, match=said):
        eo.plan_each(**{"problems": [], **arguments})


def test_a_guess_is_for_every_problem(four):
    problems, alone = four
    for guess in (alone[0], alone[0].trajectory):
        plans = eo.plan_many(problems[:2], SPLINE, guess=guess, processes=1, progress=False)
        assert all(plan.solved and plan.options["tried"] == ["given"] for plan in plans)
        assert same(plans, [eo.plan(problem, SPLINE, guess=guess) for problem in problems[:2]])


def test_a_single_problem_is_no_batch(four):
    with pytest.raises(eo.InputError, match="such as a list"):
        eo.plan_many(four[0][0])


def test_executors_of_the_caller_give_the_same_and_stay_open(four):
    problems, alone = four
    with ThreadPoolExecutor(2) as threads:
        assert same(eo.plan_many(problems, SPLINE, executor=threads, progress=False), alone)
        assert threads.submit(abs, -1).result() == 1
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as spawned:
        results = eo.plan_many([*problems, "none"], SPLINE, executor=spawned, progress=False)
        assert same(results[:4], alone) and results[4].status is FailureStatus.BAD_INPUT
        assert spawned.submit(abs, -1).result() == 1


def test_a_pool_of_processes_that_breaks_costs_only_the_problem_that_broke_it(four, caplog):
    """The whole pool ends with one of its processes and never recovers; what it held is planned by processes of our own."""
    problems, alone = four
    given = [spoiled(problems[0], "name", Deadly()), *problems, spoiled(problems[1], "name", Deadly())]
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as spawned:
        with caplog.at_level(logging.WARNING, "energyopt"):
            results = eo.plan_many(given, SPLINE, executor=spawned, progress=False)
        assert same(results[1:5], alone)
        assert [results[k].status for k in (0, 5)] == [FailureStatus.WORKER_LOST] * 2
        assert "ended with the code 7" in results[0].message and len(caplog.records) == 1
        assert "worker processes (1) take its place" in caplog.text
        assert same(eo.plan_many(problems[:1], SPLINE, executor=spawned, progress=False), alone[:1]), "it is broken still"


def test_an_error_that_no_other_process_can_read_breaks_no_pool_and_is_told(four, caplog):
    problems = [spoiled(four[0][0], "name", Spoiler()), four[0][1]]
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as spawned:
        for where in ({"executor": spawned}, {"processes": 1}):
            failure, plan = eo.plan_many(problems, SPLINE, progress=False, **where)
            assert failure.status is FailureStatus.ERROR and failure.message == "Odd: this and that"
            assert "Traceback" in failure.error.__notes__[0] and plan.solved
        assert spawned.submit(abs, -1).result() == 1 and not caplog.records


def test_an_executor_that_is_shut_down_is_refused_before_anything_starts(four):
    for kind in (ThreadPoolExecutor, ProcessPoolExecutor):
        executor = kind(1)
        executor.shutdown()
        with pytest.raises(eo.InputError, match=r"executor takes no work: .*; expected one that is open"):
            eo.plan_each(four[0], SPLINE, executor=executor)


def test_what_cannot_be_sent_says_so_and_is_planned_in_a_thread(four):
    problem = replace(four[0][0], origin=lambda key: ("here", key))
    (failure,) = eo.plan_many([problem], SPLINE, processes=1, progress=False)
    assert failure.status is FailureStatus.BAD_INPUT and "cannot be sent" in failure.message
    with ThreadPoolExecutor(1) as thread:
        assert same(eo.plan_many([problem], SPLINE, executor=thread, progress=False), four[1][:1])


def test_kernels_are_compiled_once_and_a_robot_arrives_once(tmp_path):
    environment, notes = counting_compiler(tmp_path / "cc")
    code = (
        "import energyopt as eo\n"
        "from batch_problems import SPLINE, moves\n"
        "problems = [problem for k in range(3) for problem in moves(2, eo.load_robot('twodof'), seed=k)]\n"
        "assert len({id(problem.robot) for problem in problems}) == 3\n"
        "plans = eo.plan_many(problems, SPLINE, processes=2, progress=False)\n"
        "assert all(plan.solved and plan.options['kernels'] == 'compiled' for plan in plans)\n"
    )
    run(code, environment)
    assert sum("samples.c" in line for line in notes.read_text().splitlines()) == 1


def test_equal_robots_are_unpacked_as_one(four):
    from energyopt.parcels import packed, unpacked

    problems = [next(moves(1, eo.load_robot("twodof"))) for _ in range(2)]
    assert problems[0].robot is not problems[1].robot
    first, second = (unpacked(packed(problem)) for problem in problems)
    assert first.robot is second.robot and len(packed(problems[0]).problem) < 2000 < len(packed(problems[0]).robot)


def test_a_worker_without_the_meshes_or_of_another_version_says_so(four):
    from energyopt.parcels import packed, unpacked

    parcel = packed(four[0][0])
    with pytest.raises(eo.InputError, match="meshes are not on this worker: no folder /nowhere/at/all"):
        unpacked(replace(parcel, folders=("/nowhere/at/all",)))
    with pytest.raises(eo.EnergyOptError, match=r"the sender 0\.0\.1; install the same everywhere"):
        unpacked(replace(parcel, version="0.0.1"))


def run(code, environment=None, **options):
    path = os.pathsep.join([str(HERE.parent), str(HERE), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-c", code]
    env = os.environ | {"PYTHONPATH": path} | (environment or {})
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=300, check=False, **options)
    assert done.returncode == 0, done.stderr
    return done


def test_after_ctrl_c_everything_that_was_done_is_kept_and_no_process_is_left(four):
    code = (
        "import os, signal, sys, time, energyopt as eo\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests run in the background\n"
        "from batch_problems import SPLINE, moves\n"
        "def progress(done, failed, total):\n"
        "    if done == 4: os.kill(os.getpid(), signal.SIGINT)\n"
        "of = lambda thread: open(f'/proc/self/task/{thread}/children').read().split()\n"
        "children = lambda: [child for thread in os.listdir('/proc/self/task') for child in of(thread)]\n"
        "try:\n"
        "    eo.plan_many(list(moves(400)), SPLINE, processes=2, progress=progress)\n"
        "except KeyboardInterrupt as interrupt:\n"
        "    results = interrupt.results\n"
        "    time.sleep(0.5)\n"
        "    print(sum(result.solved for result in results), {result.status.value for result in results}, children())\n"
        "    print([getattr(result, 'objective', None) for result in results[:4]])\n"
    )
    counts, objectives = run(code).stdout.splitlines()
    solved, rest = counts.split(" ", 1)
    assert 4 <= int(solved) < 20 and "SOLVED" in rest and "INTERRUPTED" in rest and rest.endswith("[]")
    assert "WORKER_LOST" not in rest
    found = ast.literal_eval(objectives)
    assert all(one in (None, plan.objective) for one, plan in zip(found, four[1], strict=True)) and any(found)


def test_the_bar_is_drawn_on_a_terminal_only_and_erased():
    import pty

    code = "import energyopt as eo\nfrom batch_problems import SPLINE, moves\neo.plan_many(list(moves(3)), SPLINE, processes=1)\n"
    assert run(code).stderr == ""
    seen, other = pty.openpty()
    path = os.pathsep.join([str(HERE.parent), str(HERE), os.environ.get("PYTHONPATH", "")])
    process = subprocess.Popen([sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": path}, stderr=other)
    assert process.wait(timeout=120) == 0
    os.close(other)
    text = os.read(seen, 65536).decode()
    assert "] 3/3" in text and text.endswith("\r\x1b[K") and "\n" not in text


def test_the_line_of_the_bar():
    from energyopt.progress import line

    assert line(0, 0, 4, 1.0) == f"  [{' ' * 30}] 0/4  "
    assert line(1, 0, 4, 20.0).endswith("] 1/4  1:00 left") and line(1, 0, 4, 20.0).count("=") == 7
    assert line(4, 2, 4, 3700.0).endswith("] 4/4  2 failed, 1:01:40 done")
    assert line(30, 1, None, 10.0) == "  30 done  1 failed, 3 a second"


def test_workers_start_no_processes_of_their_own():
    from energyopt import serving, workers

    with serving.no_more_processes():
        answers = list(workers.call_all(os.getpid, [(), ()], 2))
        assert answers == [(0, os.getpid()), (1, os.getpid())]
    ((_, pid),) = workers.call_all(os.getpid, [()], 1)
    assert pid != os.getpid()


def test_a_killed_worker_costs_no_result(four):
    """The kernel's out-of-memory killer does this."""
    from energyopt.pool import Workers

    pool = Workers(1)
    try:
        waiting = pool.submit(time.sleep, 30.0)
        time.sleep(0.5)
        os.kill(pool._workers[0]._process.pid, signal.SIGKILL)
        time.sleep(1.0)
        os.kill(pool._workers[0]._process.pid, signal.SIGKILL)
        with pytest.raises(RuntimeError, match="by signal 9"):
            waiting.result(timeout=20.0)
        assert pool.submit(abs, -3).result(timeout=60.0) == 3
    finally:
        pool.shutdown(wait=False)
        pool.shutdown()
    with pytest.raises(RuntimeError, match="have ended"):
        pool.submit(abs, -3)
