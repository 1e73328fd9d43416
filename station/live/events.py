"""What happens while something is measured: one event at a time, told to all who read, and how far a run is.

A reader that fails is not asked again, and what is measured goes on.
"""

import json
import os
import stat
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.errors import UsageError
from station.terminal import takes_now

if TYPE_CHECKING:
    from station.runs.store import NewRecord

SCHEMA = {"name": "gyrolock event", "version": 1}

KINDS: Mapping[str, tuple[str, str]] = {
    "program": ("command unit operator note pid version", "a command begins"),
    "run": (
        "run measurement gyro instrument resource simulated resumed records",
        "the bench is open, a run begins",
    ),
    "note": ("text", "one line for the operator"),
    "waiting": ("what seconds", "nothing is taken for so long: warm-up, settling"),
    "asked": ("question", "the program waits for an answer of the operator"),
    "answered": ("", "the operator has answered"),
    "counting": ("what total", "from here on `total` things are counted"),
    "counted": (
        "what done total left_s all_done all_total all_left_s",
        "one more; the time left is a guess from those so far; all: of the whole run, where it counts in parts",
    ),
    "record": ("run number key purpose conditions", "a record is on the disk"),
    "value": ("key group values running so_far flags trace problem", "what one record says, and all so far"),
    "link": ("repeated reconnected set_again down text", "what it took so far to keep the link"),
    "run_ended": ("run outcome", "the taking of a run has ended"),
    "result": ("run name value verdict standing measured", "what a run says"),
    "campaign_begun": ("campaign unit steps of seconds resumed", "a test of a unit begins"),
    "step_begun": ("step number of measurement title", "a step of it begins"),
    "step_ended": ("step number verdict run message", "a step has ended"),
    "conditions": ("*", "what instruments beside the bench read: names with their units"),
    "campaign_ended": ("verdict exit_code message", "the test has ended"),
    "ended": ("exit_code message", "the command has ended"),
    "lost": ("count", "so many events were not written: the reader was too slow"),
}
"""Each kind of event: names of what it tells (``*``: any names), and what it means."""

WAYPOINTS = frozenset(KINDS) - {"counted", "record", "value", "link", "note"}
"""Kinds that come seldom, and that a reader of the state as it stands must not miss."""


@dataclass(frozen=True)
class Event:
    """Something that happened."""

    counter: int  # counts from 1 within the program: a gap shows
    kind: str  # one of :data:`KINDS`
    at: str  # UTC, ISO 8601
    facts: Mapping[str, Any]  # plain JSON

    def line(self) -> str:
        """Return the event as one line of JSON, without its end."""
        head = {"schema": SCHEMA, "counter": self.counter, "event": self.kind, "at": self.at}
        return json.dumps({**head, **self.facts}, allow_nan=False)


Reader = Callable[[Event], None]


class Events:
    """Tells its readers what happens, in the order in which it happens; any thread may emit."""

    def __init__(self) -> None:
        self._readers: list[Reader] = []
        self._lock = threading.RLock()
        self._counter = 0
        self.wants_values = False

    def read_by(self, reader: Reader, *, values: bool = False) -> None:
        """Add a reader."""
        with self._lock:
            self._readers.append(reader)
            self.wants_values = self.wants_values or values

    def emit(self, kind: str, **facts: object) -> None:
        """Tell what happened; never raises for a reader's sake."""
        if not self._readers:
            return
        from station.results.result import plain  # needs NumPy

        with self._lock:
            self._counter += 1
            event = Event(
                self._counter,
                kind,
                datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z"),
                plain(facts),
            )
            for reader in tuple(self._readers):
                try:
                    reader(event)
                except Exception:  # whatever it is: it is the reader's, and not the measurement's
                    self._readers.remove(reader)


# --------------------
# Events as lines of JSON, for other programs: to a file, a pipe, or a descriptor that the caller has opened.
#
# A reader that is slow, has gone or never came costs lines, never the measurement: nothing here waits for it


_LINES = 1000  # that wait for a reader; of more the oldest are lost, and counted
_PIECE = 4096  # bytes: a pipe that is said to take some takes so many (PIPE_BUF) without waiting
_LAST_S = 1.0  # for so long the end of the program waits for a reader


class EventLines:
    """Writes events to a descriptor as it takes them."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._held: deque[bytes] = deque()
        self._begun = b""
        """What is left of a line that is partly written."""
        self._untold = 0
        self.lost, self.error = 0, ""

    def __call__(self, event: Event) -> None:
        """Take an event, and write as much as is taken now."""
        if self.error:
            self.lost += 1
            return
        if len(self._held) >= _LINES:
            self._held.popleft()
            self._untold, self.lost = self._untold + 1, self.lost + 1
        self._held.append(event.line().encode() + b"\n")
        if self._untold and takes_now(self._descriptor):  # in the place of those that are lost
            told = Event(event.counter, "lost", event.at, {"count": self._untold})
            self._held.appendleft(told.line().encode() + b"\n")
            self._untold = 0
        self._write()

    def close(self) -> None:
        """Write what is left, if the reader takes it within a second, and close."""
        until = time.monotonic() + _LAST_S
        while (self._held or self._begun) and not self.error and time.monotonic() < until:
            self._write()
            if self._held or self._begun:
                time.sleep(0.01)
        self.lost += len(self._held) + bool(self._begun)
        self._held.clear()
        with suppress(OSError):
            os.close(self._descriptor)

    def _write(self) -> None:
        try:
            while (self._begun or self._held) and takes_now(self._descriptor):
                self._begun = self._begun or self._held.popleft()
                self._begun = self._begun[os.write(self._descriptor, self._begun[:_PIECE]) :]
        except BlockingIOError:
            return
        except OSError as error:
            self.error = error.strerror or str(error)


def open_lines(target: str) -> EventLines:
    """Open where events are written to."""
    try:
        return EventLines(_opened(target))
    except OSError as error:
        raise UsageError(f"--events {target}: {error.strerror}") from None


def _opened(target: str) -> int:
    if target.isdecimal():
        if int(target) == 1:
            raise UsageError("--events 1: stdout belongs to the result; give a file or another descriptor")
        descriptor = os.dup(int(target))
        if not _writable(descriptor):
            os.close(descriptor)
            raise UsageError(f"--events {target}: this descriptor is not open for writing")
    else:
        mode = os.O_WRONLY | os.O_CREAT | os.O_APPEND
        with suppress(FileNotFoundError):
            if stat.S_ISFIFO(os.stat(target).st_mode):
                mode = os.O_RDWR  # the reader of a pipe may come later, or go and come again
        descriptor = os.open(target, mode | getattr(os, "O_NONBLOCK", 0), 0o666)
    if stat.S_ISSOCK(os.fstat(descriptor).st_mode):
        os.set_blocking(descriptor, False)
    return descriptor


def _writable(descriptor: int) -> bool:
    try:
        import fcntl
    except ImportError:
        return True
    return fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_ACCMODE != os.O_RDONLY


# --------------------
# How far a run is


class Progress:
    """Tells how far a run is, as events; without any, nobody hears it."""

    def __init__(self, events: Events | None = None) -> None:
        self.events = Events() if events is None else events
        self._what, self._total, self._done = "", 0, 0
        self._began = self._all_began = 0.0
        self._all_total = self._all_done = self._all_before = 0
        self._ended = False

    def note(self, text: str) -> None:
        """Say one line."""
        self.events.emit("note", text=text)

    def start(self, what: str, total: int) -> None:
        """Begin to count `total` things."""
        self._what, self._total, self._done = what, total, 0
        self._began = time.monotonic()
        self.events.emit("counting", what=what, total=total)

    def of_all(self, total: int, done: int) -> None:
        """Say how many the whole run has, and how many of them are done, where it counts them in parts."""
        if not self._all_total:
            self._all_before, self._all_done, self._all_began = done, done, time.monotonic()
        self._all_total = total

    def advance(self) -> None:
        """Count one more."""
        self._done += 1
        now = time.monotonic()
        left = (now - self._began) / self._done * max(self._total - self._done, 0)
        facts = {"what": self._what, "done": self._done, "total": self._total, "left_s": round(left, 3)}
        if self._all_total:
            self._all_done += 1
            each = (now - self._all_began) / (self._all_done - self._all_before)
            left = each * max(self._all_total - self._all_done, 0)
            facts |= {"all_done": self._all_done, "all_total": self._all_total, "all_left_s": round(left, 3)}
        self.events.emit("counted", **facts)

    def end(self, exit_code: int, message: str = "") -> None:
        """Say how the command ends; the first time counts."""
        if not self._ended:
            self._ended = True
            self.events.emit("ended", exit_code=exit_code, message=message)


# --------------------
# One line on stdout for each record that is on the disk: for programs that must know what is safe


_OF_RECORD = {"name": "gyrolock record", "version": 1}


class Acknowledgement:
    """Prints the lines. A reader that does not read gets them later: the measurement does not wait for it."""

    def __init__(self) -> None:
        self._held: deque[str] = deque()

    def __call__(self, run: Path, records: "Sequence[tuple[int, NewRecord]]") -> None:
        """Tell of the records of one commit."""
        for number, record in records:
            line = {"schema": _OF_RECORD, "run": str(run), "number": number, "key": record.key}
            self._held.append(json.dumps({**line, "purpose": record.purpose, "conditions": record.conditions}))
        while self._held and takes_now(sys.stdout):
            self._print()

    def rest(self) -> None:
        """Print what the reader has not had yet, however long it takes."""
        while self._held:
            self._print()

    def _print(self) -> None:
        sys.stdout.write(self._held.popleft() + "\n")
        sys.stdout.flush()
