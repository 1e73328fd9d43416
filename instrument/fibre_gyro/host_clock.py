"""The gyro's clock beside the computer's: when frames came, and what interval they were sent at.

A frame never comes early. A USB adapter, the operating system and this program hold it back, some milliseconds as
a rule and now and then much longer; so all arrivals lie above the line of those that were not held back. That line
is the one that no arrival lies below and that is nearest to all of them: an edge of their lower convex hull. A
stall of the computer, even at the end, only lifts points off it. (S. B. Moon, P. Skelly, D. Towsley, "Estimation
and removal of clock skew from network delay measurements", INFOCOM 1999.)

What does not show: frames that keep step with an adapter's timer are all held back alike, and drift by a part of
its period without a trace.
"""

from __future__ import annotations

import numpy as np

from instrument.fibre_gyro.recording import Floats, HostClock

NOT_WORTH_PPM = 200.0
"""Differences below this change no result; the stated rate, which belongs to the gyro, is kept."""

WRONG = 0.1
"""No oscillator is off by a tenth: then the description of the frames is wrong."""

HOST_CLOCK_U = 5e-5 / 3**0.5
"""Relative, of the computer's clock: its crystal within 50 ppm, corrected by a time server or not."""

_FEWEST = 16  # arrivals
_BLOCKS = 512  # of which the earliest arrival is kept
_GROUPS = 16  # that say how far from the line the earliest arrivals lie
_WORST_U = 0.05  # of the interval; a line that says less says nothing
_SIGNIFICANT = 4.0  # standard uncertainties
_BEAT_S = 0.018  # frames beat with the reads of 20 ms and an adapter's 16 ms, by so much or one interval at most
_ADAPTER_S = 0.016  # a USB adapter hands over what it has so often
_PLACES = 20_000  # frames whose places in that period are looked at
_BEATS = 100  # arrivals in which a beat shows as what it is; in fewer it may look like a slope


class Arrivals:
    """When the last frame of each piece came that was read."""

    def __init__(self) -> None:
        self._index: list[int] = []
        self._host_s: list[float] = []

    def add(self, index: int, host_s: float) -> None:
        """Note that the frame `index` intervals after the first came by `host_s`, s."""
        self._index.append(index)
        self._host_s.append(host_s)

    def clock(self, stated_s: float) -> HostClock | None:
        """The clocks compared; None if too few frames came, or over too short a time."""
        if len(self._index) < _FEWEST or self._index[-1] == self._index[0]:
            return None
        index, host = np.array(self._index, dtype=np.float64), np.array(self._host_s)
        interval, u = _earliest_line(index - index[0], host - host[0])
        if not (np.isfinite(u) and interval > 0 and u < _WORST_U * interval):
            return None
        u = float(np.hypot(u, HOST_CLOCK_U * interval))
        off = abs(stated_s / interval - 1)
        used = bool(off > 1e-6 * NOT_WORTH_PPM and off > _SIGNIFICANT * u / interval)
        return HostClock(stated_s, interval, u, used)


def _earliest_line(index: Floats, host: Floats) -> tuple[float, float]:
    """Slope of the line below all arrivals that is nearest to them, and its standard uncertainty."""
    slope = float(np.polyfit(index, host, 1)[0])
    late = host - slope * index
    edges = np.unique(np.linspace(0, index.size, min(_BLOCKS, index.size) + 1).astype(np.intp))[:-1]
    ends = np.append(edges[1:], index.size)
    first = np.array([a + int(np.argmin(late[a:b])) for a, b in zip(edges, ends, strict=True)])
    x, y = index[first], late[first]
    hull = _lower_hull(x, y)
    middle = float(index.mean())
    right = min(max(int(np.searchsorted(x[hull], middle)), 1), len(hull) - 1)
    a, b = hull[right - 1], hull[right]
    edge = float((y[b] - y[a]) / (x[b] - x[a]))
    above = y - y[a] - edge * (x - x[a])
    # as far from the line as the earliest arrivals of a stretch lie, the line itself may be off at its ends
    groups = [part.min() for part in np.array_split(above, min(_GROUPS, above.size // 2))]
    off = float(np.median(groups)) + float(np.ptp(np.sort(groups)[: max(2, len(groups) // 2)]))
    span = float(index[-1] - index[0])
    off = max(off, min(_BEAT_S, slope) * min(1.0, _BEATS / index.size))
    # rectangular: what is hidden is anything up to that
    hidden = _widest_gap(slope + edge, int(span)) / np.sqrt(3.0)
    return slope + edge, float(np.hypot(2 * off, hidden)) / span


def _widest_gap(interval: float, frames: int) -> float:
    """Part of an adapter's period, s, in which no frame comes: all may drift by it and come out as before."""
    places = np.sort(np.mod(interval * np.arange(min(frames, _PLACES)), _ADAPTER_S))
    return float(np.max(np.diff(places, append=places[0] + _ADAPTER_S)))


def _lower_hull(x: Floats, y: Floats) -> list[int]:
    """Places of the points of the lower convex hull, from left to right; `x` rises."""
    hull: list[int] = []
    for place in range(x.size):
        while len(hull) > 1:
            a, b = hull[-2], hull[-1]
            if (y[b] - y[a]) * (x[place] - x[a]) < (y[place] - y[a]) * (x[b] - x[a]):
                break
            hull.pop()
        if not hull or x[place] > x[hull[-1]]:
            hull.append(place)
        elif y[place] < y[hull[-1]]:
            hull[-1] = place
    return hull
