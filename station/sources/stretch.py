"""Records one behind the other that share all but number, key, time and codes, as most of a run do."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Self

from instrument import InstrumentError
from station.errors import StationError
from station.runs.store import SavedRecord

MOST_RECORDS, MOST_BYTES = 1000, 4_000_000
"""A stretch ends here: it is held in memory."""


@dataclass(slots=True)
class Stretch:
    """Some records; numbers, keys, times and payloads as of `SavedRecord`, a place for each record."""

    numbers: list[int]
    keys: list[str]
    taken_at: list[str]
    payloads: list[bytes]
    # of every one of them. A damaged record is a stretch of its own.
    purpose: str
    header: str
    intact: bool
    conditions: dict[str, Any]

    @classmethod
    def of(cls, record: SavedRecord) -> Self:
        """Return a stretch of one record."""
        number, key, taken_at, purpose, header, payload, intact, conditions = record
        return cls([number], [key], [taken_at], [payload], purpose, header, intact, conditions)

    def __len__(self) -> int:
        return len(self.numbers)

    def records(self) -> Iterator[SavedRecord]:
        """Give the records one at a time."""
        for number, key, taken_at, payload in zip(
            self.numbers, self.keys, self.taken_at, self.payloads, strict=True
        ):
            yield SavedRecord(
                number, key, taken_at, self.purpose, self.header, payload, self.intact, self.conditions
            )

    def goes_on_with(self, record: SavedRecord) -> bool:
        """Whether a record belongs to it."""
        return (
            self.intact
            and record.intact
            and record.purpose == self.purpose
            and record.header == self.header
            and record.conditions == self.conditions
            and len(self) < min(MOST_RECORDS, MOST_BYTES / max(1, len(record.payload)))
        )

    def add(self, record: SavedRecord) -> None:
        """Take one more record."""
        self.numbers.append(record.number)
        self.keys.append(record.key)
        self.taken_at.append(record.taken_at)
        self.payloads.append(record.payload)


def stretches_of(records: Iterable[SavedRecord]) -> Iterator[Stretch]:
    """Put records together that follow each other and are alike; what was read before an error comes first."""
    waiting: Stretch | None = None
    try:
        for record in records:
            if waiting is not None and waiting.goes_on_with(record):
                waiting.add(record)
                continue
            if waiting is not None:
                yield waiting
            waiting = Stretch.of(record)
    except (StationError, InstrumentError, OSError):
        if waiting is not None:
            yield waiting
        raise
    if waiting is not None:
        yield waiting
