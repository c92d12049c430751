"""plan_many(): thousands of problems over processes, other executors, or the machines of a dask cluster.

Problems are drawn from their iterable as workers fall free, and results are handed out in the order of the problems, so that at
any time a bounded number of either is held. Each problem ends in a result of its own: a `Plan`, or a `PlanFailure` that says why
there is none. What is found does not depend on the number of processes: every plan is made in one process, on one thread.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from inspect import signature
from typing import Any

from energyopt.arguments import check_names, check_options, check_problem, takes
from energyopt.enduring import is_loss
from energyopt.errors import BatchInterrupted, EnergyOptError, InputError, NoSolutionFound
from energyopt.ordered import Interrupted, Job, Undrawn, in_order
from energyopt.parameterizations import BSpline
from energyopt.parcels import packed, plan_parcel
from energyopt.places import Place
from energyopt.planning import Parameterization, plan
from energyopt.plans import Plan
from energyopt.problem import Problem
from energyopt.problem_values import shown
from energyopt.progress import Counter, told
from energyopt.readable import Readable
from energyopt.serving import WorkerError, WorkerLost, no_more_processes

_OWN = ("problem", "parameterization", "verbose", "throw")


class FailureStatus(str, Enum):
    """Why a problem of a batch has no plan."""

    BAD_INPUT = "BAD_INPUT"
    """The problem is no problem, is impossible whatever the motion, or cannot be sent."""
    ERROR = "ERROR"
    """Planning ended with an unexpected error; its notes hold the traceback."""
    WORKER_LOST = "WORKER_LOST"
    """The process that planned it ended, and so did another that planned nothing else."""
    INTERRUPTED = "INTERRUPTED"
    """Ctrl-C came first."""


@dataclass(frozen=True, eq=False, repr=False)
class PlanFailure(Readable):
    """The result of a problem that has no plan; `status`, `message`, `solved` and `problem` are there as in a `Plan`.

    Attributes:
        number: place in the batch, from 0.
        problem: what was given.
        status: why; message: the same in one line.
        error: what was raised, if anything was.
    """

    number: int
    problem: Any
    status: FailureStatus
    message: str
    error: BaseException | None = None

    def in_brief(self) -> str:
        return f"{self.status.value}, number {self.number}: {self.message}"

    @property
    def solved(self) -> bool:
        return False


def plan_many(
    problems: Iterable[Problem],
    parameterization: Parameterization | None = None,
    *,
    executor: Executor | Any | None = None,
    processes: int | None = None,
    progress: bool | Counter = True,
    throw: bool = False,
    **options: Any,
) -> list[Plan | PlanFailure]:
    """Plan many problems in parallel; one that fails spoils no other.

    Args:
        problems: any iterable, such as a generator; items are drawn as they are needed.
        parameterization, options: as for `plan`; a time limit, and a ``guess``, are for each problem.
        executor: where to plan: an executor of `concurrent.futures`, or a ``dask.distributed.Client``. It stays open.
        processes: worker processes where there is no executor; one a core by default.
        progress: a bar on standard error, where that is a terminal; or a function called with (done, failed, total).
        throw: raise at the first problem, in their order, that has no valid plan.

    Returns:
        one result a problem, in the order of the problems.

    Raises:
        InputError: an argument makes no sense. BatchInterrupted: Ctrl-C; its ``results`` are all there are so far.
        NoSolutionFound, or what planning raised: only with ``throw``.
    """
    results: list[Plan | PlanFailure] = []
    given = {"executor": executor, "processes": processes, "progress": progress, "throw": throw}
    try:
        for result in plan_each(problems, parameterization, **given, **options):
            results.append(result)
    except BatchInterrupted as interrupt:
        raise BatchInterrupted(results + interrupt.results) from None
    except KeyboardInterrupt:
        raise BatchInterrupted(results) from None
    return results


def plan_each(
    problems: Iterable[Problem],
    parameterization: Parameterization | None = None,
    *,
    executor: Executor | Any | None = None,
    processes: int | None = None,
    progress: bool | Counter = True,
    throw: bool = False,
    **options: Any,
) -> Iterator[Plan | PlanFailure]:
    """As `plan_many`, one result after another: what the caller does not keep is not kept. Workers end with the iterator.

    Args:
        problems, parameterization, executor, processes, progress, throw, options: as for `plan_many`; they are checked at once.

    Yields:
        one result a problem, in the order of the problems.

    Raises:
        InputError, NoSolutionFound: as `plan_many`. BatchInterrupted: Ctrl-C; its ``results`` were not handed out yet.
    """
    _check(problems, progress, throw, parameterization, options)
    total = _count(problems)
    options = {"parameterization": parameterization, **options}
    if isinstance(options.get("guess"), Plan):  # its problem need not travel
        options["guess"] = options["guess"].trajectory
    place = Place.of(executor, processes, total)
    return _each(problems, place, options, (progress, total), throw)


def _each(problems: Iterable, place: Place, options: dict, watch: tuple, throw: bool) -> Iterator[Plan | PlanFailure]:
    with place.open() as executor, told(*watch) as count:
        ended = lambda job: count(outcome_of(job).solved)
        try:
            for job in in_order(problems, partial(_submit, executor, options), place.window, ended):
                result = outcome_of(job)
                if throw and not result.solved:
                    raise NoSolutionFound(result) if isinstance(result, Plan) else result.error
                yield result
        except Interrupted as interrupt:
            raise BatchInterrupted([outcome_of(job) for job in interrupt.jobs]) from None


def _submit(executor: Executor, options: dict, problem: Any) -> Future:
    check_problem("plan_many", problem)
    if isinstance(executor, ThreadPoolExecutor):
        return executor.submit(_plan_here, problem, options)
    return executor.submit(plan_parcel, packed(problem), options)


def _plan_here(problem: Problem, options: dict) -> Plan:
    """In a thread of this process: nothing is sent."""
    with no_more_processes():
        return plan(problem, throw=False, **options)


def outcome_of(job: Job) -> Plan | PlanFailure:
    """The result of a job, whatever became of it; one that is not done was interrupted."""
    problem = None if isinstance(job.item, Undrawn) else job.item
    if not job.future.done():
        return PlanFailure(job.number, problem, FailureStatus.INTERRUPTED, "interrupted before it was planned")
    try:
        return replace(job.future.result(), problem=problem)
    except (Exception, CancelledError) as error:
        return PlanFailure(job.number, problem, *described(error), error)


def described(error: BaseException) -> tuple[FailureStatus, str]:
    """What an error says of its problem, in one line."""
    text = " ".join(str(error).split())
    if isinstance(error, InputError):
        return FailureStatus.BAD_INPUT, text
    lost = isinstance(error, (WorkerLost, CancelledError)) or is_loss(error)
    plain = isinstance(error, EnergyOptError) or type(error) is WorkerError
    named = text if plain else f"{type(error).__name__}: {text}".removesuffix(": ")
    return FailureStatus.WORKER_LOST if lost else FailureStatus.ERROR, named


def _is_iterable(problems: Any) -> bool:
    """An array of no dimensions, for one, only looks as if it were."""
    try:
        iter(problems)
    except TypeError:
        return False
    return True


def _count(problems: Iterable) -> int | None:
    """How many there are, where that is known beforehand."""
    try:
        return len(problems)
    except Exception:  # whatever an object of somebody else's raises
        return None


def _check(problems: Any, progress: Any, throw: Any, parameterization: Any, options: dict) -> None:
    if isinstance(problems, (Problem, str)) or not _is_iterable(problems):
        raise InputError(f"plan_many: problems is {shown(problems)}: expected an iterable of energyopt.Problem, such as a list")
    check_names("plan_many", options, [name for name in signature(plan).parameters if name not in _OWN])
    check_options(BSpline() if parameterization is None else parameterization, {**options, "throw": throw})
    if not isinstance(progress, bool) and not takes(progress, 3):
        raise InputError(f"progress is {shown(progress)}: expected True, False, or a function of (done, failed, total)")
