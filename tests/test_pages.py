"""Blocks that scripts write into pages: between their marks, once, and nothing else of the page changes."""

import importlib
import sys
from pathlib import Path

import pytest

from energyopt.errors import FileError
from energyopt.io.pages import with_block, write_block

ROOT = Path(__file__).resolve().parents[1]
MARKS = "<!-- x: begin -->", "<!-- x: end -->"
WRITERS = {
    "problems/benchmarks/moves": "docs/benchmarks.md",
    "problems/benchmarks/optima": "docs/benchmarks.md",
    "problems/benchmarks/_rivals_text": "docs/benchmarks.md",
    "problems/paper/reproduce": "docs/validation.md",
    "docs/make_figures": "README.md",
}


def test_a_block_takes_the_place_of_the_old_one_letter_by_letter(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"above\n\n{MARKS[0]}\nold\n{MARKS[1]}\nbelow\n", encoding="utf-8")
    write_block(page, MARKS, "\nΣτ² \\1 | \\n\n")
    once = page.read_text(encoding="utf-8")
    assert once == f"above\n\n{MARKS[0]}\n\nΣτ² \\1 | \\n\n\n{MARKS[1]}\nbelow\n"
    assert with_block(page, MARKS, "Στ² \\1 | \\n") == once


@pytest.mark.parametrize(
    ("text", "times"),
    [(None, 0), ("no marks", 0), (f"{MARKS[1]}\n{MARKS[0]}", 0), (2 * f"{MARKS[0]}\n{MARKS[1]}\n", 2)],
    ids=["no page", "no marks", "end before begin", "twice"],
)
def test_a_page_without_one_place_for_the_block_is_left_alone(tmp_path, text, times):
    page = tmp_path / "page.md"
    if text is not None:
        page.write_text(text, encoding="utf-8")
    with pytest.raises(FileError, match=rf"page\.md: .*stand there {times} times; expected once"):
        write_block(page, MARKS, "new")
    assert (page.read_text(encoding="utf-8") if text is not None else page.exists()) == (text or False)


@pytest.mark.parametrize("script", WRITERS)
def test_marks_of_every_script_stand_in_its_page_as_it_would_write_them(script, monkeypatch):
    path = ROOT / script
    monkeypatch.syspath_prepend(str(path.parent))
    monkeypatch.delitem(sys.modules, path.name, raising=False)
    module = importlib.import_module(path.name)
    page = ROOT / WRITERS[script]
    text = page.read_text(encoding="utf-8")
    block = text.split(module.BEGIN)[1].split(module.END)[0]
    assert block.strip() and with_block(page, (module.BEGIN, module.END), block) == text
