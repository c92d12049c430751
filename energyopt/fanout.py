"""First searches in worker processes; they end in the order of their guesses, as if they had been made one after another."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import replace

from energyopt.attempts import Attempt
from energyopt.avoidance import avoidance_of
from energyopt.dynamics.kernels import kernels_of
from energyopt.found import Found
from energyopt.problem import Problem
from energyopt.search import Search
from energyopt.search_state import STOP, SearchOptions
from energyopt.searcher import Parameterization, Searcher
from energyopt.serving import WorkerLost
from energyopt.solvers import Outcome
from energyopt.workers import Worker, call_all, cores

log = logging.getLogger("energyopt")

GRACE = 0.3
"""Seconds after the end of a time limit in which processes may still answer."""


def search_in_processes(
    searcher: Searcher, attempts: Iterator[Attempt], found: Found, enough: Callable[[], bool], workers: list[Worker]
) -> None:
    """Add the searches from all ``attempts``; fewer once it is ``enough``, or time is over.

    ``workers``: of earlier calls, and for later ones; see `workers.call_all`.
    """
    sent: dict[int, Attempt] = {}
    numbers: list[int] = []
    options, first = searcher.options, len(found.tried)
    stop = options.stop or (lambda: False)
    late = lambda grace: (left := options.remaining()) is not None and left < -grace

    def calls() -> Iterator[tuple]:
        for k, attempt in enumerate(attempts):
            if late(0.0):  # looking for a path may have taken all there was
                return
            sent[k] = attempt
            yield searcher.problem, searcher.durations, searcher.parameterization, attempt, options.iterations, options.deadline

    for k, answer in call_all(search_once, calls(), cores(), lambda: stop() or late(GRACE) or enough(), workers):
        attempt = sent.pop(k)
        if isinstance(answer, WorkerLost):  # what ends a process would end this one
            log.warning("energyopt: %s; guess '%s' is left out", answer, attempt.name)
            continue
        if isinstance(answer, Search):
            search = _received(searcher, answer, attempt)
        else:
            log.info("energyopt: no answer from a worker process (%s); guess '%s' is solved here", answer, attempt.name)
            search = searcher.search(attempt)
        found.add(search, attempt)
        numbers.append(k)
        if options.progress is not None:
            options.progress(f"start {len(found.tried)}", searcher.spent.iterations, search.objective, search.depth)
        if search.outcome in STOP:
            break
    found.put_in_order(first, numbers)
    if stop():
        found.ended_by = replace(searcher.current, outcome=Outcome.INTERRUPTED)


def search_once(
    problem: Problem,
    durations: tuple[float, float] | None,
    parameterization: Parameterization,
    attempt: Attempt,
    iterations: int,
    deadline: float | None,
) -> Search:
    """The first level from one guess, in a process of its own: without what cannot be sent, or the caller has."""
    options = SearchOptions(iterations, deadline=deadline)
    kernels, avoidance = kernels_of(problem.robot.dynamics), avoidance_of(problem)
    return Searcher(problem, parameterization, kernels, options, durations, avoidance).search(attempt).sent()


def _received(searcher: Searcher, answer: Search, attempt: Attempt) -> Search:
    """A search from another process, with what was not sent."""
    searcher.spent.add(answer.spent)
    problem = searcher.problem
    if searcher.durations is not None:
        problem = problem.lasting(answer.trajectory.duration)
    own = {"problem": problem, "kernels": searcher.kernels, "options": searcher.options, "spent": searcher.spent}
    return replace(answer, **own, avoidance=searcher.relaxed(attempt))
