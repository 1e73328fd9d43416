"""From a saved segment to its mean; one that cannot be used raises ValueError with the reason."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.fibre_gyro import (
    WindowMean,
    check_whole_turns,
    horizontal_earth_rate_dps,
    mean_at_rest,
    mean_over_turns,
    whole_turns_in,
)
from instrument.fibre_gyro import Gap, Recording
from station.fibre_gyro.recordings import Segment
from station.fibre_gyro.settings import FogSettings

Floats = NDArray[np.float64]

_OVERLAP_S = 2.0
"""By so much a log may begin before the one before has ended: stamps are rounded, or tell the end of a word."""
_APPROXIMATE = ("counter jump", "silence")
"""Causes of gaps whose length nobody knows exactly: the turn of the table is not known behind them."""


def window_over_turns(
    segment: Segment, *, turns: int, window_s: float, resolution: float, column: str = ""
) -> WindowMean:
    """Mean over whole turns."""
    recording, rate = checked(segment), float(segment.conditions["rate_dps"])
    turning = float(segment.conditions.get("table_rate_dps", rate))
    interval = recording.interval_s
    words = words_of(recording, column)
    chosen = float(segment.conditions.get("window_s", window_s))
    if chosen > 0:
        turns = check_whole_turns(chosen, turning, tolerance_s=interval)
    else:
        turns = min(turns, whole_turns_in(words.size * interval, turning, tolerance_s=interval))
    return mean_over_turns(words, interval, turning, turns=turns, resolution=resolution)


def window_at_rest(segment: Segment, *, resolution: float) -> WindowMean:
    """Mean of a segment without rotation; ValueError as in :func:`window_over_turns`."""
    recording = checked(segment)
    return mean_at_rest(words_of(recording), recording.interval_s, resolution=resolution)


def window_of_any_length(
    segment: Segment, settings: FogSettings, *, turns: int, tilt_mrad: float | None = None
) -> WindowMean:
    """Mean over whole turns, or where the record is shorter than one turn, of all of it.

    Without whole turns a part of the horizontal earth rate stays in: what the input axis, tilted by
    `tilt_mrad` (``figures.misalignment_mrad`` if not given), can see of it counts in the uncertainty. Errors as
    :func:`window_over_turns`.
    """
    recording, rate = checked(segment), float(segment.conditions["rate_dps"])
    resolution = settings.gyro.output_resolution
    turning = abs(float(segment.conditions.get("table_rate_dps", rate)))
    words = words_of(recording)
    if (words.size + 1) * recording.interval_s * turning >= 360.0:
        return window_over_turns(segment, turns=turns, window_s=0.0, resolution=resolution)
    mean = mean_at_rest(words, recording.interval_s, resolution=resolution)
    tilt = 1e-3 * (settings.figures.misalignment_mrad if tilt_mrad is None else tilt_mrad)
    seen = settings.nominal_scale_factor * tilt * horizontal_earth_rate_dps(settings.site.latitude_deg)
    return replace(mean, mean_u=math.hypot(mean.mean_u, seen))


def begins_of(segments: Sequence[Segment]) -> list[float]:
    """When each segment began, s: by the logs' own clock, by when it was saved, else one right after the other.

    A clock counts if by it no segment begins before the one before has ended.
    """
    lengths = [one.recording.duration_s for one in segments]
    of_logs = [one.conditions.get("begin_s") for one in segments]
    if all(begin is not None for begin in of_logs) and _one_after_another(begins := np.array(of_logs), lengths):
        return [float(one) for one in begins]
    saved = [_seconds(one.taken_at) for one in segments]
    if _one_after_another(begins := np.array(saved) - lengths, lengths):
        return [float(one) for one in begins]
    return [float(one) for one in np.cumsum(lengths) - lengths]


def _one_after_another(begins: Floats, lengths: Sequence[float]) -> bool:
    if not np.all(np.isfinite(begins)):
        return False
    order = np.argsort(begins)
    ends = (begins + lengths)[order]
    return bool(np.all(begins[order][1:] >= ends[:-1] - _OVERLAP_S))


def _seconds(iso: str) -> float:
    try:
        return datetime.fromisoformat(iso).timestamp()
    except ValueError:
        return math.nan


def words_of(recording: Recording, column: str = "") -> Floats:
    """Output words at equal intervals, nan where one is missing, of the longest stretch whose time is exact."""
    values = recording.extra[column] if column else recording.counts
    if not recording.gaps:
        return values
    first, last = _exact_stretch(recording)
    places = np.round(recording.times[first:last] / recording.interval_s).astype(np.intp)
    places -= places[0]
    words = np.full(int(places[-1]) + 1, np.nan)
    words[places] = values[first:last]
    return words


def _exact_stretch(recording: Recording) -> tuple[int, int]:
    edges = [0, *(gap.after + 1 for gap in recording.gaps if gap.cause in _APPROXIMATE), recording.counts.size]
    return max(itertools.pairwise(edges), key=lambda pair: pair[1] - pair[0])


def remarks_on(segment: Segment, window: WindowMean) -> list[str]:
    """Say what was missing in a window, and what was left out of it; sentences."""
    said, gaps = [], segment.recording.gaps
    cut = [gap for gap in gaps if gap.cause in _APPROXIMATE]
    if cut:
        said.append(f"{segment.key}: {cut[0].describe()}; only the longest stretch without such a gap is used.")
    if window.missing:
        words = "1 output word is" if window.missing == 1 else f"{window.missing} output words are"
        inside = f", the first {gaps[0].start_s:.6g} s after the begin" if gaps and not cut else ""
        said.append(
            f"{segment.key}: {words} missing of {window.samples}{inside}; the mean is fitted to the others."
        )
    if window.outliers:
        words = "1 output word lies" if window.outliers == 1 else f"{window.outliers} output words lie"
        said.append(
            f"{segment.key}: {words} up to {window.worst:.3g} counts off the mean, far from all others: left out."
        )
    return said


def checked(segment: Segment) -> Recording:
    """Return the recording of a segment that can be used."""
    recording = segment.recording
    if not segment.intact:
        raise ValueError("what is saved is not what was once saved (its checksum is wrong)")
    if recording.counts.size < 2 or not np.all(np.isfinite(recording.counts)):
        raise ValueError("the recording holds no usable output")
    lost = sum(gap.missing for gap in recording.gaps)
    if lost > 0.2 * (lost + recording.counts.size):
        raise ValueError(
            f"{_gaps_in_words(recording.gaps)}: {lost} of {lost + recording.counts.size} outputs are missing"
        )
    return recording


def _gaps_in_words(gaps: tuple[Gap, ...]) -> str:
    more = f", and {len(gaps) - 1} more gaps" if len(gaps) > 1 else ""
    return f"{gaps[0].describe()}{more}"


def unusable(segment: Segment, tolerance_ppm: float) -> str:
    """Why a segment would be left out for what happened while it was taken; empty if for nothing."""
    try:
        rate = float(segment.conditions.get("rate_dps") or 0.0)
        if rate:
            check_table_rate(segment.conditions, tolerance_ppm)
        recording = checked(segment)
        if any(gap.cause in _APPROXIMATE for gap in recording.gaps) and rate:
            whole_turns_in(words_of(recording).size * recording.interval_s, rate, tolerance_s=recording.interval_s)
    except ValueError as error:
        return str(error)
    return ""


def check_table_rate(conditions: dict[str, Any], tolerance_ppm: float) -> None:
    """Refuse a table rate that is not the one that was asked for; ValueError as above."""
    wanted = float(conditions["rate_dps"])
    reached = float(conditions.get("table_rate_dps", wanted))
    off_ppm = 1e6 * (reached / wanted - 1)
    if abs(off_ppm) > tolerance_ppm:
        raise ValueError(
            f"the table turned at {reached:+.6g} deg/s instead of {wanted:+.6g}, {off_ppm:+.0f} ppm off "
            f"(table.rate_tolerance_ppm = {tolerance_ppm:g})"
        )
