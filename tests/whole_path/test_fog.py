"""`gyrolock fog` as a user runs it: simulated, from logs, and on a gyro served on a serial terminal."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from instrument.simulated import SimulatedTDS2014, TcpServer
from station.cli import main
from station.runs.store import open_run

COMMAND = [sys.executable, "-m", "station.cli", "fog"]
SERVED = """
[gyro]
counts_per_code = 256.0
output_resolution = 1.0
[link]
speed = 20.0
[selfcal]
numbers = "nominal"
rates_dps = [1.0, 20.0, 60.0]
step_s = 5.0
static_s = 5.0
"""


@pytest.mark.slow
def test_a_table_run_in_one_command(gyrolock, tmp_path: Path) -> None:
    done = gyrolock("fog", "table", "--seed", 3, "--json")
    assert done.code == 0, done.err
    result = done.document
    assert [axis["axis"] for axis in result["axes"]] == ["X", "Y", "Z"]
    for axis in result["axes"]:
        off = axis["scale_factor_counts_per_dps"] - result["truth"]["scale_factor_counts_per_dps"]
        assert abs(off) < 4 * axis["scale_factor_u_counts_per_dps"]
    assert (tmp_path / result["run"]).is_file()
    assert (tmp_path / result["report"]).is_file()
    assert "seconds of output 13290/13290" in done.err
    again = gyrolock("fog", "table", result["run"], "--json", "--no-report")
    assert again.code == 0
    assert again.document["axes"] == result["axes"]


@pytest.mark.slow
def test_a_self_calibration_says_what_it_cannot_see(gyrolock, tmp_path: Path) -> None:
    table = gyrolock("fog", "table", "--json", "--no-report").document["run"]
    (tmp_path / "warm.toml").write_text("[simulation]\nscale_change_ppm = 500.0\n")
    done = gyrolock("fog", "selfcal", "--table", table, "--config", "warm.toml", "--no-report", "--full")
    assert done.code == 0, done.err
    assert "returns the mapping of numbers to rates that it was given" in " ".join(done.out.split())
    assert "blind to L·D/λ" in done.out
    assert "K_self" in done.out
    run = next(path for path in (tmp_path / "runs").iterdir() if path.name not in table)
    found = json.loads(gyrolock("fog", "selfcal", run, "--json", "--no-report").out)
    # the coil has changed by 500 ppm since the table run: K_self does not know
    assert abs(found["self_minus_table_ppm"]) < 4 * found["self_minus_table_u_ppm"]
    assert found["table_source"].startswith("rate-table run")
    refused = gyrolock("fog", "selfcal", run, "--table", table, "--no-report")
    assert refused.code == 2 and "--table belongs to a new run" in refused.err


@pytest.mark.slow
def test_limits_decide_the_exit_code(gyrolock, tmp_path: Path) -> None:
    text = "[simulation]\ntwo_pi_error = 0.002\n[eps]\nrecord_s = 0.5\n[limits]\ntwo_pi_error_ppm = 1000\n"
    (tmp_path / "eps.toml").write_text(text)
    failed = gyrolock("fog", "eps", "--config", "eps.toml", "--json", "--no-report")
    assert failed.code == 1
    assert failed.document["verdict"] == "FAIL"
    (limit,) = failed.document["limits"]
    assert limit["value"] == pytest.approx(2000, abs=20)
    (tmp_path / "wide.toml").write_text("[limits]\ntwo_pi_error_ppm = 3000\n")
    passed = gyrolock("fog", "eps", failed.document["run"], "--config", "wide.toml", "--no-report")
    assert passed.code == 0
    assert "PASS two pi error: " in passed.out
    assert gyrolock("fog", "eps", failed.document["run"], "--no-report").code == 1


def test_a_limit_that_another_test_gives_is_said_once(gyrolock, tmp_path: Path) -> None:
    text = "[eps]\nrecord_s = 0.2\n[limits]\ntwo_pi_error_ppm = 1000\nscatter_ppm = 5\nasymmetry_ppm = 9\n"
    (tmp_path / "eps.toml").write_text(text)
    done = gyrolock("fog", "eps", "--config", "eps.toml", "--json", "--no-report")
    assert done.code == 0
    assert [one["name"] for one in done.document["limits"]] == ["two_pi_error_ppm"]
    (said,) = [line for line in done.err.splitlines() if "not tested" in line]
    assert said == (
        "gyrolock: limits.scatter_ppm, limits.asymmetry_ppm are not tested by `gyrolock fog eps`, "
        "which gives two_pi_error_ppm"
    )


def test_what_the_operator_says_stands_in_json_and_report(gyrolock, tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text("[eps]\nrecord_s = 0.2\n")
    labels = ("--unit", "FG-7 <b>", "--operator", "M. Weber", "--note", "after the repair")
    done = gyrolock("fog", "eps", "--config", "short.toml", *labels, "--json")
    assert done.code == 0, done.err
    found = done.document
    assert (found["unit"], found["operator"], found["note"]) == ("FG-7 <b>", "M. Weber", "after the repair")
    page = (tmp_path / found["report"]).read_text(encoding="utf-8")
    for text in ("FG-7 &lt;b&gt;", "M. Weber", "after the repair"):
        assert text in page
    again = gyrolock("fog", "eps", found["run"], "--no-report")
    assert "FG-7 <b>" in again.out


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (("table", "--config", "no.toml"), 2, "no.toml: cannot be read"),
        (("table", "--config", "bad.toml"), 2, "table.turns (line 2): input should be greater than"),
        (("table", "nowhere"), 2, "nowhere"),
        (("table", "--port", "/dev/does-not-exist"), 3, "/dev/does-not-exist"),
        (("selfcal", "--port", "/dev/does-not-exist"), 2, "--table RUN"),
        (("table", "--resume", "nowhere"), 2, "nowhere: there is no such file"),
        (("table", "--resume", "a", "--seed", "3"), 2, "a: there is no such file"),
        (("table", "--port", "x", "--seed", "3"), 2, "--seed belongs to a simulated bench"),
        (("table", "--resume", "a", "list.csv"), 2, "--resume goes on with a run"),
        (("table", "list.csv", "--port", "x"), 2, "saved records and --port exclude each other"),
        (("selfcal", "--resume", "a", "--table", "b"), 2, "--table belongs to a new run"),
        (("sniff", "."), 2, "is a folder"),
        (("eps", "list.csv"), 2, "has no column step_codes"),
        (("table", "list.csv"), 2, "log.csv"),
        (("witness", "nowhere.csv"), 2, "nowhere.csv"),
        (("witness", "list.csv"), 2, "is not a waveform file"),
        (("witness", "list.csv", "--channel", "CH2"), 2, "saved records and --channel exclude each other"),
        (("witness", "--port", "/dev/ttyUSB7"), 2, "witness.resource no oscilloscope"),
        (("witness", "--resource", "TCPIP::127.0.0.1::1::SOCKET"), 3, "TCPIP::127.0.0.1::1::SOCKET"),
        (("witness", "--resource", "x", "--seed", "3"), 2, "--seed belongs to a simulated bench"),
    ],
)
def test_mistakes_are_one_line(
    tmp_path: Path, monkeypatch, capsys, arguments: tuple[str, ...], code: int, text: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.toml").write_text("[table]\nturns = 0\n")
    (tmp_path / "list.csv").write_text("file,rate_dps\nlog.csv,20\n")
    assert main(["fog", *arguments, "--json"]) == code
    said = capsys.readouterr()
    assert json.loads(said.out)["error"]["exit_code"] == code
    assert text in said.err
    assert len([line for line in said.err.splitlines() if line.startswith("gyrolock:")]) == 1
    assert "Traceback" not in said.err
    assert not (tmp_path / "runs").exists()


def test_points_left_out_are_one_line_each(gyrolock, tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text('[table]\nwindow_s = 540.0\naxes = ["Z"]\n')
    done = gyrolock("fog", "table", "--config", "my.toml", "--json", "--no-report")
    assert done.code == 0
    lines = [line for line in done.err.splitlines() if "is left out" in line]
    assert len(lines) == 6 == len(done.document["left_out"])
    assert "not a whole number: use 30 turns = 539.730 s or 31 turns = 557.721 s" in done.err


@pytest.mark.parametrize(
    "name", ["table", "selfcal", "eps", "figures", "threshold", "temperature", "witness", "settings", "serve"]
)
def test_every_subcommand_has_help_json_and_config(name: str, capsys) -> None:
    assert main(["fog", name, "--help"]) == 0
    text = capsys.readouterr().out
    assert "--json" in text
    assert "--config" in text


def test_settings_as_they_would_be_used(capsys, tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text("[witness]\nhalf_wave_v = 3.7\n")
    assert main(["fog", "settings", "--config", str(tmp_path / "my.toml"), "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["witness"]["half_wave_v"] == 3.7
    assert values["eps"]["steps_codes"] == [2001.0, 5001.0]


ISF_NAMES = "BYT_NR BIT_NR ENCDG BN_FMT BYT_OR NR_PT WFID PT_FMT XINCR PT_OFF XZERO XUNIT YMULT YZERO YOFF YUNIT"


@pytest.mark.slow
def test_the_witness_in_one_command_and_again_from_its_files(gyrolock, tmp_path: Path) -> None:
    (tmp_path / "modulator.toml").write_text("[simulation]\ntwo_pi_error = 0.05\n")
    done = gyrolock("fog", "witness", "--config", "modulator.toml", "--records", 3, "--json")
    assert done.code == 0, done.err
    found, truth = done.document, done.document["truth"]
    off = found["two_pi_voltage_v"] - truth["two_pi_voltage_v"]
    assert abs(off) < 4 * found["two_pi_voltage_u_without_gain_v"] < 0.02
    assert found["two_pi_error"] == pytest.approx(0.05, abs=2e-3)
    assert found["half_wave_v"] == 4.0
    assert "records 3/3" in done.err
    page = (tmp_path / found["report"]).read_text(encoding="utf-8")
    assert page.count("<svg") == 2
    assert "neither" not in page

    limits = "[limits]\nwitness_two_pi_error_ppm = 20000\n[witness]\ngain_u = 0.001\nhalf_wave_v = 4.0\n"
    (tmp_path / "limits.toml").write_text(limits)
    judged = gyrolock("fog", "witness", found["run"], "--config", "limits.toml", "--no-report")
    assert judged.code == 1
    assert "FAIL witness two pi error: 5" in judged.out
    for number, saved in enumerate(open_run(tmp_path / found["run"]).records):
        pairs = zip(ISF_NAMES.split(), saved.preamble.split(";"), strict=True)
        head = ";".join(f"{name} {value}" for name, value in pairs)
        curve = saved.codes.tobytes()
        (tmp_path / f"{number}.isf").write_bytes(f":WFMPRE:{head};:CURVE #4{len(curve)}".encode() + curve)
    again = gyrolock("fog", "witness", "0.isf", "1.isf", "2.isf", "--config", "limits.toml", "--json")
    assert again.code == 1
    assert again.document["two_pi_voltage_v"] == pytest.approx(found["two_pi_voltage_v"], rel=1e-12)
    assert [one["name"] for one in again.document["records"]] == ["0.isf", "1.isf", "2.isf"]
    assert "truth" not in again.document


@pytest.mark.slow
def test_the_witness_on_a_scope_that_somebody_else_serves(gyrolock, tmp_path: Path) -> None:
    def staircase(times):
        # a converter of 12 bits that spans 5.5 V, 331 codes down every 2.4 us, and nothing of the program in it
        return np.mod(-331 * np.floor(np.asarray(times) / 2.4e-6), 4096) * 5.5 / 4096

    coil = "[gyro]\ndac_bits = 12\ncoil_length_m = 490.0\n[witness]\nhalf_wave_v = 2.5\n"
    (tmp_path / "mine.toml").write_text(coil)
    server = TcpServer(SimulatedTDS2014({4: staircase}, seed=4))
    try:
        arguments = ("--resource", server.resource_name, "--channel", "ch4", "--records", 2)
        done = gyrolock("fog", "witness", *arguments, "--config", "mine.toml", "--json")
    finally:
        server.close()
    assert done.code == 0, done.err
    found = done.document
    assert found["two_pi_voltage_v"] == pytest.approx(5.5, abs=4 * found["two_pi_voltage_u_without_gain_v"])
    assert found["two_pi_error"] == pytest.approx(0.1, abs=2e-3)
    assert found["two_pi_error_u"] == pytest.approx(1.1 * 0.0173, rel=0.02)
    assert found["step_height_v"] == pytest.approx(-331 * 5.5 / 4096, rel=2e-3)
    assert found["step_time_s"] == pytest.approx(2.4e-6, abs=4 * found["step_time_u_s"])
    assert found["step_codes"] == pytest.approx(-331, abs=4 * found["step_u_codes"])
    assert found["bias_height_v"] == 0
    assert not found["simulated"]


@pytest.mark.skipif(os.name != "posix", reason="serial terminals of this kind are POSIX")
@pytest.mark.slow
def test_open_loop_over_a_serial_line_with_a_format_that_comes_along(gyrolock, served, tmp_path: Path) -> None:
    port = served('[link]\nspeed = 20.0\nframe_format = "binary_open_loop"\n[simulation]\ntwo_pi_error = 0.001\n')
    done = gyrolock("fog", "eps", "--port", port, "--config", "served.toml", "--json", "--no-report")
    assert done.code == 0, done.err
    assert done.document["two_pi_error_ppm"] == pytest.approx(1000, abs=5 * done.document["two_pi_error_u_ppm"])
    assert done.document["two_pi_error_u_ppm"] < 3
    assert done.document["left_out"] == []


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Callable[..., str]]:
    """A simulated gyro in a process of its own, on a serial terminal."""
    started: list[subprocess.Popen[str]] = []

    def serve(settings: str = SERVED) -> str:
        (tmp_path / "served.toml").write_text(settings)
        process = subprocess.Popen(
            [*COMMAND, "serve", "--config", "served.toml", "--speed", "20"],
            cwd=tmp_path, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        started.append(process)
        assert process.stdout is not None
        return process.stdout.readline().strip()

    yield serve
    for process in started:
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=20) == 0
        assert process.stdout is not None
        process.stdout.close()


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="serial terminals of this kind are POSIX")
@pytest.mark.parametrize("kill", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_killed_process_loses_nothing_and_goes_on(gyrolock, served, tmp_path: Path, kill: bool) -> None:
    port = served()
    process = subprocess.Popen(
        [*COMMAND, "selfcal", "--port", port, "--config", "served.toml", "--no-report"],
        cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    run = _wait_for_segments(tmp_path, 3)
    process.send_signal(signal.SIGKILL if kill else signal.SIGINT)
    _, error = process.communicate(timeout=20)
    assert process.returncode == (-signal.SIGKILL if kill else 130)
    if not kill:
        assert "--resume" in error
        assert "Traceback" not in error
    there = open_run(run).records
    assert len(there) >= 3
    done = gyrolock("fog", "selfcal", "--resume", run.parent, "--json", "--no-report")
    assert done.code == 0, done.err
    after = open_run(run)
    assert [(s.key, s.taken_at) for s in after.records[: len(there)]] == [(s.key, s.taken_at) for s in there]
    assert len(after.records) == 8
    assert abs(done.document["self_minus_numbers_ppm"]) < 5 * done.document["self_minus_numbers_u_ppm"] < 20
    assert done.document["left_out"] == []


def _wait_for_segments(folder: Path, count: int) -> Path:
    deadline = time.monotonic() + 40
    while time.monotonic() < deadline:
        for file in folder.glob("runs/*/run.sqlite"):
            with closing(sqlite3.connect(f"file:{file}?mode=ro", uri=True)) as db, db:
                (there,) = db.execute("SELECT count(*) FROM record").fetchone()
            db.close()
            if there >= count:
                return file
        time.sleep(0.05)
    raise AssertionError(f"there were no {count} segments in time")


def test_columns_and_units_of_logs_are_named_on_the_command_line(gyrolock, tmp_path: Path) -> None:
    rows = ["file,axis,rate_dps"]
    for rate in (40.0, -40.0):
        words = "".join(f"{n / 10},{3600 * rate + 10.78 + n % 2}\n" for n in range(200))
        (tmp_path / f"{rate}.csv").write_text(f"when,what\n{words}")
        rows.append(f"{rate}.csv,Z,{rate}")
    path = tmp_path / "list.csv"
    path.write_text("\n".join(rows))
    common = ("fog", "table", path, "--no-report", "--json", "--out", tmp_path)
    done = gyrolock(*common)
    assert done.code == 2
    assert "the columns are when, what; name them" in done.document["error"]["message"]
    chosen = ("--columns", "time,counts", "--units", "deg/h")
    done = gyrolock(*common, *chosen)
    assert done.code == 0
    assert abs(done.document["axes"][0]["nominal_difference_ppm"]) < 5
    done = gyrolock("fog", "table", "--json", *chosen)
    assert done.code == 2
    assert "--columns says how files are read" in done.document["error"]["message"]
    done = gyrolock("fog", "allan", tmp_path / "40.0.csv", "--json", "--no-report", "--out", tmp_path, *chosen)
    assert (done.code, "at least 512" in done.document["error"]["message"]) == (4, True)
