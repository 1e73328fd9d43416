"""`gyrolock analyze` and `gyrolock report` on saved runs and on files of real scopes."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from station.runs.store import SavedRecord, open_run
from tests.ideal_bench import ideal_bench

TEK_FILES = Path(__file__).resolve().parents[3] / "shared" / "data" / "tek-files"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from station.live.events import Progress
    from station.lock_in.measurement import MEASUREMENT
    from station.lock_in.settings import load_settings
    from station.shell.finish import start_run

    folder = tmp_path_factory.mktemp("analyze")
    overrides = ideal_bench(measurement={"records": 5}, output={"directory": str(folder)})
    return start_run(MEASUREMENT, load_settings(overrides=overrides), Progress()).path


@pytest.mark.slow
def test_every_relation_and_reference(gyrolock, run: Path) -> None:
    exact = gyrolock("analyze", run, "--json").document
    high = gyrolock("analyze", run, "--relation", "paper-10", "--input-rate", exact["input_rate_dps"], "--json")
    low = gyrolock("analyze", run, "--relation", "paper-13", "--input-rate", exact["input_rate_dps"], "--json")
    # the paper's (10) and (13) are wrong by +x^2/4 and -x^2/4 to leading order
    x = 0.01 / exact["input_rate_dps"]
    given = gyrolock("analyze", run, "--input-rate", exact["input_rate_dps"], "--json").document
    assert high.document["lock_in_rate_dps"] / given["lock_in_rate_dps"] - 1 == pytest.approx(x**2 / 4, rel=0.05)
    assert low.document["lock_in_rate_dps"] / given["lock_in_rate_dps"] - 1 == pytest.approx(-(x**2) / 4, rel=0.05)
    assert "(13)" in low.document["method"]
    doubled = gyrolock("analyze", run, "--scale-factor", 4000, "--json").document
    assert doubled["lock_in_rate_dps"] == pytest.approx(exact["lock_in_rate_dps"] / 2, rel=1e-9)


def test_one_json_object_a_record(gyrolock, run: Path) -> None:
    done = gyrolock("analyze", run, "--jsonl")
    assert done.code == 0
    lines = [json.loads(line) for line in done.out.splitlines()]
    assert [line["record"] for line in lines] == ["1", "2", "3", "4", "5"]
    assert all(abs(line["lock_in_rate_dps"] - 0.01) < 6 * line["lock_in_rate_u_dps"] for line in lines)
    assert gyrolock("analyze", run, "--jsonl", "--json").code == 2


@pytest.mark.slow
def test_the_report_again(gyrolock, run: Path, tmp_path: Path) -> None:
    done = gyrolock("report", run.parent, "--output", "again.html", "--json")
    assert done.code == 0
    assert done.document["report"] == "again.html"
    assert (tmp_path / "again.html").read_text(encoding="utf-8").startswith("<!doctype html>")
    assert gyrolock("report", run).out.strip() == str(run.parent / "report.html")


def write_csv(file: Path, record: SavedRecord, point_format: str) -> None:
    """A record of the run, written the way the scope saves it on its card."""
    fields = record.preamble.split(";")
    interval, first, scale, offset = (float(fields[i]) for i in (8, 10, 12, 14))
    header = {
        "Record Length": "2.500000e+03",
        "Sample Interval": f"{interval:.6e}",
        "Trigger Point": f"{-first / interval:.12e}",
        "Source": "CH1",
        "Vertical Units": "V",
        "Vertical Scale": f"{scale * 25:.6e}",
        "Vertical Offset": f"{offset / 25 * scale * 25:.6e}",
        "Horizontal Units": "s",
        "Horizontal Scale": f"{interval * 250:.6e}",
        "Pt Fmt": point_format,
        "Yzero": "0.000000e+00",
        "Probe Atten": "1.000000e+00",
        "Model Number": "TDS2014C",
        "Serial Number": "C000000",
        "Firmware Version": "FV:v24.26",
    }
    names = [*header, *[""] * (2500 - len(header))]
    with file.open("w", newline="") as out:
        writer = csv.writer(out)
        for n, (name, code) in enumerate(zip(names, record.codes.astype(int), strict=True)):
            volts = (code - offset) * scale
            writer.writerow([name, header.get(name, ""), "", f"{first + n * interval:.12f}", f"{volts:.5f}", ""])


def test_a_csv_file_of_the_beat_gives_the_lock_in_rate(gyrolock, run: Path, tmp_path: Path) -> None:
    write_csv(tmp_path / "F0000CH1.CSV", open_run(run).taken_for("measure")[0], "Y")
    done = gyrolock("analyze", "F0000CH1.CSV", "--scale-factor", 2000, "--json")
    assert done.code == 0, done.err
    assert done.document["lock_in_rate_dps"] == pytest.approx(0.01, abs=5 * done.document["lock_in_rate_u_dps"])
    assert done.document["schema"] == {"name": "gyrolock files", "version": 2}
    first_line = done.document["harmonics"][0]
    assert first_line["amplitude_v"] == pytest.approx(0.38 * (1 - done.document["ratio"] ** 2), rel=0.01)
    assert first_line["frequency_hz"] == pytest.approx(done.document["beat_frequency_hz"], rel=1e-5)


def test_the_scale_factor_of_a_file_is_not_assumed(gyrolock, run: Path, tmp_path: Path) -> None:
    write_csv(tmp_path / "F0002CH1.CSV", open_run(run).taken_for("measure")[0], "Y")
    (tmp_path / "my.toml").write_text("[measurement]\nrecords = 3\n")
    for given in ((), ("--config", "my.toml")):
        refused = gyrolock("analyze", "F0002CH1.CSV", *given, "--json")
        assert refused.code == 2
        assert "--scale-factor" in refused.document["error"]["message"]
    (tmp_path / "my.toml").write_text("[gyro]\nscale_factor_pulses_per_deg = 1000.0\n")
    done = gyrolock("analyze", "F0002CH1.CSV", "--config", "my.toml", "--jsonl")
    (line,) = [json.loads(text) for text in done.out.splitlines()]
    assert line["scale_factor_pulses_per_deg"] == 1000
    assert line["lock_in_rate_dps"] == pytest.approx(0.02, rel=0.02)
    assert "1000 pulses/deg" in gyrolock("analyze", "F0002CH1.CSV", "--config", "my.toml").out


@pytest.mark.parametrize(
    "option", ["--input-rate=0", "--input-rate=nan", "--input-rate=inf", "--scale-factor=nan", "--scale-factor=-1"]
)
def test_numbers_that_mean_nothing(gyrolock, option: str) -> None:
    done = gyrolock("analyze", "F0000CH1.CSV", option, "--json")
    assert done.code == 2
    assert option.split("=")[0] in done.document["error"]["message"]


def test_a_peak_detect_record_is_refused(gyrolock, run: Path, tmp_path: Path) -> None:
    write_csv(tmp_path / "F0001CH1.CSV", open_run(run).taken_for("measure")[0], "ENV")
    done = gyrolock("analyze", "F0001CH1.CSV", "--scale-factor", 2000, "--json")
    assert done.code == 4
    assert "Peak Detect" in done.document["error"]["message"]
    assert done.document.get("lock_in_rate_dps") is None


@pytest.mark.skipif(not TEK_FILES.is_dir(), reason="the files of real scopes are not here")
@pytest.mark.parametrize(
    ("name", "frequency"),
    [
        ("tds2014c_cliplow_F0000CH3.CSV", None),
        ("tds1012b_cliphigh_F0001CH2.CSV", None),
        ("tds2014c_pwm_F0000CH1.CSV", 50.03),
        ("tds2mem_fft_F0000MTH.CSV", None),
        ("tds1012b_trigpos_F0000CH1.CSV", None),
        ("tds2022b_average4_F0000CH1.CSV", None),
    ],
)
def test_files_of_real_scopes_give_no_lock_in_rate(gyrolock, name: str, frequency: float | None) -> None:
    done = gyrolock("analyze", TEK_FILES / name, "--scale-factor", 2000, "--json")
    assert done.code == 4
    assert done.document["error"]["kind"] == "no_usable_signal"
    assert done.document.get("lock_in_rate_dps") is None
    if frequency is not None:
        assert done.document["beat_frequency_hz"] == pytest.approx(frequency, abs=0.05)
        amplitudes = np.array([line["amplitude_v"] for line in done.document["harmonics"]])
        assert np.all(amplitudes[1:] / amplitudes[:-1] > 0.8)
