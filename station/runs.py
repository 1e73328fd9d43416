"""The record store: one SQLite file a run; what is acknowledged is on the disk.

A record is raw codes, the preamble text as the scope sent it, and the conditions under which it was taken.
Results are kept beside them as a convenience; they can always be computed again.
"""

from __future__ import annotations

import hashlib
import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from station.errors import RunError
from station.run_directories import new_run_directory

RUN_FILE = "run.sqlite"
REPORT_FILE = "report.html"
APPLICATION_ID = 0x47_59_4C_4B  # "GYLK": `file run.sqlite` and open_run tell our files from others
LAYOUT = 1
Purpose = Literal["tilt", "measure", "quadrature", "witness"]

_SCHEMA = """
CREATE TABLE run (
    name  TEXT PRIMARY KEY,       -- settings, identity, provenance, truth, started_at, ended_at, outcome, ...
    value TEXT NOT NULL           -- JSON
) WITHOUT ROWID;
CREATE TABLE record (
    number     INTEGER PRIMARY KEY,
    taken_at   TEXT NOT NULL,     -- UTC, ISO 8601
    purpose    TEXT NOT NULL,     -- 'tilt', 'measure', 'quadrature' or 'witness'
    codes      BLOB NOT NULL,     -- as the scope sent them: signed bytes
    preamble   TEXT NOT NULL,     -- as the scope sent it
    sha256     TEXT NOT NULL,     -- of codes followed by preamble
    conditions TEXT NOT NULL      -- JSON
);
CREATE TABLE result (             -- computed from the records; never the truth
    number      INTEGER PRIMARY KEY,
    computed_at TEXT NOT NULL,
    value       TEXT NOT NULL     -- JSON
);
"""


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


class RunWriter:
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
        self.path = new_run_directory(directory) / RUN_FILE
        try:
            _create(self.path)
            self._db = sqlite3.connect(self.path, isolation_level=None)  # every BEGIN and COMMIT is written here
            self._db.execute("PRAGMA journal_mode = WAL")
            self._db.execute("PRAGMA synchronous = FULL")
        except sqlite3.Error as error:
            raise RunError(f"{self.path}: cannot be written ({error})") from error
        self.save_facts({"started_at": utc_now(), **facts})

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def save_facts(self, facts: Mapping[str, object]) -> None:
        """Save or replace what is known about the run, by name, in one commit."""
        rows = [(name, json.dumps(value, allow_nan=False)) for name, value in facts.items()]
        self._commit("INSERT OR REPLACE INTO run VALUES (?, ?)", rows)

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

    def close(self) -> None:
        """End the run: afterwards it is one plain file, fit for a read-only or a shared disk."""
        with suppress(sqlite3.Error):  # while a reader looks, the journal stays: the run is complete all the same
            self._db.execute("PRAGMA journal_mode = DELETE")
        self._db.close()

    def _commit(self, statement: str, rows: Sequence[tuple[object, ...]]) -> None:
        try:
            self._db.execute("BEGIN IMMEDIATE")
            try:
                self._db.executemany(statement, rows)
                self._db.execute("COMMIT")
            except BaseException:
                self._db.execute("ROLLBACK")
                raise
        except sqlite3.Error as error:
            raise RunError(f"{self.path}: the disk does not take the record ({error})") from error


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
    if not is_run(file):
        raise RunError(f"{file}: is not a saved run")
    try:
        with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as db:
            _check_layout(db, file)
            facts = {name: json.loads(value) for name, value in db.execute("SELECT name, value FROM run")}
            records = tuple(_read_records(db))
            results = db.execute("SELECT value FROM result ORDER BY number DESC LIMIT 1").fetchone()
    except (sqlite3.Error, ValueError) as error:
        raise RunError(f"{file}: is damaged and cannot be read ({error})") from error
    return SavedRun(file, facts, records, json.loads(results[0]) if results else None)


def save_results(path: Path, results: Mapping[str, object]) -> None:
    """Keep what was computed from the records of a finished run beside them.

    Parameters
    ----------
    path : Path
        The SQLite file.
    results : mapping
        Plain JSON values.

    Raises
    ------
    RunError
        If the disk does not take it.
    """
    try:
        with closing(sqlite3.connect(path)) as db, db:
            db.execute("PRAGMA synchronous = FULL")
            row = (utc_now(), json.dumps(dict(results), allow_nan=False))
            db.execute("INSERT INTO result (computed_at, value) VALUES (?, ?)", row)
    except sqlite3.Error as error:
        raise RunError(f"{path}: the result cannot be saved ({error})") from error


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


def is_run(path: Path) -> bool:
    """Tell whether a path looks like a run: a directory that holds one, or an SQLite file."""
    if path.is_dir():
        return True
    with path.open("rb") as file:
        return file.read(16) == b"SQLite format 3\x00"


def utc_now() -> str:
    """Return the time of day as ISO 8601, UTC, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _create(path: Path) -> None:
    """Make an empty run; it appears under its name only when it is whole."""
    draft = path.with_name(f".{path.name}")
    with closing(sqlite3.connect(draft, isolation_level=None)) as db:
        db.execute("PRAGMA page_size = 16384")
        db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        db.execute(f"PRAGMA user_version = {LAYOUT}")
        db.executescript(f"BEGIN; {_SCHEMA} COMMIT;")
    draft.rename(path)


def _check_layout(db: sqlite3.Connection, file: Path) -> None:
    (application,) = db.execute("PRAGMA application_id").fetchone()
    (layout,) = db.execute("PRAGMA user_version").fetchone()
    if application != APPLICATION_ID:
        raise RunError(f"{file}: is a database, but not a saved run of gyrolock")
    if layout > LAYOUT:
        raise RunError(f"{file}: was written by a newer gyrolock (layout {layout}): update this one")


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
