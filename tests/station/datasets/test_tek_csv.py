"""Records written as the oscilloscope writes them, and read again."""

from pathlib import Path

import numpy as np
import pytest

import gyrolock
from station.cli import main
from station.runs.store import open_run

from .conftest import GOLDEN

GYRO = GOLDEN / "turning.sqlite"


def test_codes_time_base_and_scale_factor_come_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(GOLDEN / "single.sqlite"), "--tek-csv", str(tmp_path / "out")]) == 0
    assert "10 records of 1 sources" in capsys.readouterr().out
    run = gyrolock.open_run(GOLDEN / "single.sqlite")
    for purpose, records in (("measure", run.records), ("tilt", run.taken_for("tilt"))):
        again = gyrolock.read(tmp_path / "out" / purpose, scale_factor=2000)
        assert np.array_equal([one.codes for one in again], [one.codes for one in records])
        for new, old in zip(again, records, strict=True):
            assert np.allclose(new.times, old.times, rtol=0, atol=1e-12)
            assert np.allclose(new.volts, old.volts, rtol=0, atol=1e-9)
    names = sorted(path.relative_to(tmp_path / "out").as_posix() for path in tmp_path.rglob("*.CSV"))
    assert names[0] == "measure/ALL0000/F0000CH1.CSV"
    assert names[-1] == "tilt/ALL0003/F0003CH1.CSV"
    assert (tmp_path / "out" / "measure" / "gyrolock.toml").read_text().endswith("per_deg = 2000.0\n")


def test_the_same_estimates_and_the_same_bytes_a_second_time(tmp_path: Path) -> None:
    assert main(["export", str(GYRO), "--tek-csv", str(tmp_path / "one")]) == 0
    run, read = gyrolock.open_run(GYRO), gyrolock.read(tmp_path / "one", scale_factor=2000)
    assert read.estimates.lock_in_rate.tolist() == run.estimates.lock_in_rate.tolist()
    assert main(["export", str(tmp_path / "one"), "--tek-csv", str(tmp_path / "two")]) == 0
    for path in sorted((tmp_path / "one").rglob("*.CSV")):
        first = path.read_bytes().splitlines()
        second = (tmp_path / "two" / path.relative_to(tmp_path / "one")).read_bytes().splitlines()
        assert [
            a for a, b in zip(first, second, strict=True) if a != b and not a.startswith((b"Probe", b"Firm"))
        ] == []


def test_two_channels_and_several_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = [str(GOLDEN / f"{name}.sqlite") for name in ("quadrature", "turning", "fog_eps")]
    assert main(["export", *runs, "--tek-csv", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.count("is the output of a fibre gyro, not a record of an oscilloscope") == 4
    pair = tmp_path / "quadrature" / "measure" / "ALL0001"
    assert sorted(path.name for path in pair.iterdir()) == ["F0001CH1.CSV", "F0001CH2.CSV"]
    saved = open_run(GOLDEN / "quadrature.sqlite")
    second = saved.taken_for("quadrature")[1]
    assert np.array_equal(gyrolock.read_waveform(pair / "F0001CH2.CSV").codes, second.codes)
    assert (tmp_path / "turning" / "ALL0002" / "F0002CH1.CSV").is_file()


def test_what_cannot_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    assert main(["export", str(GYRO), "--tek-csv", str(tmp_path)]) == 2
    assert "holds files already" in capsys.readouterr().err
    assert main(["export", str(GYRO)]) == 2
    assert main(["export", str(GYRO), "--to", "x.csv", "--tek-csv", "y"]) == 2
    assert main(["export", str(GOLDEN / "fog_eps.sqlite"), "--tek-csv", str(tmp_path / "none")]) == 2
    assert "there is no record of an oscilloscope" in capsys.readouterr().err
