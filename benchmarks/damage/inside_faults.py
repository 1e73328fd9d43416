"""`python -m benchmarks.damage.inside_faults`: every system call of a measurement on its files fails once.

A small measurement is made again and again: first its first call fails (reading settings, making the directory,
writing progress, the run, the report, the acknowledged lines on stdout), then its second, until none is left. Each
time the records that were acknowledged are in the run, all of them intact, the exit code is right, one line says
what failed, and the run goes on to its full count. Needs Linux and a C compiler.
"""

from __future__ import annotations

import argparse
import ctypes
import errno
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

SOURCE = Path(__file__).with_name("failing_calls.c")
SETTINGS = "[measurement]\nrecords = 2\ntilt_records = 1\nrates_over_lock_in = [8.0]\nboth_senses = false\n"
SETTINGS += "[table]\nboth_senses = false\n"
RECORDS = 3  # one of the fast run, two of the slow one
CODES = {0, 2, 5}


@dataclass
class Outcome:
    """What became of the measurements."""

    calls: int = 0
    codes: Counter[int] = field(default_factory=Counter)
    kinds: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)


def compiled(folder: Path) -> Path | None:
    """Compile what makes calls fail; ``None`` where that is not possible."""
    compiler, library = shutil.which("cc"), folder / "failing_calls.so"
    if compiler is None or sys.platform != "linux":
        return None
    command = [compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(SOURCE), "-ldl"]
    return library if subprocess.run(command, capture_output=True).returncode == 0 else None


def run(first: int, step: int, most: int, seconds: float) -> Outcome:
    """Let every `step`-th call from the `first` on fail; in a process that the library was loaded into."""
    library = ctypes.CDLL(os.environ["LD_PRELOAD"])
    library.failed.restype, library.seen.restype = ctypes.c_char_p, ctypes.c_long
    _warm()
    outcome, began = Outcome(), time.monotonic()
    for number in range(first, most, step):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(os.path.realpath(name))
            (folder / "my.toml").write_text(SETTINGS)
            code = _measured(folder, ["measure", "--config", "my.toml", "--jsonl"], library, number)
            told = (folder / "failed").read_text() if (folder / "failed").exists() else ""
            if not told:
                break
            outcome.calls, outcome.codes[code] = outcome.calls + 1, outcome.codes[code] + 1
            outcome.kinds[told.split()[0]] += 1
            outcome.failures += [f"call {number}, {told}: {text}" for text in _wrong(folder, code, library)]
        if time.monotonic() - began > seconds:
            break
    return outcome


def _warm() -> None:
    """Import and use everything once, so that a forked process need not."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "my.toml").write_text(SETTINGS)
        _measured(Path(folder), ["measure", "--config", "my.toml"], None, 0, fork=False)


def _measured(
    folder: Path, arguments: list[str], library: ctypes.CDLL | None, number: int, *, fork: bool = True
) -> int:
    """Run a command in `folder`, its streams going to files there; returns the exit code."""
    child = os.fork() if fork else 0
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    from station.cli import main

    before, kept = Path.cwd(), [os.dup(one) for one in (1, 2)]
    os.chdir(folder)
    for stream, name in ((1, "out"), (2, "err")):
        descriptor = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(descriptor, stream)
        os.close(descriptor)
    if library is not None:
        library.arm(str(folder).encode(), number, errno.ENOSPC if number % 2 else errno.EIO)
    code = main(arguments)
    if library is not None:
        failed = library.failed().decode()
        library.arm(b"", 0, 0)
        if failed:
            Path("failed").write_text(failed)
    if fork:
        os._exit(code)
    os.chdir(before)
    for stream, descriptor in zip((1, 2), kept, strict=True):
        os.dup2(descriptor, stream)
    return code


def _wrong(folder: Path, code: int, library: ctypes.CDLL) -> list[str]:
    """What is not as it should be after a measurement in which one call failed."""
    from station.runs.store import open_run

    said, found = (folder / "err").read_text(), []
    if code not in CODES:
        found.append(f"exit code {code}: {said[-300:]}")
    if "Traceback" in said:
        found.append("a traceback")
    if code and "gyrolock: " not in said and "err" not in (folder / "failed").read_text():
        found.append(f"exit code {code}, and nothing said")
    runs = list((folder / "runs").glob("*/run.sqlite"))
    acknowledged = []
    for line in (folder / "out").read_text().splitlines():
        with suppress(ValueError, KeyError):
            acknowledged.append(json.loads(line)["number"])
    if not runs:
        return [*found, *(["acknowledged, and there is no run"] if acknowledged or code == 0 else [])]
    run = open_run(runs[0])
    if not {record.number for record in run.records} >= set(acknowledged):
        found.append("an acknowledged record is lost")
    if not all(record.intact for record in run.records) or run.damaged:
        found.append(f"the run is damaged: {run.damaged}")
    whole = len(run.records) == RECORDS and (runs[0].parent / "report.html").exists()
    if (run.facts.complete and not whole) or (code == 0 and not run.facts.complete):
        found.append(f"outcome {run.facts.outcome_text!r}, {len(run.records)} records")
    if not run.facts.complete:
        again = _measured(folder, ["measure", "--resume", str(runs[0])], None, 0)
        if again or len(open_run(runs[0]).records) != RECORDS:
            found.append(f"going on ends with {again}: {(folder / 'err').read_text()[-300:]}")
    return found


def main(arguments: list[str] | None = None) -> int:
    """Make the calls fail, print what became of the measurements, return 0 if all are as they should be."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.damage.inside_faults", description="Calls that fail."
    )
    parser.add_argument("--first", type=int, default=1, help="the first call that fails")
    parser.add_argument("--step", type=int, default=1, help="only every such call")
    parser.add_argument("--most", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=1e9, help="stop after so long")
    options = parser.parse_args(arguments)
    if "failing_calls" not in os.environ.get("LD_PRELOAD", ""):
        with tempfile.TemporaryDirectory() as name:
            library = compiled(Path(name))
            if library is None:
                sys.stdout.write("needs Linux and a C compiler\n")
                return 77
            again = [sys.executable, "-m", "benchmarks.damage.inside_faults", *(arguments or sys.argv[1:])]
            return subprocess.run(again, env={**os.environ, "LD_PRELOAD": str(library)}).returncode
    outcome = run(options.first, options.step, options.most, options.seconds)
    kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(outcome.kinds.items()))
    codes = ", ".join(f"{count} with {code}" for code, count in sorted(outcome.codes.items()))
    sys.stdout.write(f"{outcome.calls} calls failed ({kinds}); ended {codes}; {len(outcome.failures)} wrong\n")
    for text in outcome.failures[:30]:
        sys.stdout.write(f"  {text}\n")
    return 1 if outcome.failures else 0


if __name__ == "__main__":
    sys.exit(main())
