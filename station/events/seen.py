"""What one record says at once, beside the measurement: for displays, never for the result."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from station.errors import one_line

if TYPE_CHECKING:
    from station.events.event import Events
    from station.runs.store import NewRecord

_BEHIND = 200  # acquisitions that may wait to be fitted; more are not shown
_LAST_S = 1.0  # for so long the end of a run waits for values that are still to come


@dataclass(frozen=True)
class Value:
    """A number with its standard uncertainty, of noise alone."""

    name: str  # with the unit at its end: ``"lock_in_rate_dps"``
    value: float
    u: float
    text: str  # as a person reads it
    records: int = 1  # how many it is of


@dataclass(frozen=True)
class Trace:
    """A few periods of a record, and its fit at the same times; at most some hundred points."""

    seconds: float  # from the first point to the last
    unit: str
    samples: Sequence[float]
    fit: Sequence[float] = ()


@dataclass(frozen=True)
class Seen:
    """What a record says."""

    key: str
    group: str  # what is taken together: records at one rate
    values: tuple[Value, ...]  # of this record
    # of all records of its group so far; the first is the one to show in a table of groups
    running: tuple[Value, ...] = ()
    so_far: tuple[Value, ...] = ()  # of all records so far
    flags: tuple[str, ...] = ()
    trace: Trace | None = None


See = Callable[[Sequence["NewRecord"]], Seen | None]
"""Gets the records of one acquisition in the order in which they come; ``None`` if they are not to be shown."""


class Watcher:
    """Fits records as they come, in a thread of its own: what is too slow for it is not shown."""

    def __init__(self, events: Events, see: See) -> None:
        self._events, self._see = events, see
        self._queue: queue.Queue[Sequence[NewRecord] | None] = queue.Queue(_BEHIND)
        self._thread = threading.Thread(target=self._work, name="values", daemon=True)
        self._thread.start()

    def __call__(self, records: Sequence[NewRecord]) -> None:
        """Take the records of one acquisition; returns at once."""
        with suppress(queue.Full):
            self._queue.put_nowait(records)

    def close(self) -> None:
        """Let it finish what it has, for a second at most."""
        with suppress(queue.Full):
            self._queue.put_nowait(None)
            self._thread.join(_LAST_S)

    def _work(self) -> None:
        while (records := self._queue.get()) is not None:
            facts: dict[str, Any] = {"key": records[0].key}
            try:
                seen = self._see(records)
                if seen is None:
                    continue
                facts = dict(vars(seen))
            except Exception as error:  # a record that nobody can read spoils its own line only
                facts["problem"] = one_line(error)
            self._events.emit("value", **facts)
