"""What an operator says of the table's rate, against the beat: a wrong knob shows before records are taken."""

from __future__ import annotations

import math
from dataclasses import dataclass

from analysis.rotation import EARTH_RATE_DPS
from station.ring_laser.settings import BenchSettings

_TOLERANCE = 0.03
"""A display that reads wrong by less is found by the evaluation, which compares beat and table far better."""

_LOCKED_SHARE = 0.745
"""Beat over scale factor times rate at 1.5 lock-in rates, sqrt(1 - 1/1.5^2): no rate is chosen nearer."""


@dataclass(frozen=True)
class Beats:
    """Beat frequencies that fit a rate of the table, Hz."""

    lowest: float
    highest: float

    def holds(self, frequency: float) -> bool:
        """Whether a beat fits."""
        return self.lowest <= frequency <= self.highest

    def sentence(self, frequency: float) -> str:
        """What is seen and what should be."""
        if self.lowest <= 0:
            return f"it has {frequency:.4g} Hz and should have {self.highest:.4g} Hz at most"
        return f"it has {frequency:.4g} Hz and should have {self.lowest:.4g} to {self.highest:.4g} Hz"


def beats_at(settings: BenchSettings, table_rate_dps: float, tilt_deg: float | None) -> Beats:
    """Return the beats that fit a rate of the table.

    The earth rate on the axis depends on an azimuth that nobody knows, and how near lock-in is, nobody knows
    either: both widen what fits. The sense of rotation shows in no single beat.
    """
    scale_factor, latitude = settings.gyro.scale_factor_pulses_per_deg, math.radians(settings.site.latitude_deg)
    if tilt_deg is None:
        return Beats(0.0, scale_factor * (abs(table_rate_dps) * (1 + _TOLERANCE) + EARTH_RATE_DPS))
    tilt = math.radians(tilt_deg)
    vertical, horizontal = abs(math.sin(latitude) * math.cos(tilt)), abs(math.cos(latitude) * math.sin(tilt))
    earth = EARTH_RATE_DPS * (vertical + horizontal)
    on_axis = abs(table_rate_dps) * math.cos(tilt)
    slowest = max(on_axis * (1 - _TOLERANCE) - earth, 0.0)
    return Beats(scale_factor * slowest * _LOCKED_SHARE, scale_factor * (on_axis * (1 + _TOLERANCE) + earth))


def beats_of_other_sense(settings: BenchSettings, table_rate_dps: float, first: tuple[float, float]) -> Beats:
    """Return the beats that fit the fast run in the other sense."""
    scaled = first[1] * abs(table_rate_dps / first[0])
    earth = 2 * EARTH_RATE_DPS * settings.gyro.scale_factor_pulses_per_deg
    return Beats(max(scaled * (1 - _TOLERANCE) - earth, 0.0), scaled * (1 + _TOLERANCE) + earth)
