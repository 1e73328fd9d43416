"""The example notebook of the documentation runs from its first to its last cell."""

import os
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).parents[2]
pytest.importorskip("nbclient", reason="nbclient is not installed")
pytest.importorskip("pyarrow", reason="the extra `data` is not installed")


@pytest.mark.slow
def test_every_cell_runs(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, str(ROOT / "docs" / "notebook.py"), str(tmp_path)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "runs").glob("*/run.sqlite"))) == 2
    assert (tmp_path / "records.parquet").is_file()


def test_every_cell_shows_what_it_gave() -> None:
    page = nbformat.read(ROOT / "docs" / "runs_in_a_notebook.ipynb", as_version=4)
    code = [cell for cell in page.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code), "`python docs/notebook.py` writes what it shows"
    assert code[-1].outputs[-1].data["text/plain"] == "True"
