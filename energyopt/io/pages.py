"""Blocks of a documentation page that scripts write: each stands between two marks, in place of what stood there before.

No public interface: it serves the scripts of problems/ and docs/, which have nothing else in common to import.
"""

from __future__ import annotations

import re
from pathlib import Path

from energyopt.errors import FileError
from energyopt.io.archive import write_atomic


def with_block(page: Path, marks: tuple[str, str], block: str) -> str:
    """The text of a page with a block between its marks.

    Raises:
        FileError: the page is missing, or the marks do not stand in it just once.
    """
    begin, end = marks
    text = page.read_text(encoding="utf-8") if page.is_file() else ""
    pattern = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
    new, found = pattern.subn(lambda _: f"{begin}\n\n{block.strip()}\n\n{end}", text)
    if found != 1:
        raise FileError(f"{page}: '{begin}' … '{end}' stand there {found} times; expected once, in a page of a checkout")
    return new


def write_block(page: Path, marks: tuple[str, str], block: str) -> None:
    """Put a block between the marks of a page; see `with_block`."""
    write_atomic(page, with_block(page, marks, block).encode())
