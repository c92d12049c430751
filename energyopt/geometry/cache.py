"""Results that take long to compute, kept as arrays in the user's cache folder.

A file's name is the hash of everything its content depends on, so it is never out of date; it is written under another name
and renamed, so that it is whole or not there. What cannot be read, or is not as expected, is computed again.
"""

from __future__ import annotations

import hashlib
import logging
import os
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from energyopt.dynamics.compiler import cache_folder

log = logging.getLogger("energyopt")

Arrays = dict[str, np.ndarray]
MAX_BYTES = 50_000_000


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
    """The arrays of ``key``, read from the cache, or computed and put there.

    Args:
        kind: first part of the file's name; key: from `digest`.
        compute: what to call where the cache has nothing that can be used.
        valid: whether arrays read from a file are such as ``compute`` returns.
    """
    path = cache_folder() / f"{kind}-{key}.npz"
    found = _read(path)
    if found is not None and valid(found):
        return found
    arrays = compute()
    _write(path, arrays)
    return arrays


def _read(path: Path) -> Arrays | None:
    try:
        if path.stat().st_uid != os.getuid() or path.stat().st_size > MAX_BYTES:
            return None
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, MemoryError):
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
