"""A simulated rate table: it follows the commanded rate as fast as its acceleration allows.

The azimuth is the exact integral of the rate, known for every time that has passed, so that a simulated gyro
on the table can be evaluated at any of them.
"""

import math
import threading
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from instrument.simulated.clock import Clock, RealClock

Floats = NDArray[np.float64]


_STEP_S = 0.05  # s that pass in one piece while the table comes to its rate


@dataclass(frozen=True)
class TableMotion:
    """A piece of the motion of a table, with constant acceleration."""

    start: float  # absolute time, s
    azimuth_deg: float  # at the start; the acceleration holds for the whole piece
    rate_dps: float
    acceleration_dps2: float = 0.0

    def azimuth_at(self, times: Floats) -> Floats:
        """Azimuth in deg, not folded into one turn, at absolute times in s."""
        elapsed = times - self.start
        return self.azimuth_deg + (self.rate_dps + 0.5 * self.acceleration_dps2 * elapsed) * elapsed

    def rate_at(self, times: Floats) -> Floats:
        """Rate in deg/s at absolute times in s."""
        return self.rate_dps + self.acceleration_dps2 * (times - self.start)


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
        self.motion: tuple[TableMotion, ...] = (TableMotion(self._clock.now(), azimuth, 0.0),)

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
            passed = [piece for piece in self.motion if piece.start < now] or [self.motion[0]]
            azimuth, before = (float(at(np.array([now]))[0]) for at in (self.azimuth_at, self.rate_at))
            if rate_dps == before and passed[-1].acceleration_dps2 == 0:
                return
            slew_s = abs(rate_dps - before) / self._acceleration
            if slew_s > 0:
                passed.append(
                    TableMotion(now, azimuth, before, math.copysign(self._acceleration, rate_dps - before))
                )
            reached = azimuth + slew_s * (before + rate_dps) / 2
            # one assignment: the thread of the scope may be reading it
            self.motion = (*passed, TableMotion(now + slew_s, reached, float(rate_dps)))

    def wait_until_steady(self) -> None:
        """Let time pass on the clock until the table turns at the rate that was commanded."""
        steady = self.motion[-1].start
        while (left := steady - self._clock.now()) > 0:
            self._clock.sleep(min(left, _STEP_S) + 1e-9)

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
        """Time since the start of the piece of each time, and what that piece begins with."""
        start, azimuth, rate, acceleration = np.array([astuple(piece) for piece in self.motion]).T
        times = np.asarray(times, dtype=np.float64)
        index = np.maximum(np.searchsorted(start, times, side="right") - 1, 0)
        return times - start[index], azimuth[index], rate[index], acceleration[index]
