"""A results table filled from sources: only what it does not hold yet is computed, piece by piece."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from instrument import InstrumentError
from station.errors import RunError, StationError, UsageError
from station.live.events import Progress
from station.lock_in.estimate import Piece, pieces_of
from station.reanalysis.table_file import (
    Csv,
    JsonLines,
    Key,
    Sqlite,
    TableFile,
    TableRows,
    analysis_of,
    only_writer,
    rows_of_pieces,
)
from station.runs.store import RUN_FILES
from station.sources.batches import ExcludedRecord, Source
from station.sources.find import open_source
from station.sources.workers import Workers


@dataclass
class Filled:
    """What was done."""

    table: Path
    sources: int = 0  # that were computed
    records: int = 0
    known: int = 0  # sources that the table held already
    empty: int = 0  # sources without a record of a beat that can be read
    # what could not be read, whole sources and single records
    left_out: list[ExcludedRecord] = field(default_factory=list)

    def document(self) -> dict[str, Any]:
        """Return it as plain JSON."""
        missing = [{"source": one.source, "record": one.record, "reason": one.reason} for one in self.left_out]
        return {
            "schema": {"name": "gyrolock reanalysis", "version": 1},
            "table": str(self.table),
            "records": self.records,
            "sources": self.sources,
            "sources_known": self.known,
            "sources_without_records": self.empty,
            "left_out": missing,
        }


def fill_table(
    sources: Iterable[Path | Source],
    table: Path,
    choices: Mapping[str, Any],
    workers: Workers,
    progress: Progress,
    left_out: Callable[[ExcludedRecord], None] = lambda one: None,
) -> Filled:
    """Estimate every record of the sources by itself, and put one row for each into a table."""
    file, analysis, done = table_file(table), analysis_of(choices), Filled(table)
    with only_writer(table):
        known = {source: sha256 for (source, made), sha256 in _known(file).items() if made == analysis}
        # a source goes by the name that the table has for it, however its path is written now
        written = {os.path.realpath(name): name for name in known}
        sources = [
            Path(written.get(os.path.realpath(_name(source)), source)) if isinstance(source, Path) else source
            for source in sources
        ]
        replaced: set[tuple[str, str]] = set()
        before = ""
        try:
            file.begin()
            work = Work(sources, choices, known, whole=True)
            for packed, found in work.done_by(workers, partial(_packed_rows, type(file)), progress):
                if packed is not None:
                    file.add(packed)
                for rows in found:
                    for one in rows.left_out:
                        done.left_out.append(one)
                        left_out(one)
                    if rows.count:
                        replaced.add((rows.source, analysis))
                        done.records += rows.count
                    if rows.source == before:
                        continue  # a further piece of one source
                    before = rows.source
                    done.known += rows.known
                    done.sources += bool(rows.count)
                    done.empty += not (rows.known or rows.count)
            if done.records:
                file.end(replaced)
            else:
                file.give_up()
        except BaseException:
            file.give_up()
            raise
    return done


def _known(file: TableFile) -> dict[Key, str]:
    try:
        return file.known()
    except RunError as error:
        raise RunError(f"{error}; or name another table with --to") from None


def _packed_rows(kind: type[TableFile], pieces: Sequence[Piece]) -> tuple[Any, list[TableRows]]:
    """Rows of some pieces, ready to be written; and what is said of each piece, without its columns."""
    parts = rows_of_pieces(pieces)
    packed = kind.packed(parts) if any(part.count for part in parts) else None
    return packed, [replace(part, columns={}) for part in parts]


# --------------------
# Work on many sources, cut into pieces of about equal length


R = TypeVar("R")

TOGETHER = 8_000_000  # bytes of small sources that make one piece of work: some 2000 records
LARGE = 3 * TOGETHER  # bytes from which on a source is cut into pieces

_MEGABYTE = 1_000_000
_NOTHING: Mapping[str, str] = {}


class Work:
    """Estimating the records of many sources: small ones together, large ones in parts."""

    def __init__(
        self,
        sources: Iterable[Path | Source],
        choices: Mapping[str, Any],
        known: Mapping[str, str] = _NOTHING,
        *,
        whole: bool = False,
    ) -> None:
        # one that was named twice counts once, whichever way its path is written
        once: dict[str, Path | Source] = {}
        for source in sources:
            name = _name(source)
            once.setdefault(os.path.realpath(name) if isinstance(source, Path) else name, source)
        self._sources = [(source, _size(source)) for source in once.values()]
        self._choices, self._known, self._whole = choices, known, whole
        self._contents = frozenset(known.values())
        self._begun: deque[int] = deque()

    def __len__(self) -> int:
        """How many sources there are."""
        return len(self._sources)

    @property
    def opened(self) -> dict[str, Source]:
        """Sources that have no path of their own, such as those in a data set, by their names."""
        return {source.name: source for source, _ in self._sources if isinstance(source, Source)}

    def done_by(self, workers: Workers, work: Callable[[list[Piece]], R], progress: Progress) -> Iterator[R]:
        """Have every piece of it done; what comes back is in the order of the sources."""
        told = done = 0
        progress.start("megabytes", max(1, sum(size for _, size in self._sources) // _MEGABYTE))
        for found in workers.map(work, self._pieces()):
            done += self._begun.popleft()
            while told < done // _MEGABYTE:
                told += 1
                progress.advance()
            yield found

    def _pieces(self) -> Iterator[list[Piece]]:
        """Pieces of work; the bytes of each are noted as it is begun."""
        waiting: list[Piece] = []
        size = 0
        for source, here in self._sources:
            parts = self._parts(source) if here >= LARGE else None
            if parts is not None:
                if waiting:
                    self._begun.append(size)
                    yield waiting
                waiting, size = [], 0
                for part in parts:
                    self._begun.append(here // len(parts))
                    yield part
                continue
            waiting.append(Piece(source, None, self._choices, known=self._known_as(_name(source))))
            size += here
            if size >= TOGETHER:
                self._begun.append(size)
                yield waiting
                waiting, size = [], 0
        if waiting:
            self._begun.append(size)
            yield waiting

    def _known_as(self, name: str) -> frozenset[str]:
        """Contents that need no new rows: its own where the name is known, else those of any other name."""
        return frozenset({self._known[name]}) if name in self._known else self._contents

    def _parts(self, source: Path | Source) -> list[list[Piece]] | None:
        """Parts of a large source; ``None`` where it is read as a whole: it is known, or cannot be opened."""
        try:
            opened = open_source(source)
            if opened.sha256 in self._known_as(opened.name):
                return None
            return pieces_of(opened, self._choices, whole=self._whole)
        except (StationError, InstrumentError, OSError):
            return None


def _name(source: Path | Source) -> str:
    """Name of a source that has not been opened."""
    if isinstance(source, Path) and source.is_dir():
        return str(next((source / name for name in RUN_FILES if (source / name).is_file()), source))
    return str(source)


def _size(source: Path | Source) -> int:
    """Bytes of a source, about."""
    if isinstance(source, Source):
        return 2700 * len(source)
    try:
        return Path(_name(source)).stat().st_size
    except OSError:
        return 0


# --------------------
# Which kind of file a results table is


def _parquet(path: Path) -> TableFile:
    try:
        from station.reanalysis.parquet_table import Parquet
    except ImportError:
        raise UsageError(
            f"{path}: Parquet needs the package pyarrow: pip install 'gyrolock[data]', or name a .sqlite file"
        ) from None
    return Parquet(path)


KINDS: dict[str, Callable[[Path], TableFile]] = {
    ".parquet": _parquet,
    ".sqlite": Sqlite,
    ".csv": Csv,
    ".jsonl": JsonLines,
}


def table_file(path: Path) -> TableFile:
    """Return the table of a file by the ending of its name."""
    kind = KINDS.get(path.suffix.lower())
    if kind is None:
        raise UsageError(f"{path}: a results table ends in {', '.join(KINDS)}")
    if path.is_dir():
        raise UsageError(f"{path}: is a folder, not a results table: name a file in it")
    return kind(path)
