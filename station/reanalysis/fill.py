"""Fill a results table from sources: only what it does not hold yet is computed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from instrument import InstrumentError
from station.errors import StationError
from station.lock_in.records.pieces import Piece, pieces_of
from station.reanalysis.tables.columns import analysis_of, rows_of_pieces
from station.reanalysis.tables.lock import only_writer
from station.reanalysis.tables.open_table import table_file
from station.runs.progress import Progress
from station.runs.store import RUN_FILES
from station.sources.batches import LeftOut
from station.sources.find import open_source
from station.sources.source import Source
from station.sources.workers import Workers

TOGETHER = 6_000_000
"""Bytes of small sources that make one piece of work: some 2000 records."""

LARGE = 4 * TOGETHER
"""Bytes from which on a source is cut into pieces."""


@dataclass
class Filled:
    """What was done.

    Attributes
    ----------
    table : Path
    sources, records : int
        That were computed.
    known : int
        Sources that the table held already.
    empty : int
        Sources without a record of a beat that can be read.
    left_out : list of LeftOut
        What could not be read, whole sources and single records.
    """

    table: Path
    sources: int = 0
    records: int = 0
    known: int = 0
    empty: int = 0
    left_out: list[LeftOut] = field(default_factory=list)

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
    left_out: Callable[[LeftOut], None] = lambda one: None,
) -> Filled:
    """Estimate every record of the sources by itself, and put one row for each into a table.

    Parameters
    ----------
    sources : iterable of Path or Source
        Of :func:`station.sources.find_sources`.
    table : Path
        ``.parquet``, ``.sqlite``, ``.csv`` or ``.jsonl``. Rows that it holds of the same source (by its SHA-256),
        method and program stay; those of a source that has changed are replaced.
    choices : mapping
        Of :class:`analysis.lock_in_run.Method`.
    left_out : callable
        Is told at once of what cannot be read.

    Raises
    ------
    UsageError, RunError
        The table's name or what it holds is wrong, or another process writes it.
    """
    file, analysis, done = table_file(table), analysis_of(choices), Filled(table)
    with only_writer(table):
        known = {source: sha256 for (source, made), sha256 in file.known().items() if made == analysis}
        everything = list(sources)
        progress.start("sources", len(everything))
        replaced: set[tuple[str, str]] = set()
        before = ""
        file.begin()
        try:
            for found in workers.map(rows_of_pieces, _work(everything, choices, known)):
                for rows in found:
                    for one in rows.left_out:
                        done.left_out.append(one)
                        left_out(one)
                    if rows.count:
                        replaced.add((rows.source, analysis))
                        file.add(rows)
                        done.records += rows.count
                    if rows.source == before:
                        continue  # a further piece of one source
                    before = rows.source
                    done.known += rows.known
                    done.sources += bool(rows.count)
                    done.empty += not (rows.known or rows.count)
                    progress.advance()
            if done.records:
                file.end(replaced)
            else:
                file.give_up()
        except BaseException:
            file.give_up()
            raise
    return done


def _work(
    sources: Iterable[Path | Source], choices: Mapping[str, Any], known: Mapping[str, str]
) -> Iterator[list[Piece]]:
    """Pieces of work of about equal length: small sources together, parts of large ones alone."""
    waiting: list[Piece] = []
    size = 0
    for source in sources:
        here = _size(source)
        parts = _parts(source, choices, known) if here >= LARGE else None
        if parts is not None:
            if waiting:
                yield waiting
            waiting, size = [], 0
            yield from parts
            continue
        waiting.append(Piece(source, None, choices, known=known.get(_name(source), "")))
        size += here
        if size >= TOGETHER:
            yield waiting
            waiting, size = [], 0
    if waiting:
        yield waiting


def _parts(
    source: Path | Source, choices: Mapping[str, Any], known: Mapping[str, str]
) -> list[list[Piece]] | None:
    """Parts of a large source; ``None`` where it is read as a whole: it is known, or cannot be opened."""
    try:
        opened = open_source(source)
        if known.get(opened.name) == opened.sha256:
            return None
        return pieces_of(opened, choices, whole=True)
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
