"""What can still be read of a damaged run, as a new run: records that have their checksum, and no others."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from station.errors import RunError
from station.runs.database import SUMS
from station.runs.facts import checked_fact
from station.runs.journal import frames_of, journal_of
from station.runs.layouts import COLUMNS, LAYOUTS
from station.runs.pages import Row, page_size_of, rows_of
from station.runs.store import NewRecord, RunWriter, SavedRecord, SavedRun, open_run, read_record, run_file

_COMMIT = 100  # records that are saved at once


@dataclass(frozen=True)
class Salvaged:
    """What was got out of a damaged run."""

    path: Path  # the new run
    records: int  # so many are in it
    lost: tuple[str, ...]  # what is known to have been there and could not be read


def salvage(path: Path, parent: Path | None = None) -> Salvaged:
    """Make a new run of what can be read of a damaged one, which stays as it is."""
    file = run_file(path)
    content, journal = file.read_bytes(), _content(journal_of(file))  # as they lie: opening a run may fold them
    records, facts = _scanned(content, journal)
    run = _opened(file)
    if run is not None:
        records |= {record.number: record for record in run.records if record.intact}
        facts |= run.facts
    if not records:
        raise RunError(f"{file}: nothing of a run can be read there")
    lost = _lost(records, run, facts)
    told = f"salvaged from {file}: {len(records)} records" + (f", {'; '.join(lost)}" if lost else "")
    known = {**facts, "salvaged_from": str(file), "outcome": {"kind": "salvaged", "message": told, "exit_code": 2}}
    with RunWriter.create(parent or file.parent.parent, known) as writer:
        kept = [_new(records[number]) for number in sorted(records)]
        for first in range(0, len(kept), _COMMIT):
            writer.save_records(kept[first : first + _COMMIT])
    return Salvaged(writer.path, len(records), lost)


def _content(path: Path) -> bytes:
    return path.read_bytes() if path.exists() else b""


def _opened(file: Path) -> SavedRun | None:
    """The run, where it can be opened; also one of an earlier layout."""
    try:
        return open_run(file)
    except RunError:
        return None


def _scanned(content: bytes, journal: bytes) -> tuple[dict[int, SavedRecord], dict[str, Any]]:
    """Records and facts out of all pages of a file and its journal; what was written later counts."""
    size = page_size_of(content)
    pages = {1 + start // size: content[start : start + size] for start in range(0, len(content) - size + 1, size)}
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


def _record(row: Row) -> SavedRecord | None:
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
        return json.loads(text)
    except (ValueError, RecursionError):
        return None


def _lost(records: dict[int, SavedRecord], run: SavedRun | None, facts: dict[str, Any]) -> tuple[str, ...]:
    there = {record.number: record.key for record in run.records} if run is not None else {}
    numbers = range(1, max([*records, *there]) + 1)
    lost = [f"record {number} ({there.get(number, 'unknown')})" for number in numbers if number not in records]
    return (*lost, *(f"its {name}" for name in ("command", "settings") if name not in facts))


def _new(record: SavedRecord) -> NewRecord:
    return NewRecord(record.key, record.purpose, record.header, record.payload, record.conditions, record.taken_at)
