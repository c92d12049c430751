"""Work on many items at once, handed out in the order of the items, with a bounded number of either held at any time."""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
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
    begun = told = 0
    drawing = True
    try:
        while drawing or waiting or told < begun:
            if drawing and len(waiting) < window:
                drawing = _begin_next(source, submit, waiting, over)
                begun += drawing
            elif not (waiting and waiting[0].future.done()):
                ended(over.get())
                told += 1
            while not over.empty():
                ended(over.get())
                told += 1
            while waiting and waiting[0].future.done():
                yield waiting.popleft()
    except KeyboardInterrupt:
        raise Interrupted(list(waiting)) from None
    finally:
        for job in waiting:
            job.future.cancel()


def _begin_next(source: Iterator, submit: Callable[[Any], Future], waiting: deque[Job], over: queue.SimpleQueue) -> bool:
    """Begin the next job; False where there is none."""
    number, item = next(source, (0, _END))
    if item is _END:
        return False
    job = Job(number, item, _submitted(submit, item))
    waiting.append(job)
    job.future.add_done_callback(lambda _: over.put(job))
    return True


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
