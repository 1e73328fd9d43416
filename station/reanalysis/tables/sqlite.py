"""A results table as an SQLite database."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from station.errors import CannotWrite, RunError
from station.reanalysis.tables.columns import INTEGERS, ORDER, TEXTS, VERSION, Column, Rows, joined_columns
from station.reanalysis.tables.table import Key, TableFile

APPLICATION_ID = 0x47_59_4C_52
"""'GYLR': tells a results table from a run."""


class Sqlite(TableFile):
    """A table `record` in an SQLite database; new rows appear together at the end."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._db: sqlite3.Connection | None = None
        self._new = False

    def known(self) -> dict[Key, str]:
        """SHA-256 by source and analysis; see `TableFile`."""
        if not self.path.exists():
            return {}
        asked = "SELECT source, analysis, max(source_sha256) FROM record GROUP BY 1, 2"
        with closing(self._read()) as db:
            try:
                return {(source, analysis): sha256 for source, analysis, sha256 in db.execute(asked)}
            except sqlite3.Error as error:
                raise RunError(f"{self.path}: is damaged and cannot be read ({error})") from None

    def rows(self) -> Iterator[dict[str, Any]]:
        """Read the rows; see `TableFile`."""
        with closing(self._read()) as db:
            try:
                found = db.execute("SELECT * FROM record")
                names = [column[0] for column in found.description]
                for row in found:
                    yield dict(zip(names, row, strict=True))
            except sqlite3.Error as error:
                raise RunError(f"{self.path}: is damaged and cannot be read ({error})") from None

    def begin(self) -> None:
        """Begin one transaction; see `TableFile`."""
        kinds = {
            **dict.fromkeys(ORDER, "REAL"),
            **dict.fromkeys(TEXTS, "TEXT"),
            **dict.fromkeys(INTEGERS, "INTEGER"),
        }
        columns = ", ".join(f"{name} {kinds[name]}" for name in ORDER)
        self._new = not self.path.exists()
        try:
            self._db = db = sqlite3.connect(self.path, isolation_level=None)
            if self._new:
                db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
                db.execute(f"PRAGMA user_version = {VERSION}")
            db.execute("BEGIN IMMEDIATE")
            db.execute(f"CREATE TABLE IF NOT EXISTS record ({columns})")
            db.execute("CREATE INDEX IF NOT EXISTS record_by_source ON record (source, analysis)")
            db.execute("CREATE TEMP TABLE added AS SELECT * FROM record WHERE 0")
        except sqlite3.Error as error:
            raise CannotWrite(f"{self.path}: cannot be written ({error})") from None

    @staticmethod
    def packed(parts: Sequence[Rows]) -> dict[str, Column]:
        """Columns; see `TableFile`."""
        return joined_columns(parts)

    def add(self, packed: dict[str, Column]) -> None:
        """Insert rows; see `TableFile`."""
        columns = (packed[name] for name in ORDER)
        plain = [column.tolist() if isinstance(column, np.ndarray) else column for column in columns]
        marks = ", ".join("?" * len(ORDER))
        try:
            self._opened().executemany(f"INSERT INTO added VALUES ({marks})", zip(*plain, strict=True))
        except sqlite3.Error as error:
            raise CannotWrite(f"{self.path}: cannot be written ({error})") from None

    def end(self, replaced: set[Key]) -> None:
        """Commit; see `TableFile`."""
        db = self._opened()
        try:
            db.executemany("DELETE FROM record WHERE source = ? AND analysis = ?", sorted(replaced))
            db.execute("INSERT INTO record SELECT * FROM added")
            db.execute("COMMIT")
        except sqlite3.Error as error:
            raise CannotWrite(f"{self.path}: cannot be written ({error})") from None
        db.close()

    def give_up(self) -> None:
        """Roll back; see `TableFile`."""
        if self._db is not None:
            self._db.close()
        if self._new:
            self.path.unlink(missing_ok=True)

    def _opened(self) -> sqlite3.Connection:
        if self._db is None:
            raise CannotWrite(f"{self.path}: is not open")
        return self._db

    def _read(self) -> sqlite3.Connection:
        try:
            db = sqlite3.connect(f"{self.path.resolve().as_uri()}?mode=ro", uri=True)
            (application,) = db.execute("PRAGMA application_id").fetchone()
            (version,) = db.execute("PRAGMA user_version").fetchone()
        except sqlite3.Error as error:
            raise RunError(f"{self.path}: is not a results table of gyrolock ({error})") from None
        try:
            self._checked(version if application == APPLICATION_ID else None)
        except RunError:
            db.close()
            raise
        return db
