"""Measurements that the panel has started: each is a process of its own, exactly as from the command line.

A job is a folder: ``words.json`` says what was typed, ``settings.toml`` what differed, ``events.ndjson`` is what
the process tells, ``answers`` what the operator said, ``told.txt`` what it wrote. The process outlives the panel,
and a panel that starts later reads the same folder.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from station.errors import UsageError
from station.live.events import Event
from station.live.status import Running, Situation, running_programs
from station.terminal import ANSWERS_VARIABLE

FOLDER = ".gyrolock-panel"
_LOOK_S = 1.0  # between two looks at which programs run
_MOST = 200  # jobs that are looked at, the newest
_LONGEST_LINE = 4_000_000  # bytes of events that are read at once


def command_line(words: Sequence[str]) -> list[str]:
    """Return the program and its words."""
    return [sys.executable, "-m", "station.cli", *words]


@dataclass
class Job:
    """One measurement, as its folder tells it."""

    folder: Path
    words: list[str]
    situation: Situation = field(default_factory=Situation)
    counter: int = 0  # of the last event
    pid: int = 0  # of the process that was started
    _read: int = 0

    @property
    def name(self) -> str:
        """What tells it from others."""
        return self.folder.name

    @property
    def begun(self) -> str:
        """When it was started, UTC, to the minute."""
        return f"{self.name[:10]} {self.name[11:13]}:{self.name[13:15]}"

    @property
    def title(self) -> str:
        """What was typed, as a person says it: the command, and the unit."""
        unit = self.situation.program.get("unit") or ""
        return " · ".join(filter(None, [" ".join(one for one in self.words[:2] if not one.startswith("-")), unit]))

    @property
    def run(self) -> str:
        """The folder of the run that it takes or took."""
        named = self.situation.run.get("run")
        return str(Path(named).parent) if named else ""

    @property
    def ended(self) -> bool:
        """Whether it has said that it ended."""
        return bool(self.situation.ended)

    @property
    def cut_short(self) -> bool:
        """Whether there is something to go on with: it was stopped, or its link was lost, or it was killed."""
        ended = self.situation.ended.get("exit_code")
        return bool(self.run or self.situation.campaign) and ended not in (0, 1, 2, 4, 6)

    def read(self) -> bool:
        """Take what it has told since the last time; whether there was anything."""
        path = self.folder / "events.ndjson"
        try:
            with path.open("rb") as file:
                file.seek(self._read)
                data = file.read(_LONGEST_LINE)
        except OSError:
            return False
        whole, end, _ = data.rpartition(b"\n")
        if not end:
            return False
        self._read += len(whole) + 1
        for line in whole.splitlines():
            try:
                told = json.loads(line)
                kind, at, counter = told["event"], told["at"], int(told["counter"])
            except (ValueError, KeyError, TypeError):
                continue
            facts = {name: one for name, one in told.items() if name not in ("schema", "event", "at", "counter")}
            self.situation.take(Event(counter, kind, at, facts))
            self.counter = counter
        return True

    @property
    def question(self) -> str:
        """What it asks; empty where it asks nothing."""
        try:
            return (self.folder / "question").read_text(encoding="utf-8")
        except OSError:
            return ""

    def told(self) -> str:
        """The last lines that it wrote."""
        try:
            text = (self.folder / "told.txt").read_text(encoding="utf-8", errors="replace")
        except OSError:
            return ""
        return "\n".join(text.splitlines()[-12:])

    def answer(self, text: str) -> None:
        """Give the operator's answer."""
        if not self.question:
            raise UsageError("nothing was asked")
        with (self.folder / "answers").open("a", encoding="utf-8") as file:
            file.write(" ".join(text.splitlines()) + "\n")
        (self.folder / "question").unlink(missing_ok=True)  # who presses twice does not answer the next one


class Jobs:
    """All jobs of a folder; any thread may ask."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._folder = root / FOLDER / "jobs"
        self._known: dict[str, Job] = {}
        self._lock = threading.RLock()
        self._programs: tuple[float, dict[int, Running]] = (-_LOOK_S, {})
        self._processes: list[subprocess.Popen[bytes]] = []

    def start(self, words: Sequence[str], settings: str = "") -> Job:
        """Start a measurement; a settings file of its own where there are some."""
        began = datetime.now(UTC)
        folder = self._folder / f"{began:%Y-%m-%dT%H%M%S}-{began.microsecond:06d}"
        try:
            folder.mkdir(parents=True)
            given = list(words)
            if settings:
                (folder / "settings.toml").write_text(settings, encoding="utf-8")
                given += ["--config", str(folder / "settings.toml")]
            (folder / "answers").touch()
            (folder / "words.json").write_text(json.dumps(given), encoding="utf-8")
            with (folder / "result.json").open("wb") as said, (folder / "told.txt").open("wb") as told:
                process = subprocess.Popen(
                    command_line([*given, "--events", str(folder / "events.ndjson"), "--json"]),
                    cwd=self.root,
                    env={**os.environ, ANSWERS_VARIABLE: str(folder / "answers")},
                    stdin=subprocess.DEVNULL,
                    stdout=said,
                    stderr=told,
                    start_new_session=True,  # what ends the panel does not end it
                )
            (folder / "pid").write_text(str(process.pid), encoding="utf-8")
        except OSError as error:
            raise UsageError(f"{folder}: {error.strerror or error}") from None
        with self._lock:
            self._processes = [one for one in self._processes if one.poll() is None] + [process]
        return self.job(folder.name)

    def all(self) -> list[Job]:
        """Return all jobs, the newest first, each as it stands now."""
        with self._lock:
            for folder in sorted(self._folder.glob("*"))[-_MOST:]:
                if folder.name not in self._known:
                    try:
                        words = json.loads((folder / "words.json").read_text(encoding="utf-8"))
                        pid = int((folder / "pid").read_text(encoding="utf-8"))
                    except (OSError, ValueError):
                        continue
                    self._known[folder.name] = Job(folder, [str(one) for one in words], pid=pid)
            for job in self._known.values():
                if not job.ended:
                    job.read()
            return sorted(self._known.values(), key=lambda one: one.name, reverse=True)

    def job(self, name: str) -> Job:
        """Return one by its name; UsageError if there is none."""
        found = next((one for one in self.all() if one.name == name), None)
        if found is None:
            raise UsageError("there is no such measurement")
        return found

    def alive(self, job: Job) -> bool:
        """Whether it still runs."""
        own = next((one for one in self._processes if one.pid == job.pid), None)
        if own is not None:
            return own.poll() is None and not job.ended
        if job.ended:
            return False
        if job.situation.program:
            return self._running(job.pid) is not None
        try:  # it asks before it says that it runs; a number alone may be another program's by now
            return job.name.encode() in Path(f"/proc/{job.pid}/cmdline").read_bytes()
        except OSError:
            return False

    def stop(self, job: Job) -> None:
        """Ask it to end, as `gyrolock stop` does."""
        running = self._running(job.pid)
        if running is not None:
            running.stop()
        elif self.alive(job):
            os.kill(job.pid, signal.SIGTERM)  # it asks before it says that it runs
        else:
            raise UsageError("it does not run any more")

    def resume(self, job: Job) -> Job:
        """Go on with its run, with the same words."""
        words = _without("--resume", _without("--config", job.words))
        return self.start([*words, "--resume", *([job.run] if words[0] != "station" else [])])

    def repeat(self, job: Job) -> Job:
        """Do the same once more."""
        file = job.folder / "settings.toml"
        settings = file.read_text(encoding="utf-8") if file.is_file() else ""
        return self.start(_without("--resume", _without("--config", job.words)), settings)

    def read(self, job: Job) -> None:
        """Take what a job has told."""
        with self._lock:
            job.read()

    def _running(self, pid: int) -> Running | None:
        now = time.monotonic()
        if now - self._programs[0] > _LOOK_S:
            self._programs = now, {one.pid: one for one in running_programs() if one.alive}
        return self._programs[1].get(pid)


def _without(option: str, words: Sequence[str]) -> list[str]:
    """Words without what belongs to their own job alone: an option, and its value where it has one."""
    if option not in words:
        return list(words)
    place = list(words).index(option)
    return [*words[:place], *words[place + 2 :]]


def said_by(words: Sequence[str], root: Path, *, seconds: float = 120.0) -> tuple[int, str]:
    """Run a command that measures nothing to its end; exit code, and what it said."""
    plain: Mapping[str, Any] = {**os.environ, "COLUMNS": "110", "NO_COLOR": "1"}
    try:
        done = subprocess.run(
            command_line(words), cwd=root, env=plain, capture_output=True, text=True, errors="replace",
            stdin=subprocess.DEVNULL, timeout=seconds, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return 3, f"no answer within {seconds:g} s"
    return done.returncode, f"{done.stdout}{done.stderr}".strip()
