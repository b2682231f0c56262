"""Runs the notebook of the docs and keeps its outputs: python -m
tests.unit.docs.run_notebook.
"""

import os
import tempfile
from pathlib import Path

import nbclient
import nbformat

from tests.unit.docs.markdown import ROOT

NOTEBOOK = ROOT / "docs" / "tutorial" / "notebook.ipynb"


if __name__ == "__main__":
    book = nbformat.read(NOTEBOOK, as_version=4)
    os.environ["PYTHONPATH"] = str(ROOT)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "sample_logs").symlink_to(ROOT / "sample_logs")
        own = {"metadata": {"path": folder}}
        nbclient.NotebookClient(book, timeout=600, resources=own).execute()
    for cell in book.cells:
        cell.metadata = nbformat.NotebookNode()  # no times of the run
    book.metadata.pop("language_info", None)
    nbformat.write(book, NOTEBOOK)
