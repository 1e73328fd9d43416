"""Runs that earlier versions laid out otherwise: read, gone on with, salvaged."""

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from station.live.events import Progress
from station.measurements import measurement
from station.runs.salvage import salvage
from station.runs.store import open_run
from station.shell.finish import resume_run

GOLDEN = Path(__file__).parents[1] / "golden"


def cut_short(name: str, folder: Path) -> Path:
    """Copy a saved run of one measurement record too few; that of layout 2 was cut short when it was taken."""
    path = Path(shutil.copy(GOLDEN / f"{name}.sqlite", folder / "run.sqlite"))
    with closing(sqlite3.connect(path)) as db, db:
        if db.execute("PRAGMA user_version").fetchone() == (1,):
            db.execute("DELETE FROM record WHERE number = (SELECT max(number) FROM record)")
            db.execute("UPDATE run SET value = '\"interrupted by the operator\"' WHERE name = 'outcome'")
    return path


@pytest.mark.parametrize(("name", "version", "taken", "planned"), [("single", 1, 5, 6), ("cut_short", 2, 1, 2)])
def test_a_run_of_an_earlier_layout_is_gone_on_with(name, version, taken, planned, tmp_path: Path) -> None:
    path = cut_short(name, tmp_path)
    with closing(sqlite3.connect(path)) as db:
        assert db.execute("PRAGMA user_version").fetchone() == (version,)
    before = open_run(path)
    assert all(record.intact for record in before.records)
    assert len(before.taken_for("measure")) == taken
    resumed = resume_run(path, Progress(), kind=measurement("measure"))
    assert resumed.failure is None
    after = open_run(path)
    assert all(record.intact for record in after.records)
    assert len(after.taken_for("measure")) == planned
    assert after.records[: len(before.records)] == before.records


@pytest.mark.parametrize("name", ["single", "cut_short", "fog_table"])
def test_a_damaged_run_of_an_earlier_layout_is_salvaged(name: str, tmp_path: Path) -> None:
    path = Path(shutil.copy(GOLDEN / f"{name}.sqlite", tmp_path / "run.sqlite"))
    before = open_run(path)
    content = bytearray(path.read_bytes())
    place = content.index(before.records[0].payload[:64])
    content[place] ^= 1
    path.write_bytes(content)
    saved = open_run(salvage(path, tmp_path / "runs").path)
    assert [record.payload for record in saved.records] == [record.payload for record in before.records[1:]]
    assert all(record.intact for record in saved.records)
