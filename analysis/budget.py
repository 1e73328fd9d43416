"""Every input of a lock-in rate: its standard uncertainty, and the derivative of the rate by it.

With the record as its own reference WL = (f/K) 2r/(1-r^2): table, tilt and earth rate have no derivative. With the
rate given WL = W 2r/(1+r^2): K and the time base have none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np
import scipy.special
from numpy.typing import ArrayLike

from analysis.arrays import NORMAL_95, Complexes, Floats, NoBudget
from analysis.channel import gain_on_ratio, high_pass_on_ratio, low_pass_on_ratio, tail_on_ratio
from analysis.lockin_equation import beat_frequency, harmonic_ratio
from analysis.lockin_rate import LockInEstimate, size_interval
from analysis.rotation import EARTH_RATE_DPS, earth_rate_on_axis

_OWN = "does not enter: the record is its own reference"
_GIVEN = "does not enter: the rate is the reference"
_RECTANGLE = math.sqrt(3.0)
_DEGREE = math.pi / 180
_EARTH_RATE_U_DPS = 1e-8 * EARTH_RATE_DPS


def lock_in_budget(point: OperatingPoint, knowledge: BenchKnowledge, reference: Reference = "beat") -> Budget:
    """Uncertainty budget of a lock-in rate; what nobody stated counts with its bound.

    Examples
    --------
    A perfect bench but for 100 ppm of K and 50 ppm of time base: sqrt(100^2 + 50^2/3) = 104 ppm of 0.01 deg/s.

    >>> point = OperatingPoint(2000.0, 0.08, 0.01, ratio_u=0.0)
    >>> from dataclasses import replace
    >>> from analysis.budget import NOTHING_BUT_RECORDS
    >>> known = replace(NOTHING_BUT_RECORDS, scale_factor_u_ppm=100.0, time_base_limit_ppm=50.0)
    >>> budget = lock_in_budget(point, known)
    >>> [line.name for line in budget.inputs[:2]], round(budget.relative_u * 1e6)
    (['scale_factor', 'time_base'], 104)

    Nothing stated: K, distortion, bandwidth and gain corner count with what they may be at worst.

    >>> [line.name for line in lock_in_budget(point, BenchKnowledge()).not_stated]
    ['distortion', 'bandwidth', 'gain_corner', 'third_order', 'scale_factor', 'high_pass']
    """
    known = bounded(knowledge, point.beat_frequency)
    slope = ratio_slope(point.lock_in_rate, abs(point.input_rate), reference == "rate")
    lines = [*_from_records(point, slope, reference), *_from_reference(point, known, reference)]
    if knowledge.table is not None:
        lines += _from_table(point, knowledge.table, reference)
    elif reference == "rate":
        lines.append(_given_rate(point))
    return Budget(point.lock_in_rate, reference, (*lines, *channel_inputs(point, known, slope)))


def _from_records(point: OperatingPoint, slope: float, reference: Reference) -> Iterator[BudgetInput]:
    """Noise, rounding and scatter: what the records show themselves."""
    freedom, own = point.noise_degrees_of_freedom, reference == "beat"
    noise_u = point.ratio_u * math.sqrt(1 - point.rounding_share)
    note = "from what the fit leaves of the records"
    yield BudgetInput("noise", "r = A2/A1: noise", "1", point.ratio, noise_u, "normal", slope, freedom, note)
    rounding_u = point.ratio_u * math.sqrt(point.rounding_share)
    quantity, note = "r = A2/A1: rounding to levels", "a level of error over sqrt(12) in each sample"
    yield BudgetInput("quantization", quantity, "1", 0.0, rounding_u, "normal", slope, note=note)
    frequency, u = point.beat_frequency, point.beat_frequency_u
    by_frequency = point.lock_in_rate / frequency if own else 0.0
    note = "" if own else _GIVEN
    yield BudgetInput(
        "beat_frequency", "beat frequency: noise", "Hz", frequency, u, "normal", by_frequency, freedom, note
    )
    quantity, note = "scatter between records beyond their noise", "" if point.scatter_u else "none seen"
    freedom = point.scatter_degrees_of_freedom
    yield BudgetInput("scatter", quantity, "deg/s", 0.0, point.scatter_u, "normal", 1.0, freedom, note)


def _from_reference(point: OperatingPoint, known: Bounded, reference: Reference) -> Iterator[BudgetInput]:
    """Scale factor and time base: with f they make the rate of a record that is its own reference."""
    own, stated = reference == "beat", "scale_factor" not in known.assumed
    limit = f"not stated: bound of ±{100 * SCALE_FACTOR_LIMIT:g} %"
    yield BudgetInput(
        "scale_factor",
        "scale factor K",
        "pulses/deg",
        point.scale_factor,
        point.scale_factor * known.knowledge.scale_factor_u_ppm * 1e-6,
        "normal" if stated else "rectangular",
        -point.lock_in_rate / point.scale_factor if own else 0.0,
        note=_GIVEN if not own else "" if stated else limit,
        common=True,
        stated=stated,
    )
    time_base = known.knowledge.time_base_limit_ppm
    yield BudgetInput(
        "time_base",
        "time base of the oscilloscope",
        "ppm",
        0.0,
        time_base / _RECTANGLE,
        "rectangular",
        -point.lock_in_rate * 1e-6 if own else 0.0,
        note=f"within ±{time_base:g} ppm" if own else _GIVEN,
        common=True,
    )


def _given_rate(point: OperatingPoint) -> BudgetInput:
    """A rate of which nobody said how it was found: read from a table, perhaps without the earth's rotation."""
    rate = abs(point.input_rate)
    u = math.hypot(TABLE_RATE_LIMIT * rate / _RECTANGLE, EARTH_RATE_DPS / math.sqrt(2))
    note = f"not stated: bound of ±{100 * TABLE_RATE_LIMIT:g} % and of the earth's rotation"
    slope = point.lock_in_rate / rate
    return BudgetInput(
        "input_rate",
        "rate on the axis, given",
        "deg/s",
        point.input_rate,
        u,
        "arcsine",
        slope,
        note=note,
        common=True,
        stated=False,
    )


def _from_table(point: OperatingPoint, table: TableGeometry, reference: Reference) -> Iterator[BudgetInput]:
    """Table rate, tilt, latitude, azimuth and earth rate: they make the rate on the axis."""
    own = reference == "beat"
    note = _OWN if own else ""
    # d(WL)/dW of the rate on the axis, with its sign
    by_rate = 0.0 if own else math.copysign(point.lock_in_rate / abs(point.input_rate), point.input_rate)
    by_table, by_tilt, by_latitude, by_azimuth, along = _rate_slopes(table)
    earth, earth_u = EARTH_RATE_DPS * 3600, _EARTH_RATE_U_DPS * 3600
    for name, quantity, unit, value, u, slope in (
        ("table_rate", "rate of the table", "deg/s", table.table_rate, table.table_rate_u, by_table),
        ("tilt", "tilt of the axis", "deg", table.tilt_deg, table.tilt_u_deg, by_tilt),
        ("latitude", "latitude", "deg", table.latitude_deg, table.latitude_u_deg, by_latitude),
        ("earth_rate", "rotation rate of the earth", "deg/h", earth, earth_u, along / 3600),
    ):
        yield BudgetInput(name, quantity, unit, value, u, "normal", by_rate * slope, note=note, common=True)
    if math.isfinite(table.azimuth_deg):
        value, u, slope = table.azimuth_deg, table.azimuth_u_deg, by_rate * by_azimuth
        quantity, unit = "azimuth of the axis", "deg"
        yield BudgetInput("azimuth", quantity, unit, value, u, "rectangular", slope, note=note, common=True)
    else:
        horizontal = math.cos(math.radians(table.latitude_deg)) * abs(math.sin(math.radians(table.tilt_deg)))
        quantity, u = "horizontal earth rate, azimuth unknown", EARTH_RATE_DPS * horizontal / math.sqrt(2)
        yield BudgetInput("azimuth", quantity, "deg/s", 0.0, u, "arcsine", by_rate, note=note, common=True)


def _rate_slopes(table: TableGeometry) -> tuple[float, float, float, float, float]:
    """Derivatives of the axis rate by table rate, tilt, latitude, azimuth (deg/s per deg) and earth rate."""
    azimuth = table.azimuth_deg if math.isfinite(table.azimuth_deg) else 90.0  # east: the vertical part alone
    tilt, latitude, turned = (math.radians(v) for v in (table.tilt_deg, table.latitude_deg, azimuth))
    up, north, sine, cosine = math.sin(latitude), math.cos(latitude), math.sin(tilt), math.cos(tilt)
    by_tilt = -table.table_rate * sine + EARTH_RATE_DPS * (-up * sine + north * cosine * math.cos(turned))
    by_latitude = EARTH_RATE_DPS * (north * cosine - up * sine * math.cos(turned))
    by_azimuth = -EARTH_RATE_DPS * north * sine * math.sin(turned)
    along = float(earth_rate_on_axis(table.latitude_deg, table.tilt_deg, azimuth)) / EARTH_RATE_DPS
    return cosine, by_tilt * _DEGREE, by_latitude * _DEGREE, by_azimuth * _DEGREE, along


# --------------------
# What receiver, channel and laser do to the second harmonic: distortion, corners, a measured response


_PHASES = 12
_PHASE_LOST = 0.5  # rad: with a larger uncertainty the phase of the ratio is as good as unknown
Factor = Callable[[float | Floats, float | Floats], Complexes]  # on rho, of beat frequencies and a corner in Hz
ByFrequency = Callable[[Floats], Complexes]  # a factor of beat frequencies alone

TAIL_TIMES = (3e-4, 1e-3, 3e-3)  # s after which a thermal tail of an amplifier comes

CORNERS: tuple[tuple[str, str, str, Factor], ...] = (
    ("bandwidth", "bandwidth", "bandwidth of the channel", low_pass_on_ratio),
    ("high_pass", "high_pass", "AC coupling of the channel", high_pass_on_ratio),
    ("gain_corner", "gain", "gain saturation of the laser", gain_on_ratio),
)
"""Name of the line, field of the knowledge, in words, and what such a corner does to rho."""


def channel_inputs(point: OperatingPoint, known: Bounded, slope: float) -> Iterator[BudgetInput]:
    """Lines of everything between the mirrors and the samples."""
    yield distortion_input(point, known, slope)
    yield third_order_input(point, known, slope)
    for name, known_as, quantity, response in CORNERS:
        if name in known.knowledge.separated:
            yield separated_input(name, quantity)
        else:
            yield _corner(name, quantity, getattr(known.knowledge, known_as), response, point, slope, known)
    share, at = slope * point.ratio, np.array(point.beat_frequency)
    yield from stated_inputs(known.knowledge, share, lambda factor: share * (float(abs(factor(at))) - 1))


def stated_inputs(
    knowledge: BenchKnowledge, share: float, shift: Callable[[ByFrequency], float]
) -> Iterator[BudgetInput]:
    """Lines of a measured response at 2f over that at f and of a thermal tail, where they are stated."""
    # share, deg/s: of the lock-in rate, what all of the ratio gives; shift, deg/s: what a factor on rho does
    if math.isfinite(knowledge.response_u):
        name, quantity = "response", "response of the channel at 2f over f, measured"
        yield BudgetInput(name, quantity, "1", 1.0, knowledge.response_u, "normal", -share, note="corrected")
    if limit := knowledge.tail_limit:
        tails = (partial(tail_on_ratio, size=size, after_s=t) for size in (limit, -limit) for t in TAIL_TIMES)
        u = max(abs(shift(tail)) for tail in tails) / _RECTANGLE
        note = f"up to {100 * limit:.2g} %, after 0.3 to 3 ms"
        yield BudgetInput("tail", "thermal tail of the channel", "deg/s", 0.0, u, "rectangular", 1.0, note=note)


def separated_input(name: str, quantity: str) -> BudgetInput:
    """The line of something that the records were freed of: its cost is in the noise."""
    note = "does not enter: the records themselves were freed of it"
    return BudgetInput(name, quantity, "1", 0.0, 0.0, "rectangular", 0.0, note=note, common=True)


def distortion_input(point: OperatingPoint, known: Bounded, slope: float) -> BudgetInput:
    """Second-order distortion d, a real number within its limit."""
    # A square law adds d to rho = -r exp(-i phase); what it makes of the higher harmonics takes r^2 of it away.
    # Where d is not small against r the effect is no straight line: the deviation is taken over the distribution.
    name, quantity, limit = "distortion", "second-order distortion d", known.knowledge.distortion_limit
    if name in known.knowledge.separated:
        return separated_input(name, quantity)
    u, weight = limit / _RECTANGLE, _weight_of_distortion(point, limit)
    phase = "phase unknown" if _phase_lost(point) else "at the phase measured"
    note = known.note(name, f"{level(limit)}, {phase}", f"within ±{limit:.2g} ({level(limit)}), {phase}")
    by_d = slope * (1 - point.ratio**2) * weight
    stated = name not in known.assumed
    return BudgetInput(name, quantity, "1", 0.0, u, "rectangular", by_d, note=note, common=True, stated=stated)


def third_order_input(point: OperatingPoint, known: Bounded, slope: float) -> BudgetInput:
    """Third-order distortion: a share of r, the same at every rate, whose sign the readout phase decides."""
    name, quantity, limit = "third_order", "third-order distortion", known.knowledge.third_order_limit
    if name in known.knowledge.separated:
        return separated_input(name, quantity)
    by_h = slope * (point.ratio * THIRD_ORDER_ON_RATIO + THIRD_ORDER_LEAK / point.periods)
    note = known.note(name, level(limit), f"within ±{limit:.2g} ({level(limit)}), stated or seen in the records")
    u, stated = limit / _RECTANGLE, name not in known.assumed
    return BudgetInput(name, quantity, "1", 0.0, u, "rectangular", by_h, note=note, common=True, stated=stated)


def level(amplitude: float) -> str:
    """A level of a harmonic in words."""
    return f"{20 * math.log10(amplitude):.0f} dBc" if amplitude > 0 else "none"


def _phase_lost(point: OperatingPoint) -> bool:
    return not (math.isfinite(point.phase) and point.ratio_u < _PHASE_LOST * point.ratio)


def _weight_of_distortion(point: OperatingPoint, limit: float) -> float:
    """Root mean square of what d within its limit makes of r, over that of d itself; signed as its slope."""
    # At a right angle between the phases d turns rho and makes it longer: the slope is zero, the effect is not.
    if _phase_lost(point):
        phases: Floats = np.arange(_PHASES, dtype=np.float64) * (2 * np.pi / _PHASES)
        weights: Floats = np.full(_PHASES, 1 / _PHASES)
    else:
        spread, shares = np.polynomial.hermite_e.hermegauss(5)
        phases = point.phase + point.ratio_u / point.ratio * np.asarray(spread, dtype=np.float64)
        weights = np.asarray(shares / shares.sum(), dtype=np.float64)
    along = -math.copysign(1.0, point.input_rate) * np.cos(phases)
    sign = math.copysign(1.0, float(along[weights.argmax()]))
    if limit == 0:
        return sign * float(np.sqrt(weights @ along**2))
    places, lengths = np.polynomial.legendre.leggauss(8)
    d = limit * places[:, np.newaxis]
    true = np.sqrt(np.maximum(point.ratio**2 - 2 * point.ratio * d * along + d * d, 0.0))
    mean_square = float(lengths / 2 @ (true - point.ratio) ** 2 @ weights)
    return sign * math.sqrt(mean_square) * _RECTANGLE / limit


def _corner(
    name: str,
    quantity: str,
    corner: ResponseCorner,
    response: Factor,
    point: OperatingPoint,
    slope: float,
    known: Bounded,
) -> BudgetInput:
    """A first-order corner, whose `response` is the factor that it puts on rho."""
    frequency, ratio = point.beat_frequency, point.ratio
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = float(abs(response(frequency, corner.hz)))
    if not (corner.hz >= 0 and math.isfinite(factor)):
        raise NoBudget(f"{quantity}: a corner of {corner.hz!r} Hz lets no beat through")
    corrected = corner.corrected and 0 < corner.hz < math.inf
    if corrected and math.sqrt(3) * corner.u_hz < corner.hz:
        # It goes with the square of the corner: over an uncertainty of a tenth its slope is not constant, so
        # the deviation is taken over the distribution (three-point Gauss-Hermite rule; JCGM 100, 5.1.3 allows it).
        reach = math.sqrt(3) * corner.u_hz if corner.u_hz > 0 else 1e-4 * corner.hz
        low, middle, high = (float(abs(response(frequency, corner.hz + side * reach))) for side in (-1, 0, 1))
        mean = (low + 4 * middle + high) / 6
        variance = ((low - mean) ** 2 + 4 * (middle - mean) ** 2 + (high - mean) ** 2) / 6
        by_hz = -slope * ratio * math.copysign(math.sqrt(3 * variance) / (reach * middle), high - low)
        note = f"corrected for, by {1 / factor - 1:+.2%} of r"
        return BudgetInput(name, quantity, "Hz", corner.hz, corner.u_hz, "normal", by_hz, note=note)
    lost = 1 / factor - 1 if corrected else 1 - factor
    if abs(lost) < 1e-12:
        note = "none"
    elif corrected:
        note = f"corrected for a corner that is hardly known: the whole correction, {lost:+.2%} of r, is a limit"
    else:
        note = f"corner {corner.hz:.4g} Hz, not corrected for: the whole effect is a limit"
    return BudgetInput(
        name,
        f"{quantity}: share of r lost",
        "1",
        lost,
        abs(lost) / _RECTANGLE,
        "rectangular",
        slope * ratio,
        note=known.note(name, f"{corner.hz:.4g} Hz", note),
        stated=name not in known.assumed,
    )


# --------------------
# Uncertainty budget after the GUM (JCGM 100): inputs, sensitivities, combination, coverage


Distribution = Literal["normal", "rectangular", "arcsine"]
Reference = Literal["beat", "rate"]
"""What WL is measured against: f/K of the record itself, or the rate given by a table."""

"""Standard deviations of a normal distribution to either side that hold 95 % of it."""


@dataclass(frozen=True)
class BudgetInput:
    """One line of a budget."""

    name: str  # one word for programs
    quantity: str  # in words
    unit: str  # of `value` and `u`
    value: float  # estimate and standard uncertainty (k = 1)
    u: float
    distribution: Distribution  # {"normal", "rectangular", "arcsine"}: What is known of the input
    # derivative of the lock-in rate by this input, deg/s per `unit`. 0: the input does not enter.
    sensitivity: float
    degrees_of_freedom: float = math.inf  # of `u`; inf where it was not found by repeating
    note: str = ""  # where the number comes from, or why it does not enter
    # whether it acts on every rate alike: a fit over several rates leaves its share as it is at one
    common: bool = False
    # whether somebody stated or measured it; otherwise it is a bound of `analysis.budget`
    stated: bool = True

    def __post_init__(self) -> None:
        if not (math.isfinite(self.u) and self.u >= 0 and math.isfinite(self.sensitivity)):
            raise ValueError(
                f"{self.name}: the uncertainty must be finite and not negative and the sensitivity finite, "
                f"not {self.u!r} and {self.sensitivity!r}"
            )
        if not self.degrees_of_freedom > 0:
            raise ValueError(f"{self.name}: degrees of freedom must be positive, not {self.degrees_of_freedom!r}")

    @property
    def contribution(self) -> float:
        """Standard uncertainty that this input gives to the lock-in rate, deg/s."""
        return abs(self.sensitivity) * self.u


@dataclass(frozen=True)
class Budget:
    """All inputs of a lock-in rate, the largest contribution first."""

    lock_in_rate: float  # deg/s
    reference: Reference  # {"beat", "rate"}
    inputs: tuple[BudgetInput, ...]  # independent of each other

    def __post_init__(self) -> None:
        ordered = tuple(sorted(self.inputs, key=lambda line: -line.contribution))
        object.__setattr__(self, "inputs", ordered)

    @property
    def combined_u(self) -> float:
        """Standard uncertainty of the lock-in rate, deg/s."""
        return math.hypot(*(line.contribution for line in self.inputs))

    @property
    def effective_degrees_of_freedom(self) -> float:
        """After Welch and Satterthwaite (JCGM 100, G.4); inf where no line has any."""
        total = self.combined_u
        terms = sum((line.contribution / total) ** 4 / line.degrees_of_freedom for line in self.inputs if total)
        return 1 / terms if terms > 0 else math.inf

    @property
    def coverage_factor(self) -> float:
        """k of the 95 % interval: Student's factor for the effective degrees of freedom, cut to an integer."""
        freedom = self.effective_degrees_of_freedom
        if freedom > 1e6:
            return NORMAL_95
        return float(scipy.special.stdtrit(max(math.floor(freedom), 1), 0.975))

    @property
    def expanded_u_95(self) -> float:
        """Half width of the 95 % interval, deg/s."""
        return self.coverage_factor * self.combined_u

    @property
    def interval_95(self) -> tuple[float, float]:
        """Ends of the 95 % interval, deg/s; it begins at zero where a size may be nothing but uncertainty.

        Far above its uncertainty they lie U95 to both sides; near zero the interval is that of Feldman and Cousins
        (:func:`analysis.lockin_rate.size_interval`) with the combined uncertainty.
        """
        wide = self.expanded_u_95 / NORMAL_95
        if wide == 0:
            return self.lock_in_rate, self.lock_in_rate
        # the value is freed of the bias that noise gives to a size; the interval is made for one that has it
        low, high = size_interval(math.hypot(self.lock_in_rate, wide) / wide)
        return float(low) * wide, float(high) * wide

    @property
    def relative_u(self) -> float:
        """Combined standard uncertainty over the lock-in rate."""
        return self.combined_u / self.lock_in_rate if self.lock_in_rate else math.inf

    def share(self, line: BudgetInput) -> float:
        """Share of one line in the variance, 0 to 1."""
        total = self.combined_u
        return (line.contribution / total) ** 2 if total else 0.0

    @property
    def not_stated(self) -> tuple[BudgetInput, ...]:
        """Lines that are bounds of what nobody stated or measured."""
        return tuple(line for line in self.inputs if not line.stated)


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

    def for_rate(self, input_rate: float) -> TableGeometry:
        """The same table at the rate that gives a rate on the axis, deg/s; due east where no azimuth is known."""
        azimuth = self.azimuth_deg if math.isfinite(self.azimuth_deg) else 90.0
        earth = float(earth_rate_on_axis(self.latitude_deg, self.tilt_deg, azimuth))
        rate = (input_rate - earth) / math.cos(math.radians(self.tilt_deg))
        return replace(self, table_rate=rate, table_rate_u=self.table_rate_u * abs(rate / self.table_rate))


@dataclass(frozen=True)
class BenchKnowledge:
    """Everything that a budget counts besides the records.

    nan: nobody said anything of it, so that it counts with a bound of `analysis.budget`.
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
    tail_limit: float = 0.0  # largest share of a step that the scope's input shows some milliseconds later only
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
    known = {line: getattr(knowledge, bound[0]) for line, bound in bounds.items()}
    missing = {line: bounds[line] for line, of in known.items() if math.isnan(getattr(of, "hz", of))}
    return Bounded(replace(knowledge, **dict(missing.values())), frozenset(missing))  # type: ignore[arg-type]


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
