"""A table that an operator sets by hand: asked on a terminal, and nowhere else."""

import os
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest

from station.errors import UsageError
from station.lock_in.settings import load_settings
from station.ring_laser.instruments import build_instruments
from station.runs.operator import operator_table
from station.runs.store import open_run
from station.scope.serve import serve
from tests.ideal_bench import ideal_bench

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs a pseudo-terminal for the operator")


def test_without_a_terminal_it_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with open(os.devnull) as nobody:
        monkeypatch.setattr(sys, "stdin", nobody)
        with pytest.raises(UsageError, match="terminal"):
            operator_table()


def test_an_operator_leads_the_table_through_the_measurement(tmp_path: Path) -> None:
    """The operator of this test turns the simulated table by what the prompts say."""
    from instrument.simulated import VirtualClock

    instruments = build_instruments(load_settings(overrides=ideal_bench()), VirtualClock())
    with serve(instruments.scope, "tcp") as resource:
        text = f'[scope]\nresource = "{resource}"\n[table]\nkind = "manual"\nsettle_s = 0\n'
        text += "[measurement]\nrecords = 3\nrates_over_lock_in = [8.0]\n"
        text += "[gyro]\nscale_factor_pulses_per_deg = 2000.0\n"
        (tmp_path / "my.toml").write_text(text)
        terminal, keyboard = os.openpty()
        command = [sys.executable, "-m", "station.cli", "measure", "--config", "my.toml", "--no-report"]
        with subprocess.Popen(
            command, cwd=tmp_path, stdin=keyboard, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        ) as process:
            assert process.stderr is not None
            asked = []
            said = ""
            deadline = time.monotonic() + 60
            while process.poll() is None and time.monotonic() < deadline:
                if not select.select([process.stderr], [], [], 0.2)[0]:
                    continue
                said += os.read(process.stderr.fileno(), 4096).decode()
                if "Press Enter" in said:
                    rate = float(said.split("rate table to ")[1].split(" deg/s")[0])
                    asked.append(rate)
                    said = ""
                    instruments.table.set_rate(rate)
                    os.write(terminal, b"\n")
            process.kill()
            process.communicate()
        os.close(terminal)
        os.close(keyboard)
    assert asked[:2] == [50.0, -50.0]
    assert asked[2] == pytest.approx(3.507, abs=0.02)
    (path,) = (tmp_path / "runs").glob("*/run.sqlite")
    run = open_run(path)
    assert run.facts["outcome"] == "complete", said
    assert len(run.taken_for("measure")) == 3
    assert run.results is not None
    assert run.results["lock_in_rate_dps"] == pytest.approx(0.01, rel=0.02)
    # without an azimuth the earth rate stays in the rate by the table: up to 13.25 deg/h of 0.08 deg/s
    check = run.results["table_check"]
    assert check["beat_over_table"] == pytest.approx(1.0, abs=0.06)
    assert 0.02 < check["lock_in_rate_u_dps"] / 0.01 < 0.06
