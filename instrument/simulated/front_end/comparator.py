"""What the trigger comparator sees: the signal with its noise, and a stretch of its smooth part over a level."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from instrument.simulated.front_end.frontend import Floats
from instrument.simulated.front_end.smooth import Between

SHORTEST_STRETCH = 1e-9  # s
BEND = 0.25
"""Of the largest second difference: how far a signal may leave the straight line, twice over."""
_FEWEST_CELLS = 5  # of a stretch


class Stretch:
    """The smooth part of a trigger signal from one time to another, at even steps."""

    def __init__(self, smooth: Callable[[Floats], Floats], start: float, stop: float, interval: float) -> None:
        self.interval = interval
        self.times: Floats = np.linspace(start, stop, max(_FEWEST_CELLS, math.ceil((stop - start) / interval)) + 1)
        self.volts = smooth(self.times)
        self.between = Between(start, stop, self.volts)
        self.bend = BEND * float(np.abs(np.diff(self.volts, 2)).max())
        self._heights: Heights | None = None

    def heights(self, level: float, rising: bool, hysteresis: float, noise: float) -> Heights:
        """What it is over a level, worked out once; arguments as of EdgeSearch, `noise` in V."""
        asked = level, rising, hysteresis, noise
        if self._heights is None or self._heights.asked != asked:
            above = self.volts - level if rising else -(self.volts - level)
            margin = noise + self.bend
            low = np.flatnonzero(above < -hysteresis).tolist()
            near = np.flatnonzero(np.maximum(above[1:], above[:-1]) >= -margin).tolist()
            self._heights = Heights(asked, above, low, near, margin)
        return self._heights


@dataclass(frozen=True, eq=False)
class Heights:
    """A stretch over a level, turned so that the wanted edge rises."""

    asked: tuple[float, bool, float, float]  # level, sense, hysteresis and noise that it is for
    above: Floats  # (n,): V over the level at each look
    low: list[int]  # looks that are so low that the search is armed
    near: list[int]  # cells, each from a look to the next, in which the signal may cross the level
    margin: float  # V by which noise and bends may lift it


class Part:
    """A part of a stretch between two times: its ends and the looks between them are points, counted from 0."""

    def __init__(
        self, stretch: Stretch, heights: Heights, start: float, stop: float, ends: tuple[float, float]
    ) -> None:
        first, last = (int(place) for place in np.searchsorted(stretch.times, (start, stop), side="right"))
        self._times, self._heights, self._ends = stretch.times, heights, ends
        self._start, self._stop = start, stop
        self._before = first - 1  # the look in the place of point 0
        self.last: int = max(last - 1 - first, 0) + 1
        """The last point; as many cells are between all of them."""

    def time(self, point: int) -> float:
        """Of a point, s."""
        if 0 < point < self.last:
            return float(self._times[self._before + point])
        return self._stop if point else self._start

    def above(self, point: int) -> float:
        """V over the level."""
        if 0 < point < self.last:
            return float(self._heights.above[self._before + point])
        return self._ends[1] if point else self._ends[0]

    def low_from(self, point: int, hysteresis: float) -> int | None:
        """The first point from this one on at which the search is armed; None if there is none."""
        if point == 0:
            if self._ends[0] < -hysteresis:
                return 0
            point = 1
        at = bisect_left(self._heights.low, self._before + point)
        if at < len(self._heights.low) and (found := self._heights.low[at] - self._before) < self.last:
            return found
        return self.last if point <= self.last and self._ends[1] < -hysteresis else None

    def near_from(self, cell: int) -> int | None:
        """The first cell from this one on in which the signal may cross; None if there is none."""
        if cell == 0:
            if self._is_near(0):
                return 0
            cell = 1
        at = bisect_left(self._heights.near, self._before + cell)
        if at < len(self._heights.near) and (found := self._heights.near[at] - self._before) < self.last - 1:
            return found
        return self.last - 1 if cell <= self.last - 1 and self._is_near(self.last - 1) else None

    def _is_near(self, cell: int) -> bool:
        return max(self.above(cell + 1), self.above(cell)) >= -self._heights.margin


class Comparator:
    """What the trigger comparator sees: volts at absolute times in s (rising)."""

    def __init__(
        self,
        smooth: Callable[[Floats], Floats],
        noise: Callable[[Floats], Floats] = np.zeros_like,
        noise_rms: float = 0.0,
        interval: Callable[[float, float], float] = lambda start, stop: 0.0,
        bounds: Callable[[float, float], tuple[float, float]] = lambda start, stop: (-math.inf, math.inf),
    ) -> None:
        self.noise, self.noise_rms, self.bounds = noise, noise_rms, bounds
        self.smooth, self._interval = smooth, interval
        self._seen: Stretch | None = None

    def __call__(self, times: Floats) -> Floats:
        """Volts with the noise."""
        return self.smooth(times) + self.noise(times)

    def interval(self, start: float, stop: float) -> float:
        """Distance in s of looks between which the smooth part is smooth, between two times; 0: not known."""
        seen = self._seen
        if seen is not None and seen.times[0] <= start and stop <= seen.times[-1]:
            return seen.interval
        return self._interval(start, stop)

    def has_to_look(self, start: float) -> bool:
        """Whether the last stretch does not hold this time."""
        seen = self._seen
        return seen is None or not seen.times[0] <= start < seen.times[-1] - SHORTEST_STRETCH

    def stretch(self, start: float, until: float, now: float, most: int) -> Stretch:
        """What is seen from `start` to `now`, or not so far; the last one again if it holds the start.

        Up to `until` looks between which the signal is smooth are known to do. A new one has `most` cells at most.
        """
        seen = self._seen
        if seen is None or self.has_to_look(start):
            end, interval = now, self._interval(start, now)
            if not interval:  # behind `until` the table changes its rate, or the gyro locks
                end, interval = until, self._interval(start, until)
            end = min(end, start + most * interval)
            seen = self._seen = Stretch(self.smooth, start, end, interval)
        return seen
