"""Reports of what was exported."""

from pathlib import Path

import pytest

from station.cli import main

from .conftest import GOLDEN


def test_runs_of_a_data_set_and_files_of_a_card(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = f"{tmp_path}/all.npz"
    assert main(["export", str(GOLDEN / "turning.sqlite"), "--to", place]) == 0
    assert main(["export", place, "--tek-csv", f"{tmp_path}/card"]) == 0
    assert main(["report", place]) == 0
    assert main(["report", f"{tmp_path}/card"]) == 0
    pages = [tmp_path / "all.turning.html", tmp_path / "card" / "report.html"]
    assert capsys.readouterr().out.splitlines()[2:] == [str(page) for page in pages]
    for page in pages:
        assert "<svg" in page.read_text(encoding="utf-8")
