"""What is known of a measurement and of its bench: what a budget is made from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from analysis.budget.unstated import TIME_BASE_LIMIT_PPM
from analysis.errors import NoBudget
from analysis.lockin_equation import beat_frequency, harmonic_ratio
from analysis.lockin_rate import LockInEstimate

_FITTED = 6
"""Parameters of the waveform that each record's fit determines."""


@dataclass(frozen=True)
class OperatingPoint:
    """A lock-in rate that was measured, or that is expected, and what the records themselves say of it."""

    scale_factor: float  # k, pulses per degree
    input_rate: float  # W (signed) and WL, deg/s
    lock_in_rate: float
    ratio_u: float  # of the mean of all records, from their noise, rounding included; Hz for the second
    beat_frequency_u: float = 0.0
    rounding_share: float = 0.0  # share of that variance that the converter's rounding makes
    noise_degrees_of_freedom: float = math.inf  # of the noise as the fit's residual shows it
    scatter_u: float = 0.0  # deg/s; scatter of the mean beyond what noise explains
    scatter_degrees_of_freedom: float = math.inf
    phase: float = math.nan  # readout phase less backscatter phase, rad; nan where unknown
    periods: float = math.inf  # of the beat, in each record

    def __post_init__(self) -> None:
        if not (self.scale_factor > 0 and self.lock_in_rate >= 0 and math.isfinite(self.input_rate)):
            raise NoBudget("a budget needs a positive scale factor, a lock-in rate from 0 and a finite input rate")
        if not abs(self.input_rate) > self.lock_in_rate:
            raise NoBudget(
                f"the input rate, {self.input_rate:g} deg/s, must be larger than the lock-in rate, "
                f"{self.lock_in_rate:g} deg/s: below it there is no beat"
            )

    @property
    def ratio(self) -> float:
        """r = A2/A1."""
        return float(harmonic_ratio(self.lock_in_rate / abs(self.input_rate)))

    @property
    def beat_frequency(self) -> float:
        """f, Hz."""
        return float(beat_frequency(self.scale_factor, self.input_rate, self.lock_in_rate))


@dataclass(frozen=True)
class Corner:
    """A first-order corner that weighs the first and the second harmonic differently."""

    # -3 dB frequency. nan: nothing is known of it. inf (0 for a high pass): there is none.
    hz: float = math.nan
    u_hz: float = 0.0  # standard uncertainty
    # whether the lock-in rate has been freed of its effect. Otherwise the whole effect is a limit.
    corrected: bool = False


@dataclass(frozen=True)
class TableGeometry:
    """How the rate on the gyro's axis comes about: W = W_table cos(tilt) + earth rate on the axis."""

    table_rate: float  # deg/s
    table_rate_u: float
    tilt_deg: float
    tilt_u_deg: float
    latitude_deg: float
    latitude_u_deg: float
    # of the horizontal part of the axis, from north, during the record; nan where nobody knows it
    azimuth_deg: float = math.nan
    azimuth_u_deg: float = 0.0


@dataclass(frozen=True)
class BenchKnowledge:
    """Everything that a budget counts besides the records.

    nan: nobody said anything of it, so that it counts with a bound of `analysis.budget.unstated`.
    """

    scale_factor_u_ppm: float = math.nan  # of K
    time_base_limit_ppm: float = TIME_BASE_LIMIT_PPM  # largest error of the scope's time base
    # largest second harmonic that detector, amplifier and scope make of a pure sine of the beat's size, over its
    # amplitude (0.01: -40 dBc)
    distortion_limit: float = math.nan
    third_order_limit: float = math.nan  # the same for the third harmonic
    # names of lines that the records themselves were freed of, by several rates, both senses or two photodiodes:
    # ``"distortion"``, ``"third_order"``, ``"bandwidth"``, ``"gain_corner"``
    separated: frozenset[str] = frozenset()
    # of the channel (low pass), of its coupling, and of the laser's gain saturation (g_c / 2 pi)
    bandwidth: Corner = field(default_factory=Corner)
    high_pass: Corner = field(default_factory=Corner)
    gain: Corner = field(default_factory=Corner)
    # relative, of a measured response of the channel at 2f over that at f that the ratio was freed of
    response_u: float = math.nan
    # for the rate as reference; without one nobody said how well the rate is known
    table: TableGeometry | None = None


NOTHING_BUT_RECORDS = BenchKnowledge(
    scale_factor_u_ppm=0.0,
    time_base_limit_ppm=0.0,
    distortion_limit=0.0,
    third_order_limit=0.0,
    bandwidth=Corner(math.inf),
    high_pass=Corner(0.0),
    gain=Corner(math.inf),
)
"""A bench that is known to be perfect: the budget is that of the records alone."""


def operating_point(
    each: LockInEstimate, combined: LockInEstimate, *, samples: int, level_spacing: float = 0.0
) -> OperatingPoint:
    """What some records at one rate, and their combination, tell a budget."""
    rate, rate_u = float(combined.lock_in_rate), float(combined.lock_in_rate_u)
    if not (math.isfinite(rate) and math.isfinite(rate_u)):
        raise NoBudget("records without a lock-in rate have no budget")
    used = each.reshaped(-1)
    used = used[np.asarray(used.usable)]
    count = int(used.flags.size)
    # what the records' own noise makes of the mean, beside what was stated: the rest is real scatter
    noise_u = min(float(1 / np.sqrt(np.sum(1 / np.maximum(used.lock_in_rate_u**2, 1e-300)))), rate_u)
    beyond = math.sqrt(max(rate_u**2 - noise_u**2, 0.0))
    noise = float(np.sqrt(np.mean(used.noise_rms**2)))
    rounding = level_spacing**2 / 12 / noise**2 if noise > 0 else 0.0
    input_rate = float(combined.input_rate)
    slope = ratio_slope(min(rate, abs(input_rate)), abs(input_rate), combined.rate_given)
    return OperatingPoint(
        scale_factor=combined.scale_factor,
        input_rate=input_rate,
        # at the very edge of lock-in their noise may exchange the two
        lock_in_rate=min(rate, abs(input_rate) * (1 - 1e-9)),
        ratio_u=noise_u / slope,
        beat_frequency_u=float(combined.beat_frequency_u),
        rounding_share=min(rounding, 1.0),
        noise_degrees_of_freedom=float(count * max(samples - _FITTED, 1)),
        scatter_u=beyond if beyond > 0.05 * rate_u else 0.0,
        scatter_degrees_of_freedom=float(max(count - 1, 1)),
        phase=-float(combined.backscatter_phase),
        periods=float(np.min(used.periods)),
    )


def ratio_slope(lock_in_rate: float, input_rate: float, rate_given: bool) -> float:
    """Derivative of the lock-in rate by the ratio r, deg/s; rates in deg/s."""
    r = float(harmonic_ratio(lock_in_rate / input_rate))
    # WL/r is 2W/(1 + r^2) by the rate, and by the beat, whose rate is W (1 - r^2)/(1 + r^2)
    relative = (1 - r * r) / (1 + r * r) if rate_given else (1 + r * r) / (1 - r * r)
    return 2 * input_rate / (1 + r * r) * relative
