"""The station's log: what happened, in the words of its events, in files that do not grow for ever."""

from __future__ import annotations

import json
import logging
import logging.handlers
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from station.events.event import Event

FILE = "station.log"
_LARGEST = 1_000_000  # bytes of one file
_KEPT = 9  # files before the one that is written
_NOT_TOLD = frozenset({"counted", "record", "value"})


class StationLog:
    """Reads events and writes lines; a disk that takes none harms nothing."""

    def __init__(self, handler: logging.Handler) -> None:
        self._handler = handler

    def __call__(self, event: Event) -> None:
        """Write an event."""
        if event.kind in _NOT_TOLD:
            return
        told = event.facts.get("text") if event.kind == "note" else json.dumps(dict(event.facts))
        record = logging.LogRecord("gyrolock", logging.INFO, "", 0, f"{event.kind}: {told}", None, None)
        with suppress(OSError, ValueError):
            self._handler.emit(record)


@contextmanager
def station_log(directory: Path) -> Iterator[StationLog]:
    """Open the log of the station, with what the program itself logs; the oldest file goes for a new one."""
    logging.raiseExceptions = False  # a log that cannot be written is not written to stderr either
    handler: logging.Handler
    try:
        directory.mkdir(parents=True, exist_ok=True)
        path = directory / FILE
        handler = logging.handlers.RotatingFileHandler(
            path, maxBytes=_LARGEST, backupCount=_KEPT, encoding="utf-8", errors="replace"
        )
    except OSError:
        handler = logging.NullHandler()
    form = logging.Formatter("%(asctime)s.%(msecs)03dZ %(message)s", "%Y-%m-%dT%H:%M:%S")
    form.converter = time.gmtime  # UTC: no hour that comes twice
    handler.setFormatter(form)
    ours = logging.getLogger("station")
    ours.addHandler(handler)
    try:
        yield StationLog(handler)
    finally:
        ours.removeHandler(handler)
        handler.close()
