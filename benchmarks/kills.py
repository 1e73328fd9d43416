"""`python -m benchmarks.kills`: `kill -9` at 200 moments of a measurement.

`gyrolock measure --jsonl` is killed at a random moment between its first acknowledged record and its last. Every
record whose line had come must be in the run, intact, and `--resume` must bring the run to its full count.
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

from station.runs.store import open_run

COMMAND = [sys.executable, "-m", "station.cli"]
MEASURE = [*COMMAND, "measure", "--config", "my.toml", "--no-report"]
SETTINGS = "[measurement]\nrecords = 12\ntilt_records = 2\nrates_over_lock_in = [8.0]\nboth_senses = false\n"
RECORDS = 4 + 12


def one_kill(source: random.Random) -> tuple[int, list[str]]:
    """Kill one measurement; returns how many records it had acknowledged, and what is wrong afterwards."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "my.toml").write_text(SETTINGS)
        after, pause = source.randint(1, RECORDS), source.uniform(0.0, 0.08)
        acknowledged = []
        with subprocess.Popen(
            [*MEASURE, "--jsonl"], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        ) as process:
            assert process.stdout is not None
            for line in process.stdout:
                # a line that the kill cut is no line
                if line.endswith("\n"):
                    acknowledged.append(json.loads(line)["number"])
                if len(acknowledged) == after:
                    threading.Timer(pause, process.kill).start()
        (path,) = folder.glob("runs/*/run.sqlite")
        run, wrong = open_run(path), []
        if not {record.number for record in run.records if record.intact} >= set(acknowledged):
            wrong.append(f"of {len(acknowledged)} acknowledged records {len(run.records)} are there")
        if run.damaged:
            wrong.append(f"damaged: {run.damaged}")
        if not run.facts.complete:
            again = subprocess.run([*MEASURE[:4], "--resume", path, "--json"], cwd=folder, capture_output=True)
            if again.returncode or len(open_run(path).records) != RECORDS:
                wrong.append(f"going on ended with {again.returncode}: {again.stderr.decode()[-200:]}")
        return len(acknowledged), wrong


def main(arguments: list[str] | None = None) -> int:
    """Kill, print what was lost, and return 0 if nothing was."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kills", description="kill -9 at many moments.")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    source, acknowledged, wrong = random.Random(options.seed), 0, []
    for _ in range(options.count):
        lines, found = one_kill(source)
        acknowledged += lines
        wrong += found
    sys.stdout.write(f"{options.count} kills, {acknowledged} records acknowledged, {len(wrong)} failures\n")
    for text in wrong[:20]:
        sys.stdout.write(f"  {text}\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
