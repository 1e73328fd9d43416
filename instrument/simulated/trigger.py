"""Looks for the trigger: the first edge of the real signal through the level.

The comparator has to see the signal on the far side by the hysteresis before it fires, so that noise-free
rest does not trigger and an amplitude below the sensitivity never does (user manual 071-1064-00, p. 157).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from instrument.simulated.frontend import Floats

HYSTERESIS = 0.3  # divisions (a guess; the sensitivity is given as one division)
_FIRST_CHUNK = 1024
_LONGEST_CHUNK = 16_384
_MOST_POINTS = 60_000  # samples of one search, however long the time
_REFINEMENTS = 3


@dataclass
class EdgeSearch:
    """A search that goes on where it stopped.

    Attributes
    ----------
    volts_at : callable
        Volts that the comparator sees at given absolute times (rising).
    level, hysteresis : float
        In the same volts; negative edges are searched on the negated signal.
    searched_until : float
        Absolute time in s up to which there was no edge.
    """

    volts_at: Callable[[Floats], Floats]
    level: float
    rising: bool
    hysteresis: float
    searched_until: float
    armed: bool = False

    def advance(self, until: float, step: float) -> float | None:
        """Search on to `until` in steps of about `step`; the time of the edge, or None."""
        span = until - self.searched_until
        if span <= 0:
            return None
        step = max(step, span / _MOST_POINTS)
        size = _FIRST_CHUNK
        while self.searched_until < until:
            count = min(size, int((until - self.searched_until) / step) + 1)
            times = self.searched_until + step * np.arange(count + 1, dtype=np.float64)
            times[-1] = min(times[-1], until)
            edge = self._edge_in(times)
            if edge is not None:
                return edge
            self.searched_until = float(times[-1])
            size = min(size * 4, _LONGEST_CHUNK)
        return None

    def _above(self, times: Floats) -> Floats:
        """Signal over the level, turned so that the wanted edge rises."""
        above = self.volts_at(times) - self.level
        return above if self.rising else -above

    def _edge_in(self, times: Floats) -> float | None:
        above = self._above(times)
        first = 0
        if not self.armed:
            below = above < -self.hysteresis
            first = int(below.argmax())
            if not below[first]:
                return None
            self.armed = True
        crossed = above[first:] >= 0
        index = int(crossed.argmax())
        if not crossed[index]:
            return None
        index += first
        return self._refine(float(times[max(index - 1, 0)]), float(times[index]))

    def _refine(self, low: float, high: float) -> float:
        """Narrow the bracket of an edge by sampling it finely."""
        for _ in range(_REFINEMENTS):
            if high - low <= 1e-13 * max(1.0, abs(high)):
                break
            times = np.linspace(low, high, 33)
            index = int((self._above(times) >= 0).argmax())
            low, high = float(times[max(index - 1, 0)]), float(times[index])
        return (low + high) / 2
