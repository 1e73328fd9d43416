"""The record store: what is acknowledged is there, also after SIGKILL."""

import os
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from station.errors import RunError
from station.runs.database import is_database, save_result
from station.runs.store import NewRecord, RunWriter, open_run

PREAMBLE = '1;8;BIN;RI;MSB;5;"Ch1";Y;1.0E-4;0;0.0E0;"s";4.0E-3;0.0E0;0.0E0;"Volts"'
CODES = np.array([-128, -127, 0, 1, 127], dtype=np.int8)


def record(number: int, purpose: str = "measure") -> NewRecord:
    conditions = {"channel": "CH1", "azimuth_deg": number / 3}
    return NewRecord(f"{purpose} {number}", purpose, PREAMBLE, np.roll(CODES, number).tobytes(), conditions)


def new_run(folder: Path, records: int = 2) -> Path:
    with RunWriter.create(folder / "runs", {"simulated": True, "name": "Kreisel Ω"}) as run:
        for number in range(records):
            run.save_records([record(number)])
    return run.path


def test_what_was_saved_is_read_back_byte_for_byte(tmp_path: Path) -> None:
    run = open_run(new_run(tmp_path))
    assert [record.number for record in run.records] == [1, 2]
    assert run.records[1].codes.tobytes() == np.roll(CODES, 1).tobytes()
    assert run.records[0].preamble == PREAMBLE
    assert run.records[1].conditions == {"channel": "CH1", "azimuth_deg": 1 / 3}
    assert all(record.intact for record in run.records)
    assert run.facts["name"] == "Kreisel Ω"
    assert run.facts["started_at"].endswith("Z")
    assert run.results is None


def test_a_finished_run_is_one_file_with_our_mark(tmp_path: Path) -> None:
    path = new_run(tmp_path)
    assert sorted(file.name for file in path.parent.iterdir()) == ["run.sqlite"]
    db = sqlite3.connect(path)
    assert db.execute("PRAGMA application_id").fetchone() == (0x47594C4B,)
    assert db.execute("PRAGMA page_size").fetchone() == (16384,)
    assert db.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    db.close()


def test_runs_of_one_second_do_not_meet(tmp_path: Path) -> None:
    paths = {new_run(tmp_path, 1) for _ in range(4)}
    assert len(paths) == 4


def test_a_directory_or_a_file_names_the_run(tmp_path: Path) -> None:
    path = new_run(tmp_path)
    assert open_run(path.parent).path == path
    assert is_database(path)
    assert is_database(path.parent)


def test_results_are_added_to_a_closed_run(tmp_path: Path) -> None:
    path = new_run(tmp_path)
    save_result(path, {"lock_in_rate_dps": 0.01})
    save_result(path, {"lock_in_rate_dps": 0.02})
    assert open_run(path).results == {"lock_in_rate_dps": 0.02}


def test_a_reader_sees_records_while_the_run_is_being_written(tmp_path: Path) -> None:
    with RunWriter.create(tmp_path, {}) as writer:
        writer.save_records([record(1)])
        assert len(open_run(writer.path).records) == 1
        writer.save_records([record(1, "tilt")])
        run = open_run(writer.path)
    assert len(run.records) == 2
    assert len(run.taken_for("tilt")) == 1


def test_a_changed_byte_is_noticed(tmp_path: Path) -> None:
    path = new_run(tmp_path)
    db = sqlite3.connect(path)
    db.execute("UPDATE record SET payload = X'0000000000' WHERE number = 1")
    db.commit()
    db.close()
    assert [record.intact for record in open_run(path).records] == [False, True]


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("absent", None, "no such file"),
        ("text.csv", b"a,b\n1,2\n", "is not a saved run"),
        ("empty", b"", "not a saved run"),
    ],
)
def test_what_is_no_run_is_told(tmp_path: Path, name: str, content: bytes | None, said: str) -> None:
    file = tmp_path / name
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(RunError, match=said):
        open_run(file)


def test_a_strange_database_a_newer_run_and_an_empty_directory_are_told(tmp_path: Path) -> None:
    other = sqlite3.connect(tmp_path / "other.db")
    other.execute("CREATE TABLE run (a)")
    other.close()
    with pytest.raises(RunError, match="not a saved run of gyrolock"):
        open_run(tmp_path / "other.db")
    with pytest.raises(RunError, match="holds no run"):
        open_run(tmp_path)
    path = new_run(tmp_path)
    newer = sqlite3.connect(path)
    newer.execute("PRAGMA user_version = 99")
    newer.close()
    with pytest.raises(RunError, match="newer gyrolock"):
        open_run(path)


def test_a_cut_file_is_told(tmp_path: Path) -> None:
    path = new_run(tmp_path, 40)
    path.write_bytes(path.read_bytes()[:20_000])
    with pytest.raises(RunError, match="damaged"):
        open_run(path)


def test_runs_cannot_be_saved_below_a_file(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(RunError, match=r"cannot be saved there|is not a directory"):
        RunWriter.create(tmp_path / "taken", {})


WRITER = """
import sys
from pathlib import Path
import numpy as np
from station.runs.store import NewRecord, RunWriter
run = RunWriter.create(Path(sys.argv[1]), {"simulated": True})
print(run.path, flush=True)
rng = np.random.default_rng(0)
for number in range(1, 100_000):
    codes = rng.integers(-100, 100, 2500).astype(np.int8)
    run.save_records([NewRecord(str(number), "measure", sys.argv[2], codes.tobytes(), {"number": number})])
    print(number, flush=True)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no SIGKILL")
def test_sigkill_loses_no_acknowledged_record(tmp_path: Path) -> None:
    command = [sys.executable, "-c", WRITER, str(tmp_path), PREAMBLE]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        path = Path(writer.stdout.readline().strip())
        acknowledged = 0
        while acknowledged < 137:
            acknowledged = int(writer.stdout.readline())
        os.kill(writer.pid, signal.SIGKILL)
        # what was printed before the kill arrived was acknowledged too
        acknowledged = max([acknowledged, *(int(line) for line in writer.stdout if line.endswith("\n"))])
    run = open_run(path)
    assert len(run.records) >= acknowledged
    assert all(record.intact for record in run.records)
    assert [record.conditions["number"] for record in run.records] == list(range(1, len(run.records) + 1))
    assert "ended_at" not in run.facts


LOOKS = """
import sys
from pathlib import Path
from station.runs.store import open_run
while True:
    open_run(Path(sys.argv[1]))
"""


@pytest.mark.slow
def test_a_run_that_is_read_where_it_is_written_is_not_folded_by_others(tmp_path: Path) -> None:
    """Another process looks at the run all the time; the journal stays with the one that writes to it."""
    command = [sys.executable, "-c", LOOKS]
    with (
        RunWriter.create(tmp_path, {"command": "measure"}) as writer,
        subprocess.Popen([*command, writer.path]) as other,
    ):
        try:
            for number in range(1, 201):
                writer.save_records([record(number)])
                assert len(open_run(writer.path).records) == number
            assert other.poll() is None
        finally:
            other.kill()
    assert len(open_run(writer.path).records) == 200
