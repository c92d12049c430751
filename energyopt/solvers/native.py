"""The C of this package, compiled once a machine."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from importlib.resources import files

from energyopt.dynamics import compiler

_FLAGS = (
    "-O2",
    "-ftree-vectorize",
    "-fassociative-math",
    "-fno-signed-zeros",
    "-fno-trapping-math",
    "-march=native",
    "-std=gnu11",
)


@lru_cache(maxsize=8)
def library_path(*names: str) -> str | None:
    """Path of the library made of some C files, one after another; None without a compiler."""
    if compiler.find_compiler() is None:
        return None
    text = "\n".join((files("energyopt.solvers") / name).read_text() for name in names)
    key = compiler.library_key(text, *_FLAGS)
    path = compiler.cached_library(key) or compiler.compile_library(key, {"solver": (text, _FLAGS)})
    try:
        ctypes.CDLL(str(path))
    except OSError:
        return None
    return str(path)
