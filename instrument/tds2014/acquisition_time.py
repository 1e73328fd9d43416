"""How long one acquisition can take, from the settings that decide it."""

from __future__ import annotations

from dataclasses import dataclass

from instrument.facts import DIVISIONS, SCAN_FROM

AUTO_DELAY = 0.05
"""Time in s after which AUTO mode triggers by itself at the latest, on short records: a generous guess."""


@dataclass(frozen=True)
class AcquisitionTime:
    """The settings that an acquisition's duration follows from.

    Attributes
    ----------
    acquisitions : int
        Number of averages; 1 in Sample and Peak Detect.
    automatic : bool
        Trigger mode AUTO.
    holdoff : float
        Trigger holdoff in s.
    mains : bool
        Triggered by the mains, which are always there.
    """

    seconds_per_division: float
    acquisitions: int = 1
    automatic: bool = True
    holdoff: float = 0.0
    mains: bool = False

    @property
    def record_time(self) -> float:
        """Time in s that the record spans."""
        return DIVISIONS * self.seconds_per_division

    @property
    def longest(self) -> float:
        """Time in s after which the sequence is complete if triggers come.

        Every acquisition fills its record and may wait as long again for its trigger: a repetitive signal
        with a period in the record gives one within that time.
        """
        trigger_wait = max(self.record_time, AUTO_DELAY)
        return self.acquisitions * (self.record_time + trigger_wait + self.holdoff)

    @property
    def surely_ends(self) -> bool:
        """Whether it completes whatever the signals are: without a trigger, or with one that always comes."""
        scanning = self.automatic and self.seconds_per_division >= SCAN_FROM
        return (self.automatic or self.mains) and not scanning
