"""Files that are whole or not there, and .npz archives that are read without trust.

An .npz is a zip of .npy members. Nothing is unpickled; before anything is allocated, the number of members, their
declared and real sizes, and each header's type and shape are checked against what is allowed and against each other.
"""

from __future__ import annotations

import io
import os
import stat
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from energyopt.errors import FileError
from energyopt.robots.messages import shown

MAX_FILE_BYTES = 200_000_000
MAX_CONTENT_BYTES = 400_000_000
MAX_MEMBERS = 200
MAX_HEADER_BYTES = 4096
ALLOWED_TYPES = ("float64", "int64", "uint8")
"""Types of arrays in an archive; in particular no objects."""


def write_atomic(path: str | Path, data: bytes) -> None:
    """Write a file so that at any moment there is the old one, or the new one, or none: never half of one.

    Raises:
        FileError: the folder is missing, not writable, or full.
    """
    path, temporary = _named(path), None
    try:
        if path.exists() and not path.is_file():
            raise FileError(f"{path}: is not a regular file; expected the name of a file to write")
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name[:50]}.", suffix=".tmp", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, stat.S_IMODE(path.stat().st_mode) if path.exists() else 0o666 & ~_umask())
        os.replace(temporary, path)
        temporary = None
    except OSError as error:
        raise FileError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)


def npz_bytes(arrays: Mapping[str, np.ndarray]) -> bytes:
    """A compressed .npz archive; the same arrays give the same bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            member = io.BytesIO()
            npy.write_array(member, np.asarray(array, order="C"), version=(1, 0), allow_pickle=False)
            info = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, member.getvalue())
    return buffer.getvalue()


def read_npz(path: str | Path) -> dict[str, np.ndarray]:
    """All arrays of an .npz archive.

    Raises:
        FileError: missing, no archive, damaged, too large, or a member that is not what its header says.
    """
    path = _named(path)
    data = _read_bytes(path)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            _check_members(path, archive)
            return {info.filename.removesuffix(".npy"): _member(path, archive, info) for info in archive.infolist()}
    except FileError:
        raise
    except Exception as error:  # zip, deflate and npy readers raise a dozen types on damaged input
        raise FileError(f"{path}: damaged, or no .npz archive ({_first_line(error)})") from None


def _read_bytes(path: Path) -> bytes:
    try:
        if path.is_dir():
            raise FileError(f"{path}: is a folder; expected an .npz file")
        if not path.exists():
            raise FileError(f"{path}: no such file; expected the plan.npz of `energyopt plan`, or what plan.save wrote")
        if not path.is_file():
            raise FileError(f"{path}: is not a regular file; expected an .npz file")
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror or error})") from None
    if len(data) > MAX_FILE_BYTES:
        raise FileError(f"{path}: larger than {MAX_FILE_BYTES / 1e6:.0f} MB; expected a plan")
    return data


def _check_members(path: Path, archive: zipfile.ZipFile) -> None:
    infos = archive.infolist()
    names = [info.filename for info in infos]
    if len(infos) > MAX_MEMBERS or len(set(names)) != len(names) or not all(name.endswith(".npy") for name in names):
        raise FileError(f"{path}: holds {len(infos)} members; expected at most {MAX_MEMBERS} different .npy arrays")
    total = sum(info.file_size for info in infos)
    if total > MAX_CONTENT_BYTES:
        raise FileError(f"{path}: would unpack to {total / 1e6:.0f} MB; expected at most {MAX_CONTENT_BYTES / 1e6:.0f} MB")


def _member(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    """One array; reads no more than the member declares, which `_check_members` has bounded."""
    with archive.open(info) as stream:
        raw = stream.read(info.file_size + 1)
    buffer = io.BytesIO(raw)
    if npy.read_magic(buffer) != (1, 0):
        raise FileError(f"{path}: '{info.filename}' has another .npy version; expected 1.0")
    shape, fortran, dtype = npy.read_array_header_1_0(buffer, max_header_size=MAX_HEADER_BYTES)
    content = raw[buffer.tell() :]
    if dtype.str not in [np.dtype(kind).str for kind in ALLOWED_TYPES]:
        raise FileError(f"{path}: '{info.filename}' has the type {dtype}; expected one of {', '.join(ALLOWED_TYPES)}")
    size = int(np.prod([int(n) for n in shape], dtype=object)) if shape else 1
    if len(shape) > 3 or min(shape, default=0) < 0 or size * dtype.itemsize != len(content):
        raise FileError(f"{path}: '{info.filename}' says it has the shape {shape} and holds {len(content)} bytes")
    array = np.frombuffer(content, dtype=dtype)
    return array.reshape(shape[::-1]).T.copy() if fortran else array.reshape(shape).copy()


def _named(path: str | Path) -> Path:
    if not isinstance(path, (str, Path)) or not str(path) or "\0" in str(path):
        raise FileError(f"{shown(path)}: expected the name of a file")
    return Path(path)


def _first_line(error: Exception) -> str:
    return (" ".join(str(error).split()) or type(error).__name__)[:120]


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
