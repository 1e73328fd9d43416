"""A run that is read batch by batch gives what the same run gives from memory, bit for bit."""

import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from station.live.events import Progress
from station.lock_in.columns import ColumnFiles, EstimatesOnDisk
from station.lock_in.estimate import pieces_of
from station.reanalysis.analyze_table import fill_table
from station.report.show import render_report
from station.runs.store import NewRecord, RunWriter, open_run
from station.shell.finish import Evaluated, evaluate_run, evaluate_saved
from station.sources.find import find_sources, open_source
from station.sources.workers import Processes

GOLDEN = Path(__file__).parents[2] / "golden"


def streamed(path: Path, processes: int = 1) -> Evaluated:
    with Processes(processes) as workers:
        return evaluate_saved(path, workers, Progress(), config=None, choices={})


@pytest.mark.slow
@pytest.mark.parametrize("name", ["single", "several", "channel", "quadrature"])
def test_streamed_and_from_memory_are_the_same(name: str, tmp_path: Path) -> None:
    path = Path(shutil.copy(GOLDEN / f"{name}.sqlite", tmp_path))
    from_memory, as_stream = evaluate_run(open_run(path)), streamed(path)
    assert as_stream.document() == from_memory.document()
    assert list(as_stream.rows()) == list(from_memory.rows())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["single", "several", "turning", "channel"])
def test_estimates_that_lie_on_the_disk_give_the_same(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of a long run do; the report is drawn from them too."""
    path = Path(shutil.copy(GOLDEN / f"{name}.sqlite", tmp_path))
    in_memory = streamed(path)
    monkeypatch.setattr("station.lock_in.columns.LONG", 1)
    monkeypatch.setattr("station.lock_in.estimate.AT_ONCE", 3)
    monkeypatch.setattr("station.lock_in.columns.AT_ONCE", 4)
    monkeypatch.setattr("station.lock_in.columns.FOLDED", 2)
    on_disk = streamed(path)
    assert isinstance(on_disk.found.each, EstimatesOnDisk)
    assert "_columns" in vars(on_disk.found.each)
    assert on_disk.document() == in_memory.document()
    assert list(on_disk.rows()) == list(in_memory.rows())
    assert render_report(on_disk) == render_report(in_memory)


def test_rows_of_a_column_on_the_disk_come_in_the_order_they_are_asked_for() -> None:
    columns = ColumnFiles()
    columns.add({"value": np.arange(8) * 1.5}, 8)
    for rows in ([2, 3, 4], [0, 2, 1, 3], [3, 3, 4, 6], [5], []):
        asked = np.array(rows, dtype=np.intp)
        assert columns.rows("value", asked).tolist() == [1.5 * row for row in rows]


BLOCKS = (
    "analysis.combine._AT_ONCE",
    "analysis.frequency_method._AT_ONCE",
    "analysis.lock_in_run.table._CURVES_AT_ONCE",
    "analysis.lock_in_run.table._AT_ONCE",
    "analysis.several_rates.points.AT_ONCE",
    "station.lock_in.columns._AT_ONCE",
)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["single", "several"])
def test_numbers_do_not_depend_on_how_many_records_are_looked_at_together(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Path(shutil.copy(GOLDEN / f"{name}.sqlite", tmp_path))
    at_once = streamed(path).document()
    monkeypatch.setattr("station.lock_in.columns.LONG", 1)
    for block in BLOCKS:
        monkeypatch.setattr(block, 4)
    by_fours = streamed(path).document()
    assert by_fours["flags"] == at_once["flags"]
    parts = [("", by_fours, at_once)]
    if name == "several":
        fits = by_fours["several_rates"], at_once["several_rates"]
        parts += [(part, *(fit[part] for fit in fits)) for part in ("by_beat", "by_table", "by_frequency")]
        parts.append(("table_check", by_fours["table_check"], at_once["table_check"]))
    for part, now, then in parts:
        for key, value in then.items():
            # a bias rate or a lag of zero is found to what rounding leaves of it
            if isinstance(value, float) and not key.startswith(("bias_rate", "bandwidth", "third_order")):
                assert now[key] == pytest.approx(value, rel=1e-6, abs=1e-12), f"{part} {key}"


def test_a_run_cut_into_pieces_by_two_processes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A damaged record and one that is missing are named, whatever reads the run."""
    old = open_run(GOLDEN / "single.sqlite")
    taken = old.taken_for("measure")
    with RunWriter.create(tmp_path, {"command": "measure", "settings": old.facts.settings}) as writer:
        for number in range(40):
            record = taken[number % len(taken)]
            new = NewRecord(f"{number}", "measure", record.header, record.payload, record.conditions)
            writer.save_records([new])
    with sqlite3.connect(writer.path) as db:
        db.execute("UPDATE record SET payload = zeroblob(2500) WHERE number = 7")
        db.execute("DELETE FROM record WHERE number = 20")
    from_memory = evaluate_run(open_run(writer.path))
    monkeypatch.setattr("station.lock_in.estimate.AT_ONCE", 9)
    assert len(pieces_of(open_source(writer.path), {})) == 5
    as_stream = streamed(writer.path, processes=2)
    assert as_stream.document() == from_memory.document()
    assert as_stream.document()["damaged"] == ["record 7 (6) is damaged", "record 20 is missing"]
    assert as_stream.document()["records"] == 39
    assert as_stream.found.waveforms[10] == from_memory.found.waveforms[10]


@pytest.mark.parametrize("damaged", ["", "measure", "quadrature"])
def test_pairs_of_two_photodiodes_are_read_as_they_are_needed(
    damaged: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Path(shutil.copy(GOLDEN / "quadrature.sqlite", tmp_path))
    if damaged:
        with sqlite3.connect(path) as db:
            codes = (
                "codes" if "codes" in {row[1] for row in db.execute("PRAGMA table_info(record)")} else "payload"
            )
            db.execute(
                f"UPDATE record SET {codes} = zeroblob(2500) WHERE number = "
                "(SELECT max(number) FROM record WHERE purpose = ?)",
                [damaged],
            )
    from_memory = evaluate_run(open_run(path))
    monkeypatch.setattr("station.runs.store.open_run", None)  # nobody holds all of it
    monkeypatch.setattr("analysis.lock_in_run.records._RECORDS_AT_ONCE", 2)
    as_stream = streamed(path)
    assert as_stream.found.quadratures is not None
    assert as_stream.document() == from_memory.document()
    assert list(as_stream.rows()) == list(from_memory.rows())
    assert bool(damaged) == bool(as_stream.found.damaged)


def test_pairs_of_two_photodiodes_give_no_rows_of_one(tmp_path: Path) -> None:
    with Processes(1) as workers:
        table = tmp_path / "results.csv"
        done = fill_table([GOLDEN / "quadrature.sqlite"], table, {}, workers, Progress())
    assert (done.records, done.sources) == (0, 0)
    assert [one.reason.split(",")[0] for one in done.left_out] == ["its records are pairs of two photodiodes"]
    assert not table.exists()


def test_the_measurement_has_one_sum_wherever_it_lies_and_whatever_is_said_of_it(tmp_path: Path) -> None:
    path = Path(shutil.copy(GOLDEN / "single.sqlite", tmp_path / "another name.sqlite"))
    (source,) = find_sources([tmp_path])
    first = open_source(source).sha256
    assert first == open_source(GOLDEN / "single.sqlite").sha256
    with sqlite3.connect(path) as db:
        db.execute("UPDATE run SET value = '\"interrupted\"' WHERE name = 'outcome'")
    assert open_source(path).sha256 == first
    with sqlite3.connect(path) as db:
        db.execute("DELETE FROM record WHERE number = (SELECT max(number) FROM record)")
    assert open_source(path).sha256 != first
