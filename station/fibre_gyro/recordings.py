"""A stretch of a fibre gyro's output as a record of a run: packed columns, and a header that describes them."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from instrument.fibre_gyro import Gap, HostClock, Losses, Recording
from station.errors import RunError
from station.runs.store import NewRecord, SavedRecord, SavedRun

_EXTRA = "extra "
_EMPTY = Recording(np.empty(0), np.empty(0), None, None, {}, (), Losses(), 1.0, "counter")


@dataclass(frozen=True)
class Segment:
    """One stretch of output under constant conditions: a table rate, an injected step, rest."""

    key: str  # what it is, unique in its run: ``"Z +20"``
    conditions: dict[str, Any]  # plain JSON: rates, injected step, axis, ..
    recording: Recording  # empty where it is not intact
    intact: bool  # whether it still is what was once saved
    taken_at: str = ""  # when it was saved, UTC, ISO 8601


def segments_of(run: SavedRun, purpose: str) -> tuple[Segment, ...]:
    """Return the stretches of one purpose that are not set aside, in the order in which they were taken."""
    return tuple(_segment(record, run) for record in run.taken_for(purpose))


def new_record(key: str, conditions: Mapping[str, Any], recording: Recording) -> NewRecord:
    """Return a record to be saved; the conditions hold its ``purpose``."""
    columns = _columns_of(recording)
    payload = zlib.compress(np.stack(list(columns.values())).astype("<f8").tobytes(), 1)
    header = {
        "columns": list(columns),
        "interval_s": recording.interval_s,
        "clock": recording.clock,
        "gaps": [asdict(gap) for gap in recording.gaps],
        "losses": asdict(recording.losses),
        "host_clock": None if recording.host_clock is None else asdict(recording.host_clock),
        "doubts": recording.doubts,
    }
    return NewRecord(key, conditions["purpose"], json.dumps(header), payload, conditions)


def recording_of(record: NewRecord) -> Recording:
    """Return the stretch of output that a record holds which was just saved."""
    return _recording_from(json.loads(record.header), record.payload)


def _segment(record: SavedRecord, run: SavedRun) -> Segment:
    recording = _EMPTY
    if record.intact:
        try:
            recording = _recording_from(json.loads(record.header), record.payload)
        except (zlib.error, ValueError, KeyError, TypeError) as error:
            raise RunError(f"{run.path}: {record.key}: is damaged and cannot be read ({error})") from None
    return Segment(record.key, record.conditions, recording, record.intact, record.taken_at)


def _columns_of(recording: Recording) -> dict[str, NDArray[np.float64]]:
    columns = {"times": recording.times, "counts": recording.counts}
    if recording.temperature is not None:
        columns["temperature"] = recording.temperature
    if recording.status is not None:
        columns["status"] = recording.status.astype(np.float64)
    return columns | {f"{_EXTRA}{name}": values for name, values in recording.extra.items()}


def _recording_from(described: dict[str, Any], payload: bytes) -> Recording:
    table = np.frombuffer(zlib.decompress(payload), dtype="<f8").reshape(len(described["columns"]), -1)
    columns = dict(zip(described["columns"], table.astype(np.float64), strict=True))
    status, host_clock = columns.get("status"), described.get("host_clock")
    return Recording(
        times=columns["times"],
        counts=columns["counts"],
        temperature=columns.get("temperature"),
        status=None if status is None else status.astype(np.int64),
        extra={name[len(_EXTRA) :]: values for name, values in columns.items() if name.startswith(_EXTRA)},
        gaps=tuple(Gap(**gap) for gap in described["gaps"]),
        losses=Losses(**described["losses"]),
        interval_s=described["interval_s"],
        clock=described["clock"],
        host_clock=None if host_clock is None else HostClock(**host_clock),
        doubts=tuple(described.get("doubts", ())),
    )
