"""What instruments and file names say, with escape sequences, markup and scripts in it: nothing of it acts."""

from pathlib import Path

import numpy as np
import pytest

from analysis import beat_signal
from instrument.simulated import SimulatedTDS2014, TcpServer

MARKUP = "[red]7 <script>alert(1)<script>"  # escape sequences are no text, and are refused on the link
HOSTILE = f"\x1b[2J\x1b]0x\x07 {MARKUP}"
ESCAPES = "\x1b[2J", "\x1b]0", "\x07"


def beat(times: np.ndarray) -> np.ndarray:
    return beat_signal(times, scale_factor=2000, input_rate=0.08, lock_in_rate=0.01)


@pytest.mark.slow
def test_what_the_instrument_calls_itself(tmp_path: Path, gyrolock) -> None:
    identity = f"TEKTRONIX,TDS 2014,{MARKUP},CF:91.1CT {MARKUP}"
    with TcpServer(SimulatedTDS2014({1: beat}, identity=identity, seed=1)) as server:
        named = ("--resource", server.resource_name, "--rates", "8", "--records", "2", "--scale-factor", "2000")
        done = gyrolock("measure", *named)
        assert done.code == 0, done.err
    (report,) = (tmp_path / "runs").glob("*/report.html")
    page = report.read_text(encoding="utf-8")
    assert "[red]7" in page
    assert "<script>" not in page
    assert "[red]7" in gyrolock("analyze", report.parent, "--json").out


@pytest.mark.parametrize("command", ["analyze", "report"])
def test_names_of_files(gyrolock, tmp_path: Path, command: str) -> None:
    name = HOSTILE + ".csv"
    (tmp_path / name).write_text("no record\n")
    done = gyrolock(command, name)
    assert done.code == 2
    assert MARKUP in done.err
    assert not any(raw in done.err for raw in ESCAPES)
