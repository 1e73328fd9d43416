"""A simulated rate table: it follows the commanded rate as fast as its acceleration allows.

The azimuth is the exact integral of the rate, known for every time that has passed, so that a simulated gyro
on the table can be evaluated at any of them.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from instrument.simulated.clock import Clock, RealClock

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class _Segment:
    """From `start` s on: constant acceleration, beginning with this rate and azimuth."""

    start: float
    azimuth: float  # deg
    rate: float  # deg/s
    acceleration: float  # deg/s^2

    def at(self, time: float) -> tuple[float, float]:
        """Rate and azimuth at a time within the segment."""
        elapsed = time - self.start
        rate = self.rate + self.acceleration * elapsed
        return rate, self.azimuth + (self.rate + rate) / 2 * elapsed


class SimulatedRateTable:
    """A rate table on a clock.

    Parameters
    ----------
    clock : Clock, optional
        RealClock() if not given; share it with the oscilloscope.
    acceleration : float
        Largest acceleration in deg/s^2; inf changes the rate at once.
    highest_rate : float
        Largest rate in deg/s.
    azimuth : float
        Azimuth in deg at the beginning.

    Examples
    --------
    >>> from instrument.simulated.clock import VirtualClock
    >>> clock = VirtualClock()
    >>> table = SimulatedRateTable(clock, acceleration=10.0)
    >>> table.set_rate(20.0)
    >>> clock.sleep(3.0)
    >>> table.rate(), table.azimuth()
    (20.0, 40.0)
    """

    def __init__(
        self,
        clock: Clock | None = None,
        *,
        acceleration: float = math.inf,
        highest_rate: float = 1000.0,
        azimuth: float = 0.0,
    ) -> None:
        if not acceleration > 0 or not highest_rate > 0:
            raise ValueError("a rate table needs a positive acceleration and a positive highest rate")
        self._clock: Clock = clock if clock is not None else RealClock()
        self._acceleration, self._highest_rate = acceleration, highest_rate
        self._lock = threading.Lock()
        self._segments: tuple[_Segment, ...] = (_Segment(self._clock.now(), azimuth, 0.0, 0.0),)
        self._columns = self._as_columns()

    def set_rate(self, rate_dps: float) -> None:
        """Command a rate in deg/s; the table accelerates to it and stays there.

        Raises
        ------
        ValueError
            If the table cannot turn so fast.
        """
        if not abs(rate_dps) <= self._highest_rate:
            raise ValueError(
                f"the rate table turns at most {self._highest_rate:g} deg/s; {rate_dps:g} deg/s was asked for"
            )
        with self._lock:
            now = self._clock.now()
            passed = [s for s in self._segments if s.start < now] or [self._segments[0]]
            rate, azimuth = passed[-1].at(max(now, passed[-1].start))
            change = rate_dps - rate
            if change and math.isfinite(self._acceleration):
                acceleration = math.copysign(self._acceleration, change)
                ramp = _Segment(now, azimuth, rate, acceleration)
                passed.append(ramp)
                now += change / acceleration
                azimuth = ramp.at(now)[1]
            passed.append(_Segment(now, azimuth, float(rate_dps), 0.0))
            self._segments = tuple(passed)
            self._columns = self._as_columns()

    def rate(self) -> float:
        """Rate in deg/s now."""
        return float(self.rate_at(np.array([self._clock.now()]))[0])

    def azimuth(self) -> float:
        """Azimuth in deg now, not folded into one turn."""
        return float(self.azimuth_at(np.array([self._clock.now()]))[0])

    def rate_at(self, times: Floats) -> Floats:
        """Rate in deg/s at absolute times in s, any shape; before the beginning it is the first rate."""
        elapsed, _, rate, acceleration = self._look_up(times)
        return np.asarray(rate + acceleration * elapsed)

    def azimuth_at(self, times: Floats) -> Floats:
        """Azimuth in deg at absolute times in s, any shape."""
        elapsed, azimuth, rate, acceleration = self._look_up(times)
        return np.asarray(azimuth + (rate + acceleration / 2 * elapsed) * elapsed)

    def close(self) -> None:
        """Leave the table as it is."""

    def _look_up(self, times: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Time since the start of the segment of each time, and what that segment begins with."""
        start, azimuth, rate, acceleration = self._columns
        times = np.asarray(times, dtype=np.float64)
        index = np.maximum(np.searchsorted(start, times, side="right") - 1, 0)
        return times - start[index], azimuth[index], rate[index], acceleration[index]

    def _as_columns(self) -> tuple[Floats, Floats, Floats, Floats]:
        rows = [(s.start, s.azimuth, s.rate, s.acceleration) for s in self._segments]
        start, azimuth, rate, acceleration = np.array(rows, dtype=np.float64).T
        return start, azimuth, rate, acceleration
