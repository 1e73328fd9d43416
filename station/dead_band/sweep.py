"""The sweep: which rates, in which order, each with a time base that follows from the rate alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

from instrument.facts import SCAN_FROM, TIME_BASES
from station.dead_band.settings import DeadBandSettings
from station.scope.autoset import oscilloscope_steps

SLOWEST_S = max(step for step in TIME_BASES if step < SCAN_FROM)
"""s/div. A slower one would scan in AUTO, and its records be patched."""

_DIVISIONS = 10  # of a record


@dataclass(frozen=True)
class Step:
    """One rate of the sweep."""

    direction: str  # {"up", "down"}
    rate_dps: float  # on the gyro's axis, without the earth rate

    def key(self, number: int) -> str:
        """Key of one of its records; numbers count from 1."""
        return f"{self.direction} {self.rate_dps:+.9g}, {number}"


def sweep(settings: DeadBandSettings) -> list[Step]:
    """List the steps: from the lowest rate to the highest, and back."""
    lock_in, asked = settings.gyro.expected_lock_in_rate_dps, settings.sweep
    if asked.rates_over_lock_in:
        sizes = sorted({lock_in * size for size in asked.rates_over_lock_in})
        rates = [*(-size for size in reversed(sizes)), *sizes]
    else:
        # a quarter of a step beside zero: the rates of one sense lie halfway between those of the other, so that a
        # gyro without bias does not meet the same error of the steps twice
        one = lock_in * asked.highest_over_lock_in / asked.steps
        rates = [one * (n + 0.25) for n in range(-asked.steps, asked.steps + 1)]
    return [*(Step("up", rate) for rate in rates), *(Step("down", rate) for rate in reversed(rates[:-1]))]


def time_base(step: Step, settings: DeadBandSettings) -> float:
    """Return the time base of a step, s/div.

    A beat is never faster than scale factor times rate. Below the expected lock-in rate there may be none at all:
    the record is then as long as one at lock-in, and what it shows is taken as it is.
    """
    fastest = settings.gyro.scale_factor_pulses_per_deg * max(
        abs(step.rate_dps), settings.gyro.expected_lock_in_rate_dps
    )
    shape = settings.sweep
    wanted = oscilloscope_steps().time_base(fastest, shape.periods_min, shape.samples_per_period_min)
    return min(wanted, SLOWEST_S)


def seconds(settings: DeadBandSettings) -> float:
    """Return how long a sweep takes at least: its records, and the settling after each change of the rate."""
    steps = sweep(settings)
    records = sum(_DIVISIONS * time_base(step, settings) for step in steps) * settings.sweep.records
    return records + len(steps) * settings.table.settle_s


def fastest_table_rate(settings: DeadBandSettings) -> float:
    """Return the fastest rate of the table in a sweep, deg/s."""
    fastest = max(abs(step.rate_dps) for step in sweep(settings))
    return fastest / math.cos(math.radians(settings.table.tilt_deg))
