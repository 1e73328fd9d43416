"""Fill a results table from sources: only what it does not hold yet is computed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from station.errors import RunError
from station.lock_in.records.pieces import Piece
from station.reanalysis.tables.columns import Rows, analysis_of, rows_of_pieces
from station.reanalysis.tables.lock import only_writer
from station.reanalysis.tables.open_table import table_file
from station.reanalysis.tables.table import Key, TableFile
from station.reanalysis.work import Work
from station.runs.progress import Progress
from station.sources.batches import LeftOut
from station.sources.source import Source
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
    """Estimate every record of the sources by itself, and put one row for each into a table."""
    file, analysis, done = table_file(table), analysis_of(choices), Filled(table)
    with only_writer(table):
        known = {source: sha256 for (source, made), sha256 in _known(file).items() if made == analysis}
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


def _packed_rows(kind: type[TableFile], pieces: Sequence[Piece]) -> tuple[Any, list[Rows]]:
    """Rows of some pieces, ready to be written; and what is said of each piece, without its columns."""
    parts = rows_of_pieces(pieces)
    packed = kind.packed(parts) if any(part.count for part in parts) else None
    return packed, [replace(part, columns={}) for part in parts]
