"""What can still be read of a damaged run, down to the pages of its file, as a new run."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from station.errors import RunError
from station.runs.database import COLUMNS, LAYOUTS, STRICT_JSON, SUMS, checked_fact, frames_of, journal_of
from station.runs.store import NewRecord, RunWriter, SavedRecord, SavedRun, open_run, read_record, run_file

_COMMIT = 100  # records that are saved at once
_NAMED = 1000  # records that are lost one behind the other, each by its number


@dataclass(frozen=True)
class Salvaged:
    """What was got out of a damaged run."""

    path: Path  # the new run
    records: int  # so many are in it
    lost: tuple[str, ...]  # what is known to have been there and could not be read


def salvage(path: Path, parent: Path | None = None) -> Salvaged:
    """Make a new run of what can be read of a damaged one, which stays as it is."""
    file = run_file(path)
    beside = journal_of(file)
    # as they lie: opening a run may fold them
    content, journal = file.read_bytes(), beside.read_bytes() if beside.exists() else b""
    records, facts = _scanned(content, journal)
    run: SavedRun | None = None
    with suppress(RunError):  # also one of an earlier layout
        run = open_run(file)
        records |= {record.number: record for record in run.records if record.intact}
        facts |= run.facts
    keys: dict[str, int] = {}
    for number in sorted(records, key=lambda number: (number <= 0, number)):
        keys.setdefault(records[number].key, number)  # once more under a number that is damaged
    records = {number: records[number] for number in keys.values()}
    if not records:
        raise RunError(f"{file}: nothing of a run can be read there")
    lost = _lost(records, run, facts)
    told = f"salvaged from {file}: {len(records)} records" + (f", {'; '.join(lost)}" if lost else "")
    known = {**facts, "salvaged_from": str(file), "outcome": {"kind": "salvaged", "message": told, "exit_code": 2}}
    with RunWriter.create(parent or file.parent.parent, known) as writer:
        saved = (records[number] for number in sorted(records))
        kept = [NewRecord(r.key, r.purpose, r.header, r.payload, r.conditions, r.taken_at) for r in saved]
        for first in range(0, len(kept), _COMMIT):
            writer.save_records(kept[first : first + _COMMIT])
    return Salvaged(writer.path, len(records), lost)


def _scanned(content: bytes, journal: bytes) -> tuple[dict[int, SavedRecord], dict[str, Any]]:
    """Records and facts out of all pages of a file and its journal; what was written later counts."""
    size = page_size_of(content)
    # of a page that is cut, or was not written to its end, the rows in front are there: their checksums say which
    whole = content.ljust(-(-len(content) // size) * size, b"\0")
    pages = {1 + start // size: whole[start : start + size] for start in range(0, len(whole), size)}
    images = [*pages.items(), *frames_of(journal, size)]
    pages |= dict(images[len(pages) :])
    records: dict[int, SavedRecord] = {}
    texts: dict[str, list[str]] = {}
    for number, page in images:
        for row in rows_of(page, number == 1, pages):
            if (record := _record(row)) is not None:
                records[record.number] = record
            elif len(row.cells) == 2 and all(isinstance(cell, str) for cell in row.cells):
                texts.setdefault(str(row.cells[0]), []).append(str(row.cells[1]))
    return records, dict(_facts(texts))


def _record(row: SalvagedRow) -> SavedRecord | None:
    """A row as a record, if it is one and has its checksum."""
    if len(row.cells) != len(COLUMNS):
        return None
    cells = (row.number, *row.cells[1:])
    for layout in LAYOUTS:
        if layout.columns == COLUMNS and (record := read_record(cells, layout)).intact:
            return record
    return None


def _facts(texts: dict[str, list[str]]) -> Iterator[tuple[str, Any]]:
    """The facts that have a checksum, or all where there are no sums."""
    sums: dict[str, set[str]] = {}
    for text in texts.pop(SUMS, []):
        known = _json(text)
        for name, one in known.items() if isinstance(known, dict) else ():
            sums.setdefault(name, set()).add(str(one))
    for name, found in texts.items():
        for text in reversed(found):
            if not sums or hashlib.sha256(text.encode()).hexdigest() in sums.get(name, ()):
                try:
                    yield name, checked_fact(name, _json(text))
                except ValueError:
                    continue
                break


def _json(text: str) -> Any:
    try:
        return STRICT_JSON.decode(text)
    except (ValueError, RecursionError):
        return None


def _lost(records: dict[int, SavedRecord], run: SavedRun | None, facts: dict[str, Any]) -> tuple[str, ...]:
    there = {record.number: record.key for record in run.records} if run is not None else {}
    lost, ends = [], [0, *sorted(number for number in {*records, *there} if number > 0)]
    for before, number in itertools.pairwise(ends):  # a number that is damaged itself may be any
        if number - before > _NAMED:
            lost.append(f"records {before + 1} to {number - 1} (unknown)")
        else:
            lost += [f"record {one} (unknown)" for one in range(before + 1, number)]
        if number not in records:
            lost.append(f"record {number} ({there[number]})")
    return (*lost, *(f"its {name}" for name in ("command", "settings") if name not in facts))


# --------------------
# Rows out of the pages of a damaged SQLite file, without its trees: each page gives what it holds.
#
# Source: SQLite's file format, sections 1.6 and 2 (sqlite.org/fileformat2.html)


_TABLE_LEAF, _INDEX_LEAF = 0x0D, 0x0A
_LONGEST_ROW = 64 << 20  # bytes; an hour of output at 1 kHz has 60 MB
_MOST_CELLS = 100
_INTEGERS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}  # serial type, and its bytes

Value = int | str | bytes | None


@dataclass(frozen=True)
class SalvagedRow:
    """One row: its number (0 in a table that has none), and its cells."""

    number: int
    cells: tuple[Value, ...]


def page_size_of(content: bytes) -> int:
    """Return the size of the pages that a file's header tells, that of ours where it tells none."""
    size = int.from_bytes(content[16:18], "big")
    size = 65_536 if size == 1 else size
    return size if content[:6] == b"SQLite" and size >= 512 and size & (size - 1) == 0 else 16_384


def rows_of(page: bytes, first: bool, others: Mapping[int, bytes]) -> Iterator[SalvagedRow]:
    """Give the rows of one page, those that can be read."""
    start = 100 if first else 0
    kind = page[start]
    if kind not in (_TABLE_LEAF, _INDEX_LEAF):
        return
    count = int.from_bytes(page[start + 3 : start + 5], "big")
    for place in range(start + 8, min(start + 8 + 2 * count, len(page) - 1), 2):
        try:
            yield _row(page, int.from_bytes(page[place : place + 2], "big"), kind, others)
        except (ValueError, IndexError, KeyError):
            continue


def _row(page: bytes, at: int, kind: int, others: Mapping[int, bytes]) -> SalvagedRow:
    length, at = _varint(page, at)
    number = 0
    if kind == _TABLE_LEAF:
        number, at = _varint(page, at)
        number -= (number >> 63) << 64  # it has a sign
    if not 0 < length <= _LONGEST_ROW:
        raise ValueError("no row is so long")
    most = len(page) - 35 if kind == _TABLE_LEAF else (len(page) - 12) * 64 // 255 - 23
    if length <= most:
        return SalvagedRow(number, _cells(page[at : at + length]))
    least = (len(page) - 12) * 32 // 255 - 23
    here = least + (length - least) % (len(page) - 4)
    here = here if here <= most else least
    pieces, following = [page[at : at + here]], int.from_bytes(page[at + here : at + here + 4], "big")
    if length > here + len(others) * (len(page) - 4):  # else a chain that comes back to itself has no end
        raise ValueError("no file of so many pages holds so long a row")
    for _ in range(-(-(length - here) // (len(page) - 4))):
        more = others[following]
        pieces.append(more[4:])
        following = int.from_bytes(more[:4], "big")
    return SalvagedRow(number, _cells(b"".join(pieces)[:length]))


def _cells(data: bytes) -> tuple[Value, ...]:
    length, at = _varint(data, 0)
    kinds = []
    while at < length:
        kind, at = _varint(data, at)
        kinds.append(kind)
        if len(kinds) > _MOST_CELLS:
            raise ValueError("no row of ours has so many cells")
    values: list[Value] = []
    for kind in kinds:
        size = _INTEGERS.get(kind, 8 if kind == 7 else (kind - 12) // 2 if kind >= 12 else 0)
        piece = data[at : at + size]
        if len(piece) < size:
            raise ValueError("the row is cut")
        at += size
        values.append(_value(kind, piece))
    return tuple(values)


def _value(kind: int, piece: bytes) -> Value:
    if kind >= 12:
        return piece if kind % 2 == 0 else piece.decode("utf-8", errors="replace")
    if kind in _INTEGERS:
        return int.from_bytes(piece, "big", signed=True)
    return {8: 0, 9: 1}.get(kind)  # a number with a fraction is in none of our columns


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number of one to nine bytes, and where it ends."""
    value = 0
    for place in range(at, at + 8):
        value = value << 7 | data[place] & 0x7F
        if data[place] < 0x80:
            return value, place + 1
    return value << 8 | data[at + 8], at + 9
