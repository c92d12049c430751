"""Kernels alone: time a node of τ, its derivatives and its Hessian; compiled, interpreted, and the way CasADi offers.

    torque    τ                        adjoint   τ and Jᵀu, a gradient
    jacobian  τ and J = ∂τ/∂(q, q̇, q̈)  hessian   ∂²(Σ ½ pᵢτᵢ² + μᵢτᵢ)/∂(q, q̇, q̈)², full and symmetric

Times are processor time over all nodes of a batch divided by their number. CasADi's way is its own C of the same graph,
compiled with the same flags, loaded by `external` and mapped over the nodes; its `hessian` leaves out the product Jᵀ diag(p) J.
Compilation is timed in a fresh process with an empty cache.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
from _shared import Goal, Report, parser, publish, settings, table

import energyopt as eo
from energyopt.dynamics.compiler import find_compiler
from energyopt.dynamics.graphs import sample_graphs
from energyopt.dynamics.kernels import Kernels, kernels_of
from energyopt.dynamics.parameters import numbers_of, structure_of

MEASURES = "processor time a node of the compiled sample kernels, against CasADi's virtual machine and CasADi's own generated C"
NAMES = ("torque", "adjoint", "jacobian", "hessian")
REFERENCE_US = {"jacobian": 0.65, "hessian": 5.0}
"""Time a node [µs] of a prototype of these kernels for the Panda, four nodes at a time; the goal is to stay within 3 times."""
FLAGS = ("-O1", "-march=native", "-fPIC", "-shared")
_COLD = """
import sys, time, energyopt as eo
from energyopt.dynamics.kernels import kernels_of
dynamics = eo.load_robot(sys.argv[1]).dynamics
began = time.perf_counter()
print(kernels_of(dynamics).kind, time.perf_counter() - began)
"""


def main() -> int:
    made = parser("kernels", MEASURES)
    made.add_argument("--robots", nargs="+", default=["panda", "ur5", "xarm7", "baxter"], metavar="NAME")
    made.add_argument("--nodes", type=int, default=64, metavar="N", help="a batch")
    made.add_argument("--repeats", type=int, default=9, metavar="N", help="batches of 0.02 s, of which the median counts")
    made.add_argument("--casadi", nargs="*", default=["panda"], metavar="NAME", help="robots for CasADi's own C too")
    made.add_argument("--no-compilation", action="store_true", help="leave out the time of compilation")
    parsed = made.parse_args()
    results = {name: _measure(name, parsed) for name in parsed.robots}
    return publish(Report("kernels", MEASURES, settings(parsed), results, _text(results), _goals(results)), parsed.json)


def _measure(name: str, parsed) -> dict:
    dynamics = eo.load_robot(name).dynamics
    rng = np.random.default_rng(parsed.seed)
    z = rng.uniform(-1.0, 1.0, (parsed.nodes, 3 * dynamics.nv))
    p, mu = rng.uniform(0.1, 1.0, (2, parsed.nodes, dynamics.nv))
    kernels = {"compiled": kernels_of(dynamics), "interpreted": kernels_of(dynamics, compiled=False)}
    if kernels["compiled"].kind != "compiled":
        del kernels["compiled"]
    us = {kind: _kernel_times(some, (z, p, mu), parsed.repeats) for kind, some in kernels.items()}
    if name in parsed.casadi and find_compiler():
        us["casadi"] = _casadi_times(dynamics, (z, p, mu), parsed.repeats)
    compilation = None if parsed.no_compilation or not find_compiler() else _cold_compilation(name)
    return {"joints": dynamics.nv, "us_per_node": us, "compilation_s": compilation}


def _kernel_times(kernels: Kernels, state: tuple[np.ndarray, ...], repeats: int) -> dict[str, float]:
    z, p, mu = state
    calls = {
        "torque": lambda: kernels.torque(z), "adjoint": lambda: kernels.adjoint(z, p, mu),
        "jacobian": lambda: kernels.jacobian(z), "hessian": lambda: kernels.hessian(z, p, mu),
    }  # fmt: skip
    return {name: _us_per_node(call, len(z), repeats) for name, call in calls.items()}


def _us_per_node(call: Callable[[], object], nodes: int, repeats: int, least: float = 0.02) -> float:
    """Median over batches that each take ``least`` seconds of processor time."""
    call()
    count, times = 1, []
    while len(times) < repeats:
        began = time.process_time()
        for _ in range(count):
            call()
        taken = time.process_time() - began
        if taken < least:
            count = max(count + 1, int(1.2 * count * least / max(taken, 1e-6)) if taken > 1e-4 else 10 * count)
            continue
        times.append(taken / (count * nodes))
    return 1e6 * float(np.median(times))


def _casadi_times(dynamics, state: tuple[np.ndarray, ...], repeats: int) -> dict[str, float]:
    """The same graphs as C by CasADi, through `external` and `map`; arguments are ready as CasADi matrices."""
    structure = structure_of(dynamics)
    graphs, found, theta = sample_graphs(structure), {}, ca.DM(numbers_of(dynamics, structure))
    arguments = [ca.DM(np.ascontiguousarray(a.T)) for a in state]
    with tempfile.TemporaryDirectory() as folder:
        for name in NAMES:
            library = _casadi_library(getattr(graphs, name), Path(folder))
            one = ca.external(name, str(library))
            mapped = one.map("nodes", "serial", len(state[0]), [one.n_in() - 1], [])
            inputs = [*arguments[: one.n_in() - 1], theta]
            found[name] = _us_per_node(lambda mapped=mapped, inputs=inputs: mapped.call(inputs), len(state[0]), repeats)
            del mapped
    return found


def _casadi_library(function: ca.Function, folder: Path) -> Path:
    generator = ca.CodeGenerator(f"{function.name()}.c")
    generator.add(function)
    generator.generate(f"{folder}{os.sep}")
    source, library = folder / f"{function.name()}.c", folder / f"{function.name()}.so"
    subprocess.run([*find_compiler(), *FLAGS, str(source), "-o", str(library), "-lm"], check=True, capture_output=True)
    return library


def _cold_compilation(name: str) -> float:
    """Seconds (wall) until the kernels of a robot are ready in a process that finds an empty cache."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "ENERGYOPT_CACHE": cache}
        out = subprocess.run([sys.executable, "-c", _COLD, name], env=environment, check=True, capture_output=True, text=True)
    return float(out.stdout.split()[-1])


def _text(results: dict) -> str:
    rows = []
    for robot, found in results.items():
        us = found["us_per_node"]
        for kind in us:
            compared = [f"{us[kind][name]:.3g}" + _ratio(us, kind, name) for name in NAMES]
            seconds = found["compilation_s"] if kind == "compiled" else None
            rows.append((f"{robot}, {found['joints']} joints, {kind}", *compared, "" if seconds is None else f"{seconds:.1f}"))
    head = ("processor time a node [µs] (× compiled)", *NAMES, "compilation [s]")
    return table(head, rows)


def _ratio(us: dict, kind: str, name: str) -> str:
    return f" (× {us[kind][name] / us['compiled'][name]:.0f})" if kind != "compiled" and "compiled" in us else ""


def _goals(results: dict) -> list[Goal]:
    us = results.get("panda", {}).get("us_per_node", {}).get("compiled")
    return [Goal(f"panda {name}", us[name], 3 * bound, "µs a node") for name, bound in REFERENCE_US.items()] if us else []


if __name__ == "__main__":
    sys.exit(main())
