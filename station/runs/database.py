"""A run as one SQLite file in a directory of its own. A commit is on the disk when it returns."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from station.errors import RunError
from station.runs.layouts import TABLES, TODAY, Layout, layout_of


def utc_now() -> str:
    """Return the time of day as ISO 8601, UTC, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def new_run_directory(parent: Path) -> Path:
    """Make the directory of a new run below `parent`, named by the time of day; two runs never share one.

    Raises
    ------
    RunError
        If nothing can be written there.
    """
    stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H%M%SZ")
    for count in range(1, 10_000):
        directory = parent / f"{stamp}_{count:03d}"
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            if not parent.is_dir():
                raise RunError(f"{parent}: is not a directory, runs cannot be saved there") from None
            continue
        except OSError as error:
            raise RunError(f"{parent}: runs cannot be saved there ({error.strerror})") from None
        return directory
    raise RunError(f"{parent}: too many runs in one second")


def create_database(path: Path) -> None:
    """Make an empty run; it appears under its name only when it is whole.

    Raises
    ------
    RunError
        If it cannot be written.
    """
    draft = path.with_name(f".{path.name}")
    try:
        with closing(sqlite3.connect(draft, isolation_level=None)) as db:
            db.execute("PRAGMA page_size = 16384")
            db.execute(f"PRAGMA application_id = {TODAY.application_id}")
            db.execute(f"PRAGMA user_version = {TODAY.version}")
            db.executescript(f"BEGIN; {TABLES} COMMIT;")
        draft.rename(path)
    except (sqlite3.Error, OSError) as error:
        raise RunError(f"{path}: cannot be written ({error})") from error


class DatabaseWriter:
    """Writes one run. What a method returned for survives a killed process.

    Parameters
    ----------
    path : Path
        A file that :func:`create_database` made, now or once.

    Raises
    ------
    RunError
        If it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with reading(path) as (_, layout):
            self._layout = layout
        try:
            self._db = sqlite3.connect(path, isolation_level=None)  # every BEGIN and COMMIT is written here
            self._db.execute("PRAGMA journal_mode = WAL")
            self._db.execute("PRAGMA synchronous = FULL")
        except sqlite3.Error as error:
            raise RunError(f"{path}: cannot be written ({error})") from error

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

    def close(self) -> None:
        """End the run: afterwards it is one plain file, fit for a read-only or a shared disk."""
        with suppress(sqlite3.Error):  # while a reader looks, the journal stays: the run is complete all the same
            self._db.execute("PRAGMA journal_mode = DELETE")
        self._db.close()

    def _commit(self, statement: str, rows: Sequence[Sequence[object] | Mapping[str, object]]) -> None:
        try:
            self._db.execute("BEGIN IMMEDIATE")
            try:
                self._db.executemany(statement, rows)
                self._db.execute("COMMIT")
            except BaseException:
                self._db.execute("ROLLBACK")
                raise
        except sqlite3.Error as error:
            raise RunError(f"{self.path}: the disk does not take it ({error})") from error


@contextmanager
def reading(file: Path) -> Iterator[tuple[sqlite3.Connection, Layout]]:
    """Open a run to read it, finished or cut short.

    Raises
    ------
    RunError
        If it is no run, of a newer version, or damaged.
    """
    if not is_database(file):
        raise RunError(f"{file}: is not a saved run")
    try:
        with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as db:
            (application,) = db.execute("PRAGMA application_id").fetchone()
            (version,) = db.execute("PRAGMA user_version").fetchone()
            try:
                layout = layout_of(application, version)
            except ValueError as error:
                raise RunError(f"{file}: was written by a newer gyrolock ({error}): update this one") from None
            if layout is None:
                raise RunError(f"{file}: is a database, but not a saved run of gyrolock")
            yield db, layout
    except (sqlite3.Error, ValueError) as error:
        raise RunError(f"{file}: is damaged and cannot be read ({error})") from error


def read_facts(db: sqlite3.Connection) -> dict[str, Any]:
    """Return what is known about a run, by name."""
    return {name: json.loads(value) for name, value in db.execute("SELECT name, value FROM run")}


def save_result(path: Path, document: Mapping[str, object]) -> None:
    """Keep what was computed from the records of a run beside them; `document` is plain JSON.

    Raises
    ------
    RunError
        If the disk does not take it.
    """
    try:
        with closing(sqlite3.connect(path)) as db, db:
            db.execute("PRAGMA synchronous = FULL")
            row = (utc_now(), json.dumps(dict(document), allow_nan=False))
            db.execute("INSERT INTO result (computed_at, value) VALUES (?, ?)", row)
    except sqlite3.Error as error:
        raise RunError(f"{path}: the result cannot be saved ({error})") from error


def is_database(path: Path) -> bool:
    """Tell whether a path looks like a run: a directory, or an SQLite file."""
    if path.is_dir():
        return True
    with path.open("rb") as file:
        return file.read(16) == b"SQLite format 3\x00"
