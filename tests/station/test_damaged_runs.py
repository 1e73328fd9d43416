"""Runs that were killed, damaged or copied: one bad cell costs one record, and what can be read is got out."""

import json
import os
import shutil
import sqlite3
import subprocess
import sys
import tracemalloc
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from station.cli import main
from station.errors import RunError
from station.runs.database import journal_of
from station.runs.salvage import rows_of, salvage
from station.runs.store import NewRecord, RunWriter, SavedRun, open_run

PREAMBLE = '1;8;BIN;RI;MSB;2500;"Ch1";Y;1.0E-4;0;0.0E0;"s";4.0E-3;0.0E0;0.0E0;"Volts"'


def record(number: int, size: int = 2500) -> NewRecord:
    codes = np.random.default_rng(number).integers(-100, 100, size).astype(np.int8)
    return NewRecord(f"rate +8, {number}", "measure", PREAMBLE, codes.tobytes(), {"number": number})


def new_run(folder: Path, records: int = 60, size: int = 2500) -> Path:
    facts = {"command": "measure", "settings": {"gyro": {"name": "Kreisel Ω"}}, "unit": "SN 7"}
    with RunWriter.create(folder / "runs", facts) as run:
        for number in range(1, records + 1):
            run.save_records([record(number, size)])
    return run.path


def damage(path: Path, statement: str, *values: object) -> None:
    with closing(sqlite3.connect(path)) as db, db:
        db.execute(statement, values)


def payloads(run: SavedRun) -> set[bytes]:
    return {one.payload for one in run.records}


@pytest.mark.parametrize("column", ["key", "taken_at", "purpose", "header", "payload", "sha256", "conditions"])
@pytest.mark.parametrize("value", [b"\xff\x00", "[" * 5000, 7, "", '{"number": 6}'])
def test_one_bad_cell_costs_one_record_and_names_it(tmp_path: Path, column: str, value: object) -> None:
    path = new_run(tmp_path, 4)
    damage(path, f"UPDATE record SET {column} = ? WHERE number = 3", value)
    run = open_run(path)
    assert [one.intact for one in run.records] == [True, True, False, True]
    (told,) = run.damaged
    assert told.startswith("record 3 (")
    found = salvage(path)
    assert found.records == 3
    assert payloads(open_run(found.path)) == {record(number).payload for number in (1, 2, 4)}


def test_a_record_that_is_missing_is_named(tmp_path: Path) -> None:
    path = new_run(tmp_path, 6)
    damage(path, "DELETE FROM record WHERE number IN (2, 4, 5)")
    assert open_run(path).damaged == ("record 2 is missing", "records 4 to 5 are missing")


@pytest.mark.parametrize("value", ['{"gyro": {"name": "Kreisel O"}}', "no JSON", "[" * 5000, b"\xff"])
def test_a_damaged_fact_is_not_used(tmp_path: Path, value: object) -> None:
    path = new_run(tmp_path, 2)
    damage(path, "UPDATE run SET value = ? WHERE name = 'settings'", value)
    run = open_run(path)
    assert "settings" not in run.facts
    assert run.facts["unit"] == "SN 7"
    assert "settings" in run.damaged[0]
    assert main(["analyze", str(path)]) == 2


def killed(folder: Path, records: int = 60) -> Path:
    """A run whose program was killed: the last commits stand in the journal only."""
    code = "import os, sys; sys.path[:0] = sys.argv[3:]; import test_damaged_runs as t\n"
    code += "t.RunWriter.close = lambda self: os._exit(9); t.new_run(t.Path(sys.argv[1]), int(sys.argv[2]))"
    here = str(Path(__file__).parent)
    subprocess.run([sys.executable, "-c", code, str(folder), str(records), here], check=False, timeout=60)
    (path,) = (folder / "runs").glob("*/run.sqlite")
    assert journal_of(path).stat().st_size > 100_000
    return path


def test_the_next_opening_makes_one_file_of_a_killed_run(tmp_path: Path) -> None:
    path = killed(tmp_path)
    assert len(open_run(path).records) == 60
    assert [file.name for file in path.parent.iterdir()] == ["run.sqlite"]
    copy = Path(shutil.copy(path, tmp_path / "copy.sqlite"))
    assert payloads(open_run(copy)) == {record(number).payload for number in range(1, 61)}


READ = """
import os, sys
from pathlib import Path
from station.runs.store import open_run
if os.getuid() == 0:
    os.setgid(65534); os.setuid(65534)
print(len(open_run(Path(sys.argv[1])).records), flush=True)
os._exit(0)
"""


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
@pytest.mark.parametrize("journal", [True, False])
def test_a_killed_run_can_be_read_where_nothing_can_be_written(tmp_path: Path, journal: bool) -> None:
    path = killed(tmp_path)
    for file in path.parent.iterdir():
        if file.name != "run.sqlite" and not (journal and file.name.endswith("-wal")):
            file.unlink()
    if not journal:
        damage(path, "PRAGMA journal_mode = WAL")
    for folder in [path.parent, *path.parent.parents]:
        if folder.stat().st_uid == os.getuid() and folder != Path("/"):
            folder.chmod(0o755)
        if folder == tmp_path.parent.parent.parent:
            break
    for file in path.parent.iterdir():
        file.chmod(0o444)
    path.parent.chmod(0o555)
    try:
        command = [sys.executable, "-c", READ, str(path)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    finally:
        path.parent.chmod(0o755)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == 60 if journal else int(done.stdout) < 60


def test_commits_behind_a_damaged_frame_of_the_journal_are_not_dropped_silently(tmp_path: Path) -> None:
    path = killed(tmp_path)
    journal = journal_of(path)
    content = bytearray(journal.read_bytes())
    content[len(content) // 2] ^= 0x55
    journal.write_bytes(content)
    with pytest.raises(RunError, match=r"journal is damaged, \d+ commits"):
        open_run(path)
    assert journal.read_bytes() == content
    found = salvage(path)
    run = open_run(found.path)
    assert found.records >= 59
    assert payloads(run) <= {record(number).payload for number in range(1, 61)}
    assert len(payloads(run)) == found.records
    assert run.facts["unit"] == "SN 7"


@pytest.mark.parametrize("size", [2500, 40_000])  # a record in one page, and one that goes on in others
@pytest.mark.parametrize(
    ("first", "length", "least"), [(0, 100, 60), (0, 16_384, 50), (3 * 16_384, 16_384, 50), (200_000, 10**9, 8)]
)
def test_what_can_be_read_is_got_out(tmp_path: Path, size: int, first: int, length: int, least: int) -> None:
    path = new_run(tmp_path, 60, size)
    content = bytearray(path.read_bytes())
    content[first : first + length] = bytes(min(length, len(content) - first)) if length < 10**9 else b""
    path.write_bytes(content)
    found = salvage(path, tmp_path / "other")
    run = open_run(found.path)
    assert found.records >= (least if size == 2500 or least > 8 else 2)
    assert found.path.parent.parent == tmp_path / "other"
    assert {one.key: one.payload for one in run.records}.items() <= {
        record(n, size).key: record(n, size).payload for n in range(1, 61)
    }.items()
    assert not run.damaged
    assert run.facts["outcome"]["kind"] == "salvaged"
    assert path.read_bytes() == content


@pytest.mark.parametrize("records", [8, 20])
@pytest.mark.parametrize("share", [0.55, 0.75, 0.85, 0.97])
def test_of_a_page_that_is_cut_the_rows_in_front_are_got_out(tmp_path: Path, records: int, share: float) -> None:
    path = new_run(tmp_path, records)
    content = path.read_bytes()
    cut = content[: int(share * len(content))]
    # a row takes 3 kB at most: of whom the codes stand in front of the last 3 kB, the whole row does
    ends = {n: cut.find(record(n).payload) + 3000 for n in range(1, records + 1)}
    whole = {n for n, end in ends.items() if end > 3000 and end < len(cut)}
    path.write_bytes(cut)
    if not whole:
        pytest.skip("the cut lies before the first record")
    run = open_run(salvage(path, tmp_path / "other").path)
    found = {int(one.key.rpartition(" ")[2]) for one in run.records}
    assert whole <= found
    assert all(one.payload == record(int(one.key.rpartition(" ")[2])).payload for one in run.records)


def test_the_command_names_what_is_lost(tmp_path: Path, capsys) -> None:
    path = new_run(tmp_path, 5)
    damage(path, "UPDATE record SET payload = zeroblob(2500) WHERE number = 2")
    assert main(["salvage", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["records"], told["lost"]) == (4, ["record 2 (rate +8, 2)"])
    assert main(["salvage", str(path)]) == 0
    said = capsys.readouterr()
    assert said.err == "gyrolock: lost: record 2 (rate +8, 2)\n"
    assert said.out.startswith("saved   4 records in ")
    (tmp_path / "noise").write_bytes(np.random.default_rng(0).bytes(100_000))
    assert main(["salvage", str(tmp_path / "noise"), "--json"]) == 2
    assert "nothing of a run" in json.loads(capsys.readouterr().out)["error"]["message"]


@pytest.mark.parametrize("number", [10**15, 2**62, -7, 0, 12_345])
def test_a_number_that_is_damaged_is_no_count_of_records(tmp_path: Path, number: int, capsys) -> None:
    """The row of a record under another number, beside the record itself and in its place."""
    path = new_run(tmp_path, 5)
    names = "key, taken_at, purpose, header, payload, conditions, sha256"
    whole, here = tmp_path / "twice", tmp_path / "moved"
    for folder, statement in (
        (whole, f"UPDATE record SET number = {number} WHERE number = 2"),
        (
            here,
            f"INSERT INTO record (number, {names}) SELECT {number}, key || ' ', {names[5:]} FROM record LIMIT 1",
        ),
    ):
        folder.mkdir()
        copy = Path(shutil.copy(path, folder))
        damage(copy, statement)
        assert main(["salvage", str(copy), "--json", "--out", str(folder / "out")]) == 0
        told = json.loads(capsys.readouterr().out)
        assert len(told["lost"]) < 1100 and told["records"] in (5, 6)


@pytest.mark.parametrize("length", [20_000, 1 << 25])
def test_pages_that_follow_each_other_in_a_circle_end(length: int) -> None:
    """A row that would go on in another, which goes on in itself: no row, and no memory of its claimed length."""
    size, at = 4096, 100
    claimed = bytes([0x80 | length >> shift & 0x7F for shift in (28, 21, 14, 7)]) + bytes([length & 0x7F])
    page = bytearray(b"\x02" * size)  # wherever the row leaves the page, 02020202 follows
    page[0], page[3:5], page[8:10] = 0x0D, (1).to_bytes(2, "big"), at.to_bytes(2, "big")
    page[at : at + len(claimed) + 1] = claimed + b"\x01"
    circle = {0x02020202: b"\x02" * size}
    tracemalloc.start()
    found = list(rows_of(bytes(page), False, circle))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found == [] and peak < 2_000_000


GOLDEN = Path(__file__).parents[1] / "golden"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("run", "table", "where", "value"),
    [
        ("fog_eps", "run", "name = 'truth'", {"two_pi_error_ppm": {}}),
        ("fog_figures", "run", "name = 'truth'", {"bias_dph": "x"}),
        ("acquired", "run", "name = 'scope_setting'", {"a": 1}),
        ("fog_logs", "run", "name = 'provenance'", {"packages": True}),
        ("fog_logs", "run", "name = 'logs'", [float("inf")]),
        ("quadrature", "run", "name = 'identity'", {"serial": float("nan")}),
        ("turning", "record", "number = 2", {"truth": {"ratio": "x"}}),
        ("fog_selfcal_by_table", "segment", "number = 2", {"model": []}),
    ],
)
def test_a_value_of_another_kind_ends_no_command(
    tmp_path: Path, run: str, table: str, where: str, value: object
) -> None:
    """In a run of a layout without checksums of what is noted beside its records."""
    path = Path(shutil.copy(GOLDEN / f"{run}.sqlite", tmp_path))
    damage(
        path,
        f"UPDATE {table} SET {'value' if table == 'run' else 'conditions'} = ? WHERE {where}",
        json.dumps(value),
    )
    commands = (["analyze", str(path), "--full"], ["report", str(path)], ["salvage", str(path)])
    commands += (
        ["compare", str(path), str(GOLDEN / f"{run}.sqlite")],
        ["export", str(path), "--to", f"{tmp_path}/x.csv"],
    )
    for command in commands:
        assert main(command) in (0, 1, 2, 4, 6), command
