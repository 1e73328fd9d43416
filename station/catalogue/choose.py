"""Which runs of the list are wanted, and in which order."""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from station.catalogue.entry import Entry
from station.errors import UsageError

NO_LIMITS = "none"
"""Asks for runs without a verdict, or without a mark."""


@dataclass(frozen=True)
class Wanted:
    """What a run must be to be listed; what is empty or ``None`` asks for nothing."""

    command: str = ""  # patterns with ``*`` and ``?``; capital letters do not count
    unit: str = ""
    operator: str = ""
    gyro: str = ""
    verdict: str = ""  # {"PASS", "FAIL", "none", ""}
    mark: str = ""  # {"good", "bad", "none", ""}
    tags: tuple[str, ...] = ()  # all of them
    text: str = ""  # stands in a note, whoever wrote it
    since: str = ""  # UTC, ISO 8601, from its beginning: ``"2026-11"`` is the whole month in both
    until: str = ""

    def admits(self, entry: Entry) -> bool:
        """Whether a run is wanted."""
        return (
            all(
                _like(getattr(entry, name), getattr(self, name))
                for name in ("command", "unit", "operator", "gyro")
            )
            and self.verdict in ("", entry.verdict or NO_LIMITS)
            and self.mark in ("", entry.mark or NO_LIMITS)
            and set(self.tags) <= set(entry.tags)
            and (not self.text or self.text.casefold() in _notes(entry).casefold())
            and entry.started_at >= self.since
            and (not self.until or entry.started_at[: len(self.until)] <= self.until)
        )


def chosen(entries: Iterable[Entry], wanted: Wanted, sort: Sequence[str] = ()) -> list[Entry]:
    """Return the runs that are wanted, in the order that is wanted."""
    found = [entry for entry in entries if wanted.admits(entry)]
    for name in reversed(sort):
        key = name.removeprefix("-")
        if key not in ORDERS:
            raise UsageError(f"runs cannot be sorted by {key!r}, only by {', '.join(ORDERS)}")
        found.sort(key=ORDERS[key], reverse=name.startswith("-"))
    return found


def _result(entry: Entry) -> tuple[str, float]:
    """Results of one kind together; what is none comes last."""
    first = next(iter(entry.values), None)
    return ("~", math.inf) if first is None or math.isnan(first.value) else (first.name, first.value)


ORDERS: dict[str, Callable[[Entry], Any]] = {
    "when": lambda entry: entry.started_at,
    "command": lambda entry: entry.command,
    "unit": lambda entry: entry.unit or "",
    "operator": lambda entry: entry.operator or "",
    "result": _result,
    "records": lambda entry: entry.records,
    "verdict": lambda entry: entry.verdict or "~",
    "mark": lambda entry: entry.mark or "~",
}


def _like(text: str | None, pattern: str) -> bool:
    return not pattern or fnmatch.fnmatchcase((text or "").casefold(), pattern.casefold())


def _notes(entry: Entry) -> str:
    return "\n".join([entry.note or "", *(str(one.get("note", "")) for one in entry.remarks)])
