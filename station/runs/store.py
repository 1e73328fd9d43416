"""The record store: one SQLite file a run; what is acknowledged is on the disk.

A record is raw codes, the preamble text as the scope sent it, and the conditions under which it was taken.
Results are kept beside them as a convenience; they can always be computed again.
"""

from __future__ import annotations

import hashlib
import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from station.errors import RunError
from station.runs.database import DatabaseWriter, Layout, create_database, read_facts, reading, utc_now
from station.runs.run_directories import new_run_directory

RUN_FILE = "run.sqlite"
REPORT_FILE = "report.html"
Purpose = Literal["tilt", "measure", "quadrature", "witness"]

LAYOUT = Layout(
    application_id=0x47_59_4C_4B,  # "GYLK"
    version=1,
    tables="""
CREATE TABLE record (
    number     INTEGER PRIMARY KEY,
    taken_at   TEXT NOT NULL,     -- UTC, ISO 8601
    purpose    TEXT NOT NULL,     -- 'tilt', 'measure', 'quadrature' or 'witness'
    codes      BLOB NOT NULL,     -- as the scope sent them: signed bytes
    preamble   TEXT NOT NULL,     -- as the scope sent it
    sha256     TEXT NOT NULL,     -- of codes followed by preamble
    conditions TEXT NOT NULL      -- JSON
);
""",
    name="a saved run of gyrolock",
)


@dataclass(frozen=True)
class SavedRecord:
    """One record of a run.

    Attributes
    ----------
    number : int
        Counts from 1 within the run.
    taken_at : str
        UTC, ISO 8601.
    purpose : str
        ``"tilt"`` for the fast run, ``"measure"`` for the slow rates, ``"quadrature"`` for the second photodiode:
        such a record belongs to the one before it; ``"witness"`` for the modulator staircase of a fibre gyro.
    codes : ndarray, int8, shape (n,)
    preamble : str
        As the scope sent it.
    intact : bool
        Whether codes and preamble still have the checksum they were saved with.
    conditions : dict
        Channel, table rate (deg/s) and azimuth (deg) where they are known, truth of a simulated bench.
    """

    number: int
    taken_at: str
    purpose: str
    codes: NDArray[np.int8]
    preamble: str
    intact: bool
    conditions: dict[str, Any]


@dataclass(frozen=True)
class SavedRun:
    """A run as it was read from its file.

    Attributes
    ----------
    path : Path
        The SQLite file.
    facts : dict
        Settings, identity, provenance, truth, times: what was known beside the records.
    records : tuple of SavedRecord
        In the order in which they were taken.
    results : dict or None
        What was last computed from them.
    """

    path: Path
    facts: dict[str, Any]
    records: tuple[SavedRecord, ...]
    results: dict[str, Any] | None

    def taken_for(self, purpose: str) -> tuple[SavedRecord, ...]:
        """Return the records of one purpose."""
        return tuple(record for record in self.records if record.purpose == purpose)


@dataclass(frozen=True)
class NewRecord:
    """A record that is to be saved; the fields as in :class:`SavedRecord`, the conditions plain JSON."""

    purpose: Purpose
    codes: NDArray[np.integer[Any]]
    preamble: str
    conditions: Mapping[str, object]


class RunWriter(DatabaseWriter):
    """Writes one run. Records that :meth:`save_records` returned for survives a killed process.

    Parameters
    ----------
    directory : Path
        Directory of all runs; made if it is missing.
    facts : mapping
        What is known at the start, by name; values must be plain JSON.

    Raises
    ------
    RunError
        If nothing can be written there.
    """

    def __init__(self, directory: Path, facts: Mapping[str, object]) -> None:
        path = new_run_directory(directory) / RUN_FILE
        create_database(path, LAYOUT)
        super().__init__(path)
        self.save_facts({"started_at": utc_now(), **facts})

    def save_record(
        self, purpose: Purpose, codes: NDArray[np.integer[Any]], preamble: str, conditions: Mapping[str, object]
    ) -> None:
        """Save one record durably; arguments as the fields of :class:`NewRecord`."""
        self.save_records([NewRecord(purpose, codes, preamble, conditions)])

    def save_records(self, records: Sequence[NewRecord]) -> None:
        """Save the records of one acquisition durably: when this returns, all of them are on the disk.

        Parameters
        ----------
        records : sequence of NewRecord

        Raises
        ------
        RunError
            If the disk does not take them: then it holds none of them.
        """
        rows = []
        for record in records:
            blob = record.codes.astype(np.int8, casting="same_kind", copy=False).tobytes()
            circumstances = json.dumps(dict(record.conditions), allow_nan=False)
            checksum = _checksum(blob, record.preamble)
            rows.append((utc_now(), record.purpose, blob, record.preamble, checksum, circumstances))
        columns = "taken_at, purpose, codes, preamble, sha256, conditions"
        self._commit(f"INSERT INTO record ({columns}) VALUES (?, ?, ?, ?, ?, ?)", rows)


def open_run(path: Path) -> SavedRun:
    """Read a run, finished or not, whole or cut short by a crash.

    Parameters
    ----------
    path : Path
        The SQLite file or its directory.

    Returns
    -------
    SavedRun

    Raises
    ------
    RunError
        If there is no run at ``path``.
    """
    file = run_file(path)
    with reading(file, LAYOUT) as db:
        facts, records = read_facts(db), tuple(_read_records(db))
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
        if not (path / RUN_FILE).is_file():
            raise RunError(f"{path}: holds no run (there is no {RUN_FILE} in it)")
        return path / RUN_FILE
    if not path.exists():
        raise RunError(f"{path}: there is no such file")
    return path


def _read_records(db: sqlite3.Connection) -> Iterator[SavedRecord]:
    columns = "number, taken_at, purpose, codes, preamble, sha256, conditions"
    for number, taken_at, purpose, blob, preamble, sha256, conditions in db.execute(
        f"SELECT {columns} FROM record ORDER BY number"
    ):
        yield SavedRecord(
            number=number,
            taken_at=taken_at,
            purpose=purpose,
            codes=np.frombuffer(blob, dtype=np.int8),
            preamble=preamble,
            intact=_checksum(blob, preamble) == sha256,
            conditions=json.loads(conditions),
        )


def _checksum(codes: bytes, preamble: str) -> str:
    return hashlib.sha256(codes + preamble.encode()).hexdigest()
