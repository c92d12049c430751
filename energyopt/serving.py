"""A worker process, from inside: pickled calls come on its standard input, pickled answers go to its standard output.

Both are its alone: what a call prints goes to standard error, and what it reads as input is empty. What was printed while the
process began (a banner of some library, say) comes before `BEGUN`, which the parent waits for. Pickles pass between a process and
its own children only. See `workers` for the other end.
"""

from __future__ import annotations

import importlib
import os
import pickle
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, BinaryIO

BEGUN = b"\0energyopt worker\n"
"""What a worker writes before its first answer."""
LOOK = 0.05
"""Seconds between two looks at whether the parent is there."""
_ALONE: ContextVar[bool] = ContextVar("alone", default=False)


class WorkerError(RuntimeError):
    """A worker gave no answer."""


class WorkerLost(WorkerError):
    """A worker process ended, or was ended, in the middle of a call."""


@contextmanager
def no_more_processes() -> Iterator[None]:
    """In here `call_all` starts no processes: this one is a worker itself, and every core has its own already."""
    token = _ALONE.set(True)
    try:
        yield
    finally:
        _ALONE.reset(token)


def alone() -> bool:
    """Whether this is inside `no_more_processes`."""
    return _ALONE.get()


def pickled(value: Any) -> bytes:
    return pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)


def sendable(error: Exception) -> Exception:
    """An error, or a `WorkerError` that says the same where the original cannot be pickled, or not be read again.

    Many an exception cannot: one whose ``__init__`` takes other arguments than its message, for instance. A process pool of
    `concurrent.futures` that receives such an error takes itself for broken.
    """
    try:
        pickle.loads(pickled(error))
    except Exception:
        instead = WorkerError(f"{type(error).__name__}: {error}")
        for note in getattr(error, "__notes__", ()):
            instead.add_note(note)
        return instead
    return error


def write(pipe: BinaryIO, data: bytes) -> None:
    """Write data, its length first."""
    pipe.write(struct.pack("<Q", len(data)) + data)
    pipe.flush()


def read(pipe: BinaryIO) -> bytes:
    """What `write` wrote.

    Raises:
        EOFError: the other end is gone.
    """
    head = pipe.read(8)
    if len(head) < 8:
        raise EOFError("its answer is missing")
    size = struct.unpack("<Q", head)[0]
    data = pipe.read(size)
    if len(data) < size:
        raise EOFError("its answer is cut short")
    return data


def skip_to_begin(pipe: BinaryIO) -> None:
    """Read up to `BEGUN`.

    Raises:
        EOFError: the process ended before.
    """
    last = b""
    while last != BEGUN:
        byte = pipe.read(1)
        if not byte:
            raise EOFError("it never began")
        last = last[-len(BEGUN) + 1 :] + byte


def serve() -> None:
    """Answer calls until the input ends."""
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    calls, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    answers.write(BEGUN)
    answers.flush()
    with no_more_processes():
        while True:
            try:
                call = read(calls)
            except EOFError:
                return
            write(answers, _answered(call))


def _end_with(parent: int) -> None:
    """End this process, whatever it is doing, once its parent has."""
    while os.getppid() == parent:
        time.sleep(LOOK)
    os._exit(1)


def _answered(call: bytes) -> bytes:
    try:
        (module, name), arguments = pickle.loads(call)
        result = getattr(importlib.import_module(module), name)(*arguments)
    except Exception as error:
        return pickled(sendable(error))
    try:
        return pickled(result)
    except Exception as error:
        return pickled(WorkerError(f"an answer cannot be sent: {error}"))
