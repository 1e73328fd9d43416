"""From a saved segment to its mean; one that cannot be used raises ValueError with the reason."""

from __future__ import annotations

from typing import Any

import numpy as np

from analysis.fibre_gyro import (
    WindowMean,
    check_whole_turns,
    mean_at_rest,
    mean_over_turns,
    whole_turns_in,
)
from instrument.fibre_gyro import Recording
from station.fibre_gyro.recordings import Segment


def window_over_turns(segment: Segment, *, turns: int, window_s: float, resolution: float) -> WindowMean:
    """Mean over whole turns.

    Parameters
    ----------
    segment : Segment
        Its conditions hold ``rate_dps``; ``window_s`` where a log names its own window.
    turns : int
        At most so many whole turns; fewer where the record is shorter.
    window_s : float
        A window of fixed length instead, if not 0.
    resolution : float
        Of the output word, counts.

    Raises
    ------
    ValueError
        In words that follow "is left out:".
    """
    recording, rate = checked(segment), float(segment.conditions["rate_dps"])
    turning = float(segment.conditions.get("table_rate_dps", rate))
    interval = recording.interval_s
    chosen = float(segment.conditions.get("window_s", window_s))
    if chosen > 0:
        turns = check_whole_turns(chosen, turning, tolerance_s=interval)
    else:
        turns = min(turns, whole_turns_in(recording.counts.size * interval, turning, tolerance_s=interval))
    return mean_over_turns(recording.counts, interval, turning, turns=turns, resolution=resolution)


def window_at_rest(segment: Segment, *, resolution: float) -> WindowMean:
    """Mean of a segment without rotation; ValueError as in :func:`window_over_turns`."""
    recording = checked(segment)
    return mean_at_rest(recording.counts, recording.interval_s, resolution=resolution)


def checked(segment: Segment) -> Recording:
    """Return the recording of a segment whose every output is there.

    Raises
    ------
    ValueError
        It is damaged, or outputs are missing.
    """
    recording = segment.recording
    if not segment.intact:
        raise ValueError("what is saved is not what was once saved (its checksum is wrong)")
    if recording.gaps:
        more = f", and {len(recording.gaps) - 1} more gaps" if len(recording.gaps) > 1 else ""
        raise ValueError(f"{recording.gaps[0].describe()}{more}: take it again")
    if recording.counts.size < 2 or not np.all(np.isfinite(recording.counts)):
        raise ValueError("the recording holds no usable output")
    return recording


def unusable(segment: Segment, tolerance_ppm: float) -> str:
    """Why a segment would be left out for what happened while it was taken; empty if for nothing."""
    try:
        if segment.conditions.get("rate_dps"):
            check_table_rate(segment.conditions, tolerance_ppm)
        checked(segment)
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
