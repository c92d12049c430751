"""Kernels: the sample graphs of one arm, evaluated for many samples at once.

Two kinds give the same numbers (to rounding): `CompiledKernels`, C code compiled once a structure and kept in a cache, and
`InterpretedKernels`, CasADi's virtual machine, for machines without a C compiler. `kernels_of` picks the first that works.
The code serves all arms of one `parameters.Structure`: another payload or friction is another θ, and compiles nothing.
"""

from __future__ import annotations

import ctypes
import hashlib
import logging
import time
from copy import copy
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from energyopt.dynamics import compiler
from energyopt.dynamics.body import Dynamics
from energyopt.dynamics.parameters import Structure, numbers_of, structure_of

if TYPE_CHECKING:
    from energyopt.dynamics.graphs import SampleGraphs

log = logging.getLogger("energyopt")

_SOURCES = (
    "body.py",
    "parameters.py",
    "symbolic.py",
    "graphs.py",
    "codegen.py",
    "kernels.py",
    "lanes.c",
    "samples.c",
    "stretch.c",
)
_KERNEL_FLAGS = ("-O1", "-march=native", "-std=gnu11")
_SAMPLE_FLAGS = ("-O2", "-ftree-vectorize", "-march=native", "-std=gnu11")

_PREAMBLE = """#include <math.h>
#define NV {nv}
#define LANES {lanes}
#define LOWER {lower}
typedef double V __attribute__((vector_size(8 * LANES)));
"""


class Kernels:
    """Torques and their derivatives at N samples; states z = (q, q̇, q̈) have shape (N, 3 nv).

    Attributes:
        kind: "compiled" or "interpreted".
        theta: the numbers of the arm, see `parameters`.
        compile_s: seconds spent generating and compiling C in this process (0 from the cache).
    """

    kind: str
    compile_s: float = 0.0

    def __init__(self, nv: int, theta: np.ndarray):
        self.nv, self.theta = nv, np.ascontiguousarray(theta, dtype=float)

    def with_numbers(self, theta: np.ndarray) -> Kernels:
        """The same code for other numbers."""
        other = copy(self)
        other.theta = np.ascontiguousarray(theta, dtype=float)
        return other

    def torque(self, z: np.ndarray) -> np.ndarray:
        """τ [N·m], shape (N, nv)."""
        raise NotImplementedError

    def adjoint(self, z: np.ndarray, p: np.ndarray, mu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """τ and Jᵀ(p∘τ + μ), shapes (N, nv) and (N, 3 nv); ``p`` and ``mu`` have shape (N, nv)."""
        raise NotImplementedError

    def jacobian(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """τ and J = ∂τ/∂z, shapes (N, nv) and (N, nv, 3 nv)."""
        raise NotImplementedError

    def hessian(self, z: np.ndarray, p: np.ndarray, mu: np.ndarray) -> np.ndarray:
        """∂²/∂z² of Σ ½ pᵢ τᵢ² + μᵢ τᵢ, shape (N, 3 nv, 3 nv), symmetric."""
        raise NotImplementedError


class InterpretedKernels(Kernels):
    """The graphs in CasADi's virtual machine."""

    kind = "interpreted"

    def __init__(self, graphs: SampleGraphs, theta: np.ndarray):
        super().__init__(graphs.torque.size1_out(0), theta)
        self._graphs = graphs

    def torque(self, z):
        return self._call(self._graphs.torque, z)[0]

    def adjoint(self, z, p, mu):
        return tuple(self._call(self._graphs.adjoint, z, p, mu))

    def jacobian(self, z):
        tau, flat = self._call(self._graphs.jacobian, z)
        return tau, self._unflatten(flat)

    def hessian(self, z, p, mu):
        flat, lower = self._call(self._graphs.hessian, z, p, mu)
        J = self._unflatten(flat)
        H = np.einsum("kia,ki,kib->kab", J, p, J, optimize=True)
        rows, columns = self._graphs.lower.T
        H[:, rows, columns] += lower
        off = rows != columns
        H[:, columns[off], rows[off]] += lower[:, off]
        return H

    def _unflatten(self, flat: np.ndarray) -> np.ndarray:
        return flat.reshape(len(flat), 3 * self.nv, self.nv).transpose(0, 2, 1)

    def _call(self, function, *arguments: np.ndarray) -> list[np.ndarray]:
        """Evaluate sample by sample; inputs (N, n) and outputs flattened to (N, m)."""
        count = len(arguments[0])
        results = _mapped(function, count).call([np.ascontiguousarray(a, dtype=float).T for a in arguments] + [self.theta])
        return [
            np.array(r).T.reshape(count, -1) if r.size1() > 1 else np.array(r).reshape(count, -1)
            for r in map(_flat(count), results)
        ]


@lru_cache(maxsize=32)
def _mapped(function, count: int):
    """The function at ``count`` samples, with one θ (its last input) for all."""
    return function.map("samples", "serial", count, [function.n_in() - 1], [])


def _flat(count: int):
    """A matrix of ``count`` blocks side by side → one flattened block (column-major) a column."""
    import casadi as ca

    return lambda result: ca.reshape(result, result.numel() // count, count)


class CompiledKernels(Kernels):
    """The graphs as machine code; `library` also holds the assembly of the whole program (see `samples.c`)."""

    kind = "compiled"

    def __init__(self, nv: int, library: ctypes.CDLL, theta: np.ndarray):
        super().__init__(nv, theta)
        self.library = library

    def torque(self, z):
        return self._call(self.library.eo_torque, [z], [self.nv])[0]

    def adjoint(self, z, p, mu):
        return tuple(self._call(self.library.eo_adjoint, [z, p, mu], [self.nv, 3 * self.nv]))

    def jacobian(self, z):
        tau, flat = self._call(self.library.eo_jacobian, [z], [self.nv, 3 * self.nv * self.nv])
        return tau, flat.reshape(len(flat), 3 * self.nv, self.nv).transpose(0, 2, 1)

    def hessian(self, z, p, mu):
        size = 3 * self.nv
        return self._call(self.library.eo_hessian, [z, p, mu], [size * size])[0].reshape(-1, size, size)

    def _call(self, function, inputs: list[np.ndarray], sizes: list[int]) -> list[np.ndarray]:
        inputs = [np.ascontiguousarray(a, dtype=float) for a in inputs]
        count = len(inputs[0])
        outputs = [np.empty((count, size)) for size in sizes]
        theta, *arrays = (ctypes.c_void_p(a.ctypes.data) for a in (self.theta, *inputs, *outputs))
        function(theta, ctypes.c_long(count), *arrays)
        return outputs


def _load(path: Path) -> ctypes.CDLL:
    library = ctypes.CDLL(str(path))
    for name in ("torque", "adjoint", "jacobian", "hessian"):
        getattr(library, f"eo_{name}").restype = None
    library.eo_program_objective.restype = ctypes.c_double
    return library


_LOADED: dict[str, Kernels] = {}
"""By the key of their code, kernels of some arm of each structure."""


def kernels_of(dynamics: Dynamics, compiled: bool = True) -> Kernels:
    """The kernels of an arm: compiled where possible, else interpreted (one notice in the log). Code is made once a process."""
    structure, theta = _split(dynamics)
    if compiled:
        key = compiler.library_key(structure.digest, _generator_digest(), *_KERNEL_FLAGS, *_SAMPLE_FLAGS)
        if key not in _LOADED:
            _LOADED[key] = _compiled(dynamics, structure, key) or _without_compiler(dynamics)
        return _LOADED[key].with_numbers(theta)
    if structure.digest not in _LOADED:
        from energyopt.dynamics.graphs import sample_graphs

        _LOADED[structure.digest] = InterpretedKernels(sample_graphs(structure), theta)
    return _LOADED[structure.digest].with_numbers(theta)


@lru_cache(maxsize=64)
def _split(dynamics: Dynamics) -> tuple[Structure, np.ndarray]:
    """Structure and numbers of an arm."""
    structure = structure_of(dynamics)
    return structure, numbers_of(dynamics, structure)


def _without_compiler(dynamics: Dynamics) -> Kernels:
    if compiler.find_compiler() is None:  # where there is one, what went wrong has been said
        log.warning(
            "energyopt: %s: kernels run interpreted (same numbers, slower); get gcc, clang or `pip install ziglang`",
            compiler.why_interpreted(),
        )
    return kernels_of(dynamics, compiled=False)


def _compiled(dynamics: Dynamics, structure: Structure, key: str) -> CompiledKernels | None:
    """Kernels from the cache or the compiler, their torques checked against Pinocchio before they are trusted."""
    started = time.perf_counter()
    for fresh in (False, True):
        path = compiler.compile_library(key, c_units(structure)) if fresh else compiler.cached_library(key)
        if path is None:
            continue
        try:
            kernels = CompiledKernels(structure.nv, _load(path), numbers_of(dynamics, structure))
        except OSError as error:
            fault = f"does not load: {error}"
        else:
            if _agrees(kernels, dynamics):
                kernels.compile_s = time.perf_counter() - started if fresh else 0.0
                return kernels
            fault = "gives wrong torques"
        if fresh:
            log.warning("energyopt: the compiled library %s; kernels run interpreted (same numbers, slower)", fault)
        compiler.discard(path)
    return None


def _agrees(kernels: Kernels, dynamics: Dynamics) -> bool:
    z = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 3 * dynamics.nv))
    expected = dynamics.torque(*np.split(z, 3, axis=1))
    return bool(np.allclose(kernels.torque(z), expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max()))


def c_units(structure: Structure) -> dict[str, tuple[str, tuple[str, ...]]]:
    """The C of a structure's kernels and of the program around them: by unit, source text and compiler flags."""
    from energyopt.dynamics.codegen import c_declaration, c_function
    from energyopt.dynamics.graphs import sample_graphs

    graphs = sample_graphs(structure)
    lanes = 8 if compiler.has_wide_vectors() else 4
    preamble = _PREAMBLE.format(nv=structure.nv, lanes=lanes, lower=len(graphs.lower))
    lanewise = (files("energyopt.dynamics") / "lanes.c").read_text()
    names = [f"kernel_{graph.name()}" for graph in graphs.all]
    declarations = [c_declaration(graph, name) + ";" for graph, name in zip(graphs.all, names, strict=True)]
    kernels = {
        name: (preamble + lanewise + c_function(graph, name), _KERNEL_FLAGS)
        for graph, name in zip(graphs.all, names, strict=True)
    }
    index = [
        f"static const int lower_{what}[] = {{{', '.join(map(str, graphs.lower[:, k]))}}};"
        for k, what in enumerate(("row", "column"))
    ]
    program = "\n".join((files("energyopt.dynamics") / name).read_text() for name in ("samples.c", "stretch.c"))
    return kernels | {"samples": ("\n".join([preamble, *declarations, *index, program]), _SAMPLE_FLAGS)}


@lru_cache(maxsize=1)
def _generator_digest() -> str:
    import casadi

    h = hashlib.sha256(casadi.__version__.encode())
    for name in _SOURCES:
        h.update((files("energyopt.dynamics") / name).read_bytes())
    return h.hexdigest()
