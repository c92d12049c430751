"""Compile generated C once and keep the library in a folder of the user's own.

The cache key is a hash of everything that decides the machine code: the numbers of the arm, the source text of the
generator, the CasADi release, the compiler and its flags, and the CPU. Libraries are written to a temporary name and
renamed, so that processes running at the same time see either nothing or a whole file. The name ends in a checksum of the
content: a file that a full disk or a crash cut short would end the process that loads it. The folder is open to its owner
alone, and a library that somebody else could have written is never loaded.
"""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import IO

from energyopt.threads import Wanted, always_wanted, side_by_side

log = logging.getLogger("energyopt")

COMPILE_TIMEOUT = 600.0
"""Seconds after which a compiler is given up."""
LOOK = 0.05
"""Seconds between two looks at whether it is wanted still."""
FORSAKEN = 24 * 3600.0
"""Seconds after which the working folder of a compilation belongs to nobody: its process was killed."""
_WORK = "compile-"


_FAILURES: dict[tuple[str, ...], str] = {}
"""By compiler, what went wrong with it first; that has been said in the log."""


@lru_cache(maxsize=1)
def find_compiler() -> tuple[str, ...] | None:
    """The C compiler command: $ENERGYOPT_CC or $CC, else cc, gcc or clang, else the `ziglang` package; None without one.

    ``ENERGYOPT_CC=none`` switches compilation off. A compiler that was asked for and cannot be used is named once in the log.
    """
    variable, asked = _asked()
    if asked == ("none",):
        return None
    fault = _fault(asked) if asked else ""
    found = asked if asked and not fault else _usual_compiler()
    if fault:
        instead = f"'{' '.join(found)}' is used in its place" if found else "and there is no other compiler"
        log.warning("energyopt: %s is '%s', %s; %s", variable, " ".join(asked), fault, instead)
    return found


def why_interpreted() -> str:
    """Why nothing is compiled, or nothing was, in a few words."""
    compiler = find_compiler()
    if compiler is None:
        return "no C compiler" + (" (switched off by ENERGYOPT_CC=none)" if _asked()[1] == ("none",) else "")
    return f"the C compiler '{' '.join(compiler)}' failed ({_FAILURES.get(compiler, 'its library does not work')})"


def _asked() -> tuple[str, tuple[str, ...]]:
    """The environment variable that names a compiler, and the command."""
    for variable in ("ENERGYOPT_CC", "CC"):
        words = tuple(os.environ.get(variable, "").split())
        if words:
            return variable, words
    return "", ()


def _usual_compiler() -> tuple[str, ...] | None:
    for name in ("cc", "gcc", "clang"):
        if not _fault((name,)):
            return (name,)
    zig = (sys.executable, "-m", "ziglang", "cc")
    return zig if find_spec("ziglang") and not _fault(zig) else None


@lru_cache(maxsize=1)
def cache_folder() -> Path:
    """The folder of compiled kernels: $ENERGYOPT_CACHE, else ~/.cache/energyopt; a temporary one where those are read-only."""
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    asked = os.environ.get("ENERGYOPT_CACHE")
    for candidate in filter(None, (asked, os.path.join(home, "energyopt"))):
        folder = Path(candidate)
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            fault = "" if _owned(folder) and os.access(folder, os.W_OK | os.X_OK) else "others can write it, or its owner cannot"
        except OSError as error:
            fault = error.strerror or str(error)
        if not fault:
            return folder
        if candidate == asked:
            log.warning("energyopt: ENERGYOPT_CACHE is '%s', which cannot be used (%s); another folder is", asked, fault)
    shared = Path(tempfile.gettempdir()) / f"energyopt-{os.getuid()}"
    try:
        shared.mkdir(mode=0o700, exist_ok=True)
        if _owned(shared) and os.access(shared, os.W_OK | os.X_OK):
            return shared
    except OSError:
        pass
    return Path(tempfile.mkdtemp(prefix="energyopt-"))


def library_key(*parts: str) -> str:
    """Hash of ``parts`` and of the compiler and CPU in use."""
    h = hashlib.sha256()
    for part in (*parts, *(find_compiler() or ()), _compiler_version(), _cpu()):
        h.update(part.encode())
        h.update(b"\0")
    return h.hexdigest()[:32]


def cached_library(key: str) -> Path | None:
    """The compiled library of this key, if it is there and whole and nobody else could have put it there."""
    for path in cache_folder().glob(f"kernels-{key}-*.so"):
        try:
            if _owned(path) and path.name == _library_name(key, path):
                return path
        except OSError:  # another process has just removed it
            continue
    return None


def _library_name(key: str, path: Path) -> str:
    """The file name that belongs to the content of ``path``."""
    return f"kernels-{key}-{hashlib.sha256(path.read_bytes()).hexdigest()[:16]}.so"


def compile_library(key: str, units: dict[str, tuple[str, tuple[str, ...]]]) -> Path | None:
    """Compile C sources into one shared library in the cache.

    Args:
        key: from `library_key`.
        units: by name, the source text and its own flags.

    Returns:
        the library, or None where there is no compiler or it fails (said once, as a warning in the log).
    """
    compiler = find_compiler()
    if compiler is None:
        return None
    folder = cache_folder()
    with _lock(folder / f"kernels-{key}.lock"):
        if (ready := cached_library(key)) is not None:
            return ready
        for damaged in folder.glob(f"kernels-{key}-*.so"):
            discard(damaged)
        _tidy(folder)
        try:
            with tempfile.TemporaryDirectory(dir=folder, prefix=_WORK) as work:
                made = _build(compiler, Path(work), units)
                os.chmod(made, 0o700)
                target = folder / _library_name(key, made)
                os.replace(made, target)
        except (OSError, subprocess.SubprocessError) as error:
            if compiler not in _FAILURES:
                _FAILURES[compiler] = _reason(error)[:200]
                log.warning("energyopt: %s, what it was to compile runs interpreted (same numbers, slower)", why_interpreted())
            return None
    return target


def _tidy(folder: Path) -> None:
    """Remove what compilations have left that were killed."""
    for work in folder.glob(f"{_WORK}*"):
        with suppress(OSError):  # another process has just removed it
            if time.time() - work.stat().st_mtime > FORSAKEN:
                shutil.rmtree(work, ignore_errors=True)


def discard(path: Path) -> None:
    """Remove a library that does not load or gives wrong numbers."""
    path.unlink(missing_ok=True)


def _build(compiler: tuple[str, ...], work: Path, units: dict[str, tuple[str, tuple[str, ...]]]) -> Path:
    def compile_unit(name: str, wanted: Wanted) -> str:
        text, flags = units[name]
        (work / f"{name}.c").write_text(text)
        _run([*compiler, *flags, "-fPIC", "-c", f"{name}.c", "-o", f"{name}.o"], work, wanted)
        return f"{name}.o"

    objects = side_by_side(compile_unit, units)
    _run([*compiler, "-shared", *objects, "-o", "library.so", "-lm"], work, always_wanted)
    return work / "library.so"


def _run(command: list[str], folder: Path, wanted: Wanted) -> None:
    """Run a command; where it is not wanted any more, takes too long, or Ctrl-C comes, it ends, and all it has started."""
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    latest = time.monotonic() + COMPILE_TIMEOUT
    with subprocess.Popen(command, cwd=folder, text=True, process_group=0, **pipes) as process:
        try:
            said = _said(process, latest, wanted)
        except BaseException:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            raise
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command, *said)


def _said(process: subprocess.Popen, latest: float, wanted: Wanted) -> tuple[str, str]:
    """What a process has written once it has ended.

    Raises:
        TimeoutExpired: it has not by the time of `time.monotonic` that is ``latest``. Unwanted: it need not go on.
    """
    while True:
        wanted()
        try:
            return process.communicate(timeout=LOOK)
        except subprocess.TimeoutExpired:
            if time.monotonic() > latest:
                raise subprocess.TimeoutExpired(process.args, COMPILE_TIMEOUT) from None


def _reason(error: Exception) -> str:
    said = getattr(error, "stderr", None)  # bytes after a timeout
    code = getattr(error, "returncode", None)
    usual = str(error) if code is None else f"it ends with the code {code}"
    text = (said if isinstance(said, str) and said.strip() else usual).strip().splitlines()
    return next((line for line in text if "error" in line), text[0] if text else type(error).__name__)


def _fault(command: tuple[str, ...]) -> str:
    """Why a command makes no library (a compiler without headers or linker does not), or ""."""
    if not shutil.which(command[0]):
        return "which is no program that can be run"
    text = "#include <math.h>\ntypedef double V __attribute__((vector_size(32)));\ndouble f(double x) { return sin(x); }\n"
    try:
        with tempfile.TemporaryDirectory(prefix="energyopt-") as work:
            _build(command, Path(work), {"probe": (text, ("-O1",))})
        return ""
    except (OSError, subprocess.SubprocessError) as error:
        return f"which compiles no C file: {_reason(error)[:200]}"


def _owned(path: Path) -> bool:
    status = path.stat()
    return status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


@lru_cache(maxsize=1)
def _compiler_version() -> str:
    compiler = find_compiler()
    if compiler is None:
        return ""
    found = subprocess.run([*compiler, "--version"], capture_output=True, text=True, timeout=60, check=False)
    return found.stdout.partition("\n")[0]


@lru_cache(maxsize=1)
def _cpu() -> str:
    """Architecture and instruction set, so that a home folder shared by machines is safe with -march=native."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    return platform.machine() + "".join(
        next((line for line in lines if line.startswith(key)), "") for key in ("model name", "flags", "Features")
    )


def has_wide_vectors() -> bool:
    """Whether the CPU has 512-bit vectors of doubles (eight samples at once instead of four)."""
    return " avx512f" in _cpu()


@contextmanager
def _lock(path: Path):
    """One compilation of a library at a time; where files cannot be locked, several compile it and rename theirs in turn."""
    try:
        handle = _locked(path)
    except (ImportError, OSError):
        yield
        return
    try:
        yield
    finally:
        path.unlink(missing_ok=True)  # before the lock is let go: whoever waits for it sees that the file is gone
        handle.close()


def _locked(path: Path) -> IO:
    """The file at ``path``, locked.

    Raises:
        OSError, ImportError: files cannot be locked here.
    """
    import fcntl

    while True:
        handle = path.open("w")
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
            if os.path.samestat(os.fstat(handle.fileno()), path.stat()):
                return handle
        except FileNotFoundError:  # its last owner has removed it
            pass
        except OSError:
            handle.close()
            raise
        handle.close()
