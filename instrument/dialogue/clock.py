"""The time that limits are measured on."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Seconds that pass, and a way to let them pass; a simulated instrument's virtual clock is one."""

    def now(self) -> float:
        """Time in s since some moment."""

    def sleep(self, seconds: float) -> None:
        """Let `seconds` pass; zero or less returns at once."""


class ComputerClock:
    """The computer's own time, which nobody sets."""

    def now(self) -> float:
        """Time in s since some moment."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait."""
        if seconds > 0:
            time.sleep(seconds)
