"""Reading a TOML file from anywhere: size capped, every failure one line, and every key can be found again by its line."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from energyopt.errors import FileError, ProblemError

MAX_TOML_BYTES = 1_000_000
"""Larger files are refused: a problem is a page of text."""
LARGEST_NUMBER = 1e100
"""Beyond this no quantity of a robot is meant, and squares overflow."""

_HEADER = re.compile(r"\s*\[{1,2}\s*([^\[\]#]+?)\s*\]{1,2}\s*(#.*)?$")
_KEY = re.compile(r"""\s*((?:[A-Za-z0-9_\-.]|"[^"]*"|'[^']*')+)\s*=""")
_STEP = re.compile(r"([^.\[\]]+)(?:\[(\d+)\])*")
_Step = tuple[str, int | None]
"""A name of a dotted key, and its place in an array of tables where it is one."""


@dataclass(frozen=True)
class Document:
    """A parsed TOML file.

    Attributes:
        path: where it was read.
        text: its text.
        table: its content.
        overridden: dotted keys whose value is not the file's but the caller's.
    """

    path: Path
    text: str
    table: dict[str, Any]
    overridden: frozenset[str] = frozenset()

    def place(self, key: str) -> str:
        """``file:line`` of a dotted key such as "problem.start[2]"; of the nearest enclosing table where it has no line."""
        if key in self.overridden:
            return f"{self.path}, changed by the caller"
        wanted = [(name, int(index) if index else None) for name, index in _STEP.findall(key)]
        best, line = 0, 0
        for number, found in _keys(self.text):
            depth = len(found)
            if depth > best and all(map(_fits, found, wanted)) and depth <= len(wanted):
                best, line = depth, number
        return f"{self.path}:{line}" if line else str(self.path)

    def error(self, key: str, reason: str) -> ProblemError:
        """The error "file:line: key reason"."""
        return ProblemError(f"{self.place(key)}: {key} {reason}")


def read_toml(path: Path) -> Document:
    """Parse a TOML file whose numbers are all finite.

    Raises:
        FileError: missing, a folder, not a regular file, too large, unreadable, not UTF-8.
        ProblemError: not TOML (with the line), or a number that is not finite (with its key).
    """
    text = _read_text(path)
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise _syntax_error(path, str(error)) from None
    except RecursionError:
        raise ProblemError(f"{path}: tables or lists are nested too deeply") from None
    except ValueError as error:  # numbers and dates that look right and are not
        raise _syntax_error(path, str(error)) from None
    document = Document(path, text, table)
    for key, value in _leaves("", table):
        if isinstance(value, (int, float)) and not abs(value) <= LARGEST_NUMBER:
            shown = f"{value}" if isinstance(value, float) else "larger than 1e100"
            raise document.error(key, f"is {shown}; expected a finite number")
    return document


def shown(value: Any, width: int = 60) -> str:
    """A value as it would stand in the file, on one line, shortened."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "a table with the keys " + ", ".join(map(str, value)) if value else "an empty table"
    text = f'"{value}"' if isinstance(value, str) else repr(value) if isinstance(value, (int, float, list)) else str(value)
    text = " ".join(text.split())
    return text if len(text) <= width else text[: width - 1] + "…"


def _read_text(path: Path) -> str:
    try:
        if path.is_dir():
            raise FileError(f"{path}: is a folder; expected a TOML file")
        if not path.exists():
            raise FileError(f"{path}: no such file")
        if not path.is_file():
            raise FileError(f"{path}: is not a regular file; expected a TOML file")
        with path.open("rb") as file:
            data = file.read(MAX_TOML_BYTES + 1)
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror})") from None
    if len(data) > MAX_TOML_BYTES:
        raise FileError(f"{path}: larger than {MAX_TOML_BYTES / 1e6:.0f} MB; expected a problem file, a page of TOML")
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: not UTF-8 text (byte {error.start}); expected a TOML file") from None


def _syntax_error(path: Path, message: str) -> ProblemError:
    place = re.search(r"\s*\(at line (\d+), column (\d+)\)", message)
    where = f"{path}:{place[1]}:{place[2]}" if place else str(path)
    reason = " ".join((message.replace(place[0], "") if place else message).split())
    return ProblemError(f"{where}: not valid TOML: {reason}")


def _leaves(prefix: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from _leaves(f"{prefix}.{key}" if prefix else key, entry)
    elif isinstance(value, list):
        for i, entry in enumerate(value):
            yield from _leaves(f"{prefix}[{i}]", entry)
    else:
        yield prefix, value


def _keys(text: str) -> Iterator[tuple[int, list[_Step]]]:
    """Line number and path of every header and key: names, and for tables of an array their place in it, from 0."""
    table: list[_Step] = []
    counts: dict[str, int] = {}
    for number, line in enumerate(text.split("\n"), start=1):
        if header := _HEADER.match(line):
            table = _header_path(_parts(header[1]), line.lstrip().startswith("[["), counts)
            yield number, table
        elif key := _KEY.match(line):
            yield number, table + [(part, None) for part in _parts(key[1])]


def _header_path(parts: tuple[str, ...], array: bool, counts: dict[str, int]) -> list[_Step]:
    """The path of a header; ``counts`` knows how many tables each array has so far, by the path of the array."""
    path: list[_Step] = []
    for depth, part in enumerate(parts, start=1):
        key = repr((path, part))
        if array and depth == len(parts):
            counts[key] = counts.get(key, 0) + 1
        path.append((part, counts[key] - 1 if key in counts else None))
    return path


def _fits(found: _Step, wanted: _Step) -> bool:
    """Whether a step of a line is the wanted one; a step without place stands for all of its array."""
    return found[0] == wanted[0] and (found[1] == wanted[1] or None in (found[1], wanted[1]))


def _parts(dotted: str) -> tuple[str, ...]:
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))
