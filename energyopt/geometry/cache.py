"""Results that take long to compute, kept as arrays: those of the catalogue's robots come with the package, others are
computed once and put into the user's cache folder.

Everything a result depends on is hashed into its key, so it is never out of date; `VERSION` stands for the code. A file is
written under another name and renamed, so that it is whole or not there. What cannot be read, or is not as expected, is
computed again.
"""

from __future__ import annotations

import hashlib
import io
import logging
import os
import tempfile
import threading
import zipfile
import zlib
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np

from energyopt.dynamics.compiler import cache_folder

log = logging.getLogger("energyopt")

Arrays = dict[str, np.ndarray]
MAX_BYTES = 50_000_000
VERSION = "2"
"""To be raised with every change of this folder's modules that changes pieces of meshes or covers; then
``python -m energyopt.geometry.ship`` renews what comes with the package."""
SHIPPED = Path(__file__).with_name("shipped.npz")
_one_reader = threading.Lock()
"""NumPy parses the head of an array by `ast.literal_eval`; CPython 3.11 fails at that now and then in two threads at once."""


def digest(*parts: str | bytes | np.ndarray) -> str:
    """Hash of texts, bytes and arrays, in order."""
    h = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            part = f"{part.dtype.str}{part.shape}".encode() + np.ascontiguousarray(part).tobytes()
        data = part.encode() if isinstance(part, str) else part
        h.update(len(data).to_bytes(8, "little"))
        h.update(data)
    return h.hexdigest()[:32]


def cached_arrays(kind: str, key: str, compute: Callable[[], Arrays], valid: Callable[[Arrays], bool]) -> Arrays:
    """The arrays of ``key``: those that come with the package, or read from the cache, or computed and put there.

    Args:
        kind: first part of the file's name; key: from `digest`.
        compute: what to call where the cache has nothing that can be used.
        valid: whether arrays read from a file are such as ``compute`` returns.
    """
    name = f"{kind}-{key}"
    found = _shipped(name)
    if found is not None and valid(found):
        return found
    path = cache_folder() / f"{name}.npz"
    found = _read(path)
    if found is not None and valid(found):
        return found
    arrays = compute()
    _write(path, arrays)
    return arrays


def _shipped(name: str) -> Arrays | None:
    """What comes with the package under a name; members of the archive are called ``name/array``."""
    try:
        with _one_reader:
            archive, members = shipped_archive()
            return {member.partition("/")[2]: archive[member] for member in members[name]} if name in members else None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error):
        return None


@cache
def shipped_archive() -> tuple[Mapping[str, np.ndarray], dict[str, list[str]]]:
    """The archive of the package, read into memory, and its members by name; empty where it is missing or damaged."""
    try:
        archive = np.load(io.BytesIO(SHIPPED.read_bytes()), allow_pickle=False)
        members: dict[str, list[str]] = {}
        for member in archive.files:
            members.setdefault(member.partition("/")[0], []).append(member)
        return archive, members
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return {}, {}


def _read(path: Path) -> Arrays | None:
    try:
        if path.stat().st_uid != os.getuid() or path.stat().st_size > MAX_BYTES:
            return None
        with _one_reader, np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, MemoryError):
        return None


def _write(path: Path, arrays: Arrays) -> None:
    """Best effort: a full or read-only disk costs time at the next run, nothing else."""
    temporary = None
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name[:20]}.", suffix=".tmp", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **arrays)
        os.replace(temporary, path)
        temporary = None
    except OSError as error:
        log.info("energyopt: %s not cached: %s", path.name, error)
    finally:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
