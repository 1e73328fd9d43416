"""The run store of the fibre gyro: one SQLite file a run, one durable commit a segment.

A segment is one stretch of the gyro's output under constant conditions: a table rate, an injected step, rest. Its
key says which, so that a run that was cut short goes on with the segments that are missing.
"""

from __future__ import annotations

import hashlib
import json
import sqlite3
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from instrument.fibre_gyro import Gap, Losses, Recording
from station.errors import RunError
from station.runs.database import (
    DatabaseWriter,
    Layout,
    create_database,
    is_database,
    read_facts,
    reading,
    utc_now,
)
from station.runs.run_directories import new_run_directory

FOG_RUN_FILE = "fog.sqlite"
FOG_REPORT_FILE = "report.html"
_ASIDE = " (set aside "

LAYOUT = Layout(
    application_id=0x47_59_4C_46,  # "GYLF"
    version=1,
    tables="""
CREATE TABLE segment (
    number     INTEGER PRIMARY KEY,
    key        TEXT NOT NULL UNIQUE,
    taken_at   TEXT NOT NULL,     -- UTC, ISO 8601
    conditions TEXT NOT NULL,     -- JSON
    recording  TEXT NOT NULL,     -- JSON: names of the columns, interval, clock, gaps, losses
    samples    BLOB NOT NULL,     -- zlib: the columns one after the other, little-endian float64
    sha256     TEXT NOT NULL      -- of samples, conditions and recording
);
""",
    name="a run of `gyrolock fog`",
)


@dataclass(frozen=True)
class Segment:
    """One segment as it was saved.

    Attributes
    ----------
    key : str
        What it is, unique in its run: ``"Z +20"``.
    taken_at : str
        UTC, ISO 8601.
    conditions : dict
        Plain JSON: rates, injected step, axis, ...
    recording : Recording
    intact : bool
        Whether it still has the checksum that it was saved with.
    """

    key: str
    taken_at: str
    conditions: dict[str, Any]
    recording: Recording
    intact: bool


@dataclass(frozen=True)
class FogRun:
    """A run as it was read from its file.

    Attributes
    ----------
    path : Path
        The SQLite file.
    facts : dict
        What was known beside the segments: command, settings, provenance, truth, times, outcome.
    segments : tuple of Segment
        In the order in which they were taken.
    """

    path: Path
    facts: dict[str, Any]
    segments: tuple[Segment, ...]

    def taken_for(self, purpose: str) -> tuple[Segment, ...]:
        """Segments of ``"table"``, ``"selfcal"``, ``"eps"`` or ``"figures"`` that are not set aside."""
        return tuple(
            segment
            for segment in self.segments
            if segment.conditions.get("purpose") == purpose and _ASIDE not in segment.key
        )


class FogRunWriter(DatabaseWriter):
    """Writes one run; a segment that :meth:`save_segment` returned for survives a killed process.

    Use :meth:`create` or :meth:`resume`.
    """

    @classmethod
    def create(cls, parent: Path, facts: Mapping[str, object]) -> Self:
        """Begin a run in a new directory below `parent`; RunError if nothing can be written there."""
        path = new_run_directory(parent) / FOG_RUN_FILE
        create_database(path, LAYOUT)
        writer = cls(path)
        writer.save_facts({"started_at": utc_now(), **facts})
        return writer

    @classmethod
    def resume(cls, path: Path) -> Self:
        """Go on with a run that :func:`open_fog_run` can read."""
        return cls(path)

    def save_segment(self, key: str, conditions: Mapping[str, object], recording: Recording) -> None:
        """Save one segment durably: when this returns, it is on the disk.

        Raises
        ------
        RunError
            If the disk does not take it, or the run has a segment of this key.
        """
        columns = _columns_of(recording)
        blob = zlib.compress(np.stack(list(columns.values())).astype("<f8").tobytes(), 1)
        circumstances = json.dumps(dict(conditions), allow_nan=False)
        described = json.dumps(
            {
                "columns": list(columns),
                "interval_s": recording.interval_s,
                "clock": recording.clock,
                "gaps": [asdict(gap) for gap in recording.gaps],
                "losses": asdict(recording.losses),
            }
        )
        row = (key, utc_now(), circumstances, described, blob, _checksum(blob, circumstances, described))
        names = "key, taken_at, conditions, recording, samples, sha256"
        self._commit(f"INSERT INTO segment ({names}) VALUES (?, ?, ?, ?, ?, ?)", [row])

    def set_aside(self, key: str) -> None:
        """Keep a segment out of the results under another key, so that it can be taken again."""
        (before,) = self._db.execute(
            "SELECT count(*) FROM segment WHERE key LIKE ?", (f"{key}{_ASIDE}%",)
        ).fetchone()
        self._commit("UPDATE segment SET key = ? WHERE key = ?", [(f"{key}{_ASIDE}{before + 1})", key)])


def is_fog_run(path: Path) -> bool:
    """Tell whether a path looks like a run: its directory, or an SQLite file."""
    with suppress(OSError):
        return is_database(path)
    return False


def open_fog_run(path: Path) -> FogRun:
    """Read a run, finished or cut short.

    Parameters
    ----------
    path : Path
        The SQLite file or its directory.

    Raises
    ------
    RunError
        If there is no such run, or it is damaged.
    """
    file = path / FOG_RUN_FILE if path.is_dir() else path
    if not file.is_file():
        raise RunError(f"{path}: holds no run of a fibre gyro (there is no {FOG_RUN_FILE} in it)")
    with reading(file, LAYOUT) as db:
        try:
            return FogRun(file, read_facts(db), tuple(_read_segments(db)))
        except zlib.error as error:
            raise RunError(f"{file}: is damaged and cannot be read ({error})") from error


def _read_segments(db: sqlite3.Connection) -> Iterator[Segment]:
    names = "key, taken_at, conditions, recording, samples, sha256"
    for key, taken_at, conditions, described, blob, sha256 in db.execute(
        f"SELECT {names} FROM segment ORDER BY number"
    ):
        intact = _checksum(blob, conditions, described) == sha256
        recording = _recording_from(json.loads(described), blob) if intact else _EMPTY
        yield Segment(key, taken_at, json.loads(conditions), recording, intact)


def _columns_of(recording: Recording) -> dict[str, NDArray[np.float64]]:
    columns = {"times": recording.times, "counts": recording.counts}
    if recording.temperature is not None:
        columns["temperature"] = recording.temperature
    if recording.status is not None:
        columns["status"] = recording.status.astype(np.float64)
    return columns | {f"extra {name}": values for name, values in recording.extra.items()}


def _recording_from(described: dict[str, Any], blob: bytes) -> Recording:
    table = np.frombuffer(zlib.decompress(blob), dtype="<f8").reshape(len(described["columns"]), -1)
    columns = dict(zip(described["columns"], table.astype(np.float64), strict=True))
    status = columns.get("status")
    return Recording(
        times=columns["times"],
        counts=columns["counts"],
        temperature=columns.get("temperature"),
        status=None if status is None else status.astype(np.int64),
        extra={name[6:]: values for name, values in columns.items() if name.startswith("extra ")},
        gaps=tuple(Gap(**gap) for gap in described["gaps"]),
        losses=Losses(**described["losses"]),
        interval_s=described["interval_s"],
        clock=described["clock"],
    )


_EMPTY = Recording(np.empty(0), np.empty(0), None, None, {}, (), Losses(), 1.0, "counter")


def _checksum(blob: bytes, conditions: str, described: str) -> str:
    return hashlib.sha256(blob + conditions.encode() + described.encode()).hexdigest()
