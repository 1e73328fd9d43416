"""A results table as a file: Parquet, SQLite, CSV or one JSON object a line, by the ending of its name."""

from __future__ import annotations

import csv
import json
import math
import sqlite3
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import IO, Any

from station.errors import CannotWrite, RunError, UsageError
from station.reanalysis.columns import INTEGERS, ORDER, TEXTS, VERSION, Rows

Key = tuple[str, str]
"""Source and analysis of a row."""

APPLICATION_ID = 0x47_59_4C_52
"""'GYLR': a results table as SQLite."""


class TableFile(ABC):
    """One kind of file.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @abstractmethod
    def known(self) -> dict[Key, tuple[str, int, int]]:
        """SHA-256 of each source and analysis that the table holds, how many rows, and how many there should be.

        Raises
        ------
        RunError
            It is no results table, of a newer version, or damaged.
        """

    @abstractmethod
    def rows(self) -> Iterator[dict[str, Any]]:
        """Read the rows one by one; errors as `known`."""

    @abstractmethod
    def begin(self) -> None:
        """Begin to write; what is there stays valid until `end`."""

    @abstractmethod
    def add(self, rows: Rows) -> None:
        """Add rows."""

    @abstractmethod
    def end(self, replaced: set[Key]) -> None:
        """Put the new rows behind those that are there, without the old ones of `replaced`."""

    @abstractmethod
    def give_up(self) -> None:
        """Leave the table as it was."""

    def _checked(self, version: object) -> None:
        if not isinstance(version, int) or isinstance(version, bool) or version < 1:
            raise RunError(f"{self.path}: is not a results table of gyrolock")
        if version > VERSION:
            raise RunError(
                f"{self.path}: was written by a newer gyrolock (results table {version}, this one knows {VERSION}): "
                "update this one"
            )


def table_file(path: Path) -> TableFile:
    """Return the table of a file by the ending of its name.

    Raises
    ------
    UsageError
        Another ending, or Parquet without pyarrow.
    """
    kind = KINDS.get(path.suffix.lower())
    if kind is None:
        raise UsageError(f"{path}: a results table ends in {', '.join(KINDS)}")
    return kind(path)


class TextTable(TableFile):
    """Lines of text; new ones go to a draft beside the table, which takes its place at the end."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._draft = path.with_name(f".{path.name}.part")
        self._file: IO[str] | None = None

    def known(self) -> dict[Key, tuple[str, int, int]]:
        """Count the rows of each source and analysis; see `TableFile`."""
        found: dict[Key, tuple[str, int, int]] = {}
        if self.path.exists():
            for row in self.rows():
                key = str(row["source"]), str(row["analysis"])
                count = found.get(key, ("", 0, 0))[1]
                found[key] = str(row["source_sha256"]), count + 1, int(row["source_records"] or 0)
        return found

    def begin(self) -> None:
        """Open the draft; see `TableFile`."""
        self._file = self._draft.open("w", encoding="utf-8", newline="")

    def add(self, rows: Rows) -> None:
        """Write lines to the draft; see `TableFile`."""
        columns = [rows.column(name) for name in ORDER]
        plain = [column.tolist() if hasattr(column, "tolist") else column for column in columns]
        for values in zip(*plain, strict=True):
            self._write(values)

    def end(self, replaced: set[Key]) -> None:
        """Write what stays before the new lines; see `TableFile`."""
        file = self._opened()
        file.close()
        joined = self.path.with_name(f".{self.path.name}.new")
        with joined.open("w", encoding="utf-8", newline="") as self._file:
            self._headings()
            if self.path.exists():
                for row in self.rows():
                    if (row["source"], row["analysis"]) not in replaced:
                        self._write(tuple(row.get(name) for name in ORDER))
            with self._draft.open(encoding="utf-8", newline="") as new:
                for line in new:
                    self._file.write(line)
        joined.replace(self.path)
        self._draft.unlink()

    def give_up(self) -> None:
        """Take the draft away; see `TableFile`."""
        if self._file is not None:
            self._file.close()
        with suppress(OSError):
            self._draft.unlink()

    def _opened(self) -> IO[str]:
        if self._file is None:
            raise CannotWrite(f"{self.path}: is not open")
        return self._file

    def _headings(self) -> None:
        """Write what stands above the rows."""

    @abstractmethod
    def _write(self, values: tuple[Any, ...]) -> None:
        """Write one row, in `ORDER`."""


class JsonLines(TextTable):
    """One JSON object a line; what is not known is null."""

    def rows(self) -> Iterator[dict[str, Any]]:
        """Read the lines; see `TableFile`."""
        try:
            with self.path.open(encoding="utf-8") as file:
                for number, line in enumerate(file, start=1):
                    row = _json_row(line)
                    if row is None:
                        raise RunError(f"{self.path}: line {number} is no row of a results table")
                    self._checked(row.get("schema_version"))
                    yield row
        except (OSError, UnicodeDecodeError) as error:
            raise RunError(f"{self.path}: cannot be read ({error})") from None

    def _write(self, values: tuple[Any, ...]) -> None:
        named = {name: None if _is_nan(value) else value for name, value in zip(ORDER, values, strict=True)}
        self._opened().write(json.dumps(named, allow_nan=False, default=str) + "\n")


def _json_row(line: str) -> dict[str, Any] | None:
    try:
        row = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(row, dict) or not {"source", "analysis", "source_sha256", "source_records"} <= row.keys():
        return None
    return {name: math.inf if value == "inf" else value for name, value in row.items()}


class Csv(TextTable):
    """Comma-separated values below a line of headings; what is not known is empty."""

    def rows(self) -> Iterator[dict[str, Any]]:
        """Read the lines; see `TableFile`."""
        try:
            with self.path.open(encoding="utf-8-sig", newline="") as file:
                reader = csv.DictReader(file)
                if not {"source", "analysis", "schema_version"} <= set(reader.fieldnames or ()):
                    raise RunError(f"{self.path}: is not a results table of gyrolock")
                for number, row in enumerate(reader, start=2):
                    if None in row or None in row.values():
                        raise RunError(f"{self.path}: line {number} is cut or has too many cells")
                    read = _csv_row(row)
                    if read is None:
                        raise RunError(f"{self.path}: line {number} holds no number where one belongs")
                    self._checked(read.get("schema_version"))
                    yield read
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise RunError(f"{self.path}: cannot be read ({error})") from None

    def _headings(self) -> None:
        csv.writer(self._opened(), lineterminator="\n").writerow(ORDER)

    def _write(self, values: tuple[Any, ...]) -> None:
        cells = ["" if value is None or _is_nan(value) else value for value in values]
        csv.writer(self._opened(), lineterminator="\n").writerow(cells)


def _csv_row(row: Mapping[str, str]) -> dict[str, Any] | None:
    try:
        return {name: _csv_value(name, text) for name, text in row.items()}
    except ValueError:
        return None


def _csv_value(name: str, text: str) -> Any:
    if not text:
        return None
    if name in TEXTS:
        return text
    return int(text) if name in INTEGERS else float(text)


class Sqlite(TableFile):
    """A table `record` in an SQLite database; new rows appear together at the end."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._db: sqlite3.Connection | None = None

    def known(self) -> dict[Key, tuple[str, int, int]]:
        """Count the rows of each source and analysis; see `TableFile`."""
        if not self.path.exists():
            return {}
        asked = (
            "SELECT source, analysis, max(source_sha256), count(*), max(source_records) FROM record GROUP BY 1, 2"
        )
        with closing(self._read()) as db:
            try:
                return {(row[0], row[1]): (row[2], row[3], row[4] or 0) for row in db.execute(asked)}
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
        new = not self.path.exists()
        try:
            self._db = db = sqlite3.connect(self.path, isolation_level=None)
            if new:
                db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
                db.execute(f"PRAGMA user_version = {VERSION}")
            db.execute("BEGIN IMMEDIATE")
            db.execute(f"CREATE TABLE IF NOT EXISTS record ({columns})")
            db.execute("CREATE INDEX IF NOT EXISTS record_by_source ON record (source, analysis)")
            db.execute("CREATE TEMP TABLE added AS SELECT * FROM record WHERE 0")
        except sqlite3.Error as error:
            raise CannotWrite(f"{self.path}: cannot be written ({error})") from None

    def add(self, rows: Rows) -> None:
        """Insert rows; see `TableFile`."""
        columns = [rows.column(name) for name in ORDER]
        plain = [column.tolist() if hasattr(column, "tolist") else column for column in columns]
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


def _is_nan(value: object) -> bool:
    return isinstance(value, float) and math.isnan(value)


def _parquet(path: Path) -> TableFile:
    try:
        from station.reanalysis.parquet import Parquet
    except ImportError:
        raise UsageError(
            f"{path}: Parquet needs the package pyarrow: pip install 'gyrolock[data]', or name a .sqlite file"
        ) from None
    return Parquet(path)


KINDS = {".parquet": _parquet, ".sqlite": Sqlite, ".csv": Csv, ".jsonl": JsonLines}
