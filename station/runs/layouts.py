"""How a run is laid out in its SQLite file: today's layout, and the three that earlier versions wrote.

Every layout gives the same columns to a reader, so that nothing above knows which one a file has.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

_RING_LASER = 0x47_59_4C_4B  # "GYLK"; every run today
_FIBRE_GYRO = 0x47_59_4C_46  # "GYLF"; runs of the fibre gyro, once

COLUMNS = ("number", "key", "taken_at", "purpose", "header", "payload", "sha256", "conditions")


@dataclass(frozen=True)
class Layout:
    """One layout."""

    # four letters at the beginning of the file, by which ``file`` and we tell it from other databases
    application_id: int
    version: int
    table: str  # table of the records
    columns: tuple[str, ...]  # SQL that gives each of `COLUMNS`
    # SHA-256 of a record, as this layout makes it; gets its cells by the names of `COLUMNS`
    checksum: Callable[[Mapping[str, Any]], str]

    @property
    def select(self) -> str:
        """SQL that reads all records in the order in which they were taken."""
        return f"SELECT {', '.join(self.columns)} FROM {self.table} ORDER BY number"

    @property
    def select_between(self) -> str:
        """The same for records from one number to another, its two parameters."""
        return f"SELECT {', '.join(self.columns)} FROM {self.table} WHERE number BETWEEN ? AND ? ORDER BY number"

    @property
    def insert(self) -> str:
        """SQL that adds one record; its parameters are those of `COLUMNS` that the table holds, by name."""
        held = [(c, name) for c, name in zip(self.columns, COLUMNS, strict=True) if c.isidentifier()]
        names, values = zip(*((c, f":{name}") for c, name in held if name != "number"), strict=True)
        return f"INSERT INTO {self.table} ({', '.join(names)}) VALUES ({', '.join(values)})"


def _of(*names: str, lengths: bool = False) -> Callable[[Mapping[str, Any]], str]:
    """SHA-256 of some cells one behind the other, with `lengths` each behind its own length."""

    def checksum(cells: Mapping[str, Any]) -> str:
        digest = hashlib.sha256()
        for name in names:
            cell = cells[name]
            data = cell if isinstance(cell, bytes) else cell.encode()
            digest.update(b"%d " % len(data) + data if lengths else data)
        return digest.hexdigest()

    return checksum


_EVERYTHING = ("key", "taken_at", "purpose", "header", "payload", "conditions")
TODAY = Layout(_RING_LASER, 3, "record", COLUMNS, _of(*_EVERYTHING, lengths=True))
TABLES = """
CREATE TABLE run (
    name  TEXT PRIMARY KEY,       -- command, settings, provenance, truth, started_at, ended_at, outcome, ...
    value TEXT NOT NULL           -- JSON
) WITHOUT ROWID;
CREATE TABLE result (             -- computed from the records; never the truth
    number      INTEGER PRIMARY KEY,
    computed_at TEXT NOT NULL,
    value       TEXT NOT NULL     -- JSON
);
CREATE TABLE record (
    number     INTEGER PRIMARY KEY,
    key        TEXT NOT NULL UNIQUE,  -- what it is: a run cut short goes on with the keys that are missing
    taken_at   TEXT NOT NULL,         -- UTC, ISO 8601
    purpose    TEXT NOT NULL,         -- which part of which measurement it was taken for
    header     TEXT NOT NULL,         -- preamble as the scope sent it, or JSON on the columns of an output
    payload    BLOB NOT NULL,         -- codes as the scope sent them, or the columns of an output (zlib)
    sha256     TEXT NOT NULL,         -- of all the others but the number
    conditions TEXT NOT NULL          -- JSON
);
"""
_RING_LASER_1 = Layout(
    _RING_LASER,
    1,
    "record",
    ("number", "purpose || ' ' || number", "taken_at", "purpose", "preamble", "codes", "sha256", "conditions"),
    _of("payload", "header"),
)
_RING_LASER_2 = Layout(_RING_LASER, 2, "record", COLUMNS, _of("payload", "header", "conditions"))
_FIBRE_GYRO_1 = Layout(
    _FIBRE_GYRO,
    1,
    "segment",
    (
        "number", "key", "taken_at",
        "CASE WHEN json_valid(conditions) THEN json_extract(conditions, '$.purpose') END",
        "recording", "samples", "sha256", "conditions",
    ),
    _of("payload", "conditions", "header"),
)  # fmt: skip
LAYOUTS = (TODAY, _RING_LASER_2, _RING_LASER_1, _FIBRE_GYRO_1)


def layout_of(application_id: int, version: int) -> Layout | None:
    """Return the layout of a file, ``None`` if it is no run of ours."""
    ours = [layout for layout in LAYOUTS if layout.application_id == application_id]
    if not ours:
        return None
    for layout in ours:
        if layout.version == version:
            return layout
    raise ValueError(f"layout {version}")
