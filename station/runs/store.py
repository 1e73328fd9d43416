"""The record store: one SQLite file a run; what is acknowledged is on the disk.

A record is what the instrument sent, a header that tells how to read it, and the conditions under which it was
taken: codes and preamble of an oscilloscope, or a stretch of a fibre gyro's output. Results are kept beside the
records as a convenience; they can always be computed again.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from station.errors import RunError
from station.runs.database import (
    DatabaseWriter,
    create_database,
    new_run_directory,
    read_facts,
    reading,
    utc_now,
)
from station.runs.facts import RunFacts
from station.runs.layouts import Layout

RUN_FILE = "run.sqlite"
REPORT_FILE = "report.html"
_RUN_FILES = (RUN_FILE, "fog.sqlite")  # the second is that of fibre-gyro runs of earlier versions
_ASIDE = " (set aside "


@dataclass(frozen=True)
class SavedRecord:
    """One record of a run.

    Attributes
    ----------
    number : int
        Counts from 1 within the run.
    key : str
        What it is, unique in its run: ``"Z +20"``.
    taken_at : str
        UTC, ISO 8601.
    purpose : str
        Which part of which measurement it was taken for: ``"tilt"``, ``"measure"``, ``"table"``, ...
    header : str
        Preamble as the scope sent it, or JSON that describes the columns of an output.
    payload : bytes
        Codes as the scope sent them, or the columns of an output.
    intact : bool
        Whether it still has the checksum that it was saved with.
    conditions : dict
        Channel, table rate, azimuth, injected step...: plain JSON.
    """

    number: int
    key: str
    taken_at: str
    purpose: str
    header: str
    payload: bytes
    intact: bool
    conditions: dict[str, Any]

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
    """A run as it was read from its file.

    Attributes
    ----------
    path : Path
        The SQLite file.
    facts : RunFacts
        What was known beside the records: command, settings, identity, provenance, truth, times, outcome.
    records : tuple of SavedRecord
        In the order in which they were taken.
    results : dict or None
        What was last computed from them.
    """

    path: Path
    facts: RunFacts
    records: tuple[SavedRecord, ...]
    results: dict[str, Any] | None

    def taken_for(self, purpose: str) -> tuple[SavedRecord, ...]:
        """Return the records of one purpose that are not set aside."""
        return tuple(one for one in self.records if one.purpose == purpose and _ASIDE not in one.key)


@dataclass(frozen=True)
class NewRecord:
    """A record that is to be saved; the fields as in :class:`SavedRecord`, the conditions plain JSON."""

    key: str
    purpose: str
    header: str
    payload: bytes
    conditions: Mapping[str, object]


class RunWriter(DatabaseWriter):
    """Writes one run. Records that :meth:`save_records` returned for survives a killed process.

    Use :meth:`create`, or the class itself for a run that is gone on with.
    """

    @classmethod
    def create(cls, parent: Path, facts: Mapping[str, object]) -> Self:
        """Begin a run in a new directory.

        Parameters
        ----------
        parent : Path
            Directory of all runs; made if it is missing.
        facts : mapping
            What is known at the start, by name; values must be plain JSON.

        Raises
        ------
        RunError
            If nothing can be written there.
        """
        path = new_run_directory(parent) / RUN_FILE
        create_database(path)
        writer = cls(path)
        writer.save_facts({"started_at": utc_now(), **facts})
        return writer

    def save_records(self, records: Sequence[NewRecord]) -> None:
        """Save the records of one acquisition durably: when this returns, all of them are on the disk.

        Raises
        ------
        RunError
            If the disk does not take them, or the run has a record of one of the keys: then it holds none of them.
        """
        rows = []
        for record in records:
            conditions = json.dumps(dict(record.conditions), allow_nan=False)
            row = {"key": record.key, "taken_at": utc_now(), "purpose": record.purpose, "header": record.header}
            checksum = self._layout.checksum(record.payload, record.header, conditions)
            rows.append({**row, "payload": record.payload, "sha256": checksum, "conditions": conditions})
        self._commit(self._layout.insert, rows)

    def set_aside(self, key: str) -> None:
        """Keep a record out of the results under another key, so that it can be taken again."""
        counted = f"SELECT count(*) FROM {self._layout.table} WHERE key LIKE ?"
        (before,) = self._db.execute(counted, (f"{key}{_ASIDE}%",)).fetchone()
        renamed = (f"{key}{_ASIDE}{before + 1})", key)
        self._commit(f"UPDATE {self._layout.table} SET key = ? WHERE key = ?", [renamed])


def open_run(path: Path) -> SavedRun:
    """Read a run, finished or not, whole or cut short by a crash.

    Parameters
    ----------
    path : Path
        The SQLite file or its directory.

    Raises
    ------
    RunError
        If there is no run at ``path``.
    """
    file = run_file(path)
    with reading(file) as (db, layout):
        facts, records = RunFacts(read_facts(db)), tuple(_read_records(db, layout))
        results = db.execute("SELECT value FROM result ORDER BY number DESC LIMIT 1").fetchone()
        return SavedRun(file, facts, records, json.loads(results[0]) if results else None)


def run_file(path: Path) -> Path:
    """Return the SQLite file of a run given by its file or by its directory.

    Raises
    ------
    RunError
        If there is none.
    """
    if path.is_dir():
        for name in _RUN_FILES:
            if (path / name).is_file():
                return path / name
        raise RunError(f"{path}: holds no run (there is no {RUN_FILE} in it)")
    if not path.exists():
        raise RunError(f"{path}: there is no such file")
    return path


def _read_records(db: sqlite3.Connection, layout: Layout) -> Iterator[SavedRecord]:
    for number, key, taken_at, purpose, header, payload, sha256, conditions in db.execute(layout.select):
        intact = layout.checksum(payload, header, conditions) == sha256
        yield SavedRecord(number, key, taken_at, purpose, header, payload, intact, json.loads(conditions))
