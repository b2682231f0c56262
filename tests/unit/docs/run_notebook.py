"""Runs the notebook of the docs and keeps its outputs: python -m tests.unit.docs.run_notebook."""

import os
import tempfile
from pathlib import Path

import nbclient
import nbformat

from tests.unit.docs.markdown import ROOT

NOTEBOOK = ROOT / "docs" / "notebook.ipynb"


def main() -> None:
    """Run all cells in a folder of their own, with the samples in it."""
    book = nbformat.read(NOTEBOOK, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "sample_logs").symlink_to(ROOT / "sample_logs")
        os.environ["PYTHONPATH"] = str(ROOT)
        nbclient.NotebookClient(
            book, timeout=600, resources={"metadata": {"path": folder}}
        ).execute()
    for cell in book.cells:
        cell.metadata = nbformat.NotebookNode()  # no times of the run
    book.metadata.pop("language_info", None)
    nbformat.write(book, NOTEBOOK)


if __name__ == "__main__":
    main()
