"""What a source of records is, and its records in batches: codes as one array, in bounded memory."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from instrument import InstrumentError, Preamble, Waveform
from station.errors import NoUsableSignal, StationError
from station.runs.database import RunFacts
from station.runs.store import SavedRecord

# --------------------
# What every source of records gives, whatever its layout


class Source(ABC):
    """Records that were taken together: one run, or one file of an oscilloscope. It is read anew each time."""

    path: Path  # the file that holds it: that of the run, the CSV or ISF file, or the data set
    name: str  # what it is called in results: its path, or in a data set the path that it was exported from
    kind: str  # {"run", "csv", "isf", "curve", "data set"}: How it is laid out
    facts: RunFacts  # what is known beside the records; of a file what it says of its oscilloscope
    unusable: Mapping[str, str]  # facts that are not what was once saved, and why they are left out
    protected: bool = True  # whether damage to a fact would show
    # records that are missing and facts that are damaged; damaged records show when they are read
    damaged: tuple[str, ...] = ()

    @abstractmethod
    def records(self, numbers: range | None = None) -> Iterator[SavedRecord]:
        """Read the records in the order in which they were taken, one at a time, damaged ones too."""

    def stretches(self, numbers: range | None = None) -> Iterator[Stretch]:
        """Read the same records, those together that lie one behind the other and are alike."""
        # Errors are those of `records`; what could be read before comes first.
        return stretches_of(self.records(numbers))

    def __str__(self) -> str:
        return self.name

    @abstractmethod
    def __len__(self) -> int:
        """Return how many records it holds."""

    @property
    def span(self) -> tuple[int, int]:
        """Least and largest number of the records; (1, 0) where there are none, (1, 1) where they say nothing."""
        return 1, 1

    @property
    @abstractmethod
    def sha256(self) -> str:
        """SHA-256 of records, settings and command: the same measurement has the same, wherever it lies.

        Notes, results and how the run ended do not count: they change no number.
        """

    @property
    def is_run(self) -> bool:
        """Whether it was taken by a measurement of ours, with its settings."""
        return bool(self.facts.get("settings")) or self.kind == "run"


AT_ONCE = 1000
"""Records in a batch: 2.5 MB of codes. Results do not depend on it."""


NO_RECORD = "holds no record"  # why a source that can be read is left out


@dataclass(frozen=True)
class ExcludedRecord:
    """Something that could not be read: a whole source, or one record of it."""

    source: str
    record: str | None
    reason: str
    damaged: bool = False  # whether it is not what was once saved

    def __str__(self) -> str:
        return f"{self.source}: {self.reason}" if self.record is None else f"{self.source}: record {self.reason}"


@dataclass(frozen=True)
class RecordBatch:
    """Records of one length and time base."""

    # (n, n_samples): Contiguous; -128 means "no data". int16 from scopes with more than eight bits.
    codes: NDArray[np.int8] | NDArray[np.int16]
    preambles: tuple[Preamble, ...]  # of each record, as it was read; equal ones are one object

    def __len__(self) -> int:
        return len(self.preambles)

    @property
    def sample_interval(self) -> float:
        """Seconds between two samples."""
        return self.preambles[0].xincr


def preamble_of(stretch: Stretch) -> Preamble | None:
    """Preamble of records that can be used; ``None`` where not all of them can, see `why_not`."""
    if not stretch.intact:
        return None
    try:
        preamble = usable_preamble(stretch.header)
    except (InstrumentError, NoUsableSignal):
        return None
    return preamble if set(map(len, stretch.payloads)) == {preamble.nr_pt * preamble.byt_nr} else None


def why_not(record: SavedRecord) -> str:
    """Say of a record that cannot be used what is wrong with it."""
    reason = "is damaged: it is not what was once saved"
    if record.intact:
        try:
            points = usable_preamble(record.header).nr_pt
            reason = f"has {len(record.payload)} bytes of codes, its preamble says {points} points"
        except (InstrumentError, NoUsableSignal) as error:
            reason = f"cannot be used: {error}"
    return f"{record.number} ({record.key}) {reason}"


@lru_cache(maxsize=4096)
def usable_preamble(text: str) -> Preamble:
    """The preamble of a record over time; an error for other records."""
    preamble = Preamble.parse(text)
    check_over_time(preamble, "it")
    return preamble


def codes_of(payloads: Sequence[bytes], preamble: Preamble) -> NDArray[np.int8] | NDArray[np.int16]:
    """Codes (n, n_samples) of records of the length that a preamble says."""
    wide = preamble.byt_nr > 1
    codes: NDArray[Any] = np.frombuffer(b"".join(payloads), ">i2" if wide else np.int8)
    codes = codes.reshape(len(payloads), preamble.nr_pt)
    return codes.astype(np.int16) if wide else codes


# --------------------
# Records one behind the other that share all but number, key, time and codes, as most of a run do


MOST_RECORDS, MOST_BYTES = 1000, 4_000_000  # a stretch ends here: it is held in memory


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


# --------------------
# What only looks like a record of a beat over time


def check_over_time(waveform: Waveform | Preamble, name: str) -> None:
    """Refuse what only looks like a record."""
    preamble = waveform if isinstance(waveform, Preamble) else waveform.preamble
    unit = preamble.xunit
    if unit.lower() in ("v", "volts"):
        raise NoUsableSignal(f"{name}: is an XY record ({unit} across), none over time: save the channel itself")
    if unit.lower() != "s":
        raise NoUsableSignal(f"{name}: is a spectrum ({unit}), not a record over time: save the channel itself")
    if preamble.pt_fmt == "ENV" or "pk detect" in preamble.wfid.lower():
        raise NoUsableSignal(
            f"{name}: was taken with Peak Detect: it holds minima and maxima, not samples; use SAMPLE mode"
        )
