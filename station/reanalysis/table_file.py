"""Results tables: their columns, one writer at a time, and CSV, JSON lines and SQLite files."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import os
import sqlite3
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from analysis import flag_names
from analysis.lock_in_run import by_themselves
from instrument.claims import lock
from station.errors import CannotWrite, RunError, StationError
from station.files import alive, inert, program
from station.lock_in.estimate import COLUMNS, Gathered, Piece, columns_of, estimate_pieces
from station.lock_in.evaluate import describe_method
from station.lock_in.settings import RING_LASER, FrontEndSettings, channel_response
from station.results.numbers import LOCK_IN_RATE, LOCK_IN_RATE_NOISE_U, SCALE_FACTOR
from station.settings import saved_settings
from station.sources.batches import ExcludedRecord

Key = tuple[str, str]  # source and analysis of a row


class TableFile(ABC):
    """One kind of file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._draft = path.with_name(f".{path.name}.part")

    def known(self) -> dict[Key, str]:
        """SHA-256 of each source and analysis that the table holds."""
        if not self.path.exists():
            return {}
        return {(source, analysis): sha256 for source, analysis, sha256 in self._keys()}

    def _keys(self) -> Iterable[tuple[str, str, str]]:
        """Source, analysis and SHA-256 of the rows."""
        return ((str(row["source"]), str(row["analysis"]), str(row["source_sha256"])) for row in self.rows())

    @abstractmethod
    def rows(self) -> Iterator[dict[str, Any]]:
        """Read the rows one by one; errors as `known`."""

    @abstractmethod
    def begin(self) -> None:
        """Begin to write; what is there stays valid until `end`."""

    @staticmethod
    @abstractmethod
    def packed(parts: Sequence[TableRows]) -> Any:
        """Return rows as :meth:`add` takes them: done by the process that computes them, many at a time."""

    @abstractmethod
    def add(self, packed: Any) -> None:
        """Add rows that were packed."""

    @abstractmethod
    def end(self, replaced: set[Key]) -> None:
        """Put the new rows behind those that are there, without the old ones of `replaced`."""

    @abstractmethod
    def give_up(self) -> None:
        """Leave the table as it was."""

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, sqlite3.Error) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else error
            raise CannotWrite(f"{self.path}: cannot be written ({reason})") from None

    def _checked(self, version: object) -> None:
        if not isinstance(version, int) or isinstance(version, bool) or version < 1:
            raise RunError(f"{self.path}: is not a results table of gyrolock")
        if version > VERSION:
            raise RunError(
                f"{self.path}: was written by a newer gyrolock (table {version}, this one knows {VERSION}): "
                "update this one"
            )


# --------------------
# The columns of a results table: one row a record, units in the names


NAME, VERSION = "gyrolock results", 1  # of the layout of a results table; apart from the version of the package

TEXTS = (
    *("source", "source_sha256", "analysis", "key", "taken_at", "unit", "gyro", "operator", "channel"),
    *("model", "serial", "firmware", "probe", "taken_with", "method", "relation", "flags", "software"),
)
INTEGERS = ("schema_version", "record", "samples", "flag_bits")
NUMBERS = (
    *("sample_interval_s", "table_rate_dps", "azimuth_start_deg", "azimuth_end_deg", "over_lock_in"),
    *(SCALE_FACTOR.key(), "given_input_rate_dps"),
    *(name for name in COLUMNS if name != "flag_bits"),
)
ORDER = (
    *("source", "record", "key", "taken_at", "unit", "gyro", "operator", "channel"),
    *(LOCK_IN_RATE.key(), LOCK_IN_RATE_NOISE_U.key()),
    *("lock_in_rate_noise_low_95_dps", "lock_in_rate_noise_high_95_dps"),
    *(name for name in NUMBERS if name in COLUMNS and not name.startswith("lock_in_rate")),
    *("flags", "flag_bits", "method", "relation", SCALE_FACTOR.key(), "given_input_rate_dps"),
    *("table_rate_dps", "azimuth_start_deg", "azimuth_end_deg", "over_lock_in", "samples", "sample_interval_s"),
    *("model", "serial", "firmware", "probe", "taken_with"),
    *("source_sha256", "analysis", "software", "schema_version"),
)
"""All columns, as a reader meets them."""

_PAIRED = (
    "its records are pairs of two photodiodes, and a row of one of them would hold its distortion: "
    "`gyrolock analyze --jsonl` evaluates them together"
)

Texts = str | list[str | None] | None
Values = Texts | int | float | NDArray[Any]
Column = Sequence[Any] | NDArray[Any]  # one value for each row; None, or nan of a number: not known


@dataclass(frozen=True)
class TableRows:
    """Rows of one source, or of a piece of it."""

    source: str
    count: int
    # by the names of `ORDER`: an array or list of `count` values, or one value that all rows share; None: not
    # known. Empty where the rows were known already.
    columns: dict[str, Values]
    left_out: tuple[ExcludedRecord, ...]  # what could not be read
    known: bool = False  # whether the table has them already

    def column(self, name: str) -> Column:
        """One value for each row."""
        values = self.columns[name]
        return values if isinstance(values, list | np.ndarray) else [values] * self.count


def joined_columns(parts: Sequence[TableRows]) -> dict[str, Column]:
    """Put rows of several sources behind each other; every one of `ORDER` is there."""
    filled = [part for part in parts if part.count]
    if len(filled) == 1:
        return {name: filled[0].column(name) for name in ORDER}
    return {name: _joined([part.column(name) for part in filled]) for name in ORDER}


def _joined(columns: Sequence[Column]) -> Column:
    arrays = [column for column in columns if isinstance(column, np.ndarray)]
    if len(arrays) == len(columns):
        return np.concatenate(arrays)
    return [value for column in columns for value in column]


def analysis_of(choices: Mapping[str, Any]) -> str:
    """Say by which method, settings and program rows are made: those with the same need no new ones."""
    wanted = {name: value for name, value in choices.items() if value is not None}
    scale = f"{wanted['scale_factor']!r} pulses/deg" if "scale_factor" in wanted else "scale factor of the source"
    rate = f"input rate {wanted['input_rate']!r} deg/s" if "input_rate" in wanted else "self-referenced"
    channel = ""
    if "front_end" in wanted:
        stated = {name: value for name, value in wanted["front_end"].items() if value}
        if points := stated.pop("response", ()):  # hundreds, which would stand in every row
            stated["response"] = hashlib.sha256(repr(points).encode()).hexdigest()[:12]
        channel = f"channel {' '.join(f'{name} {value}' for name, value in stated.items()) or 'as it is'}; "
    return f"{wanted.get('relation', 'exact')}; {scale}; {rate}; {channel}{software()}"


@cache
def software() -> str:
    """Version of this program, with the state of its source where it runs from one."""
    return " ".join(filter(None, program()))


def rows_of_pieces(pieces: Sequence[Piece]) -> list[TableRows]:
    """Estimate the records of some pieces and make rows of them; a source that does not go is left out."""
    return [_rows(piece, gathered) for piece, gathered in zip(pieces, estimate_pieces(pieces), strict=True)]


def _rows(piece: Piece, gathered: Gathered) -> TableRows:
    if gathered.method is None:
        return TableRows(gathered.name, 0, {}, gathered.left_out, known=bool(gathered.sha256))
    if gathered.paired:
        return TableRows(gathered.name, 0, {}, (ExcludedRecord(gathered.name, None, _PAIRED),))
    try:
        return TableRows(gathered.name, len(gathered), _columns(piece, gathered), gathered.left_out)
    except StationError as error:
        return TableRows(
            gathered.name, 0, {}, (*gathered.left_out, ExcludedRecord(gathered.name, None, str(error)))
        )


def _columns(piece: Piece, gathered: Gathered) -> dict[str, Values]:
    each, method = gathered.each, gathered.method
    if each is None or method is None:
        return {}
    response = None
    if (stated := piece.choices.get("front_end")) is not None:
        response = channel_response(FrontEndSettings(**stated))
    elif gathered.front_end is not None:
        settings = saved_settings(RING_LASER, dict(gathered.front_end), gathered.name)
        response = channel_response(settings.front_end)
    each = by_themselves(each, response)
    known, labels = gathered.columns, gathered.labels
    columns: dict[str, Values] = {
        **dict.fromkeys(ORDER),
        **columns_of(each),
        **gathered.about,
        **{name: known[name] for name in known if name in NUMBERS},
        "source": gathered.name,
        "source_sha256": gathered.sha256,
        "analysis": analysis_of(piece.choices),
        "software": software(),
        "schema_version": VERSION,
        "record": gathered.numbers,
        "samples": known["samples"].astype(np.int64),
        "key": list(labels["key"]),
        "taken_at": list(labels["taken_at"]),
        "channel": list(labels["channel"]),
        "flags": [_flags(bits) for bits in each.flags.tolist()],
        "method": describe_method(method),
        "relation": method.relation,
        SCALE_FACTOR.key(): method.scale_factor,
        "given_input_rate_dps": math.nan if method.input_rate is None else method.input_rate,
    }
    columns["third_harmonic_u"] = np.where(np.isfinite(each.third_harmonic_u), each.third_harmonic_u, np.nan)
    return {name: columns[name] for name in ORDER}


@cache
def _flags(bits: int) -> str:
    return " ".join(flag_names(bits))


# --------------------
# One writer at a time


@contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Hold a file against other writers; a process that is killed holds nothing any more."""
    place = path.with_name(f".{path.name}.lock")
    try:
        descriptor = os.open(place, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise CannotWrite(f"{path}: cannot be written ({error.strerror or error})") from None
    try:
        if not lock(descriptor):
            raise CannotWrite(
                f"{path}: another analysis is writing this table: wait for its end, or name another with --to"
            )
        try:
            yield
        finally:
            with suppress(OSError):
                place.unlink()
    finally:
        os.close(descriptor)


# --------------------
# Results tables as text: comma-separated values, or one JSON object a line


class DelimitedTable(TableFile):
    """Lines of text; new ones go to a draft beside the table, which takes its place at the end."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._joined = path.with_name(f".{path.name}.new")
        self._file: IO[str] | None = None

    def begin(self) -> None:
        """Open the draft; see `TableFile`."""
        with self._writing():
            self._file = self._draft.open("w", encoding="utf-8", newline="")

    @classmethod
    def packed(cls, parts: Sequence[TableRows]) -> str:
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
    if not isinstance(column, np.ndarray):
        return [None if value != value else value for value in column]
    values: list[Any] = column.tolist()
    if column.dtype.kind == "f" and np.isnan(column).any():
        return [None if value != value else value for value in values]
    return values


class JsonLines(DelimitedTable):
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


class Csv(DelimitedTable):
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
                    try:
                        read = {name: _csv_value(name, text) for name, text in row.items()}
                    except ValueError:
                        raise RunError(f"{self.path}: line {number} holds no number where one belongs") from None
                    self._checked(read.get("schema_version"))
                    yield read
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise RunError(f"{self.path}: cannot be read ({error})") from None

    def _headings(self) -> None:
        csv.writer(self._opened(), lineterminator="\n").writerow(ORDER)

    @staticmethod
    def _lines(rows: Iterable[tuple[Any, ...]]) -> str:
        text = io.StringIO()
        told = ([inert(cell) if isinstance(cell, str) else cell for cell in row] for row in rows)
        csv.writer(text, lineterminator="\n").writerows(told)
        return text.getvalue()


def _csv_value(name: str, text: str) -> Any:
    if not text:
        return None
    if name in TEXTS:
        return alive(text)
    return int(text) if name in INTEGERS else float(text)


# --------------------
# A results table as an SQLite database


APPLICATION_ID = 0x47_59_4C_52  # 'GYLR': tells a results table from a run


class Sqlite(TableFile):
    """A table `record` in an SQLite database; new rows appear together at the end."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._db: sqlite3.Connection | None = None
        self._new = False

    def _keys(self) -> Iterator[tuple[str, str, str]]:
        rows = self._rows("SELECT source, analysis, max(source_sha256) FROM record GROUP BY 1, 2")
        return ((source, analysis, sha256) for source, analysis, sha256 in map(dict.values, rows))

    def rows(self) -> Iterator[dict[str, Any]]:
        """Read the rows; see `TableFile`."""
        return self._rows("SELECT * FROM record")

    def _rows(self, asked: str) -> Iterator[dict[str, Any]]:
        with closing(self._read()) as db:
            try:
                found = db.execute(asked)
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
        with self._writing():
            self._db = db = sqlite3.connect(self.path, isolation_level=None)
            if self._new:
                db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
                db.execute(f"PRAGMA user_version = {VERSION}")
            db.execute("BEGIN IMMEDIATE")
            db.execute(f"CREATE TABLE IF NOT EXISTS record ({columns})")
            db.execute("CREATE INDEX IF NOT EXISTS record_by_source ON record (source, analysis)")
            db.execute("CREATE TEMP TABLE added AS SELECT * FROM record WHERE 0")

    @staticmethod
    def packed(parts: Sequence[TableRows]) -> dict[str, Column]:
        """Columns; see `TableFile`."""
        return joined_columns(parts)

    def add(self, packed: dict[str, Column]) -> None:
        """Insert rows; see `TableFile`."""
        columns = (packed[name] for name in ORDER)
        plain = [column.tolist() if isinstance(column, np.ndarray) else column for column in columns]
        marks = ", ".join("?" * len(ORDER))
        with self._writing():
            self._opened().executemany(f"INSERT INTO added VALUES ({marks})", zip(*plain, strict=True))

    def end(self, replaced: set[Key]) -> None:
        """Commit; see `TableFile`."""
        db = self._opened()
        with self._writing():
            db.executemany("DELETE FROM record WHERE source = ? AND analysis = ?", sorted(replaced))
            db.execute("INSERT INTO record SELECT * FROM added")
            db.execute("COMMIT")
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
