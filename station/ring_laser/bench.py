"""The bench as a measurement sees it: an oscilloscope, perhaps a rate table, and a way to wait."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from instrument import TDS2014, ManualRateTable, RateTable
from station.errors import UsageError


@dataclass(frozen=True)
class Bench:
    """What a measurement works with."""

    scope: TDS2014
    table: RateTable | None  # ``None`` where the table turns by itself
    sleep: Callable[[float], None] = time.sleep  # waits so many seconds, of the clock that the instruments live by
    # on a simulated bench: the true values of the last record, with the names of the results
    truth: Callable[[], dict[str, float]] | None = None
    now: Callable[[], float] = time.time  # seconds on that clock, from any beginning
    # what chamber and power supply read now, under names with their units; nothing where there are none
    surroundings: Callable[[], dict[str, float]] = dict

    def turn_table(self, rate_dps: float, settle_s: float, why: str = "") -> float:
        """Set the table's rate, wait until it turns steadily, and then let it settle."""
        if self.table is None:
            raise UsageError("this bench has no rate table that could be set")
        if isinstance(self.table, ManualRateTable):
            self.table.why = why
        self.table.set_rate(rate_dps)
        self.sleep(settle_s)
        return self.table.rate()

    def azimuth(self) -> float | None:
        """Return the table's azimuth in deg, or ``None`` where nobody knows it."""
        if self.table is None:
            return None
        azimuth = self.table.azimuth()
        return azimuth if math.isfinite(azimuth) else None
