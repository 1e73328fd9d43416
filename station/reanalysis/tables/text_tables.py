"""Results tables as text: comma-separated values, or one JSON object a line."""

from __future__ import annotations

import csv
import io
import json
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

from station.errors import CannotWrite, RunError
from station.reanalysis.tables.columns import INTEGERS, ORDER, TEXTS, Column, Repeated, Rows, joined_columns
from station.reanalysis.tables.table import Key, TableFile


class TextTable(TableFile):
    """Lines of text; new ones go to a draft beside the table, which takes its place at the end."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._draft = path.with_name(f".{path.name}.part")
        self._joined = path.with_name(f".{path.name}.new")
        self._file: IO[str] | None = None

    def known(self) -> dict[Key, str]:
        """SHA-256 by source and analysis; see `TableFile`."""
        if not self.path.exists():
            return {}
        return {(str(row["source"]), str(row["analysis"])): str(row["source_sha256"]) for row in self.rows()}

    def begin(self) -> None:
        """Open the draft; see `TableFile`."""
        with self._writing():
            self._file = self._draft.open("w", encoding="utf-8", newline="")

    @classmethod
    def packed(cls, parts: Sequence[Rows]) -> str:
        """Lines; see `TableFile`."""
        columns = joined_columns(parts)
        return cls._lines(zip(*(_known(columns[name]) for name in ORDER), strict=True))

    def add(self, packed: str) -> None:
        """Write lines to the draft; see `TableFile`."""
        with self._writing():
            self._opened().write(packed)

    def end(self, replaced: set[Key]) -> None:
        """Write what stays before the new lines; see `TableFile`."""
        with self._writing():
            self._opened().close()
            with self._joined.open("w", encoding="utf-8", newline="") as self._file:
                self._headings()
                if self.path.exists():
                    for row in self.rows():
                        if (row["source"], row["analysis"]) not in replaced:
                            self._file.write(self._lines([tuple(row.get(name) for name in ORDER)]))
                with self._draft.open(encoding="utf-8", newline="") as new:
                    for line in new:
                        self._file.write(line)
            self._joined.replace(self.path)
        self._draft.unlink()

    def give_up(self) -> None:
        """Take the draft away; see `TableFile`."""
        with suppress(OSError):  # a disk that is full does not take what is held back
            if self._file is not None:
                self._file.close()
        for path in (self._draft, self._joined):
            with suppress(OSError):
                path.unlink()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise CannotWrite(f"{self.path}: cannot be written ({error.strerror or error})") from None

    def _opened(self) -> IO[str]:
        if self._file is None:
            raise CannotWrite(f"{self.path}: is not open")
        return self._file

    def _headings(self) -> None:
        """Write what stands above the rows."""

    @staticmethod
    @abstractmethod
    def _lines(rows: Iterable[tuple[Any, ...]]) -> str:
        """Rows, in `ORDER`, as lines; None: not known."""


def _known(column: Column) -> Sequence[Any]:
    """Values, None where they are nan."""
    if isinstance(column, Repeated):
        return Repeated(None, len(column)) if column.value != column.value else column
    if not isinstance(column, np.ndarray):
        return [None if value != value else value for value in column]
    values: list[Any] = column.tolist()
    if column.dtype.kind == "f" and np.isnan(column).any():
        return [None if value != value else value for value in values]
    return values


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

    @staticmethod
    def _lines(rows: Iterable[tuple[Any, ...]]) -> str:
        named = (dict(zip(ORDER, row, strict=True)) for row in rows)
        return "".join([f"{json.dumps(row, allow_nan=False, default=str)}\n" for row in named])


def _json_row(line: str) -> dict[str, Any] | None:
    try:
        row = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(row, dict) or not {"source", "analysis", "source_sha256"} <= row.keys():
        return None
    return row


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

    @staticmethod
    def _lines(rows: Iterable[tuple[Any, ...]]) -> str:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(rows)
        return text.getvalue()


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
