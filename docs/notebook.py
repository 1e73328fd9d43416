"""Run docs/runs_in_a_notebook.ipynb and write it with what it shows: ``python docs/notebook.py``.

With a folder it is run there and written nowhere: ``python docs/notebook.py FOLDER``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).with_name("runs_in_a_notebook.ipynb")


def executed(folder: Path) -> nbformat.NotebookNode:
    """The notebook with the outputs of a run in a folder; an error of a cell is raised."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    client = NotebookClient(notebook, timeout=300, kernel_name="python3", record_timing=False)
    client.execute(cwd=str(folder))
    notebook.metadata.pop("language_info", None)  # the version of Python is no part of it
    return notebook


def main() -> None:
    """Write it, or only run it."""
    if len(sys.argv) > 1:
        executed(Path(sys.argv[1]))
        return
    with tempfile.TemporaryDirectory() as folder:
        notebook = executed(Path(folder))
    nbformat.write(notebook, NOTEBOOK)


if __name__ == "__main__":
    main()
