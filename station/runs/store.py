"""The record store: one SQLite file a run; what is acknowledged is on the disk.

A record is what the instrument sent, a header that tells how to read it, and the conditions under which it was
taken: codes and preamble of an oscilloscope, or a stretch of a fibre gyro's output. Results are kept beside the
records as a convenience; they can always be computed again.
"""

import itertools
import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from station.errors import RunError
from station.runs.database import (
    COLUMNS,
    DatabaseWriter,
    Layout,
    RunFacts,
    conditions_of,
    create_database,
    new_run_directory,
    read_facts,
    reading,
    utc_now,
)

RUN_FILE = "run.sqlite"
REPORT_FILE = "report.html"
RUN_FILES = (RUN_FILE, "fog.sqlite")  # the second is that of fibre-gyro runs of earlier versions
_ASIDE = " (set aside "
_NAMED = 20  # gaps among the records that are named one by one


class SavedRecord(NamedTuple):
    """One record of a run."""

    number: int  # counts from 1 within the run
    key: str  # what it is, unique in its run: ``"Z +20"``
    taken_at: str  # UTC, ISO 8601
    purpose: str  # which part of which measurement it was taken for: ``"tilt"``, ``"measure"``, ``"table"``, ..
    header: str  # preamble as the scope sent it, or JSON that describes the columns of an output
    payload: bytes  # codes as the scope sent them, or the columns of an output
    intact: bool  # whether it still has the checksum that it was saved with
    conditions: dict[str, Any]  # channel, table rate, azimuth, injected step...: plain JSON

    @property
    def aside(self) -> bool:
        """Whether it is kept, but belongs to no result."""
        return _ASIDE in self.key

    @property
    def codes(self) -> NDArray[np.int8]:
        """Codes of an oscilloscope's record, shape (n,)."""
        return np.frombuffer(self.payload, dtype=np.int8)

    @property
    def preamble(self) -> str:
        """Preamble of an oscilloscope's record, as the scope sent it."""
        return self.header


@dataclass(frozen=True)
class SavedRun:
    """A run as it was read from its file."""

    path: Path  # the SQLite file
    # what was known beside the records: command, settings, identity, provenance, truth, times, outcome
    facts: RunFacts
    # in the order in which they were taken; those of a long run may be read when they are asked for
    records: Sequence[SavedRecord]
    results: dict[str, Any] | None  # what was last computed from them
    # facts that are not what was once saved, and why they are left out
    unusable: Mapping[str, str] = field(default_factory=dict)
    protected: bool = True  # whether damage to a fact would show: an earlier version kept no sums of them
    damaged: tuple[str, ...] = ()  # what of the run is not what was once saved, one sentence each
    excluded: tuple[int, ...] = ()  # numbers of records that were left out as asked

    @property
    def whole(self) -> Self:
        """The run without its damaged records."""
        return replace(self, records=tuple(record for record in self.records if record.intact))

    def taken_for(self, purpose: str) -> tuple[SavedRecord, ...]:
        """Return the records of one purpose that are not set aside."""
        return tuple(one for one in self.records if one.purpose == purpose and not one.aside)


@dataclass(frozen=True)
class NewRecord:
    """A record that is to be saved; the fields as in :class:`SavedRecord`, the conditions plain JSON."""

    # Without `taken_at` it is taken now.

    key: str
    purpose: str
    header: str
    payload: bytes
    conditions: Mapping[str, object]
    taken_at: str = ""


Acknowledge = Callable[[Path, Sequence[tuple[int, "NewRecord"]]], None]
"""Gets the run's path, and the numbers of records with what was saved under them, when they are on the disk."""


class RunWriter(DatabaseWriter):
    """Writes one run. Records that :meth:`save_records` returned for survives a killed process."""

    # Use :meth:`create`, or the class itself for a run that is gone on with.

    acknowledge: Acknowledge | None = None  # is told of records when they are on the disk

    @classmethod
    def create(cls, parent: Path, facts: Mapping[str, object]) -> Self:
        """Begin a run in a new directory."""
        path = new_run_directory(parent) / RUN_FILE
        try:
            create_database(path)
            writer = cls(path)
            writer.save_facts({"started_at": utc_now(), **facts})
        except (RunError, OSError):  # nothing is in it yet, and it could not be gone on with
            shutil.rmtree(path.parent, ignore_errors=True)
            raise
        return writer

    def save_records(self, records: Sequence[NewRecord]) -> None:
        """Save the records of one acquisition durably: when this returns, all of them are on the disk."""
        rows = []
        for record in records:
            conditions = json.dumps(dict(record.conditions), allow_nan=False)
            taken_at = record.taken_at or utc_now()
            row = {"key": record.key, "taken_at": taken_at, "purpose": record.purpose, "header": record.header}
            cells: dict[str, Any] = {**row, "payload": record.payload, "conditions": conditions}
            rows.append({**cells, "sha256": self._layout.checksum(cells)})
        self._commit(self._layout.insert, rows)
        if self.acknowledge is not None:
            (last,) = self._db.execute(f"SELECT max(number) FROM {self._layout.table}").fetchone()
            self.acknowledge(self.path, list(enumerate(records, start=last - len(records) + 1)))

    def set_aside(self, key: str) -> None:
        """Keep a record out of the results under another key, so that it can be taken again."""
        counted = f"SELECT count(*) FROM {self._layout.table} WHERE key LIKE ?"
        (before,) = self._db.execute(counted, (f"{key}{_ASIDE}%",)).fetchone()
        renamed = f"UPDATE {self._layout.table} SET key = ?, sha256 = ? WHERE number = ?"
        for row in self._db.execute(self._layout.select).fetchall():
            record = read_record(row, self._layout)
            if record.key == key:
                cells = {**dict(zip(COLUMNS, row, strict=True)), "key": f"{key}{_ASIDE}{before + 1})"}
                # one that is damaged stays so: its sum must not become right again
                checksum = self._layout.checksum(cells) if record.intact else cells["sha256"]
                self._commit(renamed, [(cells["key"], checksum, record.number)])


def open_run(path: Path) -> SavedRun:
    """Read a run, finished or not, whole or cut short by a crash."""
    file = run_file(path)
    with reading(file) as (db, layout):
        facts, unusable, protected = read_facts(db)
        records = tuple(read_record(row, layout) for row in db.execute(layout.select))
        results = db.execute("SELECT value FROM result ORDER BY number DESC LIMIT 1").fetchone()
        damaged = tuple(damage_of(records, unusable))
        return SavedRun(file, RunFacts(facts), records, results_of(results), unusable, protected, damaged)


def read_record(row: Sequence[Any], layout: Layout) -> SavedRecord:
    """Return a record from its cells, as `layout` selects them; a cell that is none costs this record only."""
    cells = dict(zip(COLUMNS, row, strict=True))
    conditions = conditions_of(cells["conditions"])
    try:
        intact = conditions is not None and layout.checksum(cells) == cells["sha256"]
    except (TypeError, AttributeError, ValueError):
        intact = False
    key, taken_at, purpose, header = (
        cells[name] if isinstance(cells[name], str) else "" for name in ("key", "taken_at", "purpose", "header")
    )
    return SavedRecord(
        number=cells["number"],
        key=key or f"record {cells['number']}",
        taken_at=taken_at,
        purpose=purpose,
        header=header,
        payload=cells["payload"] if isinstance(cells["payload"], bytes) else b"",
        intact=intact and bool(key and header),
        conditions=conditions or {},
    )


def damage_of(records: Sequence[SavedRecord], unusable: Mapping[str, str]) -> Iterator[str]:
    """Say in one sentence each what of a run is not what was once saved."""
    yield from (said for record in records if (said := damaged_record(record)))
    yield from missing_records(sorted({record.number for record in records if record.number > 0}))
    yield from damaged_facts(unusable)


def damaged_record(record: SavedRecord) -> str:
    """Say that a record is damaged; nothing if it is not, or counts in no result."""
    return "" if record.intact or record.aside else f"record {record.number} ({record.key}) is damaged"


def missing_records(numbers: Iterable[int]) -> Iterator[str]:
    """Say which records are missing between those that are there, by their rising numbers from 1."""
    pairs = itertools.pairwise(itertools.chain([0], numbers))
    gaps = list(itertools.islice(((low + 1, high) for low, high in pairs if high > low + 1), _NAMED + 1))
    for first, behind in gaps[:_NAMED]:
        last = behind - 1
        yield f"record {first} is missing" if first == last else f"records {first} to {last} are missing"
    if len(gaps) > _NAMED:
        yield "further records are missing"


def damaged_facts(unusable: Mapping[str, str]) -> Iterator[str]:
    """Say which facts of a run are not what was once saved."""
    yield from (f"what the run knows of itself is damaged: {name} {why}" for name, why in unusable.items())


def results_of(row: Sequence[Any] | None) -> dict[str, Any] | None:
    """The results of a run, from the row that holds them; ``None`` where there are none that can be read."""
    try:
        found = json.loads(row[0]) if row else None
    except (TypeError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def run_file(path: Path) -> Path:
    """Return the SQLite file of a run given by its file or by its directory."""
    if path.is_dir():
        for name in RUN_FILES:
            if (path / name).is_file():
                return path / name
        raise RunError(f"{path}: holds no run (there is no {RUN_FILE} in it)")
    if not path.exists():
        raise RunError(f"{path}: there is no such file")
    if not path.is_file():  # a device has no end, and a pipe waits for its writer
        raise RunError(f"{path}: is not a saved run")
    return path
