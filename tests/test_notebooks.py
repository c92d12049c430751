"""Notebooks run from top to bottom, offline, in the interpreter of the tests, and show what they would show today."""

import os
import re
import sys
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "notebooks").glob("*.ipynb"))
FIGURES = {"01_first_plan.ipynb": 2, "02_obstacles.ipynb": 5, "03_paper.ipynb": 3}
SECONDS = 120
"""For one cell; a whole notebook takes less than a minute on a free machine."""


@pytest.fixture(scope="module", params=NOTEBOOKS, ids=lambda path: path.name)
def both(request, tmp_path_factory):
    """A notebook as committed, and as it runs now."""
    committed = nbformat.read(request.param, as_version=4)
    fresh = nbformat.read(request.param, as_version=4)
    folder = tmp_path_factory.mktemp("notebook")
    manager = nbclient.NotebookClient(fresh, timeout=SECONDS, resources={"metadata": {"path": str(folder)}})
    manager.create_kernel_manager()
    manager.km.kernel_spec.argv[0] = sys.executable
    manager.execute(env={**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, filter(None, sys.path)))})
    return committed, fresh, folder, request.param.name


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def text(cell):
    return "".join(output.get("text", "") for output in cell.outputs)


def test_the_notebook_runs_and_leaves_nothing_behind(both):
    _, fresh, folder, _ = both
    assert all(cell.execution_count for cell in code_cells(fresh))
    assert not [output for cell in code_cells(fresh) for output in cell.outputs if output.output_type == "error"]
    assert list(folder.iterdir()) == []


def test_what_is_committed_was_executed_and_is_small(both):
    committed, _, _, _ = both
    nbformat.validate(committed)
    assert all(cell.execution_count and (cell.outputs or k == 0) for k, cell in enumerate(code_cells(committed)))
    assert all(path.stat().st_size < 1_000_000 for path in NOTEBOOKS)
    assert not any(re.search(r"/(home|root|tmp|work|Users)/", path.read_text(encoding="utf-8")) for path in NOTEBOOKS)


def test_the_objectives_shown_are_those_of_today(both):
    """Every "J = …" of the committed outputs, to 1 %: the accuracy of a plan."""
    committed, fresh, _, _ = both
    pattern = re.compile(r"J = +([\d.]+\d)")
    shown, now = ([float(x) for cell in code_cells(book) for x in pattern.findall(text(cell))] for book in (committed, fresh))
    assert len(shown) >= 5 and shown == pytest.approx(now, rel=0.01)


def test_the_figures_are_shown_inline(both):
    *books, _, name = both
    for book in books:
        kinds = [kind for cell in code_cells(book) for output in cell.outputs for kind in output.get("data", {})]
        assert kinds.count("image/png") == FIGURES[name]
