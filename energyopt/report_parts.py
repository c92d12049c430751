"""Pieces of HTML: tables, lists of facts, boxes. Whatever is not `Markup` is escaped."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass


class Markup(str):
    """Text that is HTML already."""


@dataclass(frozen=True)
class Cell:
    """A table cell with a class of the style sheet: "n" (a number), "good", "bad"."""

    text: str
    kind: str = ""


def escape(text: object) -> str:
    """Text as it may stand in HTML, attributes included; control characters are shown as a replacement sign."""
    if isinstance(text, Markup):
        return text
    clean = "".join(c if c.isprintable() or c in "\n\t" else "\N{REPLACEMENT CHARACTER}" for c in str(text))
    return html.escape(clean, quote=True)


def section(title: str, content: str, text: str = "") -> Markup:
    """A titled box, with a remark below its title."""
    remark = f"<p>{escape(text)}</p>\n" if text else ""
    return Markup(f"<section>\n<h2>{escape(title)}</h2>\n{remark}{escape(content)}\n</section>")


def table(head: Sequence[str], rows: Sequence[Sequence[str | Cell]]) -> Markup:
    """A table; a heading "Value|n" has the class after its bar."""
    heads = "".join(_tag("th", Cell(*h.split("|"))) for h in head)
    body = "\n".join("<tr>" + "".join(_tag("td", c if isinstance(c, Cell) else Cell(c)) for c in row) + "</tr>" for row in rows)
    return Markup(f'<div class="wide"><table>\n<thead><tr>{heads}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table></div>')


def definitions(facts: Mapping[str, str]) -> Markup:
    """Names and what they are."""
    return Markup(
        "<dl>\n" + "\n".join(f"<dt>{escape(key)}</dt><dd>{escape(value)}</dd>" for key, value in facts.items()) + "\n</dl>"
    )


def numbers(boxes: Sequence[tuple[str, str, str]]) -> Markup:
    """Boxes of (what, the number, a remark)."""
    inside = "\n".join(f"<div><p>{escape(a)}</p><strong>{escape(b)}</strong><p>{escape(c)}</p></div>" for a, b, c in boxes)
    return Markup(f'<div class="numbers">\n{inside}\n</div>')


def percent(value: float | None) -> str:
    """A saving with its sign."""
    return "–" if value is None else f"{value:.1f} %".replace("-", "−")


def plain_name(name: str) -> str:
    """The name of a limit as words."""
    return name.removesuffix("_percent").replace("_", " ")


def _tag(tag: str, cell: Cell) -> str:
    kind = f' class="{cell.kind}"' if cell.kind else ""
    return f"<{tag}{kind}>{escape(cell.text)}</{tag}>"
