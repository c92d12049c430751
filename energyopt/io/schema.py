"""A small schema language for problem files: every key has a kind, and every kind says what it expects.

A `Table` lists its keys; a `Kind` tests one value; `OneOf` and `ListOf` combine them. `validate` walks a document
along a schema and raises one error that names file, line, key, value and expectation.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from energyopt.errors import ProblemError
from energyopt.io.toml_text import Document, shown


@dataclass(frozen=True)
class Kind:
    """What a value may be: ``accepts`` tests it, ``expected`` says it in words, unit included."""

    expected: str
    accepts: Callable[[Any], bool]


@dataclass(frozen=True)
class Table:
    """A table with known keys; those in ``required`` have to be there."""

    keys: Mapping[str, Kind | Table | ListOf | OneOf]
    required: tuple[str, ...] = ()
    expected: str = "a table"


@dataclass(frozen=True)
class ListOf:
    """An array of tables."""

    table: Table

    @property
    def expected(self) -> str:
        return "a list of tables"


@dataclass(frozen=True)
class OneOf:
    """A value that a plain kind accepts, or else a table."""

    kind: Kind | ListOf
    table: Table

    @property
    def expected(self) -> str:
        return f"{self.kind.expected}, or a table with the keys {', '.join(self.table.keys)}"


def validate(document: Document, schema: Table) -> dict[str, Any]:
    """The document's table, once every key and value fits.

    Raises:
        ProblemError: names file, line, key, value and expectation; the nearest valid names for an unknown key.
    """
    _check_table(document, "", document.table, schema, schema)
    return document.table


def nearest(word: str, known: tuple[str, ...]) -> str:
    """A hint: the names most like ``word``, else all of them."""
    near = difflib.get_close_matches(word.lower(), known, n=3, cutoff=0.6)
    return f"did you mean {' or '.join(near)}?" if near else f"expected one of {', '.join(known)}"


def _home(key: str, root: Table) -> str:
    """A hint where a key stands in the wrong section: the right one, if there is only one."""
    sections = {name: kind for name, kind in root.keys.items() if isinstance(kind, Table)}
    homes = [name for name, section in sections.items() if key in section.keys]
    if key in root.keys:
        return "it belongs to the top of the file, before any section" if isinstance(root.keys[key], Kind) else ""
    return f"it belongs under [{homes[0]}]" if len(homes) == 1 else ""


def _check(document: Document, key: str, value: Any, schema: Kind | Table | ListOf | OneOf, root: Table) -> None:
    expected = schema.expected
    if isinstance(schema, OneOf):
        schema = schema.table if isinstance(value, dict) else schema.kind
    if isinstance(schema, Table):
        _check_table(document, key, value, schema, root)
    elif isinstance(schema, ListOf):
        if not isinstance(value, list):
            raise document.error(key, f"is {shown(value)}; expected {schema.expected}, each under [[{key}]]")
        for i, entry in enumerate(value):
            _check_table(document, f"{key}[{i}]", entry, schema.table, root)
    elif not schema.accepts(value):
        raise document.error(key, f"is {shown(value)}; expected {expected}")


def _check_table(document: Document, path: str, value: Any, schema: Table, root: Table) -> None:
    if not isinstance(value, dict):
        raise document.error(path, f"is {shown(value)}; expected {schema.expected} with the keys {', '.join(schema.keys)}")
    for key, entry in value.items():
        full = f"{path}.{key}" if path else key
        if key not in schema.keys:
            raise document.error(full, f"is not a known key; {_home(key, root) or nearest(key, tuple(schema.keys))}")
        _check(document, full, entry, schema.keys[key], root)
    for key in schema.required:
        if key not in value:
            full = f"{path}.{key}" if path else key
            what = getattr(schema.keys[key], "expected", "a table")
            raise ProblemError(f"{document.place(path)}: {full} is missing; expected {what}")


def is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def number(unit: str = "", low: float = float("-inf"), positive: bool = False) -> Kind:
    """A number; ``low`` is 0 where it must not be negative, ``positive`` excludes zero too."""
    span = "> 0" if positive else "≥ 0" if low == 0 else ""
    words = " ".join(part for part in ("a number", span, f"[{unit}]" if unit else "") if part)
    return Kind(words, lambda x: is_number(x) and x >= low and (x > 0 or not positive))


def integer(low: int, high: int) -> Kind:
    accepts = lambda x: isinstance(x, int) and not isinstance(x, bool) and low <= x <= high
    return Kind(f"a whole number from {low} to {high}", accepts)


def text(meaning: str, longest: int = 4000) -> Kind:
    return Kind(meaning, lambda x: isinstance(x, str) and 0 < len(x) <= longest and x.isprintable())


def choice(*words: str) -> Kind:
    return Kind(f"one of {', '.join(words)}", lambda x: isinstance(x, str) and x in words)


def numbers(meaning: str, *sizes: int) -> Kind:
    """A list of numbers, of one of the given lengths where some are given."""
    return Kind(meaning, lambda x: isinstance(x, list) and len(x) in (sizes or [len(x) or -1]) and all(map(is_number, x)))


def either(*kinds: Kind) -> Kind:
    """A value that any of the kinds accepts."""
    return Kind(" or ".join(k.expected for k in kinds), lambda x: any(k.accepts(x) for k in kinds))


def by_joint(entry: Kind) -> Kind:
    """A table from joint names to values of a kind."""
    words = f"a table by joint name of {entry.expected}"
    return Kind(words, lambda x: isinstance(x, dict) and len(x) > 0 and all(entry.accepts(v) for v in x.values()))
