"""`python -m benchmarks.damage.streams`: every command where what it says cannot go.

Its streams are closed as under a daemon, go to a disk that is full or to a reader that has gone, or know only the
letters of ASCII or Latin-1. The exit code is that of the command undisturbed, or 5 where its result is lost, and
nothing ends in a traceback.
"""

from __future__ import annotations

import argparse
import io
import os
import shutil
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path

from station.cli import main as gyrolock
from station.errors import EXIT_FAIL, EXIT_OK, EXIT_OUTPUT

RUN = Path(__file__).parents[2] / "tests" / "golden" / "single.sqlite"
BENCH = "[measurement]\nrecords = 1\ntilt_records = 1\nrates_over_lock_in = [8.0]\nboth_senses = false\n"
BENCH += '[table]\nboth_senses = false\n[gyro]\nname = "Kreisel Ω 中"\n'
QUICK = (("analyze", "run.sqlite"), ("acquire", "--config", "my.toml", "--jsonl"))
SLOW = (
    ("list",),
    ("analyze", "run.sqlite", "--jsonl"),
    ("plan",),
    ("settings", "simulated"),
    ("simulate", "--tcp"),
    ("fog", "table", "--no-report"),
    ("measure", "--config", "my.toml"),
    ("measure", "--config", "my.toml", "--no-report", "--json"),
    ("report", "run.sqlite"),
    ("deadband", "--no-report"),
    ("fog", "witness", "--no-report"),
    ("study", "--figure", "2"),
    ("doctor",),
)


@dataclass(frozen=True)
class Streams:
    """Where the streams of a command go: a file, ``None`` for closed, ``"gone"`` for a pipe that nobody reads."""

    stdout: str | None = "out"
    stderr: str | None = "err"
    stdin: bool = True
    encoding: str = "utf-8"

    @property
    def result_is_lost(self) -> bool:
        return self.stdout != "out"


BROKEN = {
    "all closed": Streams(None, None, stdin=False),
    "stdout closed": Streams(stdout=None),
    "stderr closed": Streams(stderr=None),
    "stdout full": Streams(stdout="/dev/full"),
    "stderr full": Streams(stderr="/dev/full"),
    "stdout gone": Streams(stdout="gone"),
    "stderr gone": Streams(stderr="gone"),
    "latin-1": Streams(encoding="latin-1"),
    "ascii": Streams(encoding="ascii"),
}
QUICK_BROKEN = ("all closed", "stdout full", "stderr gone", "ascii")


def ended(folder: Path, arguments: Sequence[str], streams: Streams) -> int:
    """Run a command in a forked process in `folder`; returns its exit code."""
    child = os.fork()
    if not child:
        code = 70
        try:
            os.chdir(folder)
            _direct(streams)
            code = gyrolock(arguments)
        finally:
            os._exit(code)
    if arguments[0] == "simulate":  # it serves until it is ended
        _until_served(int(arguments[-1]))
        os.kill(child, signal.SIGTERM)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _until_served(port: int) -> None:
    """Return when somebody listens, and has had the time to say so."""
    served = False
    while not served:
        time.sleep(0.05)
        with suppress(OSError), socket.create_connection(("127.0.0.1", port)):
            served = True
    time.sleep(1.0)


def free_port() -> int:
    """Return a TCP port of this computer that nobody has."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def _direct(streams: Streams) -> None:
    """Give this process its streams, as Python finds them when it starts."""
    if streams.stdin:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    else:
        os.close(0)
        sys.stdin = None  # type: ignore[assignment]  # as Python does it
    for number, where in ((1, streams.stdout), (2, streams.stderr)):
        text = None
        if where is None:
            os.close(number)
        else:
            os.dup2(_opened(where), number)
            raw = io.BufferedWriter(io.FileIO(number, "w", closefd=False))
            text = io.TextIOWrapper(raw, encoding=streams.encoding, line_buffering=number == 2)
        setattr(sys, "stdout" if number == 1 else "stderr", text)


def _opened(where: str) -> int:
    if where != "gone":
        return os.open(where, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    reader, writer = os.pipe()
    os.close(reader)
    return writer


def after(command: Sequence[str], streams: Streams) -> tuple[int, str]:
    """Run a command in a folder of its own; returns its exit code, and what it said on stderr."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        shutil.copyfile(RUN, folder / "run.sqlite")
        (folder / "my.toml").write_text(BENCH, encoding="utf-8")
        (folder / "out").touch()
        (folder / "err").touch()
        given = [*command, str(free_port())] if command[0] == "simulate" else command
        code = ended(folder, given, streams)
        return code, (folder / "err").read_bytes().decode(errors="replace")


def wrong_with(command: Sequence[str], names: Sequence[str]) -> list[str]:
    """What is not as it should be when a command has such streams."""
    undisturbed, said = after(command, Streams())
    wrong = []
    if undisturbed not in (EXIT_OK, EXIT_FAIL if command[0] == "plan" else EXIT_OK):
        wrong.append(f"{' '.join(command)}: ended with {undisturbed}: {said[-200:]}")
    for name in names:
        code, said = after(command, BROKEN[name])
        wanted = EXIT_OUTPUT if BROKEN[name].result_is_lost else undisturbed
        if code != wanted or "Traceback" in said or "defect" in said:
            wrong.append(f"{' '.join(command)}, {name}: ended with {code}, not {wanted}: {said[-200:]}")
    return wrong


def main(arguments: list[str] | None = None) -> int:
    """Run every command with every kind of streams; returns 0 if each ended as it should."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.damage.streams", description="Broken streams.")
    parser.add_argument("--quick", action="store_true", help="commands that take less than a second, some streams")
    options = parser.parse_args(arguments)
    commands, names = (QUICK, QUICK_BROKEN) if options.quick else (QUICK + SLOW, tuple(BROKEN))
    with tempfile.TemporaryDirectory() as place, redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        # what is imported here, a forked process need not
        (Path(place) / "my.toml").write_text(BENCH, encoding="utf-8")
        gyrolock(["acquire", "--config", f"{place}/my.toml", "--out", f"{place}/runs"])
    wrong = [text for command in commands for text in wrong_with(command, names)]
    sys.stdout.write(f"{len(commands)} commands, {len(names)} kinds of streams, {len(wrong)} wrong\n")
    for text in wrong:
        sys.stdout.write(f"  {text}\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
