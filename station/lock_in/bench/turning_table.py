"""The simulated rate table that remembers how it turned, for the gyro that stands on it."""

from __future__ import annotations

import math
from collections.abc import Callable

from analysis.ring_laser import Segment
from instrument.simulated import SimulatedRateTable
from instrument.simulated.clock import Clock

_STEP_S = 0.05


class TurningTable:
    """The simulated rate table, and the history of its motion for the gyro that stands on it.

    ``when_steady``, if it is set, is called with the new piece of motion whenever the table turns steadily again.

    Parameters
    ----------
    clock : Clock
    acceleration : float
        deg/s^2.
    azimuth : float
        At the beginning, deg.
    rate : float, optional
        At the beginning, deg/s.
    """

    def __init__(self, clock: Clock, *, acceleration: float, azimuth: float, rate: float = 0.0) -> None:
        self._clock, self._acceleration = clock, acceleration
        self._table = SimulatedRateTable(clock, acceleration=acceleration, azimuth=azimuth)
        self.motion: tuple[Segment, ...] = (Segment(clock.now(), azimuth, 0.0),)
        self.when_steady: Callable[[Segment], None] | None = None
        if rate:
            self.set_rate(rate)

    def set_rate(self, rate_dps: float) -> None:
        """Bring the table to a rate in deg/s and return when it turns steadily."""
        start, azimuth, before = self._clock.now(), self._table.azimuth(), self._table.rate()
        self._table.set_rate(rate_dps)
        slew_s = abs(rate_dps - before) / self._acceleration
        if slew_s == 0:
            return
        steady = start + slew_s
        reached = azimuth + slew_s * (before + rate_dps) / 2
        slew = Segment(start, azimuth, before, math.copysign(self._acceleration, rate_dps - before))
        # one assignment: the thread of the scope may be reading it
        self.motion = (*self.motion, slew, Segment(steady, reached, rate_dps))
        while (left := steady - self._clock.now()) > 0:
            self._clock.sleep(min(left, _STEP_S) + 1e-9)
        if self.when_steady is not None:
            self.when_steady(self.motion[-1])

    def rate(self) -> float:
        """Rate in deg/s now."""
        return self._table.rate()

    def azimuth(self) -> float:
        """Azimuth in deg now, not folded into one turn."""
        return self._table.azimuth()

    def close(self) -> None:
        """Leave the table as it is."""
        self._table.close()
