"""Which programs of this user are measuring on this machine: each keeps a small file that says how it stands.

A lock that the operating system takes away with the process tells a program that runs from one that was killed. A
file beside it asks the program to end: that works on every system, and signals do not.
"""

import json
import os
import platform
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import IO, Any, Self

from instrument.claims import lock as lock_file
from station.errors import UsageError
from station.live.events import WAYPOINTS, Event
from station.runs.signals import stop_from_within

# --------------------
# How things stand: what a program's events, one after the other, add up to


SCHEMA = {"name": "gyrolock status", "version": 1}
_NOTES = 4


@dataclass
class Situation:
    """What a person wants to know of a program that is measuring."""

    at: str = ""
    program: dict[str, Any] = field(default_factory=dict)  # the last event of that kind; empty if there was none
    run: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)  # the last few
    waiting: dict[str, Any] = field(default_factory=dict)
    # ``what``, ``done``, ``total``, ``left_s`` and ``at``, the time of the count
    counted: dict[str, Any] = field(default_factory=dict)
    records: int = 0  # on the disk, of all runs of this program
    value: dict[str, Any] = field(default_factory=dict)  # the last record's values and trace
    # for each group of records what all of them so far say
    groups: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    link: dict[str, Any] = field(default_factory=dict)
    result: dict[str, Any] = field(default_factory=dict)
    campaign: dict[str, Any] = field(default_factory=dict)
    # of a campaign: ``step``, ``state`` ("to come", "now" or a verdict)
    steps: list[dict[str, Any]] = field(default_factory=list)
    conditions: dict[str, Any] = field(default_factory=dict)
    ended: dict[str, Any] = field(default_factory=dict)

    def take(self, event: Event) -> None:
        """Add an event."""
        self.at = event.at
        change = getattr(self, f"_{event.kind}", None)
        if change is not None:
            change(dict(event.facts), event.at)

    def as_json(self) -> dict[str, Any]:
        """Return everything as plain JSON."""
        return {"schema": SCHEMA, **asdict(self)}

    @classmethod
    def of_json(cls, document: Mapping[str, Any]) -> Self:
        """Return what :meth:`as_json` gave, of this version or a later one; what is missing is empty."""
        known = cls()
        for one in fields(cls):
            if isinstance(document.get(one.name), type(getattr(known, one.name))):
                setattr(known, one.name, document[one.name])
        return known

    def _program(self, facts: dict[str, Any], at: str) -> None:
        self.program = {**facts, "at": at}

    def _run(self, facts: dict[str, Any], at: str) -> None:
        self.run, self.records = {**facts, "at": at}, int(facts.get("records") or 0)
        self.value, self.groups, self.link, self.result, self.counted = {}, {}, {}, {}, {}

    def _note(self, facts: dict[str, Any], at: str) -> None:
        self.notes = [*self.notes, facts["text"]][-_NOTES:]

    def _waiting(self, facts: dict[str, Any], at: str) -> None:
        self.waiting = {**facts, "at": at}

    def _asked(self, facts: dict[str, Any], at: str) -> None:
        self.waiting = {"what": "an answer of the operator", "at": at}

    def _answered(self, facts: dict[str, Any], at: str) -> None:
        self.waiting = {}

    def _counting(self, facts: dict[str, Any], at: str) -> None:
        self.counted, self.waiting = {**facts, "done": 0, "left_s": None, "at": at}, {}

    def _counted(self, facts: dict[str, Any], at: str) -> None:
        self.counted, self.waiting = {**facts, "at": at}, {}

    def _record(self, facts: dict[str, Any], at: str) -> None:
        self.records += 1

    def _value(self, facts: dict[str, Any], at: str) -> None:
        self.value = facts
        if facts.get("running"):
            self.groups[facts["group"]] = facts["running"]

    def _link(self, facts: dict[str, Any], at: str) -> None:
        self.link = {**facts, "at": at}

    def _result(self, facts: dict[str, Any], at: str) -> None:
        self.result = facts

    def _campaign_begun(self, facts: dict[str, Any], at: str) -> None:
        self.campaign = {**facts, "at": at}
        self.steps = [{"step": name, "state": "to come"} for name in facts.get("steps", ())]

    def _step_begun(self, facts: dict[str, Any], at: str) -> None:
        self.campaign["now"] = facts
        self._mark(facts, "now")

    def _step_ended(self, facts: dict[str, Any], at: str) -> None:
        self._mark(facts, facts.get("verdict") or "done")

    def _mark(self, facts: dict[str, Any], state: str) -> None:
        place = int(facts.get("number") or 0) - 1
        if 0 <= place < len(self.steps):
            self.steps[place]["state"] = state

    def _conditions(self, facts: dict[str, Any], at: str) -> None:
        self.conditions |= facts

    def _campaign_ended(self, facts: dict[str, Any], at: str) -> None:
        self.campaign |= facts

    def _ended(self, facts: dict[str, Any], at: str) -> None:
        self.ended = {**facts, "at": at}


STATE_VARIABLE = "GYROLOCK_STATE"
_STATUS, _STOP, _LOCK = ".json", ".stop", ".lock"
_EVERY_S = 1.0
_LOOK_S = 0.2  # between two looks whether somebody asks it to end
_KEPT_DAYS = 7.0


def state_directory() -> Path:
    """Return the directory in which programs say how they stand."""
    if given := os.environ.get(STATE_VARIABLE):
        return Path(given)
    from platformdirs import user_state_path

    return user_state_path("gyrolock", appauthor=False) / "running"


class StatusFile:
    """Reads events and keeps ``HOST-PID.json`` up to date; where it cannot be written, there is none."""

    # ``HOST-PID.stop`` beside it ends the program, as SIGTERM does.

    def __init__(self, directory: Path | None = None) -> None:
        self.situation = Situation()
        self._written_at = 0.0
        self._lock: IO[bytes] | None = None
        self._ended = threading.Event()
        self._path = (directory or state_directory()) / f"{platform.node() or 'here'}-{os.getpid()}{_STATUS}"
        with suppress(OSError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            before = time.time() - _KEPT_DAYS * 86400
            for path in self._path.parent.glob(f"*{_LOCK}"):
                with suppress(OSError):
                    if path.stat().st_mtime < before and not _is_held(path):
                        _take_away(path)
            lock = self._path.with_suffix(_LOCK).open("ab")
            if lock_file(lock.fileno()):
                self._lock = lock
                self._path.with_suffix(_STOP).unlink(missing_ok=True)  # of a program that had this number before
                threading.Thread(target=self._listen, name="stop", daemon=True).start()
            else:
                lock.close()

    def __call__(self, event: Event) -> None:
        """Take an event; the file is written at most once a second, and for what must not be missed at once."""
        self.situation.take(event)
        now = time.monotonic()
        if event.kind in WAYPOINTS or now - self._written_at >= _EVERY_S:
            self._written_at = now
            self._write()

    def close(self) -> None:
        """Take the file away: the program has ended, and has said how."""
        self._ended.set()
        if self._lock is None:
            return
        _take_away(self._path)
        self._lock.close()
        self._lock = None

    def _write(self) -> None:
        if self._lock is None:
            return
        with suppress(OSError):  # a status that cannot be written harms nothing
            draft = self._path.with_suffix(".draft")
            draft.write_text(json.dumps(self.situation.as_json(), allow_nan=False), encoding="utf-8")
            draft.replace(self._path)

    def _listen(self) -> None:
        """End the program when somebody asks for it; a second time, at once."""
        asked = self._path.with_suffix(_STOP)
        while not self._ended.wait(_LOOK_S):
            with suppress(OSError):  # most of the time it is not there
                asked.unlink()
                stop_from_within()


@dataclass(frozen=True)
class Running:
    """A program that is measuring, or was when it was killed."""

    path: Path
    pid: int
    alive: bool  # whether it still runs
    situation: Situation

    @property
    def run(self) -> Path | None:
        """The run that it is taking, or took."""
        named = self.situation.run.get("run")
        return Path(named) if named else None

    def as_json(self) -> dict[str, Any]:
        """Return it as plain JSON."""
        return {"pid": self.pid, "alive": self.alive, **self.situation.as_json()}

    def forget(self) -> None:
        """Take the files of a program that was killed away."""
        _take_away(self.path)

    def stop(self) -> None:
        """Ask it to end, as Ctrl-C in its terminal does: what it has taken is kept."""
        try:
            self.path.with_suffix(_STOP).touch()
        except OSError as error:
            raise UsageError(f"process {self.pid} cannot be told to stop: {error.strerror}") from None


def running_programs(directory: Path | None = None) -> list[Running]:
    """Return the programs of this user on this machine, those that were killed too, in the order of starting."""
    found = list(_found(directory or state_directory()))
    return sorted(found, key=lambda one: str(one.situation.program.get("at", "")))


def _found(directory: Path) -> Iterator[Running]:
    for path in sorted(directory.glob(f"{platform.node() or 'here'}-*{_STATUS}")):
        number = path.stem.rpartition("-")[2]
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue
        if number.isdecimal() and isinstance(document, dict):
            yield Running(path, int(number), _is_held(path.with_suffix(_LOCK)), Situation.of_json(document))


def _is_held(path: Path) -> bool:
    """Whether the process that made a lock still holds it."""
    try:
        with path.open("ab") as lock:
            return not lock_file(lock.fileno())
    except OSError:
        return False


def _take_away(path: Path) -> None:
    """Take all files of a program away."""
    for suffix in (_STATUS, _STOP, _LOCK):
        with suppress(OSError):
            path.with_suffix(suffix).unlink(missing_ok=True)
