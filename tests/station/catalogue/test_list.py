"""The list of all runs: what it says, that it never opens a record, and when it looks again."""

import csv
import io
import json
import os
import re
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from xml.etree import ElementTree

import pytest

from station.catalogue import INDEX_FILE, Entry, RunFilter, chosen, list_runs, write_trend
from station.cli import main
from station.errors import UsageError
from station.results.numbers import LOCK_IN_RATE
from station.results.quantity import Value
from station.runs.store import open_run

GOLDEN = Path(__file__).parents[2] / "golden"
OLD = 1_700_000_000  # a time of a file long ago: it is not looked at again for being young


def keep(folder: Path, name: str, saved: str) -> Path:
    file = folder / name / "run.sqlite"
    file.parent.mkdir(parents=True)
    shutil.copyfile(GOLDEN / f"{saved}.sqlite", file)
    os.utime(file, (OLD, OLD))
    return file


def relabel(file: Path, **facts: str) -> None:
    with closing(sqlite3.connect(file)) as db, db:
        sums = json.loads((db.execute("SELECT value FROM run WHERE name = 'sums'").fetchone() or ["{}"])[0])
        for name, value in facts.items():
            sums.pop(name, None)
            db.execute("INSERT OR REPLACE INTO run VALUES (?, ?)", (name, json.dumps(value)))
        db.execute("INSERT OR REPLACE INTO run VALUES ('sums', ?)", (json.dumps(sums),))
    os.utime(file, (OLD, OLD))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, saved, unit in (
        ("2026/a", "single", "RLG 1"),
        ("2026/b", "turning", "RLG 2"),
        ("c", "fog_table", "FOG 7"),
        ("d", "acquired", "RLG 1"),
    ):
        relabel(keep(tmp_path / "runs", name, saved), unit=unit, operator="Ada", note=f"bench of {unit}")
    return tmp_path / "runs"


def names(entries: list[Entry], folder: Path) -> list[str]:
    return [Path(entry.run).parent.relative_to(folder).as_posix() for entry in entries]


def test_every_run_below_a_folder_with_what_it_says(folder: Path) -> None:
    entries = list_runs(folder)
    assert sorted(names(entries, folder)) == ["2026/a", "2026/b", "c", "d"]
    for entry in entries:
        run = open_run(Path(entry.run))
        assert (entry.command, entry.records) == (run.facts.command, len(run.records))
        assert (entry.unit, entry.operator, entry.note) == tuple(run.facts.labels.values())
        assert (entry.started_at, entry.outcome) == (run.facts.started_at, run.facts.outcome_text)
        if entry.values and entry.command == "measure":
            assert run.results is not None
            assert entry.values[0].value == run.results["lock_in_rate_dps"]
            assert entry.values[0].u == run.results["lock_in_rate_u_dps"]
    table = entries[names(entries, folder).index("c")]
    assert [value.of for value in table.values] == ["X", "Z"]
    assert table.verdict == "FAIL"
    assert list_runs(folder) == entries  # the same from the index


def test_no_record_is_opened(folder: Path) -> None:
    file = folder / "2026/a/run.sqlite"
    record = open_run(file).records[0]
    content = file.read_bytes()
    place = content.index(record.payload[:1000])
    file.write_bytes(content[:place] + bytes(1000) + content[place + 1000 :])
    assert open_run(file).damaged
    assert [entry.problem for entry in list_runs(folder)] == ["", "", "", ""]


def test_only_what_has_changed_is_looked_at_again(folder: Path) -> None:
    before = list_runs(folder)
    file = folder / "2026/a/run.sqlite"
    nothing = bytes(file.stat().st_size)
    file.write_bytes(nothing)
    os.utime(file, (OLD, OLD))
    assert list_runs(folder) == before  # size and time are the same: the index is believed
    os.utime(file, (OLD + 1, OLD + 1))
    seen = {Path(entry.run): entry for entry in list_runs(folder)}
    assert "salvage" in seen[file].problem
    assert seen[file].result_text == "damaged"
    shutil.rmtree(file.parent)
    keep(folder, "e", "several")
    assert sorted(names(list_runs(folder), folder)) == ["2026/b", "c", "d", "e"]


@pytest.mark.parametrize("harm", ["missing", "garbage", "newer", "cannot be written"])
def test_the_index_is_made_again(folder: Path, harm: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    before = list_runs(folder)
    index = folder / INDEX_FILE
    index.unlink()
    if harm == "garbage":
        index.write_bytes(b"SQLite format 3\0" + bytes(range(256)) * 40)
    elif harm == "newer":
        with closing(sqlite3.connect(index)) as db:
            db.executescript("CREATE TABLE run (path, other); PRAGMA user_version = 99;")
    elif harm == "cannot be written":
        index.mkdir()
    assert list_runs(folder) == before
    assert list_runs(folder) == before
    place = next((tmp_path / "cache").rglob("*.sqlite")) if harm == "cannot be written" else index
    with closing(sqlite3.connect(place)) as db:
        assert db.execute("SELECT count(*) FROM run").fetchone() == (4,)


def test_databases_of_others_links_and_hidden_folders(folder: Path) -> None:
    with closing(sqlite3.connect(folder / "other.sqlite")) as db:
        db.execute("CREATE TABLE things (a)")
    (folder / "2026" / "round").symlink_to(folder)
    keep(folder, ".trash/x", "single")
    assert len(list_runs(folder)) == 4
    with pytest.raises(UsageError, match="there is no such folder"):
        list_runs(folder / "nowhere")


WRITER = """
import sys
from pathlib import Path
from xml.etree import ElementTree
from station.runs.store import NewRecord, RunWriter
writer = RunWriter.create(Path(sys.argv[1]), {"command": "measure", "unit": "RLG 9"})
for number in range(1, 4):
    writer.save_records([NewRecord(f"r{number}", "measure", "header", bytes(2500), {})])
    print(number, flush=True)
    sys.stdin.readline()
writer.close()
"""


def test_a_run_that_is_being_written_is_listed_and_not_disturbed(folder: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as writer:
        assert writer.stdout is not None
        assert writer.stdin is not None
        for number in range(1, 4):
            assert writer.stdout.readline() == f"{number}\n"
            (entry,) = chosen(list_runs(folder), RunFilter(unit="RLG 9"))
            assert entry.records == number
            assert Path(f"{entry.run}-wal").exists()
            writer.stdin.write("\n")
            writer.stdin.flush()
    assert writer.returncode == 0
    run = open_run(Path(entry.run))
    assert [record.intact for record in run.records] == [True] * 3


def test_runs_are_chosen_and_sorted(folder: Path) -> None:
    entries = list_runs(folder)

    def asked(*sort: str, **wanted: object) -> list[str]:
        return names(chosen(entries, RunFilter(**wanted), sort), folder)  # type: ignore[arg-type]

    assert asked(unit="rlg*") == ["2026/a", "2026/b", "d"]
    assert asked(unit="RLG 1", command="measure") == ["2026/a", "d"]
    assert asked(verdict="FAIL") == ["c"]
    assert asked(verdict="none") == ["2026/a", "2026/b", "d"]
    assert asked(text="FOG") == ["c"]
    assert asked(tags=("x",)) == []
    assert asked(since="2026-11-22", until="2026-11-22") == ["2026/a", "2026/b", "d", "c"]
    assert asked(until="2026-10") == asked(since="2027") == []
    assert asked("-when") == ["c", "d", "2026/b", "2026/a"]
    assert asked("unit", "-when") == ["c", "d", "2026/a", "2026/b"]
    by_result = chosen(entries, RunFilter(command="measure"), ["result"])
    assert [entry.values[0].value for entry in by_result if entry.values] == sorted(
        entry.values[0].value for entry in entries if entry.command == "measure" and entry.values
    )
    assert not by_result[-1].values
    with pytest.raises(UsageError, match="cannot be sorted by 'size', only by when"):
        asked("size")


def test_the_command(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["runs", str(folder), "--unit", "RLG*", "--plot", str(tmp_path / "trend.svg")]) == 0
    said = capsys.readouterr()
    assert "RLG 1" in said.out
    assert "FOG" not in said.out
    assert "2026/a" in said.out
    drawn = (tmp_path / "trend.svg").read_text()
    assert "RLG 1" in drawn
    assert "lock-in rate" in drawn
    assert main(["runs", str(folder), "--json", "--sort", "-when", "--limit", "2"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == {"name": "gyrolock runs", "version": 1}
    assert [run["unit"] for run in document["runs"]] == ["RLG 2", "RLG 1"]
    assert main(["runs", str(folder), "--csv"]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [row["result_of"] for row in rows] == ["", "", "", "X", "Z"]
    value = open_run(folder / "2026/a").results["lock_in_rate_dps"]  # type: ignore[index]
    assert float(rows[0]["result"]) == value


@pytest.mark.slow
def test_a_trend_shows_what_the_runs_were_judged_by(tmp_path: Path) -> None:
    def judged(size: float, u: float, limit: float | None) -> str:
        value = Value(size, "deg/s", size - 2 * u, size + 2 * u, u=u, quantity=LOCK_IN_RATE)
        limits = {} if limit is None else {value.limit_name: limit}
        entries = [
            Entry(str(day), "measure", f"2026-11-0{day}T00:00:00+00:00", unit="A", values=(value,), limits=limits)
            for day in (1, 2)
        ]
        assert Entry.from_json(json.loads(json.dumps(entries[0].as_json()))).limits == limits
        write_trend(tmp_path / "trend.svg", entries)
        return (tmp_path / "trend.svg").read_text(encoding="utf-8")

    assert "limit" not in judged(0.01, 1e-4, None)
    assert re.search(r"limit 0\.0102\b(?!, )", judged(0.01, 1e-4, 0.0102))
    assert "limit 0.5, above the picture" in judged(0.01, 1e-4, 0.5)
    assert "limit 0.009, below the picture" in judged(0.01, 1e-5, 0.009)
    drawn = ElementTree.fromstring(judged(-0.01, 4e-3, 0.015))  # a limit is on sizes: both ends are drawn
    dashed = [one for one in drawn.iter() if "stroke-dasharray" in (one.get("style") or "")]
    assert len(dashed) == 3  # and the one beside its name


@pytest.mark.parametrize("limits", [None, "none", ["x", {}, {"name": "a"}, {"name": "b", "limit": "high"}]])
def test_limits_that_are_none_do_not_stop_the_list(tmp_path: Path, limits: object) -> None:
    file = keep(tmp_path, "a", "single")
    with closing(sqlite3.connect(file)) as db, db:
        (text,) = db.execute("SELECT value FROM result ORDER BY number DESC LIMIT 1").fetchone()
        odd = json.dumps({**json.loads(text), "limits": limits})
        db.execute("UPDATE result SET value = ? WHERE number = (SELECT max(number) FROM result)", (odd,))
    (entry,) = list_runs(tmp_path)
    assert entry.limits == {} and entry.values


def test_what_cannot_be_done_is_one_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["runs", str(folder / "no")]) == 2
    assert main(["runs", str(folder), "--plot", "trend.bmp"]) == 2
    assert main(["runs", str(folder), "--unit", "nobody", "--plot", "t.svg"]) == 4
    assert main(["runs", str(folder), "--json", "--csv"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 4
