"""The motion of the rate table, piece by piece."""

from __future__ import annotations

import bisect
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Motion(Protocol):
    """A piece of the table's motion with constant acceleration, from an absolute time `start` (s) on.

    Any object with these attributes will do, as long as it does not change: phases that it led to are kept.
    """

    def __hash__(self) -> int:
        """Of its values."""

    @property
    def start(self) -> float:
        """Absolute time, s."""

    @property
    def azimuth_deg(self) -> float:
        """Azimuth at the start."""

    @property
    def rate_dps(self) -> float:
        """Rate at the start."""

    @property
    def acceleration_dps2(self) -> float:
        """Acceleration of the whole piece."""

    def azimuth_at(self, times: Array) -> Array:
        """Table azimuth in deg, not wrapped, at absolute times in s."""

    def rate_at(self, times: Array) -> Array:
        """Table rate in deg/s at absolute times in s."""


Inside = NDArray[np.intp] | slice


def split(motion: tuple[Motion, ...], times: Array) -> list[tuple[int, Inside]]:
    """Sort times into pieces: number of the piece, and the indices of the times that fall into it.

    Shapes: times (n,).
    """
    if times.size == 0:
        return []
    starts = [piece.start for piece in motion]
    first, last = (max(bisect.bisect_right(starts, t) - 1, 0) for t in (float(times.min()), float(times.max())))
    if first == last:
        return [(first, slice(None))]
    which = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, None)
    return [(int(i), np.flatnonzero(which == i)) for i in np.unique(which)]
