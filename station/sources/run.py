"""A saved run as a source: read record by record, so that its length costs no memory."""

from __future__ import annotations

import hashlib
import json
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, overload

from station.runs.database import (
    COLUMNS,
    NUMBERED,
    TODAY,
    Layout,
    RunFacts,
    conditions_of,
    opened,
    read_facts,
    reading,
    told,
)
from station.runs.store import SavedRecord, SavedRun, damaged_facts, missing_records, read_record, run_file
from station.sources.batches import MOST_BYTES, MOST_RECORDS, Source, Stretch

AT_ONCE = 1000

MEASUREMENT = ("command", "settings", "truth", "injected", "rates", "rates_without_beat", "logs")
"""Facts that a result may rest on; the others say how the run went."""


class RunSource(Source):
    """One run."""

    kind = "run"

    def __init__(self, path: Path, held: ExitStack | None = None) -> None:
        self.path = run_file(path)
        self.name = str(self.path)
        self._open = None if held is None else opened(self.path, held)
        with self._reading() as (db, _):
            facts, self.unusable, self.protected = read_facts(db)
        self.facts, self._sha256 = RunFacts(facts), ""

    @contextmanager
    def _reading(self) -> Iterator[tuple[sqlite3.Connection, Layout]]:
        if self._open is None:
            with reading(self.path) as found:
                yield found
        else:
            with told(self.path):
                yield self._open

    @cached_property
    def _numbers(self) -> tuple[int | None, int | None, int]:
        """Least and largest number, and how many: found when it is asked for, since all records are counted."""
        with self._reading() as (db, layout):
            counted = f"SELECT min(number), max(number), count(*) FROM {layout.table} WHERE {NUMBERED}"
            found = db.execute(counted).fetchone()
        return found[0], found[1], int(found[2])

    @cached_property
    def damaged(self) -> tuple[str, ...]:  # type: ignore[override]  # found when it is asked for
        """Records that are missing, and facts that are damaged; see `Source`."""
        first, last, count = self._numbers
        gaps: tuple[str, ...] = ()
        if first is not None and (first, last) != (1, count):
            with self._reading() as (db, layout):
                rows = db.execute(
                    f"SELECT number FROM {layout.table} WHERE {NUMBERED} AND number > 0 ORDER BY number"
                )
                gaps = tuple(missing_records(number for (number,) in rows))
        return (*gaps, *damaged_facts(self.unusable))

    @property
    def span(self) -> tuple[int, int]:
        """Least and largest number of the records; see `Source`."""
        first, last, count = self._numbers
        if first is None or last is None:
            return 1, 0
        # a damaged run may hold any number: then it is read as a whole
        return (first, last) if last - first < 2 * count + AT_ONCE else (1, 1)

    def __len__(self) -> int:
        return self._numbers[2]

    def records(self, numbers: range | None = None) -> Iterator[SavedRecord]:
        """Read the records one at a time; see `Source`."""
        for stretch in self.stretches(numbers):
            yield from stretch.records()

    def stretches(self, numbers: range | None = None) -> Iterator[Stretch]:
        """Read the records, those together that are alike; see `Source`."""
        digest = self._of_facts() if numbers is None else None
        with self._reading() as (db, layout):
            db.text_factory = bytes  # decoded below: most texts of a run are the same
            if numbers is None:
                rows = db.execute(layout.select)
            else:
                rows = db.execute(layout.select_between, (numbers.start, numbers.stop - 1))
            for stretch, sums in _stretches(rows, layout):
                if digest is not None:
                    digest.update(b"".join(map(_line, stretch.numbers, sums)))
                yield stretch
        if digest is not None:
            self._sha256 = digest.hexdigest()

    @property
    def sha256(self) -> str:
        """SHA-256 of the measurement; see `Source`. Whoever has read all records has it already."""
        if not self._sha256:
            digest = self._of_facts()
            with self._reading() as (db, layout):
                db.text_factory = bytes
                of_each = f"SELECT number, sha256 FROM {layout.table} WHERE {NUMBERED} ORDER BY number"
                for number, sum_ in db.execute(of_each):
                    digest.update(_line(number, sum_))
            self._sha256 = digest.hexdigest()
        return self._sha256

    def _of_facts(self) -> hashlib._Hash:
        """Sum of what a result may rest on beside the records; theirs follow in it."""
        digest = hashlib.sha256()
        for name in MEASUREMENT:
            if name in self.facts:
                text = json.dumps(self.facts[name], sort_keys=True, allow_nan=False)
                digest.update(f"{name} {text}\n".encode())
        return digest


def _stretches(rows: Iterable[tuple[Any, ...]], layout: Layout) -> Iterator[tuple[Stretch, list[Any]]]:
    """Stretches of the rows of a run, and the saved checksum of each record; on an error, what came before it."""
    texts, parsed = _Cache(_decoded), _Cache(conditions_of)
    waiting, sums, alike, room = None, list[Any](), None, 0
    try:
        for row in rows:
            number, key, taken_at, purpose, header, payload, sum_, said = row
            right = layout is TODAY and _sum(row) == sum_ and parsed[said] is not None
            like = (purpose, header, said) if right else None
            if waiting is not None and like is not None and like == alike and room > 0:
                waiting.numbers.append(number)
                waiting.keys.append(_decoded(key))
                waiting.taken_at.append(_decoded(taken_at))
                waiting.payloads.append(payload)
                sums.append(sum_)
                room -= 1
                continue
            if waiting is not None:
                yield waiting, sums
            if right:
                taken = _decoded(key), _decoded(taken_at), texts[purpose], texts[header]
                record = SavedRecord(number, *taken, payload, True, parsed[said])
            else:
                decoded = [_decoded(c) if type(c) is bytes and n != _PAYLOAD else c for n, c in enumerate(row)]
                record = read_record(decoded, layout)
            waiting, sums, alike = Stretch.of(record), [sum_], like
            room = min(MOST_RECORDS, MOST_BYTES // max(1, len(record.payload))) - 1
    except sqlite3.Error:
        if waiting is not None:
            yield waiting, sums
        raise
    if waiting is not None:
        yield waiting, sums


def _line(number: Any, sum_: Any) -> bytes:
    return b"%d %b\n" % (number, sum_ if type(sum_) is bytes else str(sum_).encode())


_PAYLOAD = COLUMNS.index("payload")


def _sum(row: tuple[Any, ...]) -> bytes | None:
    """SHA-256 of a record as today's layout makes it; ``None`` where a cell is neither text nor bytes."""
    _, key, taken_at, purpose, header, payload, _, said = row
    try:
        data = b"%d %b%d %b%d %b%d %b%d %b%d %b" % (
            *(len(key), key, len(taken_at), taken_at, len(purpose), purpose),
            *(len(header), header, len(payload), payload, len(said), said),
        )
    except TypeError:
        return None
    return hashlib.sha256(data).hexdigest().encode()


def _decoded(cell: bytes) -> str:
    return cell.decode("utf-8", errors="replace")


class _Cache(dict[bytes, Any]):
    """What was made of texts, as long as there are few."""

    def __init__(self, make: Callable[[bytes], Any]) -> None:
        super().__init__()
        self._make = make

    def __missing__(self, cell: bytes) -> Any:
        made = self._make(cell)
        if len(self) < 1000:
            self[cell] = made
        return made


class SavedRecords(Sequence[SavedRecord]):
    """The records of a source, read from it each time they are asked for."""

    def __init__(self, source: Source) -> None:
        self.source = source

    def __iter__(self) -> Iterator[SavedRecord]:
        return self.source.records()

    def __len__(self) -> int:
        return sum(1 for _ in self.source.records())

    @overload
    def __getitem__(self, place: int) -> SavedRecord: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[SavedRecord]: ...
    def __getitem__(self, place: int | slice) -> SavedRecord | Sequence[SavedRecord]:
        return list(self.source.records())[place]


class HeldRun(Source):
    """A run whose records are in memory: one that was just taken."""

    kind = "run"

    def __init__(self, run: SavedRun) -> None:
        self.run, self.path, self.name, self.facts = run, run.path, str(run.path), run.facts
        self.unusable, self.protected = run.unusable, run.protected

    def records(self, numbers: range | None = None) -> Iterator[SavedRecord]:
        """Give the records; see `Source`."""
        return (one for one in self.run.records if numbers is None or one.number in numbers)

    def __len__(self) -> int:
        return len(self.run.records)

    @property
    def sha256(self) -> str:
        """Nobody asks for it."""
        return ""


def read_as_needed(source: Source) -> SavedRun:
    """Return a source as a run that reads its records each time they are asked for."""
    facts, records = source.facts, SavedRecords(source)
    return SavedRun(source.path, facts, records, None, source.unusable, source.protected, source.damaged)


def source_of(run: SavedRun) -> Source:
    """Return what the records of a run are read from."""
    return run.records.source if isinstance(run.records, SavedRecords) else HeldRun(run)
