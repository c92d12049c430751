"""A figure as SVG text that stands inside an HTML page and follows the page's light or dark colours.

The colours of `look` become CSS variables (``--figure-ink`` and so on) that fall back to the colours themselves; words
become outlines, so that the page needs no font; nothing in the text names an address.
"""

from __future__ import annotations

import html
import io
import re

import matplotlib as mpl
from matplotlib.figure import Figure

from energyopt.plots import look

VARIABLES = {
    look.PAPER: "paper",
    look.INK: "ink",
    look.QUIET: "quiet",
    look.RULE: "rule",
    look.PLANNED: "planned",
    look.REPLAYED: "replayed",
    look.LIMIT: "limit",
    look.BASELINE_COLOURS[0]: "baseline",
    look.KINETIC: "kinetic",
    look.VISCOUS: "viscous",
    look.COULOMB: "coulomb",
    look.GEAR: "gear",
    look.STANDBY: "standby",
}
"""CSS variables (without the prefix ``--figure-``) by colour."""


def inline_svg(figure: Figure, name: str, description: str) -> str:
    """The figure as an ``<svg>`` element.

    Args:
        figure: from `plot_metrics` or `plot_joints`.
        name: put before every id, so that several figures can stand in one page.
        description: what a reader who does not see it is told.
    """
    buffer = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "path", "svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.DOTALL)
    view = re.search(r'viewBox="([^"]*)"', text)[1]
    body = text[text.index(">") + 1 :]
    body = re.sub(r'\bid="', f'id="{name}-', body)
    body = re.sub(r"url\(#", f"url(#{name}-", body)
    body = re.sub(r'(?:xlink:)?href="#', f'href="#{name}-', body)
    for colour, variable in VARIABLES.items():
        body = body.replace(colour, f"var(--figure-{variable},{colour})")
    return f'<svg role="img" aria-label="{html.escape(description, quote=True)}" viewBox="{view}">{body}'
