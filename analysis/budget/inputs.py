"""Every input of a lock-in rate: its standard uncertainty, and the derivative of the rate by it.

With the record as its own reference WL = (f/K) 2r/(1-r^2): table, tilt and earth rate have no derivative. With the
rate given WL = W 2r/(1+r^2): K and the time base have none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.special

from analysis.arrays import NORMAL_95, Complexes, Floats, NoBudget
from analysis.budget.bench import (
    SCALE_FACTOR_LIMIT,
    TABLE_RATE_LIMIT,
    THIRD_ORDER_LEAK,
    THIRD_ORDER_ON_RATIO,
    BenchKnowledge,
    Bounded,
    OperatingPoint,
    ResponseCorner,
    TableGeometry,
    bounded,
    ratio_slope,
)
from analysis.channel import gain_on_ratio, high_pass_on_ratio, low_pass_on_ratio
from analysis.lockin_rate import size_interval
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
    for name, field, quantity, response in CORNERS:
        if name in known.knowledge.separated:
            yield separated_input(name, quantity)
        else:
            yield _corner(name, quantity, getattr(known.knowledge, field), response, point, slope, known)
    if math.isfinite(known.knowledge.response_u):
        yield response_input(known.knowledge.response_u, -slope * point.ratio)


def separated_input(name: str, quantity: str) -> BudgetInput:
    """The line of something that the records were freed of: its cost is in the noise."""
    note = "does not enter: the records themselves were freed of it"
    return BudgetInput(name, quantity, "1", 0.0, 0.0, "rectangular", 0.0, note=note, common=True)


def response_input(response_u: float, sensitivity: float) -> BudgetInput:
    """The line of a measured response at 2f over that at f, whose relative uncertainty is given."""
    quantity = "response of the channel at 2f over f, measured"
    return BudgetInput("response", quantity, "1", 1.0, response_u, "normal", sensitivity, note="corrected")


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
    by_level = slope * (point.ratio * THIRD_ORDER_ON_RATIO + THIRD_ORDER_LEAK / point.periods)
    note = known.note(name, level(limit), f"within ±{limit:.2g} ({level(limit)}), stated or seen in the records")
    stated = name not in known.assumed
    return BudgetInput(
        name,
        quantity,
        "1",
        0.0,
        limit / _RECTANGLE,
        "rectangular",
        by_level,
        note=note,
        common=True,
        stated=stated,
    )


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
    # whether somebody stated or measured it; otherwise it is a bound of `analysis.budget.bench`
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

    def with_line(self, line: BudgetInput, share: float) -> Budget:
        """The budget with one of its lines known so much better: `share` of its uncertainty is left."""
        better = replace(line, u=share * line.u)
        return replace(self, inputs=tuple(better if one is line else one for one in self.inputs))
