"""How results show themselves: ``repr()`` is one line, whatever they hold; ``str()`` and a notebook's output tell more."""

from __future__ import annotations

from typing import Any


class Readable:
    """For results that hold arrays or models, of which Python's own ``repr`` would print pages."""

    def in_brief(self) -> str:
        """The line without the name of the class."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.in_brief()}>"

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:
        """What a notebook shows of it; inside a list, its line."""
        printer.text(str(self) if printer.indentation == 0 and not cycle else repr(self))


def counted(number: int, noun: str, ending: str = "s") -> str:
    """Such as ``1 joint`` and ``7 joints``."""
    return f"{number} {noun}{ending * (number != 1)}"
