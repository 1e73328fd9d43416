"""Results tables of every kind: the same rows, filled with what they lack, by one writer at a time."""

import json
import math
import shutil
import sqlite3
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from station.cli import main
from station.errors import CannotWrite, RunError, UsageError
from station.live.events import Progress
from station.lock_in.quantities import QUANTITIES
from station.reanalysis import parquet_table  # its schema holds the version: not first imported in a changed one
from station.reanalysis.analyze_table import KINDS, Filled, fill_table, table_file
from station.reanalysis.compare import compare, read_records, with_headlines
from station.reanalysis.table_file import ORDER, only_writer
from station.results.verdict import budgeted_values
from station.runs.store import NewRecord, RunWriter, open_run
from station.sources.find import find_sources
from station.sources.workers import Processes, ThisProcess
from tests.golden_outputs.differences import differences

GOLDEN = Path(__file__).parents[2] / "golden"
QUIET = Progress()
NUMBERS = ("lock_in_rate_dps", "lock_in_rate_noise_u_dps", "beat_frequency_hz", "beat_frequency_u_hz")


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of three kinds in a folder."""
    folder = tmp_path_factory.mktemp("runs")
    for name in ("single", "several", "channel"):
        shutil.copy(GOLDEN / f"{name}.sqlite", folder / f"{name}.sqlite")
    return folder


def filled(table: Path, *places: Path, processes: int = 1, **choices: object) -> Filled:
    with Processes(processes) as workers:
        return fill_table(find_sources(places), table, choices, workers, QUIET)


@pytest.mark.parametrize("ending", KINDS)
def test_rows_are_the_records_of_the_runs_and_come_back(ending: str, tree: Path, tmp_path: Path) -> None:
    table = tmp_path / f"results{ending}"
    done = filled(table, tree)
    rows = list(table_file(table).rows())
    expected = [json.loads(line) for name in ("channel", "several", "single") for line in _golden(name)]
    assert (done.sources, done.records, len(rows)) == (3, len(expected), len(expected))
    assert set(rows[0]) == set(ORDER)
    for row, one in zip(rows, expected, strict=True):
        assert differences({name: one[name] for name in NUMBERS}, row) == []
        assert (row["flags"] or "") == " ".join(one["flags"])
        assert row["schema_version"] == 1
    again = filled(table, tree)
    assert (again.records, again.known) == (0, 3)
    assert list(table_file(table).rows()) == rows


def _golden(name: str) -> list[str]:
    return (GOLDEN / f"{name}.jsonl").read_text().splitlines()


def test_only_what_is_new_or_has_changed_is_computed(tree: Path, tmp_path: Path) -> None:
    runs, table = tmp_path / "runs", tmp_path / "results.sqlite"
    runs.mkdir()
    shutil.copy(tree / "single.sqlite", runs)
    filled(table, runs)
    shutil.copy(tree / "channel.sqlite", runs)
    assert (done := filled(table, runs)).sources == 1
    assert done.known == 1
    shutil.copy(tree / "several.sqlite", runs / "single.sqlite")  # another run under its name
    done = filled(table, runs)
    assert (done.sources, done.known) == (1, 1)
    rows = list(table_file(table).rows())
    assert len(rows) == len(_golden("several")) + len(_golden("channel"))
    assert filled(table, runs, relation="paper-13").sources == 2  # another method: both stay
    assert len(list(table_file(table).rows())) == 2 * len(rows)


def test_the_same_bits_by_any_number_of_processes(
    tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("station.reanalysis.analyze_table.TOGETHER", 1)  # every source by itself
    filled(tmp_path / "two.jsonl", tree, processes=2)
    monkeypatch.undo()
    filled(tmp_path / "one.jsonl", tree)
    assert (tmp_path / "one.jsonl").read_bytes() == (tmp_path / "two.jsonl").read_bytes()


def test_parts_of_a_large_run_make_the_same_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run of 1100 records, cut at its thousandth."""
    old = open_run(GOLDEN / "single.sqlite")
    record = old.taken_for("measure")[0]
    new = [NewRecord(f"{n}", "measure", record.header, record.payload, record.conditions) for n in range(1100)]
    with RunWriter.create(tmp_path / "runs", {"command": "measure", "settings": old.facts.settings}) as writer:
        writer.save_records(new)
    whole = filled(tmp_path / "whole.csv", tmp_path / "runs")
    monkeypatch.setattr("station.reanalysis.analyze_table.LARGE", 1)
    cut = filled(tmp_path / "cut.csv", tmp_path / "runs")
    assert whole.records == cut.records == 1100
    assert (tmp_path / "whole.csv").read_bytes() == (tmp_path / "cut.csv").read_bytes()
    assert filled(tmp_path / "cut.csv", tmp_path / "runs").known == 1


def test_what_cannot_be_read_is_named_and_left_out(tree: Path, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    shutil.copytree(tree, runs)
    with sqlite3.connect(runs / "single.sqlite") as db:
        db.execute("UPDATE record SET codes = zeroblob(2500) WHERE number = (SELECT max(number) FROM record)")
    (runs / "cut.sqlite").write_bytes((runs / "several.sqlite").read_bytes()[:30_000])
    (runs / "F0000CH1.CSV").write_text("no waveform\n")
    done = filled(tmp_path / "results.csv", runs)
    assert done.sources == 3
    said = [str(one) for one in done.left_out]
    assert len(said) == 3
    assert any("cut.sqlite" in one for one in said)
    assert any("F0000CH1.CSV" in one for one in said)
    assert any("is damaged" in one and "single.sqlite" in one for one in said)


@pytest.mark.parametrize("ending", KINDS)
def test_two_writers_and_strangers_are_refused(ending: str, tree: Path, tmp_path: Path) -> None:
    table = tmp_path / f"results{ending}"
    with only_writer(table), pytest.raises(CannotWrite, match="another analysis is writing this table"):
        filled(table, tree)
    table.write_text("something else\n")
    with pytest.raises(RunError, match=r"results\."):
        filled(table, tree)
    assert table.read_text() == "something else\n"


@pytest.mark.slow
@pytest.mark.parametrize("ending", KINDS)
@pytest.mark.parametrize("limit", [pytest.param(0, marks=pytest.mark.slow), 5000])
def test_a_disk_that_is_full_costs_no_table(ending: str, limit: int, tree: Path, tmp_path: Path) -> None:
    """By a process of its own that may write so many bytes to a file."""
    resource = pytest.importorskip("resource", reason="limits of a process are those of POSIX")
    table = tmp_path / f"results{ending}"
    if limit:
        filled(table, tree / "single.sqlite")
    before = table.read_bytes() if limit else b""
    command = [sys.executable, "-m", "station.cli", "analyze", str(tree), "--to", str(table), "--quiet"]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    assert done.returncode == 5, done.stderr
    assert f"{table}: cannot be written" in done.stderr
    assert done.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ([table.name] if limit else [])
    assert not limit or table.read_bytes() == before


def test_a_folder_is_no_table(tree: Path, tmp_path: Path) -> None:
    (tmp_path / "results.csv").mkdir()
    with pytest.raises(UsageError, match="is a folder, not a results table"):
        filled(tmp_path / "results.csv", tree)


@pytest.mark.parametrize("ending", KINDS)
def test_a_table_of_a_newer_version_is_refused(ending: str, tree: Path, tmp_path: Path, monkeypatch) -> None:
    table = tmp_path / f"results{ending}"
    monkeypatch.setattr("station.reanalysis.table_file.VERSION", 2)
    if ending == ".parquet":
        newer = parquet_table.SCHEMA.with_metadata({"schema_name": "gyrolock results", "schema_version": "2"})
        monkeypatch.setattr(parquet_table, "SCHEMA", newer)
    filled(table, tree / "single.sqlite")
    monkeypatch.undo()
    with pytest.raises(RunError, match="was written by a newer gyrolock"):
        filled(table, tree)


@pytest.mark.parametrize("ending", KINDS)
def test_a_table_of_the_first_layout_can_be_read(ending: str) -> None:
    rows = list(table_file(GOLDEN / "results" / f"version_1{ending}").rows())
    then = [json.loads(line) for line in _golden("single")]
    assert len(rows) == len(then)
    rates = [row["lock_in_rate_dps"] for row in rows]
    np.testing.assert_allclose(rates, [one["lock_in_rate_dps"] for one in then], rtol=1e-6)


def test_another_ending_is_refused(tree: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"\.parquet, \.sqlite, \.csv, \.jsonl"):
        filled(tmp_path / "results.xlsx", tree)


def test_two_methods_are_compared_record_by_record(tree: Path, tmp_path: Path) -> None:
    table = tmp_path / "results.sqlite"
    filled(table, tree / "single.sqlite")
    first = read_records(str(table), {}, ThisProcess())
    second = read_records(str(tree / "single.sqlite"), {"relation": "paper-10"}, ThisProcess())
    found = compare(first, second)
    one = found.differences[0]
    assert found.same_records
    assert one.compared == len(_golden("single"))
    a, b = first.values["lock_in_rate_dps"], second.values["lock_in_rate_dps"]
    u = np.maximum(first.us["lock_in_rate_dps"], second.us["lock_in_rate_dps"])
    np.testing.assert_allclose(one.over_u, (b - a) / u)
    # (10) of the paper leaves out r^2: with the beat as reference 2r instead of 2r/(1 - r^2)
    assert one.difference < 0
    filled(table, tree / "single.sqlite", relation="paper-10")
    with pytest.raises(UsageError, match="several analyses"):
        read_records(str(table), {}, ThisProcess())
    chosen = read_records(str(table), {}, ThisProcess(), "paper-10")
    np.testing.assert_array_equal(chosen.values["lock_in_rate_dps"], b)


def test_two_gyros_are_compared_by_their_means(tree: Path) -> None:
    first, second = (
        read_records(str(tree / f"{name}.sqlite"), {}, ThisProcess()) for name in ("single", "channel")
    )
    found = compare(first, second)
    assert not found.same_records
    one = found.differences[0]
    assert one.difference == pytest.approx(one.mean_second - one.mean_first)
    assert one.difference_u == pytest.approx(math.hypot(one.mean_first_u, one.mean_second_u))
    assert math.isnan(one.largest_over_u)


@pytest.mark.slow
def test_runs_are_compared_by_their_results_with_every_input_counted(tree: Path) -> None:
    single, channel, several = (
        read_records(str(tree / f"{name}.sqlite"), {}, ThisProcess()) for name in ("single", "channel", "several")
    )
    found = compare(*with_headlines(single, channel, ThisProcess()))
    one, document = found.differences[0], found.document()
    results = [json.loads((GOLDEN / f"{name}.json").read_text()) for name in ("single", "channel")]
    us = [result["lock_in_rate_u_dps"] for result in results]
    assert (one.mean_first_u, one.mean_second_u) == pytest.approx(tuple(us), rel=1e-6)
    # no unit is named, and a scope of this model always says 0 for its serial number: nothing need be in both
    assert one.difference_u == pytest.approx(math.hypot(*us), rel=1e-6)
    assert document["sentences"][0].endswith("no input of a named unit or oscilloscope is in both.")
    named = []
    for side, result in zip(with_headlines(single, channel, ThisProcess()), results, strict=True):
        told = {**result, "unit": "RLG-7", "instrument": {"serial": "C010203"}}
        named.append(replace(side, headline=next(budgeted_values(told, QUANTITIES, "lock_in_rate_dps"))))
    shared = compare(*named)
    assert shared.shared == ("gain_corner", "scale_factor", "time_base")
    lines = [result["budget"]["inputs"] for result in results]
    inputs = [{line["name"]: line["contribution_dps"] for line in of_result} for of_result in lines]
    both = sum(inputs[0][name] * inputs[1][name] for name in shared.shared)
    expected = math.sqrt(us[0] ** 2 + us[1] ** 2 - 2 * both)
    assert shared.differences[0].difference_u == pytest.approx(expected, rel=1e-6)
    assert document["counted"] == "every input"
    # what noise alone says is kept apart
    assert found.by_noise is not None and found.by_noise.difference_u < one.difference_u
    assert [row.quantity for row in found.differences] == ["lock_in_rate_dps", "beat_frequency_hz", "ratio"]
    # several rates have no one beat and no one ratio
    found = compare(*with_headlines(single, several, ThisProcess()))
    assert [row.quantity for row in found.differences] == ["lock_in_rate_dps"]
    # two methods differ by what they make of the same noise
    assert with_headlines(single, single, ThisProcess())[0].headline is None


def test_a_table_is_compared_by_noise_and_says_so(tree: Path, tmp_path: Path) -> None:
    table = tmp_path / "results.sqlite"
    filled(table, tree / "single.sqlite")
    first = read_records(str(table), {}, ThisProcess())
    second = read_records(str(tree / "channel.sqlite"), {}, ThisProcess())
    found = compare(*with_headlines(first, second, ThisProcess()))
    assert found.counted == "noise and scatter"
    assert "by noise and scatter of their records alone" in found.sentences()[0]


def test_what_is_not_there_cannot_be_compared(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="nothing there: No such file"):
        read_records(str(tmp_path / "nothing there"), {}, ThisProcess())


CHANNEL = "[front_end]\nlow_pass_hz = 3000.0\n"


def test_what_is_stated_of_the_channel_counts_in_a_table_too(
    tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The rows are those of ``--jsonl``, and those of another channel stand beside them."""
    run, config, table = tree / "single.sqlite", tmp_path / "channel.toml", tmp_path / "results.csv"
    config.write_text(CHANNEL)
    filled(table, run)
    assert main(["analyze", str(run), "--to", str(table), "--config", str(config), "--quiet"]) == 0
    capsys.readouterr()
    assert main(["analyze", str(run), "--jsonl", "--config", str(config), "--quiet"]) == 0
    then = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    rows = list(table_file(table).rows())
    assert len(rows) == 2 * len(then)
    for row, plain, record in zip(rows[len(then) :], rows, then, strict=False):
        assert differences({name: record[name] for name in NUMBERS}, row) == []
        assert row["lock_in_rate_dps"] > plain["lock_in_rate_dps"]
    assert main(["analyze", str(run), "--to", str(table), "--config", str(tmp_path / "no.toml")]) == 2
    assert "no.toml" in capsys.readouterr().err


def test_a_run_under_another_spelling_of_its_path_stands_once(
    tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table, runs = tmp_path / "results.sqlite", tmp_path / "runs"
    runs.mkdir()
    shutil.copy(tree / "single.sqlite", runs)
    monkeypatch.chdir(tmp_path)
    first = filled(table, Path("runs"))
    for place in (Path("runs/../runs"), runs, Path("./runs/single.sqlite"), runs / "single.sqlite"):
        again = filled(table, place)
        assert (again.records, again.known) == (0, 1), place
    assert filled(table, Path("runs"), runs).known == 1
    shutil.copy(tree / "single.sqlite", runs / "copy.sqlite")  # the same records under another name
    assert filled(table, runs).records == 0
    assert len(list(table_file(table).rows())) == first.records


def test_nobody_is_asked_for_a_scale_factor_that_the_runs_know(
    tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, mixed = tmp_path / "limits.toml", tmp_path / "mixed"
    config.write_text("[limits]\nlock_in_rate_dps = 0.02\n")
    runs = [str(tree / f"{name}.sqlite") for name in ("single", "channel")]
    assert main(["compare", *runs, "--config", str(config)]) == 0
    shutil.copytree(tree, mixed)
    filled(mixed / "results.csv", mixed / "single.sqlite")
    assert main(["analyze", str(mixed), "--to", str(tmp_path / "all.csv"), "--quiet"]) == 2
    told = capsys.readouterr()
    assert "results.csv" in told.err and "scale factor" not in told.err
    assert "3 sources" in told.out


def test_a_measured_response_takes_few_words_in_each_row(tree: Path, tmp_path: Path) -> None:
    response = [[10.0 * number, 1.0, 0.0] for number in range(1, 400)]
    told = []
    for name, gain in (("flat", 1.0), ("lower", 0.9)):
        config = tmp_path / f"{name}.toml"
        config.write_text(f"[front_end]\nresponse = {[*response, [5000.0, gain, 0.0]]}\n")
        table = tmp_path / f"{name}.csv"
        assert main(["analyze", str(tree / "single.sqlite"), "--to", str(table), "--config", str(config)]) == 0
        told.append(next(iter(table_file(table).rows()))["analysis"])
    assert told[0] != told[1]
    assert max(map(len, told)) < 150


def test_files_beside_runs_get_the_scale_factor_that_is_stated(
    tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mixed, config = tmp_path / "mixed", tmp_path / "gyro.toml"
    config.write_text("[gyro]\nscale_factor_pulses_per_deg = 2000.0\n")
    mixed.mkdir()
    shutil.copy(tree / "single.sqlite", mixed)
    assert main(["export", str(tree / "single.sqlite"), "--tek-csv", str(mixed / "card")]) == 0
    capsys.readouterr()
    assert main(["compare", str(mixed), str(tree / "channel.sqlite"), "--config", str(config), "--json"]) == 0
    told = capsys.readouterr()
    assert "pulses per degree" not in told.err
    assert json.loads(told.out)["first"]["records"] > 6  # the run's and the card's
