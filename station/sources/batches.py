"""Records of many sources in batches: codes as one array, in bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument import InstrumentError, Preamble
from station.errors import NoUsableSignal, StationError
from station.runs.store import SavedRecord
from station.sources.over_time import check_over_time
from station.sources.source import Source
from station.sources.stretch import Stretch

AT_ONCE = 1000
"""Records in a batch: 2.5 MB of codes. Results do not depend on it."""


@dataclass(frozen=True)
class LeftOut:
    """Something that could not be read: a whole source, or one record of it."""

    source: str
    record: str | None
    reason: str

    def __str__(self) -> str:
        return f"{self.source}: {self.reason}" if self.record is None else f"{self.source}: record {self.reason}"


@dataclass(frozen=True)
class RecordBatch:
    """Records of one length and time base."""

    # (n, n_samples): Contiguous; -128 means "no data". int16 from scopes with more than eight bits.
    codes: NDArray[np.int8] | NDArray[np.int16]
    preambles: tuple[Preamble, ...]  # of each record, as it was read; equal ones are one object
    records: tuple[SavedRecord, ...] = ()  # as they were saved; empty where nobody needs them
    sources: tuple[Source, ...] = ()  # that of each record, where they are read from several

    def __len__(self) -> int:
        return len(self.preambles)

    @property
    def sample_interval(self) -> float:
        """Seconds between two samples."""
        return self.preambles[0].xincr


def batches_of(
    sources: Iterable[Source],
    left_out: Callable[[LeftOut], None],
    *,
    at_once: int = AT_ONCE,
    wanted: Callable[[SavedRecord], bool] = lambda record: True,
) -> Iterator[RecordBatch]:
    """Read all records of oscilloscopes, source by source, in batches."""
    open_batches: dict[tuple[int, float, int], list[tuple[SavedRecord, Preamble, Source]]] = {}
    held = 0
    for source in sources:
        try:
            for record in source.records():
                if not wanted(record):
                    continue
                one = read_one(record, source, left_out)
                if one is None:
                    continue
                shape = one[1].nr_pt, one[1].xincr, one[1].byt_nr
                batch = open_batches.setdefault(shape, [])
                batch.append(one)
                held += 1
                if len(batch) >= at_once:
                    yield _collected(open_batches.pop(shape))
                    held -= at_once
                elif held >= 2 * at_once:
                    for shape in list(open_batches):
                        yield _collected(open_batches.pop(shape))
                    held = 0
        except (StationError, InstrumentError, OSError) as error:
            left_out(LeftOut(source.name, None, _without_name(str(error), source.name)))
    for batch in open_batches.values():
        yield _collected(batch)


def read_one(
    record: SavedRecord, source: Source, left_out: Callable[[LeftOut], None]
) -> tuple[SavedRecord, Preamble, Source] | None:
    """See that a record can be used; what cannot is left out, and `left_out` is told why."""
    preamble = preamble_of(Stretch.of(record))
    if preamble is not None:
        return record, preamble, source
    left_out(LeftOut(source.name, record.key, why_not(record)))
    return None


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


def _collected(rows: list[tuple[SavedRecord, Preamble, Source]]) -> RecordBatch:
    """Put records of one length and time base into one batch."""
    records, preambles, sources = zip(*rows, strict=True)
    return RecordBatch(codes_of([record.payload for record in records], preambles[0]), preambles, records, sources)


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


def _without_name(text: str, name: str) -> str:
    return text.removeprefix(f"{name}: ")
