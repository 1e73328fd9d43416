"""What happens while something is measured: one event at a time, told to all who read.

A reader that fails is not asked again, and what is measured goes on.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

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
    "counted": ("what done total left_s", "one more; the time left is a guess from those so far"),
    "record": ("run number key purpose conditions", "a record is on the disk"),
    "value": ("key group values running so_far flags trace problem", "what one record says, and all so far"),
    "link": ("repeated reconnected set_again text", "what it took so far to keep the link"),
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
        from station.results.as_json import plain  # needs NumPy

        with self._lock:
            self._counter += 1
            event = Event(self._counter, kind, now_text(), plain(facts))
            for reader in tuple(self._readers):
                try:
                    reader(event)
                except Exception:  # whatever it is: it is the reader's, and not the measurement's
                    self._readers.remove(reader)


def now_text() -> str:
    """Return the time, UTC, ISO 8601 with milliseconds."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
