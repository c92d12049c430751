"""From a CasADi SX function to plain C that works on several samples at once.

The type of every variable is a GCC/Clang vector of doubles (one lane a sample), so that an addition in the graph is one
vector instruction. The C is written from the function's own list of instructions; a graph is straight-line code, so
each instruction is one assignment. It is cut into pieces of a few thousand assignments that hand values on through an
array: the register allocators of C compilers take time that grows with the square of a function's length.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

SHARED = "theta"
"""An input of this name is the same for all lanes: an array of doubles."""
PIECE = 2000
"""Assignments a piece: shorter ones cost loads and stores at run time, longer ones minutes of compilation."""

_BINARY = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
_UNARY = {
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_ASSIGN: "{0}",
    ca.OP_SIN: "lanes_sin({0})",
    ca.OP_COS: "lanes_cos({0})",
    ca.OP_TANH: "lanes_tanh({0})",
    ca.OP_SQRT: "lanes_sqrt({0})",
    ca.OP_EXP: "lanes_exp({0})",
    ca.OP_LOG: "lanes_log({0})",
    ca.OP_FABS: "lanes_fabs({0})",
}


@dataclass(frozen=True)
class _Assignment:
    """One line of C: work variables read, the one written (None: an output), and the text."""

    reads: tuple[int, ...]
    writes: int | None
    text: str


def c_function(function: ca.Function, name: str) -> str:
    """An SX function as ``void name(const V *i0, …, V *o0, …)`` and the static pieces it calls; see also `SHARED`.

    Args:
        function: all inputs and outputs dense vectors or matrices (column-major).
        name: the C name.

    Raises:
        NotImplementedError: the graph has an operation that is not in the tables above.
    """
    names = _argument_names(function)
    arguments = _arguments(function)
    lines = [_assignment(function, k) for k in range(function.n_instructions())]
    pieces = [lines[k : k + PIECE] for k in range(0, len(lines), PIECE)]
    text = [
        f"static void {name}_{k}({arguments}, V *restrict w) {{\n{body}\n}}\n" for k, body in enumerate(_piece_bodies(pieces))
    ]
    calls = "\n".join(f"  {name}_{k}({', '.join(names)}, w);" for k in range(len(pieces)))
    return "".join([*text, f"{c_declaration(function, name)} {{\n  V w[{max(1, function.sz_w())}];\n{calls}\n}}\n"])


def c_declaration(function: ca.Function, name: str) -> str:
    """The C declaration of what `c_function` writes, without a semicolon."""
    return f"void {name}({_arguments(function)})"


def _argument_names(function: ca.Function) -> list[str]:
    return [f"i{k}" for k in range(function.n_in())] + [f"o{k}" for k in range(function.n_out())]


def _arguments(function: ca.Function) -> str:
    types = ["const double" if function.name_in(k) == SHARED else "const V" for k in range(function.n_in())]
    types += ["V"] * function.n_out()
    return ", ".join(f"{kind} *restrict {name}" for kind, name in zip(types, _argument_names(function), strict=True))


def _piece_bodies(pieces: list[list[_Assignment]]) -> list[str]:
    """The C of each piece: load what earlier pieces left, assign, store what later ones read."""
    bodies, needed_later = [], set()
    for piece in reversed(pieces):
        loaded, written = set(), set()
        for line in piece:
            loaded.update(s for s in line.reads if s not in written)
            if line.writes is not None:
                written.add(line.writes)
        stored = written & needed_later
        needed_later = (needed_later - written) | loaded
        text = [f"  V w{s} = w[{s}];" for s in sorted(loaded)]
        text += [f"  V w{s};" for s in sorted(written - loaded)]
        text += [line.text for line in piece]
        text += [f"  w[{s}] = w{s};" for s in sorted(stored)]
        bodies.append("\n".join(text))
    return bodies[::-1]


def _assignment(function: ca.Function, k: int) -> _Assignment:
    op, target, source = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
    if op == ca.OP_OUTPUT:
        return _Assignment((source[0],), None, f"  o{target[0]}[{target[1]}] = w{source[0]};")
    if op == ca.OP_INPUT:
        value = f"i{source[0]}[{source[1]}]"
        reads, value = (), f"lanes({value})" if function.name_in(source[0]) == SHARED else value
    elif op == ca.OP_CONST:
        reads, value = (), f"lanes({function.instruction_constant(k)!r})"
    elif op in _BINARY:
        reads, value = tuple(source[:2]), f"w{source[0]} {_BINARY[op]} w{source[1]}"
    elif op in _UNARY:
        reads, value = (source[0],), _UNARY[op].format(f"w{source[0]}")
    else:
        raise NotImplementedError(f"no C for CasADi operation {op} in {function.name()}")
    return _Assignment(reads, target[0], f"  w{target[0]} = {value};")
