"""`python -m benchmarks.kills`: `kill -9` at 200 moments of measurements of several kinds.

A measurement with `--jsonl` is killed at a random moment after its first acknowledged record: between records, in
the middle of one, while the result is made. Every record whose line had come must be in the run, intact, and
`--resume` must bring the run to its full count. Each measurement is a process of its own, forked from one that has
imported the program already.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from station.cli import main as gyrolock
from station.runs.store import open_run

BENCH = "[measurement]\nrecords = 6\ntilt_records = 1\nrates_over_lock_in = [8.0]\nboth_senses = false\n"
BENCH += "[table]\nboth_senses = false\n"
COMMANDS = (("measure", "--config", "my.toml"), ("acquire", "--config", "my.toml"), ("fog", "table"))
"""Commands that are killed, the first most often."""
_LONGEST_PAUSE_S = 0.15  # between an acknowledged record and the kill; a record takes some hundredths


def started(folder: Path, arguments: Sequence[str]) -> tuple[int, int]:
    """Fork a process that runs a command in `folder`; returns its number, and where its stdout is read."""
    reader, writer = os.pipe()
    child = os.fork()
    if child:
        os.close(writer)
        return child, reader
    code = 70
    try:
        os.chdir(folder)
        nothing = os.open(os.devnull, os.O_RDWR)
        for stream, descriptor in enumerate((nothing, writer, os.open("said", os.O_WRONLY | os.O_CREAT))):
            os.dup2(descriptor, stream)
        os.close(reader)
        code = gyrolock(arguments)
    finally:
        os._exit(code)


def ended(folder: Path, arguments: Sequence[str]) -> int:
    """Run a command in `folder` to its end; returns its exit code."""
    child, reader = started(folder, arguments)
    with os.fdopen(reader) as out:
        out.read()
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def without_report(command: Sequence[str]) -> list[str]:
    """Return a command that writes no report: nothing of a run depends on it."""
    return [*command, *(() if command[0] == "acquire" else ("--no-report",))]


def full_count(command: Sequence[str]) -> int:
    """How many records a command takes when nobody kills it; what it imports is then here for all others."""
    with tempfile.TemporaryDirectory() as name:
        folder, before = Path(name), Path.cwd()
        (folder / "my.toml").write_text(BENCH)
        os.chdir(folder)
        try:
            with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
                code = gyrolock([*without_report(command), "--jsonl"])
        finally:
            os.chdir(before)
        (path,) = folder.glob("runs/*/run.sqlite")
        if code:
            raise RuntimeError(f"{' '.join(command)} ended with {code}")
        return len(open_run(path).records)


def one_kill(source: random.Random, command: Sequence[str], records: int) -> tuple[int, list[str]]:
    """Kill one measurement; returns how many records it had acknowledged, and what is wrong afterwards."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "my.toml").write_text(BENCH)
        after, pause = source.randint(1, records), source.uniform(0.0, _LONGEST_PAUSE_S)
        child, reader = started(folder, [*without_report(command), "--jsonl"])
        acknowledged: list[int] = []
        with os.fdopen(reader) as lines:
            for line in lines:
                # a line that the kill cut is no line
                if line.endswith("\n"):
                    acknowledged.append(json.loads(line)["number"])
                if len(acknowledged) == after:
                    time.sleep(pause)
                    os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        (path,) = folder.glob("runs/*/run.sqlite")
        run, wrong = open_run(path), []
        if not {record.number for record in run.records if record.intact} >= set(acknowledged):
            wrong.append(f"of {len(acknowledged)} acknowledged records {len(run.records)} are there")
        if run.damaged:
            wrong.append(f"damaged: {run.damaged}")
        if not run.facts.complete:
            name_of = [one for one in command if not one.startswith("-") and not one.endswith(".toml")]
            code = ended(folder, [*without_report(name_of), "--resume", str(path)])
            if code or len(open_run(path).records) != records or not open_run(path).facts.complete:
                wrong.append(f"going on ended with {code}: {(folder / 'said').read_text()[-200:]}")
        elif len(run.records) != records:
            wrong.append(f"complete with {len(run.records)} of {records} records")
        return len(acknowledged), wrong


def main(arguments: list[str] | None = None) -> int:
    """Kill, print what was lost, and return 0 if nothing was."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kills", description="kill -9 at many moments.")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    source, acknowledged, wrong = random.Random(options.seed), 0, []
    counts = {command: full_count(command) for command in COMMANDS[: options.count]}
    for number in range(options.count):
        command = COMMANDS[number % len(COMMANDS)]
        lines, found = one_kill(source, command, counts[command])
        acknowledged += lines
        wrong += [f"{' '.join(command)}: {text}" for text in found]
    sys.stdout.write(f"{options.count} kills, {acknowledged} records acknowledged, {len(wrong)} failures\n")
    for text in wrong[:20]:
        sys.stdout.write(f"  {text}\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
