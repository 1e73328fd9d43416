"""A recording as a log."""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path

import numpy as np

from instrument.fibre_gyro.frame_format import COUNTS, STATUS, TEMPERATURE
from instrument.fibre_gyro.recording import Floats, Recording


def write_gyro_log(path: str | os.PathLike[str], recording: Recording) -> None:
    """Write a recording as a log that `read_gyro_log` reads back exactly."""
    columns: dict[str, Floats] = {"time_s": recording.times, COUNTS: recording.counts}
    if recording.temperature is not None:
        columns[TEMPERATURE] = recording.temperature
    if recording.status is not None:
        columns[STATUS] = recording.status.astype(np.float64)
    columns |= recording.extra
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([repr(int(v)) if v == int(v) else repr(v) for v in row] for row in _as_rows(columns))
    Path(path).write_text(out.getvalue(), "ascii")


def _as_rows(columns: dict[str, Floats]) -> list[list[float]]:
    rows: list[list[float]] = np.column_stack(list(columns.values())).tolist()
    return rows
