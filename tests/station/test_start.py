"""``gyrolock start``: an operator at a terminal, a scope on a real byte stream."""

import json
import os
import select
import subprocess
import sys
import time
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from analysis import beat_signal
from instrument.simulated import SimulatedTDS2014
from station.scope.tools import serve

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs a pseudo-terminal for the operator")


def beat(times: np.ndarray) -> np.ndarray:
    """Of a gyro with 0.01 deg/s at 0.08 deg/s, with K = 2000: 158.7 Hz."""
    return 0.2 * beat_signal(times, scale_factor=2000.0, input_rate=0.08, lock_in_rate=0.01)


def led(folder: Path, answers: Sequence[str], *options: str, signals: dict) -> tuple[int, str]:  # type: ignore[type-arg]
    """What `gyrolock start` says to these answers, and its exit code; the scope's time passes as it is asked."""
    with serve(SimulatedTDS2014(signals, noise_levels=1.0, seed=3), "tcp") as resource:
        terminal, keyboard = os.openpty()
        command = [sys.executable, "-m", "station.cli", "start", "--resource", resource, *options]
        with subprocess.Popen(command, cwd=folder, stdin=keyboard, stdout=-1, stderr=-2, bufsize=0) as process:
            assert process.stdout is not None
            said, left, seen = "", list(answers), 0
            deadline = time.monotonic() + 200
            while time.monotonic() < deadline:
                if not select.select([process.stdout], [], [], 0.2)[0]:
                    continue
                more = os.read(process.stdout.fileno(), 4096).decode()
                if not more:
                    break
                said += more
                if left and said[seen:].endswith(("]: ", "data sheet: ")):
                    seen = len(said)
                    os.write(terminal, f"{left.pop(0)}\n".encode())
            code = process.wait(20)
        os.close(terminal)
        os.close(keyboard)
    return code, said


def test_from_cable_to_number(tmp_path: Path) -> None:
    """The beat is on CH2, a logic output on CH1: it is seen, proposed, and measured; the settings are left."""
    square = {1: lambda times: 0.5 * np.sign(np.sin(2 * np.pi * 158.7 * times)), 2: beat}
    code, said = led(tmp_path, ["", "nonsense", "2000", "", "", "RLG-7"], signals=square)
    assert code == 0, said
    assert "logic output?" in said
    looks = [line for line in said.splitlines() if "looks like a beat" in line]
    assert len(looks) == 1 and "CH2" in looks[0]
    assert "That is not a positive number" in said
    written = tomllib.loads((tmp_path / "bench.toml").read_text())
    assert written["scope"]["channel"] == "CH2" and written["gyro"]["scale_factor_pulses_per_deg"] == 2000.0
    assert written["table"]["kind"] == "none"
    value = float(said.split("lock-in rate")[-1].split()[0].rstrip("±"))
    assert value == pytest.approx(0.01, rel=0.2)
    assert "--table manual" in said


@pytest.mark.slow
def test_what_is_there_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "bench.toml").write_text("[gyro]\n")
    code, said = led(tmp_path, [], signals={1: beat})
    assert code == 2 and "bench.toml is there already" in said
    assert (tmp_path / "bench.toml").read_text() == "[gyro]\n"


@pytest.mark.slow
def test_a_file_that_cannot_be_written_is_told_before_anybody_is_asked(tmp_path: Path) -> None:
    code, said = led(tmp_path, [], "--to", "nowhere/bench.toml", signals={1: beat})
    assert code == 2 and "cannot be written" in said and "channels" not in said


def test_without_a_terminal_it_is_refused(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "station.cli", "start"]
    done = subprocess.run(
        command, cwd=tmp_path, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2 and "terminal" in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_who_turns_the_table_is_an_option() -> None:
    """`--table` is a setting: the same as in a file, and told by its name where it is wrong."""
    run = [sys.executable, "-m", "station.cli", "measure", "--quiet", "--json", "--table"]
    for given, told in (("manual", "--table: an operator cannot"), ("bla@GPIB0::3", "acutrol")):
        done = subprocess.run([*run, given], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
        assert done.returncode == 2 and told in json.loads(done.stdout)["error"]["message"]
