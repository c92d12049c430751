"""plan_many on a dask cluster: two worker processes on this machine, through the same client as a cluster of many."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from batch_problems import SPLINE, Deadly, counting_compiler, moves, spoiled

import energyopt as eo
from energyopt.batch import FailureStatus

distributed = pytest.importorskip("distributed", reason="dask is not installed: pip install 'energyopt[cluster]'")

HERE = Path(__file__).resolve().parent


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A client of two single-threaded worker processes, with an empty cache of kernels and a compiler that is counted."""
    import dask

    folder = tmp_path_factory.mktemp("dask")
    environment, notes = counting_compiler(folder / "cc")
    environment["PYTHONPATH"] = os.pathsep.join([str(HERE.parent), str(HERE), os.environ.get("PYTHONPATH", "")])
    settings = {
        "temporary-directory": str(folder),
        "distributed.nanny.pre-spawn-environ": environment,
        "distributed.scheduler.allowed-failures": 0,
    }
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": None, "host": "127.0.0.1"}
    with dask.config.set(settings), distributed.LocalCluster(**options) as started, distributed.Client(started) as client:
        yield client, notes


def test_a_cluster_gives_the_same_plans_in_order_and_stays_open(cluster):
    client, notes = cluster
    problems = list(moves(6))
    results = eo.plan_many([*problems, "no problem"], SPLINE, executor=client, progress=False)
    alone = [eo.plan(problem, SPLINE) for problem in problems]
    t = np.linspace(0.0, 4.0, 33)
    assert [plan.objective for plan in results[:6]] == [plan.objective for plan in alone]
    assert all(np.array_equal(a.trajectory(t), b.trajectory(t)) for a, b in zip(results, alone, strict=False))
    assert all(plan.problem is problem for plan, problem in zip(results, problems, strict=False))
    assert results[6].status is FailureStatus.BAD_INPUT
    assert client.submit(abs, -2).result() == 2
    assert sum("samples.c" in line for line in notes.read_text().splitlines()) == 1, "kernels are compiled once a machine"
    pids = set(client.run(os.getpid).values())
    assert len(pids) == 2 and os.getpid() not in pids


def test_problems_that_kill_workers_are_given_up_and_spoil_no_other(cluster):
    """The cluster gives up whatever a worker that died had been given, which is mostly not the killer alone."""
    client, _ = cluster
    problems = list(moves(6))
    alone = [eo.plan(problem, SPLINE) for problem in problems]
    deadly = (0, 3)
    for k in deadly:
        problems[k] = spoiled(problems[k], "name", Deadly())
    results = eo.plan_many(problems, SPLINE, executor=client, progress=False)
    assert [k for k, result in enumerate(results) if not result.solved] == list(deadly)
    for k, (result, plan) in enumerate(zip(results, alone, strict=True)):
        if k in deadly:
            assert result.status is FailureStatus.WORKER_LOST and "ended with the code 7" in result.message, result.message
        else:
            assert result.objective == plan.objective


def test_the_iterator_draws_as_the_cluster_works(cluster, monkeypatch):
    monkeypatch.setattr("energyopt.places.IN_FLIGHT", 4)
    drawn = []
    source = (drawn.append(problem.name) or problem for problem in moves(10**9))
    results = eo.plan_each(source, SPLINE, executor=cluster[0], progress=False)
    assert [next(results).problem.name for _ in range(12)] == [f"move {k}" for k in range(12)]
    results.close()
    assert len(drawn) <= 12 + 8, "four a worker"


def test_a_client_that_is_closed_is_refused_before_anything_starts(cluster):
    client = distributed.Client(cluster[0].scheduler.address, set_as_default=False)
    client.close()
    with pytest.raises(eo.InputError, match="a dask client that has no cluster"):
        eo.plan_each([], executor=client)


def test_dask_is_not_imported_by_energyopt():
    import subprocess

    code = "import sys, energyopt.batch; assert not {'dask', 'distributed'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ | {"PYTHONPATH": str(HERE.parent)})
