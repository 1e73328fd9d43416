"""Time for simulated instruments: the computer's own, or a clock that jumps instead of waiting."""

import time
from typing import Protocol


class Clock(Protocol):
    """What a simulated instrument needs to know about time."""

    @property
    def virtual(self) -> bool:
        """True when waiting costs no real time."""

    def now(self) -> float:
        """Time in s since this clock began."""

    def sleep(self, seconds: float) -> None:
        """Let `seconds` pass; zero or less returns at once."""


class RealClock:
    """Seconds since the clock was made; waiting really waits."""

    virtual = False

    def __init__(self) -> None:
        self._began = time.perf_counter()

    def now(self) -> float:
        """Time in s since this clock was made."""
        return time.perf_counter() - self._began

    def sleep(self, seconds: float) -> None:
        """Wait `seconds` of real time."""
        if seconds > 0:
            time.sleep(seconds)


class VirtualClock:
    """A clock that stands still until somebody waits on it, and then jumps.

    Examples
    --------
    >>> clock = VirtualClock()
    >>> clock.sleep(3600)
    >>> clock.now()
    3600.0
    """

    virtual = True

    def __init__(self, now: float = 0.0) -> None:
        self._now = float(now)

    def now(self) -> float:
        """Time in s, as far as it has been advanced."""
        return self._now

    def sleep(self, seconds: float) -> None:
        """Move the clock forward by `seconds` without waiting."""
        if seconds > 0:
            self._now += seconds


class HeldClock:
    """Another clock that stands still while it is held: what one message asks for happens at one moment."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._held_at, self._depth = 0.0, 0

    @property
    def virtual(self) -> bool:
        """As of the clock beneath."""
        return self._clock.virtual

    def now(self) -> float:
        """Time in s: of the moment in which it was held last, or of the clock beneath."""
        return self._held_at if self._depth else self._clock.now()

    def sleep(self, seconds: float) -> None:
        """Let time pass on the clock beneath."""
        self._clock.sleep(seconds)

    def hold(self) -> None:
        """Stand still at the time of now; again within that, at the time of then."""
        self._held_at = self._clock.now()
        self._depth += 1

    def release(self) -> None:
        """Go on, when it was released as often as it was held."""
        self._depth -= 1
