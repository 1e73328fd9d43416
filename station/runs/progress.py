"""How far a run is, told as events; records acknowledged one a line."""

from __future__ import annotations

import json
import sys
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from station.live.events import Events
from station.terminal import takes_now

if TYPE_CHECKING:
    from station.runs.store import NewRecord


class Progress:
    """Tells how far a run is."""

    def __init__(self, events: Events | None = None, *, quiet: bool = False) -> None:
        if events is None:
            events = Events()
            if not quiet:
                from station.live.console import PlainLines

                events.read_by(PlainLines())
        self.events = events
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


SCHEMA = {"name": "gyrolock record", "version": 1}


class Acknowledgement:
    """Prints the lines. A reader that does not read gets them later: the measurement does not wait for it."""

    def __init__(self) -> None:
        self._held: deque[str] = deque()

    def __call__(self, run: Path, records: Sequence[tuple[int, NewRecord]]) -> None:
        """Tell of the records of one commit."""
        for number, record in records:
            line = {"schema": SCHEMA, "run": str(run), "number": number, "key": record.key}
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
