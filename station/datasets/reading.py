"""A data set as the sources that it was exported from."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from station.datasets.csv_file import CsvTable
from station.datasets.hdf5 import Hdf5Table
from station.datasets.numpy_file import NumpyTable
from station.datasets.packages import package
from station.datasets.parquet import ParquetTable, is_url
from station.datasets.rows import AT_ONCE, SCHEMA, record_of
from station.errors import RunError
from station.runs.facts import RunFacts, checked_fact
from station.runs.store import SavedRecord, SavedRun, damage_of, damaged_facts, missing_records
from station.sources.source import Source

PARTS = "part-*.parquet"
_ENDINGS: dict[str, Callable[[str], Table]] = {
    ".parquet": ParquetTable,
    ".h5": Hdf5Table,
    ".hdf5": Hdf5Table,
    ".npz": NumpyTable,
    ".csv": CsvTable,
}


class Table(Protocol):
    """A file of a data set."""

    place: str

    def heads(self) -> Iterator[tuple[str, int]]:
        """Yield what is known of the source of each row, equal ones as one object, and its number there."""

    def rows(self, first: int, last: int, numbers: range | None = None) -> Iterator[tuple[dict[str, Any], bytes]]:
        """Yield rows: what stands in the columns, and the bytes that were sent."""


@dataclass
class _Stretch:
    """Rows of one source, one behind the other."""

    table: Table
    first: int
    last: int


class DatasetSource(Source):
    """A source as it was when it was exported."""

    kind = "data set"

    def __init__(self, place: str, about: dict[str, Any]) -> None:
        self.path, self.name, self.origin = Path(place), str(about["name"]), str(about["kind"])
        self.facts = RunFacts({name: checked_fact(name, value) for name, value in about["facts"].items()})
        self.unusable, self.protected = dict(about["unusable"]), bool(about["protected"])
        self._sha256, self._is_run, self._records = (
            str(about["sha256"]),
            bool(about["is_run"]),
            int(about["records"]),
        )
        self._stretches: list[_Stretch] = []
        self._least, self._most = math.inf, -math.inf

    def add(self, table: Table, row: int, number: int) -> None:
        """Take a row to those that are its own."""
        self._least, self._most = min(self._least, number), max(self._most, number)
        stretch = self._stretches[-1] if self._stretches else None
        if stretch is None or stretch.table is not table or stretch.last != row:
            self._stretches.append(_Stretch(table, row, row + 1))
        else:
            stretch.last += 1

    @property
    def span(self) -> tuple[int, int]:
        """Least and largest number of the records; see `Source`."""
        far = self._most - self._least >= 2 * len(self) + AT_ONCE  # a damaged run may hold any number
        return (1, 1) if far else (int(self._least), int(self._most))

    def complete(self) -> None:
        """Say what is missing or damaged, when all rows are there."""
        whole = (self._least, self._most) == (1, len(self))
        numbers = () if whole else sorted({record.number for record in self._records_there() if record.number > 0})
        self.damaged = (*missing_records(numbers), *damaged_facts(self.unusable))

    def __len__(self) -> int:
        return sum(one.last - one.first for one in self._stretches)

    def records(self, numbers: range | None = None) -> Iterator[SavedRecord]:
        """Read the records one at a time; see `Source`."""
        if len(self) < self._records:
            raise RunError(
                f"{self.path}: holds {len(self)} of {self._records} records of {self.name}: a part is missing"
            )
        yield from self._records_there(numbers)

    def _records_there(self, numbers: range | None = None) -> Iterator[SavedRecord]:
        for one in self._stretches:
            for row, payload in one.table.rows(one.first, one.last, numbers):
                if numbers is None or int(row["number"]) in numbers:
                    yield record_of(row, payload)

    @property
    def sha256(self) -> str:
        """That of the source that it was exported from; see `Source`."""
        return self._sha256

    @property
    def is_run(self) -> bool:
        """Whether it was taken by a measurement of ours."""
        return self._is_run


def is_dataset(place: str | Path) -> bool:
    """Tell whether something that can be read is a data set: by its name, a CSV by its first line."""
    text = str(place)
    path = Path(text)
    if is_url(text):
        return True
    if path.is_dir():
        return any(path.glob(PARTS))
    ending = path.suffix.lower()
    if ending == ".csv":
        if not path.is_file():  # a pipe would wait for its writer
            return False
        with path.open("rb") as file:
            return file.read(64).removeprefix(b"\xef\xbb\xbf").startswith(b"schema,source,number,")
    return ending in _ENDINGS


def tables_of(place: str | Path) -> list[Table]:
    """Return the files of a data set: one, or the parts in a folder or below a URL that ends with ``/``."""
    return [_table(one) for one in parts_of(place)]


def parts_of(place: str | Path) -> list[str]:
    """Return path or URL of each file of a data set."""
    text = str(place)
    if is_url(text):
        if not text.endswith("/"):
            return [text]
        fsspec = package("fsspec", "cluster")
        system, folder = fsspec.core.url_to_fs(text)
        found = sorted(system.glob(f"{folder.rstrip('/')}/{PARTS}"))
        if not found:
            raise RunError(f"{text}: holds no part of a data set ({PARTS})")
        return [system.unstrip_protocol(one) for one in found]
    if Path(text).is_dir():
        return [str(one) for one in sorted(Path(text).glob(PARTS))]
    return [text]


def sources_of(place: str | Path) -> list[DatasetSource]:
    """Return the sources that a data set was exported from, in their order."""
    found: dict[str, DatasetSource] = {}
    seen: dict[int, DatasetSource] = {}  # by the text as one object: it is not taken apart for each row
    for table in tables_of(place):
        texts: list[str] = []
        for row, (about, number) in enumerate(table.heads()):
            source = seen.get(id(about))
            if source is None:
                source = found.get(about)
                if source is None:
                    source = found[about] = DatasetSource(str(place), _taken_apart(about, table.place))
                texts.append(about)  # held, so that no other object gets its id
                seen[id(about)] = source
            source.add(table, row, number)
        seen.clear()
    for source in found.values():
        source.complete()
    return list(found.values())


def run_of(source: Source) -> SavedRun:
    """Return a source as the run that it was: everything that evaluates a run takes it."""
    records = tuple(source.records())
    damaged = tuple(damage_of(records, source.unusable))
    return SavedRun(source.path, source.facts, records, None, dict(source.unusable), source.protected, damaged)


def names_of(sources: Sequence[Source]) -> str:
    """Return names of sources for a message, the first few."""
    names = [source.name for source in sources]
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def _table(place: str) -> Table:
    kind = _ENDINGS.get(Path(place).suffix.lower())
    if kind is None:
        raise RunError(f"{place}: is no data set by its name: they end with {', '.join(_ENDINGS)}")
    return kind(place)


def _taken_apart(about: str, place: str) -> dict[str, Any]:
    try:
        known = json.loads(about)
        wanted = {"name": str, "kind": str, "is_run": bool, "sha256": str, "records": int, "facts": dict}
        wanted |= {"unusable": dict, "protected": bool}
        if not all(isinstance(known[name], kind) for name, kind in wanted.items()):
            raise ValueError("holds something that it never does")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise RunError(f"{place}: what it knows of a source is damaged ({error}): export it again") from None
    return dict(known)


__all__ = [
    "SCHEMA",
    "DatasetSource",
    "Table",
    "is_dataset",
    "names_of",
    "parts_of",
    "run_of",
    "sources_of",
    "tables_of",
]
