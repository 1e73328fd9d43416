"""The motion of the rate table, piece by piece."""

from __future__ import annotations

import bisect
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Segment:
    """A piece of the table's motion with constant acceleration.

    Attributes
    ----------
    start : float
        Absolute time, s.
    azimuth_deg, rate_dps, acceleration_dps2 : float
        At the start; the acceleration holds for the whole segment.
    """

    start: float
    azimuth_deg: float
    rate_dps: float
    acceleration_dps2: float = 0.0

    def azimuth_at(self, times: Array) -> Array:
        """Table azimuth in deg, not wrapped, at absolute times in s."""
        elapsed = times - self.start
        return self.azimuth_deg + (self.rate_dps + 0.5 * self.acceleration_dps2 * elapsed) * elapsed

    def rate_at(self, times: Array) -> Array:
        """Table rate in deg/s at absolute times in s."""
        return self.rate_dps + self.acceleration_dps2 * (times - self.start)


Inside = NDArray[np.intp] | slice


def split(motion: tuple[Segment, ...], times: Array) -> list[tuple[int, Inside]]:
    """Sort times into segments: number of the segment, and the indices of the times that fall into it.

    Parameters
    ----------
    motion : tuple of Segment
        In order of time; the last one goes on for ever, the first one also holds before its start.
    times : ndarray, shape (n,)
        Absolute times, s.
    """
    if times.size == 0:
        return []
    starts = [segment.start for segment in motion]
    first, last = (max(bisect.bisect_right(starts, t) - 1, 0) for t in (float(times.min()), float(times.max())))
    if first == last:
        return [(first, slice(None))]
    which = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, None)
    return [(int(i), np.flatnonzero(which == i)) for i in np.unique(which)]
