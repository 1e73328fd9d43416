"""What is known of a measurement and of its bench: what a budget is made from."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats, NoBudget
from analysis.lockin_equation import beat_frequency, harmonic_ratio
from analysis.lockin_rate import LockInEstimate

# --------------------
# Bounds for what nobody has stated or measured: what is not known is not zero.
#
# Each bound is the half width of a rectangular distribution: inside it everything is taken to be equally likely.
# It is meant for a photodiode, its amplifier and an eight-bit oscilloscope with records that show nothing
# suspicious; whoever knows more states it, and whoever measures it does best


SECOND_ORDER_LIMIT = 0.01
"""Second harmonic that the receiver makes of a pure sine as large as the beat, over the sine: -40 dBc.

Eight-bit oscilloscopes show -45 to -55 dBc near full scale, a photodiode with its amplifier in linear use less;
the worst of the former, with some of the latter in phase, is -40 dBc."""

THIRD_ORDER_LIMIT = 0.01
"""The same for the third harmonic, and the same reasons. A record shows much of it: the third harmonic of the beat
itself is r^2, and what stands beside it is seen as soon as it stands out of the noise."""

THIRD_ORDER_ON_RATIO = 1.0
"""Largest relative change of r for a third harmonic h of the receiver, over h, at every rate alike; its sign is
that of -cos(2 delta), delta the readout less the backscatter phase.

s + k s^3 makes h = k/4 and turns the second harmonic by 1 - 3 h exp(2 i delta). A geometric series that is fitted
to the waveform sees the third harmonic too, and takes two of the three back."""

THIRD_ORDER_LEAK = 0.3  # what the same third harmonic leaks into r, over h, times the periods in a record

LOWEST_BANDWIDTH_OVER_BEAT = 5.0
"""-3 dB bandwidth of the channel (one pole) over the slowest beat of a run.

An amplifier or a filter against noise is chosen for the beat, so its corner scales with it. At five times the
beat a pole takes 2 % off the fundamental and 7 % off the second harmonic; nobody who means to measure the
second harmonic takes a slower one on purpose. It costs 5.3 % of r."""

LOWEST_GAIN_CORNER_OVER_BEAT = 3.0
"""Corner of the laser's gain saturation, g_c/2 pi, over the slowest beat of a run.

It lies between tens of hertz in large rings and 17 kHz in small ones, so only the method's own condition, a beat
slow against the gain, bounds it: at three beats r has lost 5 % and its phase lags by 18 degrees."""

LOWEST_GAIN_CORNER_HZ = 5000.0
"""What is computed for a navigation gyro of 0.28 m with a net gain of 3e-5: where three beats would be more than
this, this is the bound, since a fast beat does not make the gain faster."""

PHASE_CHANGE_LIMIT = 1.0
"""Largest change of the phase of the backscatter or of the readout, rad: between the two senses, and during a run.

A mirror that moves by 10 nm turns the backscatter by 0.2 rad; a table that stops and turns back, or a frame that
warms up by a kelvin, moves one by some tens."""

LOCK_IN_DRIFT_LIMIT = 0.03
"""Largest relative change of the lock-in rate during a run: that of a laser which is still warming up."""

PROBE_LIMIT, PROBE_HZ = 0.03, 1500.0
"""Error of the compensation of a 10X probe, as a share of the gain, and the frequency about which it shows: 9 MOhm
beside 12 pF. A square wave shows less than that by eye only when somebody looks for it."""

SCALE_FACTOR_LIMIT = 0.01
"""Relative error of a scale factor that stands on a data sheet or a type plate: rounded, and of another unit."""

TIME_BASE_LIMIT_PPM = 50.0  # data sheet of the TDS2014

AC_CORNER_HZ = 10.0
"""Lower -3 dB corner of the oscilloscope's AC coupling with a direct cable, where nobody says that it was set to
DC."""

TABLE_RATE_LIMIT = 1e-3  # relative error of the rate that a table shows, or that somebody reads from it
LATITUDE_LIMIT_DEG = 0.1  # of a bench whose latitude was looked up for its town

BIAS_LIMIT_DPH = 0.03
"""Bias of the gyro, deg/h: some three times that of a navigation gyro. A discharge whose two arms carry different
currents makes degrees per hour; who measures lock-in balances it first."""

FRONT_END_LIMIT = 0.1  # relative error of a corner or of a response that the records were freed of: parts of 10 %


def lowest_bandwidth(slowest_beat_hz: float) -> float:
    """Lowest -3 dB bandwidth of a channel of which nobody said anything, Hz."""
    return LOWEST_BANDWIDTH_OVER_BEAT * slowest_beat_hz


def lowest_gain_corner(slowest_beat_hz: float) -> float:
    """Lowest corner of the laser's gain of which nobody said anything, Hz."""
    return min(LOWEST_GAIN_CORNER_OVER_BEAT * slowest_beat_hz, LOWEST_GAIN_CORNER_HZ)


_FITTED = 6  # parameters of the waveform that each record's fit determines


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
class ResponseCorner:
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

    nan: nobody said anything of it, so that it counts with a bound of `analysis.budget.bench`.
    """

    scale_factor_u_ppm: float = math.nan  # of K
    time_base_limit_ppm: float = TIME_BASE_LIMIT_PPM  # largest error of the scope's time base
    # largest second harmonic that detector, amplifier and scope make of a pure sine of the beat's size, over its
    # amplitude (0.01: -40 dBc)
    distortion_limit: float = math.nan
    third_order_limit: float = math.nan  # the same for the third harmonic
    # largest change of the backscatter phase, rad, and of the lock-in rate, relative, during a run
    phase_change_limit: float = math.nan
    lock_in_drift_limit: float = math.nan
    # names of lines that the records themselves were freed of, by several rates, both senses or two photodiodes:
    # ``"distortion"``, ``"third_order"``, ``"bandwidth"``, ``"gain_corner"``
    separated: frozenset[str] = frozenset()
    # of the channel (low pass), of its coupling, and of the laser's gain saturation (g_c / 2 pi)
    bandwidth: ResponseCorner = field(default_factory=ResponseCorner)
    high_pass: ResponseCorner = field(default_factory=ResponseCorner)
    gain: ResponseCorner = field(default_factory=ResponseCorner)
    # relative, of a measured response of the channel at 2f over that at f that the ratio was freed of
    response_u: float = math.nan
    probe_limit: float = 0.0  # largest error of the compensation of a probe that divides, as a share of the gain
    # for the rate as reference; without one nobody said how well the rate is known
    table: TableGeometry | None = None


NOTHING_BUT_RECORDS = BenchKnowledge(
    scale_factor_u_ppm=0.0,
    time_base_limit_ppm=0.0,
    distortion_limit=0.0,
    third_order_limit=0.0,
    bandwidth=ResponseCorner(math.inf),
    high_pass=ResponseCorner(0.0),
    gain=ResponseCorner(math.inf),
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
    # at the very edge of lock-in their noise may exchange the two
    possible = min(rate, abs(input_rate) * (1 - 1e-9))
    slope = ratio_slope(possible, abs(input_rate), combined.rate_given)
    return OperatingPoint(
        scale_factor=combined.scale_factor,
        input_rate=input_rate,
        lock_in_rate=possible,
        ratio_u=noise_u / slope,
        # each record is its own reference: that their rates differ does not enter
        beat_frequency_u=float(1 / np.sqrt(np.sum(1 / np.maximum(used.beat_frequency_u**2, 1e-300)))),
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


# --------------------
# What is known of a bench, with a bound in the place of everything that nobody stated


_RECTANGLE = math.sqrt(3.0)


@dataclass(frozen=True)
class Bounded:
    """Knowledge without gaps."""

    # without nan, but for `response_u`, which is nan where there is no measured response
    knowledge: BenchKnowledge
    assumed: frozenset[str]  # names of the lines that rest on a bound

    def note(self, name: str, bound: str, otherwise: str) -> str:
        """Say of a line where its size comes from."""
        return f"not stated: bound of {bound}" if name in self.assumed else otherwise


def bounded(knowledge: BenchKnowledge, slowest_beat_hz: float) -> Bounded:
    """Put bounds where nothing is known."""
    bounds = {
        "scale_factor": ("scale_factor_u_ppm", 1e6 * SCALE_FACTOR_LIMIT / _RECTANGLE),
        "distortion": ("distortion_limit", SECOND_ORDER_LIMIT),
        "third_order": ("third_order_limit", THIRD_ORDER_LIMIT),
        "bandwidth": ("bandwidth", ResponseCorner(lowest_bandwidth(slowest_beat_hz))),
        "high_pass": ("high_pass", ResponseCorner(AC_CORNER_HZ)),
        "gain_corner": ("gain", ResponseCorner(lowest_gain_corner(slowest_beat_hz))),
    }
    missing = {line: bound for line, bound in bounds.items() if _unknown(getattr(knowledge, bound[0]))}
    return Bounded(replace(knowledge, **dict(missing.values())), frozenset(missing))  # type: ignore[arg-type]


def _unknown(value: float | ResponseCorner) -> bool:
    return math.isnan(value.hz if isinstance(value, ResponseCorner) else value)


# --------------------
# What noise will leave in the ratio and the frequency of a record, before any record is taken.
#
# The waveform is c0 + Re[H e/(1 - q e)] with six unknowns. With whole periods its harmonics are orthogonal, the
# Fisher information is a sum of geometric series, and its inverse (the Cramér-Rao bound) is closed. With white
# noise
# of s volts in each of N samples, amplitude A, record length T, r = |q|:
#
#     u(r)     = (s/A) sqrt(2/N) sqrt(1 - r^2)                       along the complex ratio
#     u_across = (s/A) sqrt(2/N) sqrt((1 + r^2)/(1 - r^2))           across it
#     u(f)     = (s/A) sqrt(6/N) / (pi T) sqrt((1 - r^2)/(1 + r^2))
#
# Broken periods raise the bound of the lock-in rate by 1 % in the mean over phases with three periods in the
# record, by 0.2 % with eight


@dataclass(frozen=True)
class RecordShape:
    """How each record is taken."""

    samples: int
    sample_interval: float  # s
    amplitude: float  # A of the beat at the converter, V
    noise_rms: float  # white noise in each sample, V, without that of rounding
    level_spacing: float = 0.0  # V per level of the converter; 0: no rounding
    records: int = 1  # at one rate

    def __post_init__(self) -> None:
        if self.samples < 8 or self.records < 1:
            raise ValueError("a record needs at least 8 samples, and there must be at least one record")
        if not (
            self.sample_interval > 0 and self.amplitude > 0 and self.noise_rms >= 0 and self.level_spacing >= 0
        ):
            raise ValueError(
                "sample interval and amplitude must be positive, noise and level spacing not negative"
            )

    @property
    def duration(self) -> float:
        """Of one record, s."""
        return self.samples * self.sample_interval

    @property
    def total_noise(self) -> float:
        """Noise and rounding, V rms."""
        return math.sqrt(self.noise_rms**2 + self.level_spacing**2 / 12)

    @property
    def rounding_share(self) -> float:
        """Share of rounding in the variance."""
        total = self.total_noise**2
        return self.level_spacing**2 / 12 / total if total > 0 else 0.0


@dataclass(frozen=True)
class NoiseOfRatio:
    """Standard uncertainties from white noise: of r, of its part across (phase times r), of f in Hz."""

    ratio_u: Floats
    across_u: Floats
    beat_frequency_u: Floats


def expected_noise(shape: RecordShape, ratio: ArrayLike) -> NoiseOfRatio:
    """Uncertainty of the mean of all records, for r = `ratio` of any shape.

    Examples
    --------
    One per cent of noise, 2500 samples, W = 20 WL: r is known to 1.13 %.

    >>> one = RecordShape(2500, 1e-4, amplitude=1.0, noise_rms=0.01)
    >>> noise = expected_noise(one, 0.025)
    >>> round(100 * float(noise.ratio_u) / 0.025, 2)
    1.13
    """
    r = np.asarray(ratio, dtype=np.float64)
    squared = r * r
    each = shape.total_noise / shape.amplitude / math.sqrt(shape.samples * shape.records)
    return NoiseOfRatio(
        ratio_u=np.asarray(each * np.sqrt(2 * (1 - squared))),
        across_u=np.asarray(each * np.sqrt(2 * (1 + squared) / (1 - squared))),
        beat_frequency_u=np.asarray(
            each * np.sqrt(6 * (1 - squared) / (1 + squared)) / (math.pi * shape.duration)
        ),
    )


def expected_point(
    shape: RecordShape,
    *,
    scale_factor: float,
    input_rate: float,
    lock_in_rate: float,
    scatter: float = 0.0,
    phase: float = math.nan,
) -> OperatingPoint:
    """The operating point of a budget for records that are still to be taken."""
    ratio = float(harmonic_ratio(min(lock_in_rate / abs(input_rate), 1.0))) if input_rate else 1.0
    noise = expected_noise(shape, min(ratio, 1 - 1e-12))
    frequency = float(beat_frequency(scale_factor, input_rate, min(lock_in_rate, abs(input_rate))))
    return OperatingPoint(
        scale_factor=scale_factor,
        input_rate=input_rate,
        lock_in_rate=lock_in_rate,
        ratio_u=float(noise.ratio_u),
        beat_frequency_u=float(noise.beat_frequency_u),
        rounding_share=shape.rounding_share,
        noise_degrees_of_freedom=float(shape.records * (shape.samples - 6)),
        scatter_u=scatter / math.sqrt(shape.records),
        scatter_degrees_of_freedom=float(max(shape.records - 1, 1)),
        phase=phase,
        periods=max(frequency * shape.duration, 1.0),
    )
