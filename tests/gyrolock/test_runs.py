"""Runs of every kind as arrays, and the results they give: the same as on the command line."""

import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gyrolock
from station.cli import main
from station.errors import RunError, UsageError

GOLDEN = Path(__file__).parent.parent / "golden"
RING_LASER = ("single", "several", "quadrature", "channel", "turning", "acquired")
FIBRE_GYRO = ("fog_table", "fog_logs", "fog_selfcal", "fog_selfcal_by_table", "fog_eps", "fog_figures")
EVERY = (*RING_LASER, *FIBRE_GYRO, "fog_witness")


def opened(name: str) -> gyrolock.Run:
    return gyrolock.open_run(GOLDEN / f"{name}.sqlite")


def printed(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    main([*map(str, arguments), "--json"])
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    return document


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_a_result_is_what_the_command_prints(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    result = opened(name).result()
    document = printed(capsys, "analyze", GOLDEN / f"{name}.sqlite")
    assert result.document == document
    for key, value in document.items():
        if key != "run":
            assert getattr(result, key) == value
    assert str(result.run) == document["run"]
    assert result.verdict == document["verdict"]
    assert set(document) <= set(dir(result))


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_a_result_shows_itself(name: str) -> None:
    result = opened(name).result()
    line = repr(result)
    assert line.startswith(f"<Result of {result.run.command}: ")
    assert "\n" not in line
    assert f"{len(result)} records" in line
    assert result._repr_html_().startswith("<table>")
    picture = result.plot()
    assert picture._repr_png_().startswith(b"\x89PNG")
    assert len(picture.axes) == (2 if name in RING_LASER else 1)


@pytest.mark.long
@pytest.mark.parametrize("name", RING_LASER)
def test_records_of_an_oscilloscope_are_arrays(name: str) -> None:
    run = opened(name)
    rows = [json.loads(line) for line in (GOLDEN / f"{name}.jsonl").read_text().splitlines()]
    assert run.volts.shape == (len(run), 2500) == (len(rows), 2500)
    assert [record.name for record in run] == [row["record"] for row in rows]
    for record, volts in zip(run, run.volts, strict=True):
        assert record.codes.dtype == np.int8
        assert np.array_equal(record.volts, volts)
        assert record.times.shape == volts.shape
        assert record.conditions["channel"] == "CH1"
    us = np.array([row["lock_in_rate_noise_u_dps"] for row in rows])
    rates = np.array([row["lock_in_rate_dps"] for row in rows])
    assert np.all(np.abs(run.estimates.lock_in_rate - rates) < 1e-3 * us)
    assert len(run.estimates) == len(run)


@pytest.mark.parametrize("name", FIBRE_GYRO)
def test_records_of_a_fibre_gyro_are_stretches_of_output(name: str) -> None:
    run = opened(name)
    assert len(run) > 1
    for record in run:
        assert record.times.shape == record.counts.shape == (len(record),)
        assert record.recording.interval_s > 0
    with pytest.raises(UsageError, match="stretch of a fibre gyro's output"):
        _ = run.volts
    with pytest.raises(UsageError, match=r"gyrolock fog .*give no lock-in rate each"):
        _ = run.estimates


def test_what_is_known_of_a_run() -> None:
    run = opened("single")
    assert run.command == "gyrolock measure"
    assert run.settings["gyro"]["scale_factor_pulses_per_deg"] == 2000
    assert run.outcome == "complete"
    assert Path(run) == GOLDEN / "single.sqlite"
    assert gyrolock.open_run(run).path == run.path
    assert repr(run) == f"<Run of gyrolock measure: 6 records, complete, {run.path}>"
    assert "simulated ring laser" in run._repr_html_()


def test_other_records_of_a_run_by_their_purpose() -> None:
    run = opened("quadrature")
    assert run.purposes == ("tilt", "measure", "quadrature")
    assert len(run.taken_for("tilt")) == 4
    assert [record.conditions["channel"] for record in run.taken_for("quadrature")] == ["CH2"] * 3
    assert len(opened("fog_selfcal").taken_for("table")) == 6


def test_the_choices_of_analyze() -> None:
    then = json.loads((GOLDEN / "single.paper13.json").read_text())
    result = opened("single").result(relation="paper-13")
    assert result.lock_in_rate_dps == pytest.approx(then["lock_in_rate_dps"], rel=1e-6)
    with pytest.raises(UsageError, match="--relation means nothing"):
        opened("fog_eps").result(relation="paper-13")


def test_limits_from_a_settings_file(tmp_path: Path) -> None:
    (tmp_path / "limits.toml").write_text("[limits]\nlock_in_rate_dps = 0.001\n")
    result = opened("single").result(tmp_path / "limits.toml")
    assert result.verdict == "FAIL"
    assert repr(result).endswith("6 records, FAIL>")
    assert "lock_in_rate_dps is beyond its limit" in result._repr_html_()


@pytest.mark.long
def test_a_record_is_chosen_by_place_or_by_name() -> None:
    result = opened("several").result()
    assert result.plot(2).get_suptitle() == result.plot("3").get_suptitle() == "gyrolock measure: record 3"
    with pytest.raises(UsageError, match="there is no record '99'"):
        result.plot("99")


def test_a_key_that_is_not_there_is_named() -> None:
    with pytest.raises(AttributeError, match="has no 'lock_in_rate'; did you mean 'lock_in_rate_dps'"):
        _ = opened("single").result().lock_in_rate


def test_a_damaged_record_is_left_out_and_named(tmp_path: Path) -> None:
    path = Path(shutil.copy(GOLDEN / "single.sqlite", tmp_path))
    with closing(sqlite3.connect(path)) as db, db:
        db.execute("UPDATE record SET codes = zeroblob(2500) WHERE number = (SELECT max(number) FROM record)")
    run = gyrolock.open_run(path)
    assert run.damaged == ("6",)
    assert len(run) == len(run.volts) == len(run.estimates) == 5
    assert "5 records, 1 damaged" in repr(run)
    assert run.result().records_rejected == 1


def test_a_run_without_records() -> None:
    run = opened("locked")
    assert len(run) == 0
    assert run.volts.shape == (0, 0)
    with pytest.raises(RunError, match="no record at the slow rate"):
        run.result()


def test_no_run(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="holds no run"):
        gyrolock.open_run(tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("name", ["single", "several"])
def test_the_number_that_lists_show_is_the_results_own(name: str) -> None:
    result = gyrolock.open_run(GOLDEN / f"{name}.sqlite").result()
    assert (result.value, result.u) == (result.lock_in_rate_dps, result.lock_in_rate_u_dps)
    assert result.interval == (result.lock_in_rate_low_95_dps, result.lock_in_rate_high_95_dps)
    assert result.interval[0] < result.value < result.interval[1]


def test_records_are_left_out_as_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As if they had never been taken: against a copy of the run without them."""
    whole = gyrolock.open_run(GOLDEN / "single.sqlite")
    without = tmp_path / "run.sqlite"
    without.write_bytes((GOLDEN / "single.sqlite").read_bytes())
    with closing(sqlite3.connect(without)) as db, db:
        out = [number for (number,) in db.execute("SELECT number FROM record WHERE purpose = 'measure'")][1:3]
        db.execute(f"DELETE FROM record WHERE number IN ({out[0]}, {out[1]})")
    assert main(["analyze", str(GOLDEN / "single.sqlite"), "--exclude", f"{out[0]}-{out[1]}", "--json"]) == 0
    captured = capsys.readouterr()
    found, then = json.loads(captured.out), gyrolock.open_run(without).result().document
    assert "2 of" in captured.err and "left out as asked" in captured.err
    assert found["records"] == then["records"] == whole.result().records - 2
    assert found["lock_in_rate_dps"] == then["lock_in_rate_dps"] != whole.result().lock_in_rate_dps


def test_records_of_what_is_not_one_run_are_not_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder of two runs, a file of an oscilloscope: there a number of a record means nothing."""
    runs, card = tmp_path / "runs", tmp_path / "card"
    for name in ("a", "b"):
        (runs / name).mkdir(parents=True)
        shutil.copy(GOLDEN / "single.sqlite", runs / name / "run.sqlite")
    assert main(["export", str(GOLDEN / "single.sqlite"), "--tek-csv", str(card)]) == 0
    (file, *_) = sorted(card.rglob("*.CSV"))
    for given in (
        [runs],
        [file, "--scale-factor", "2000"],
        [runs / "a", "--combine"],
        [runs / "a", "--to", "x.csv"],
    ):
        capsys.readouterr()
        assert main(["analyze", *map(str, given), "--exclude", "2"]) == 2
        assert "--exclude is for one run" in capsys.readouterr().err


@pytest.mark.parametrize("given", ["a", "5-", "-", "1-2-3", "999", ""])
def test_records_that_cannot_be_meant_are_refused(given: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyze", str(GOLDEN / "single.sqlite"), "--exclude", given]) == 2
    assert "exclude" in capsys.readouterr().err


def test_a_frame_has_times_and_not_texts(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas", reason="the extra `data` is not installed")
    run = gyrolock.open_run(shutil.copy(GOLDEN / "single.sqlite", tmp_path / "run.sqlite"))
    taken = run.to_dataframe()["taken_at"]
    assert isinstance(taken.dtype, pandas.DatetimeTZDtype)
    assert [one.isoformat(timespec="milliseconds") for one in taken] == [
        record.taken_at.replace("Z", "+00:00") for record in run
    ]
