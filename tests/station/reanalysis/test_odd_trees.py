"""Trees and names as people have them: what cannot be read is one line, and costs itself only."""

import json
import os
import shutil
from pathlib import Path

from station.cli import main

GOLDEN = Path(__file__).parents[2] / "golden"


def test_a_tree_with_links_that_lead_nowhere_or_round(tmp_path, capsys):
    tree = tmp_path / "tree"
    (tree / "loop").mkdir(parents=True)
    (tree / "loop" / "up").symlink_to(tree)
    (tree / "self.CSV").symlink_to(tree / "self.CSV")
    shutil.copy(GOLDEN / "single.sqlite", tree / "a name\x1b[31m\n.sqlite")
    (tree / "._F0000CH1.CSV").write_bytes(b"Mac OS X")
    (tree / ".run.sqlite").write_bytes((GOLDEN / "single.sqlite").read_bytes()[:30_000])
    assert main(["analyze", str(tree), "--to", str(tmp_path / "t.csv"), "--quiet"]) == 2
    out, err = capsys.readouterr()
    assert "6 records of 1 sources" in out
    assert err.count("\n") == 1
    assert "self.CSV" in err


def test_a_folder_that_may_not_be_read_is_named(tmp_path, capsys, monkeypatch):
    (tmp_path / "closed").mkdir()
    shutil.copy(GOLDEN / "single.sqlite", tmp_path / "single.sqlite")
    scandir = os.scandir

    def refuse(path):
        if Path(path).name == "closed":
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr("station.sources.find.os.scandir", refuse)
    assert main(["analyze", str(tmp_path), "--json", "--quiet"]) == 2
    out, err = capsys.readouterr()
    first, second = json.loads(out)["results"]
    assert "Permission denied" in first["error"]["message"]
    assert second["records"] == 6
    assert err.count("\n") == 1


def test_a_report_that_cannot_be_written_costs_no_result(tmp_path, capsys):
    nowhere = tmp_path / "nowhere" / "report.html"
    arguments = ["analyze", str(GOLDEN / "single.sqlite"), "--combine", "--json", "--quiet"]
    assert main([*arguments, "--report", str(nowhere)]) == 5
    document = json.loads(capsys.readouterr().out)
    assert document["records"] == 6
    assert str(nowhere) in document["error"]["message"]
