"""Work on many items at once, handed out in the order of the items, with a bounded number of either held at any time."""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any

from energyopt.errors import InputError


@dataclass(frozen=True, eq=False)
class Job:
    """An item, its place (from 0), and the future of the work on it."""

    number: int
    item: Any
    future: Future


class Interrupted(KeyboardInterrupt):
    """Ctrl-C, with the jobs that were begun and not handed out; some of them are done."""

    def __init__(self, jobs: list[Job]):
        super().__init__("interrupted")
        self.jobs = jobs


def in_order(items: Iterable, submit: Callable[[Any], Future], window: int, ended: Callable[[Job], None]) -> Iterator[Job]:
    """Jobs that are done, in the order of their items.

    Args:
        items: drawn one by one. Where drawing one fails, its job holds the error, and is the last.
        submit: starts the work on an item; what it raises is the result of that item alone.
        window: jobs begun and not handed out yet, at most.
        ended: called with each job once it is done, in whatever order that happens.

    Raises:
        Interrupted: Ctrl-C.
    """
    source, over = enumerate(_drawn(items)), queue.SimpleQueue()
    waiting: deque[Job] = deque()
    untold: dict[int, Job] = {}
    drawing = True
    try:
        while drawing or waiting or untold:
            if drawing and len(waiting) < window:
                number, item = next(source, (0, _END))
                drawing = item is not _END
                if drawing:
                    waiting.append(_begun(number, item, submit, over))
                    untold[number] = waiting[-1]
            elif not (waiting and waiting[0].future.done()):
                ended(untold.pop(over.get()))
            while not over.empty():
                ended(untold.pop(over.get()))
            while waiting and waiting[0].future.done():
                yield waiting.popleft()
    except KeyboardInterrupt:
        # What is cancelled now, or lost with its worker, did not end by itself: a future that never is done says so.
        raise Interrupted([job if job.future.done() else replace(job, future=Future()) for job in waiting]) from None
    finally:
        for job in waiting:
            job.future.cancel()


def _begun(number: int, item: Any, submit: Callable[[Any], Future], over: queue.SimpleQueue) -> Job:
    """A job whose number is put into a queue once it is done. (A future keeps what it calls: the job itself would never go.)"""
    job = Job(number, item, _submitted(submit, item))
    job.future.add_done_callback(lambda _: over.put(number))
    return job


_END = object()


@dataclass(frozen=True)
class Undrawn:
    """In place of an item that its iterable could not give."""

    error: Exception


def _drawn(items: Iterable) -> Iterator:
    try:
        yield from items
    except Exception as error:
        yield Undrawn(error)


def _submitted(submit: Callable[[Any], Future], item: Any) -> Future:
    try:
        if isinstance(item, Undrawn):
            raise InputError(f"problems: drawing the next one failed: {type(item.error).__name__}: {item.error}") from item.error
        return submit(item)
    except Exception as error:
        failed: Future = Future()
        failed.set_exception(error)
        return failed
