"""The automated station killed at any moment: three units, the same verdicts as in one go.

    python -m benchmarks.station [KILLS]

Tests a good unit, one at the limit and a bad one on the simulated bench; then each again, killed with SIGKILL
after commits drawn at random, again and again until it has come to its end, and with the cable pulled once each
time.
Prints verdicts and exit codes.
"""

from __future__ import annotations

import json
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

CAMPAIGN = """
[campaign]
name = "killed"
unit_type = "RLG"
station = "benchmark"
reports = false
retry_after_s = 0.0

[bench.measurement]
records = 2
tilt_records = 1

[bench.budget]
scale_factor_u_ppm = 2000.0

[unit.GOOD.simulation]
lock_in_rate_dps = 0.009

[unit.LIMIT.simulation]
lock_in_rate_dps = 0.010

[unit.BAD.simulation]
lock_in_rate_dps = 0.011

[[step]]
name = "lock-in rate"
measurement = "measure"

[[step.limit]]
number = "lock_in_rate_dps"
at_most = 0.010

[[step]]
name = "dead band"
measurement = "deadband"

[step.settings.sweep]
steps = 6

[[step.limit]]
number = "dead_band_dps"
at_most = 0.030
"""

KILLED = """
import itertools, os, signal, sys
from instrument import LinkError
from station.cli import main
from station.runs.store import RunWriter
from station.lock_in import take
commit, commits, kill, pull = RunWriter.save_records, itertools.count(1), int(sys.argv[1]), int(sys.argv[2])
def save_records(writer, records):
    commit(writer, records)
    if next(commits) == kill:
        os.kill(os.getpid(), signal.SIGKILL)
record, count = take.take_record, itertools.count(1)
def take_record(*arguments):
    if next(count) == pull:
        raise LinkError("the cable was pulled")
    return record(*arguments)
RunWriter.save_records, take.take_record = save_records, take_record
sys.exit(main(sys.argv[3:]))
"""

UNITS = {"GOOD": ("PASS", 0), "LIMIT": ("MARGINAL", 6), "BAD": ("FAIL", 1)}


def say(line: str) -> None:
    """Print a line."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def run(folder: Path, unit: str, kill: int, pull: int, *more: str) -> tuple[int, str]:
    """Test a unit in a process that kills itself after so many commits (0: never); exit code and verdict."""
    station = ["station", "campaign.toml", "--unit", unit, "--json", "--quiet", *more]
    command = [sys.executable, "-c", KILLED, str(kill), str(pull), *station]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    verdict = json.loads(done.stdout)["verdict"] if done.stdout else "killed"
    return done.returncode, str(verdict)


def main(kills: int = 4) -> int:
    """Print what has become of each unit; 1 if a verdict differs."""
    draws, wrong = random.Random(15), 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "campaign.toml").write_text(CAMPAIGN)
        for unit, (verdict, code) in UNITS.items():
            began = time.monotonic()
            whole = run(folder, unit, 0, 0, "--out", "whole")
            say(f"{unit:6} in one go: {whole[1]} exit {whole[0]}, {time.monotonic() - began:.0f} s")
            found = run(folder, unit, draws.randint(1, 20), draws.randint(2, 12), "--out", "cut")
            times = 0
            while found[1] == "killed" and times < 50:
                times += 1
                kill = draws.randint(1, 20) if times < kills else 0
                found = run(folder, unit, kill, draws.randint(2, 12), "--out", "cut", "--resume")
            say(f"{unit:6} killed {times} times: {found[1]} exit {found[0]}")
            wrong += whole != (code, verdict) or found != (code, verdict)
    say("all verdicts as they should be" if not wrong else f"{wrong} units with another verdict")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
