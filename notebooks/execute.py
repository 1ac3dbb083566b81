"""Execute the notebooks at full quality and keep their outputs: `execute.py [NAME …]`."""

from __future__ import annotations

import argparse
import base64
import io
from pathlib import Path

import nbformat
import PIL.Image
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parent


def execute(file: Path, timeout: int | None = None) -> nbformat.NotebookNode:
    """
    Return a notebook with new outputs; the first error in a cell is raised.

    Parameters
    ----------
    file
        Notebook, executed in its own folder.
    timeout
        Seconds for each cell.
    """
    notebook = nbformat.read(file, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=timeout,
        resources={"metadata": {"path": file.parent}},
        coalesce_streams=True,
        record_timing=False,  # times would differ in every commit
    )
    return client.execute()


def compress(notebook: nbformat.NotebookNode) -> None:
    """Make the pictures in the outputs smaller, without a loss."""
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            if "image/png" not in output.get("data", {}):
                continue
            before = base64.b64decode(output.data["image/png"])
            after = io.BytesIO()
            with PIL.Image.open(io.BytesIO(before)) as picture:
                # Nothing in a figure is transparent.
                picture.convert("RGB").save(after, "PNG", optimize=True)
            if len(after.getvalue()) < len(before):
                output.data["image/png"] = base64.b64encode(after.getvalue()).decode() + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="without .ipynb; default: all")
    names = parser.parse_args().names or sorted(file.stem for file in FOLDER.glob("*.ipynb"))
    for name in names:
        file = FOLDER / f"{name}.ipynb"
        notebook = execute(file)
        compress(notebook)
        notebook.metadata["language_info"] = {"name": "python"}  # not the version of this machine
        nbformat.write(notebook, file)
        print(f"{file.name}: {file.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
