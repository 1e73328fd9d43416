"""The command line as a user runs it, and a simulated scope that somebody else serves."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.ideal_bench import IDEAL_TOML

if os.name == "posix":  # where the tests run under nohup, programs would ignore it too
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

COMMAND = [sys.executable, "-m", "station.cli"]


@dataclass(frozen=True)
class Finished:
    """What a command left: exit code, stdout and stderr."""

    code: int
    out: str
    err: str

    @property
    def document(self) -> dict[str, Any]:
        """The one JSON document on stdout."""
        document: dict[str, Any] = json.loads(self.out)
        return document


Gyrolock = Callable[..., Finished]


@pytest.fixture
def gyrolock(tmp_path: Path) -> Gyrolock:
    """Run `gyrolock` in a directory that holds `ideal.toml`, and see that no traceback reaches the user."""
    (tmp_path / "ideal.toml").write_text(IDEAL_TOML)
    run_once = _run_forked if hasattr(os, "fork") else _run

    def run(*arguments: object, timeout: float = 60) -> Finished:
        done = run_once([*map(str, arguments)], tmp_path, timeout)
        assert "Traceback" not in done.err, done.err
        return done

    return run


def _run(arguments: list[str], folder: Path, timeout: float) -> Finished:
    done = subprocess.run(
        [*COMMAND, *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=timeout,
        stdin=subprocess.DEVNULL,
    )
    return Finished(done.returncode, done.stdout, done.stderr)


def _run_forked(arguments: list[str], folder: Path, timeout: float) -> Finished:
    """By a process of its own that has imported everything already: half the time of these tests is importing."""
    places = Path(tempfile.mkdtemp(prefix="gyrolock-told-"))
    out, err = places / "stdout", places / "stderr"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of fork beside the thread of xdist
        child = os.fork()
    if child == 0:
        code = 70
        try:
            code = _in_child(arguments, folder, out, err)
        finally:
            os._exit(code)
    until = time.monotonic() + timeout
    while not (ended := os.waitpid(child, os.WNOHANG))[0]:
        if time.monotonic() > until:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            raise subprocess.TimeoutExpired(arguments, timeout)
        time.sleep(0.005)
    told = (path.read_text(encoding="utf-8") for path in (out, err))
    finished = Finished(os.waitstatus_to_exitcode(ended[1]), *told)
    shutil.rmtree(places)
    return finished


def _in_child(arguments: list[str], folder: Path, out: Path, err: Path) -> int:
    """What a shell and Python do before a program begins."""
    from station.cli import main

    warnings.resetwarnings()
    os.chdir(folder)
    for number, path, flags in ((0, os.devnull, os.O_RDONLY), (1, out, os.O_WRONLY), (2, err, os.O_WRONLY)):
        opened = os.open(path, flags | os.O_CREAT, 0o600)
        os.dup2(opened, number)
        os.close(opened)
    sys.stdin, sys.stdout, sys.stderr = (
        os.fdopen(number, mode, encoding="utf-8", closefd=False) for number, mode in ((0, "r"), (1, "w"), (2, "w"))
    )
    sys.argv = ["gyrolock", *arguments]
    code = main(arguments)
    sys.stdout.flush()
    sys.stderr.flush()
    return code


@dataclass(frozen=True)
class ServedScope:
    """A simulated scope in a process of its own."""

    process: subprocess.Popen[str]
    resource: str

    def switch_off(self) -> None:
        """Kill it, as a mains switch would."""
        self.process.kill()
        self.process.wait()


@pytest.fixture
def serve_scope(tmp_path: Path) -> Iterator[Callable[..., ServedScope]]:
    """Start `gyrolock simulate ...` in a directory that holds `ideal.toml`; it is ended with the test."""
    (tmp_path / "ideal.toml").write_text(IDEAL_TOML)
    started: list[subprocess.Popen[str]] = []

    def serve(*arguments: str) -> ServedScope:
        process = subprocess.Popen(
            [*COMMAND, "simulate", *arguments],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            # as from a shell script: a background process that would ignore Ctrl-C
            preexec_fn=_ignore_interrupt if os.name == "posix" else None,
        )
        started.append(process)
        assert process.stdout is not None
        return ServedScope(process, process.stdout.readline().strip())

    yield serve
    for process in started:
        process.terminate()
        process.wait(timeout=20)
        if process.stdout is not None:
            process.stdout.close()


def _ignore_interrupt() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@pytest.fixture
def start_gyrolock(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start a command that the test will interrupt."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: object) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [*COMMAND, *map(str, arguments)],
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
            process.communicate()


CUT = """
import itertools, os, signal, sys
from station.cli import main
from station.runs.store import RunWriter
commit, commits = RunWriter.save_records, itertools.count(1)
def save_records(writer, records):
    commit(writer, records)
    if next(commits) == int(sys.argv[2]):
        os.kill(os.getpid(), getattr(signal, sys.argv[1]))
RunWriter.save_records = save_records
sys.exit(main(sys.argv[3:]))
"""


@pytest.fixture
def cut_gyrolock(tmp_path: Path) -> Callable[..., Finished]:
    """Run a command that gets a signal at the moment when so many commits are on the disk, on any machine."""

    def run(how: str, commits: int, *arguments: object) -> Finished:
        command = [sys.executable, "-c", CUT, how, str(commits), *map(str, arguments)]
        done = subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, timeout=100, stdin=subprocess.DEVNULL
        )
        assert "Traceback" not in done.stderr, done.stderr
        return Finished(done.returncode, done.stdout, done.stderr)

    return run
