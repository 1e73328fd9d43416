"""`gyrolock deadband` from the empty directory to report, verdict and resumed run, through real byte streams."""

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from station.runs.store import open_run

FEW = "[sweep]\nrates_over_lock_in = [0.4, 0.7, 0.9, 1.1, 1.3, 1.6]\n"


@pytest.mark.slow
def test_one_command_gives_band_report_and_verdict(gyrolock, tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text(FEW + "[limits]\nlock_in_rate_dps = 0.012\nbias_rate_dps = 0.001\n")
    labels = ("--unit", "RLG 7", "--operator", "M. Chen", "--note", "after baking")
    done = gyrolock("deadband", "--config", "my.toml", "--seed", 3, "--json", *labels)
    result = done.document
    # the earth rate alone is more bias than that limit allows
    assert done.code == 1, done.err
    assert (result["command"], result["simulated"], result["verdict"]) == ("deadband", True, "FAIL")
    assert {one["name"]: one["passed"] for one in result["limits"]} == {
        "lock_in_rate_dps": True,
        "bias_rate_dps": False,
    }
    assert (result["unit"], result["operator"], result["note"]) == ("RLG 7", "M. Chen", "after baking")
    assert abs(result["lock_in_rate_dps"] - 0.01) < 3 * result["lock_in_rate_u_dps"]
    assert result["records"] == 23
    page = (tmp_path / result["report"]).read_text(encoding="utf-8")
    for text in (
        "Dead band",
        "RLG 7",
        "FAIL",
        "dead band",
        "fitted hyperbola",
        "locked",
        "Truth of the simulation",
    ):
        assert text in page

    # the same run by every command that reads runs
    again = gyrolock("deadband", result["run"], "--no-report", "--json")
    assert {**again.document, "report": None} == {**result, "report": None}
    analyzed = gyrolock("analyze", result["run"], "--json")
    assert analyzed.document["dead_band_dps"] == result["dead_band_dps"]
    lines = gyrolock("analyze", result["run"], "--jsonl").out.splitlines()
    assert len(lines) == 23
    assert gyrolock("report", result["run"]).code == 0

    finished = gyrolock("deadband", "--resume", result["run"])
    assert finished.code == 2
    assert "is finished" in finished.err
    other = gyrolock("measure", "--resume", result["run"])
    assert other.code == 2
    assert "`gyrolock deadband`" in other.err


def test_its_settings_can_be_printed_and_used(gyrolock, tmp_path: Path) -> None:
    printed = gyrolock("settings", "dead_band")
    (tmp_path / "my.toml").write_text(printed.out, encoding="utf-8")
    values = gyrolock("settings", "dead_band", "--json").document
    assert values["sweep"]["steps"] == 20
    assert gyrolock("settings", "dead_band", "--config", "my.toml").document == values


def test_a_limit_that_it_does_not_know_is_a_mistake(gyrolock, tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text("[limits]\nlock_in_rate = 0.012\n")
    done = gyrolock("deadband", "--config", "my.toml")
    assert done.code == 2
    assert "lock_in_rate_dps" in done.err


def test_without_a_beat_at_the_first_rate_there_is_no_usable_signal(gyrolock, tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text("[simulation]\nlock_in_rate_dps = 0.05\n")
    done = gyrolock("deadband", "--config", "my.toml", "--json")
    assert done.code == 4
    assert done.document["error"]["kind"] == "no_usable_signal"


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
@pytest.mark.slow
@pytest.mark.parametrize("how", ["SIGINT", "SIGKILL"])
def test_a_sweep_that_is_stopped_goes_on(gyrolock, cut_gyrolock, tmp_path: Path, how: str) -> None:
    (tmp_path / "my.toml").write_text(FEW)
    ended = cut_gyrolock(how, 5, "deadband", "--config", "my.toml", "--json")
    assert ended.code == (130 if how == "SIGINT" else -getattr(signal, how))
    (path,) = (tmp_path / "runs").glob("*/run.sqlite")
    kept = [record.key for record in open_run(path).records]
    assert len(kept) == 5
    changed = gyrolock("deadband", "--resume", path, "--records", 2)
    assert changed.code == 2
    assert "sweep.records is 1 in the run, not 2" in changed.err
    done = gyrolock("deadband", "--resume", path, "--json")
    assert done.code == 0, done.err
    assert done.document["records"] == 23
    assert len(done.document["resumed_at"]) == 1
    keys = [record.key for record in open_run(path).records]
    assert keys[: len(kept)] == kept
    assert len(set(keys)) == 23


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="needs a pseudo-terminal for the operator")
def test_an_operator_leads_the_table_through_the_sweep(tmp_path: Path) -> None:
    """The operator of this test turns the simulated table by what the prompts say, a little off."""
    from instrument.simulated import VirtualClock
    from station.dead_band.take import DEAD_BAND
    from station.ring_laser.instruments import build_instruments
    from station.scope.tools import serve
    from station.settings import load

    instruments = build_instruments(load(DEAD_BAND), VirtualClock())
    with serve(instruments.scope, "tcp") as resource:
        (tmp_path / "my.toml").write_text(f'[scope]\nresource = "{resource}"\n[table]\nsettle_s = 0\n{FEW}')
        terminal, keyboard = os.openpty()
        command = [sys.executable, "-m", "station.cli", "deadband", "--config", "my.toml", "--no-report"]
        with subprocess.Popen(
            command, cwd=tmp_path, stdin=keyboard, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        ) as process:
            assert process.stderr is not None
            asked, said = [], ""
            deadline = time.monotonic() + 60
            while process.poll() is None and time.monotonic() < deadline:
                if not select.select([process.stderr], [], [], 0.2)[0]:
                    continue
                said += os.read(process.stderr.fileno(), 4096).decode()
                if "Press Enter" in said:
                    asked.append(float(said.split("rate table to ")[1].split(" deg/s")[0]))
                    said = ""
                    instruments.table.set_rate(asked[-1] + 1e-4)
                    os.write(terminal, f"{asked[-1] + 1e-4:.6f}\n".encode())
            process.kill()
            process.communicate()
        os.close(terminal)
        os.close(keyboard)
    # once for the trial records, then the sweep
    assert asked[:3] == [-0.016, -0.016, -0.013]
    assert len(asked) == 24
    (path,) = (tmp_path / "runs").glob("*/run.sqlite")
    run = open_run(path)
    assert run.facts.complete, said
    assert not run.facts.simulated and run.facts.truth is None
    assert run.records[0].conditions["table_rate_dps"] == pytest.approx(-0.0159)
    assert run.results is not None
    assert abs(run.results["lock_in_rate_dps"] - 0.01) < 3 * run.results["lock_in_rate_u_dps"]
    assert run.results["hyperbola"]["bias_rate_dps"] == pytest.approx(-0.001974, abs=5e-5)
