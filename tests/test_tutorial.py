"""The tutorial runs, says what it said when it was kept, and shows its figures."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

TUTORIAL = Path(__file__).parents[1] / "docs/tutorial.ipynb"


@pytest.mark.slow
def test_the_tutorial_runs(tmp_path):
    notebook = nbformat.read(TUTORIAL, as_version=4)
    before = words_shown(notebook)
    NotebookClient(notebook, timeout=250, resources={"metadata": {"path": tmp_path}}).execute()
    assert words_shown(notebook) == before
    printed = "".join(o.get("text", "") for cell in notebook.cells for o in cell.get("outputs", []))
    rescued, broken = map(int, re.search(r"rescued: (\d+)  broken: (\d+)", printed).groups())
    assert rescued > 20 > broken  # of 40 episodes


def words_shown(notebook):
    """What the outputs say apart from numbers, which another processor rounds otherwise."""
    outputs = [o for cell in notebook.cells for o in cell.get("outputs", [])]
    texts = [o.get("text") or o["data"].get("text/markdown", "") for o in outputs]
    return set(re.findall(r"[a-z_]+", "".join(texts).lower()))


def test_the_tutorial_shows_what_it_gives():
    notebook = nbformat.read(TUTORIAL, as_version=4)
    outputs = [o for cell in notebook.cells for o in cell.get("outputs", [])]
    assert sum("image/png" in o.get("data", {}) for o in outputs) == 2
    assert not [o for o in outputs if o.output_type == "error" or o.get("name") == "stderr"]
