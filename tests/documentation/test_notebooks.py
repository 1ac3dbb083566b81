"""Every notebook runs from top to bottom, at a small size, and is kept with its outputs."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))

by_notebook = pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)


@by_notebook
def test_runs(file, monkeypatch):
    monkeypatch.setenv("MI_ELLIPSE_QUALITY", "test")
    notebook = nbformat.read(file, as_version=4)
    resources = {"metadata": {"path": FOLDER}}
    NotebookClient(notebook, timeout=300, resources=resources).execute()
    # Figures are drawn after the cell: what fails then does not stop the notebook.
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert not [output for output in outputs if output.output_type == "error"]


@by_notebook
def test_kept_with_outputs(file):
    """In order, without errors, the machine's paths and times, and small enough to be read."""
    notebook = nbformat.read(file, as_version=4)
    nbformat.validate(notebook)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell.outputs]
    assert not [output for output in outputs if output.output_type == "error"]
    assert not [output for output in outputs if output.get("name") == "stderr"]
    assert not [cell for cell in cells if "execution" in cell.metadata]

    text = file.read_text()
    assert str(FOLDER.parent) not in text
    assert len(text) < 1.5e6
