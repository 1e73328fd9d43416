"""What one stretch of output says as soon as it is there, its mean and its course: for those who watch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from station.events.seen import See, Seen, Trace, Value
from station.fibre_gyro.recordings import recording_of
from station.results.numbers import with_uncertainty
from station.runs.store import NewRecord

_POINTS = 240


def watch(settings: Any) -> See:
    """Return what looks at stretches of output as they come, whatever test they are of."""
    return _seen


def _seen(records: Sequence[NewRecord]) -> Seen | None:
    record = records[0]
    recording = recording_of(record)
    counts = recording.counts
    if counts.size == 0:
        return Seen(record.key, record.purpose, (), flags=("empty",))
    mean, u = float(counts.mean()), float(counts.std() / math.sqrt(counts.size)) if counts.size > 1 else math.nan
    values = (Value("output_counts", mean, u, with_uncertainty(mean, u, "counts"), counts.size),)
    # neighbours are taken together: of a long stretch the mean of each part is shown
    parts = np.array_split(counts, min(_POINTS, counts.size))
    samples = [float(f"{part.mean():.6g}") for part in parts]
    flags = () if recording.complete else ("gaps",)
    trace = Trace(recording.duration_s, "counts", samples)
    return Seen(record.key, record.key, values, values, flags=flags, trace=trace)
