"""Every input of a lock-in rate: its standard uncertainty, and the derivative of the rate by it.

With the record as its own reference WL = (f/K) 2r/(1-r^2): table, tilt and earth rate have no derivative. With the
rate given WL = W 2r/(1+r^2): K and the time base have none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from analysis.arrays import Complexes
from analysis.budget.combination import Budget, BudgetInput, Reference
from analysis.budget.knowledge import BenchKnowledge, Corner, OperatingPoint, TableGeometry, ratio_slope
from analysis.channel import gain_on_ratio, high_pass_on_ratio, low_pass_on_ratio
from analysis.errors import NoBudget
from analysis.rotation import EARTH_RATE_DPS, earth_rate_on_axis

_OWN = "does not enter: the record is its own reference"
_GIVEN = "does not enter: the rate is the reference"
_RECTANGLE = math.sqrt(3.0)
_DEGREE = math.pi / 180
_EARTH_RATE_U_DPS = 1e-8 * EARTH_RATE_DPS

Factor = Callable[[float, float], Complexes]
"""On rho, of a beat frequency and a corner in Hz."""


def lock_in_budget(point: OperatingPoint, knowledge: BenchKnowledge, reference: Reference = "beat") -> Budget:
    """Uncertainty budget of a lock-in rate.

    Parameters
    ----------
    reference : {"beat", "rate"}
        Whether WL was found with f/K of the record itself or with the rate of a table.

    Raises
    ------
    NoBudget
        A corner that lets no beat through or is not known at all.
    ValueError
        The rate as reference without `knowledge.table`, or impossible values.

    Examples
    --------
    Only 100 ppm of K and 50 ppm of time base: sqrt(100^2 + 50^2/3) = 104 ppm of 0.01 deg/s.

    >>> point = OperatingPoint(2000.0, 0.08, 0.01, ratio_u=0.0)
    >>> budget = lock_in_budget(point, BenchKnowledge(scale_factor_u_ppm=100.0))
    >>> [line.name for line in budget.inputs[:2]], round(budget.relative_u * 1e6)
    (['scale_factor', 'time_base'], 104)
    """
    if reference == "rate" and knowledge.table is None:
        raise ValueError("a budget with the rate as reference needs the table's rate, tilt and latitude")
    lines: list[BudgetInput] = [*_from_records(point, reference), *_from_reference(point, knowledge, reference)]
    if knowledge.table is not None:
        lines += _from_table(point, knowledge.table, reference)
    unstated: list[str] = []
    if math.isnan(knowledge.scale_factor_u_ppm) and reference == "beat":
        unstated.append("uncertainty of the scale factor")
    slope = _slope(point, reference)
    for line, missing in (
        _distortion(point, knowledge, slope),
        _corner("bandwidth", "bandwidth of the channel", knowledge.bandwidth, low_pass_on_ratio, point, slope),
        _corner("high_pass", "AC coupling of the channel", knowledge.high_pass, high_pass_on_ratio, point, slope),
        _corner("gain_corner", "gain saturation of the laser", knowledge.gain, gain_on_ratio, point, slope),
    ):
        if line is None:
            unstated.append(missing)
        else:
            lines.append(line)
    if math.isfinite(knowledge.response_u):
        quantity = "response of the channel at 2f over f, measured"
        by_response = -slope * point.ratio
        lines.append(
            BudgetInput(
                "response", quantity, "1", 1.0, knowledge.response_u, "normal", by_response, note="corrected"
            )
        )
    return Budget(point.lock_in_rate, reference, tuple(lines), tuple(unstated))


def _slope(point: OperatingPoint, reference: Reference) -> float:
    return ratio_slope(point.lock_in_rate, abs(point.input_rate), reference == "rate")


def _from_records(point: OperatingPoint, reference: Reference) -> Iterator[BudgetInput]:
    """Noise, rounding and scatter: what the records show themselves."""
    slope, freedom, own = _slope(point, reference), point.noise_degrees_of_freedom, reference == "beat"
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


def _from_reference(
    point: OperatingPoint, knowledge: BenchKnowledge, reference: Reference
) -> Iterator[BudgetInput]:
    """Scale factor and time base: with f they make the rate of a record that is its own reference."""
    own = reference == "beat"
    if not math.isnan(knowledge.scale_factor_u_ppm):
        yield BudgetInput(
            "scale_factor",
            "scale factor K",
            "pulses/deg",
            point.scale_factor,
            point.scale_factor * knowledge.scale_factor_u_ppm * 1e-6,
            "normal",
            -point.lock_in_rate / point.scale_factor if own else 0.0,
            note="" if own else _GIVEN,
            common=True,
        )
    yield BudgetInput(
        "time_base",
        "time base of the oscilloscope",
        "ppm",
        0.0,
        knowledge.time_base_limit_ppm / _RECTANGLE,
        "rectangular",
        -point.lock_in_rate * 1e-6 if own else 0.0,
        note=f"within ±{knowledge.time_base_limit_ppm:g} ppm" if own else _GIVEN,
        common=True,
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


def _distortion(point: OperatingPoint, knowledge: BenchKnowledge, slope: float) -> tuple[BudgetInput | None, str]:
    """Second-order distortion d, a real number within its limit.

    A square law adds d to rho = -r exp(-i phase); what it makes of the higher harmonics takes r^2 of it away.
    """
    limit, slope = knowledge.distortion_limit, slope * (1 - point.ratio**2)
    name, quantity = "distortion", "second-order distortion d"
    if knowledge.distortion_separated:
        note = "does not enter: both senses or several rates separate it"
        return BudgetInput(name, quantity, "1", 0.0, 0.0, "rectangular", 0.0, note=note, common=True), ""
    if math.isnan(limit):
        return None, "second-order distortion of detector and oscilloscope"
    level = f"{20 * math.log10(limit):.0f} dBc" if limit > 0 else "none"
    if math.isnan(point.phase):
        # any phase: the mean of cos^2 is one half
        turned, known = 1 / math.sqrt(2), "phase unknown"
    else:
        turned, known = -math.copysign(1.0, point.input_rate) * math.cos(point.phase), "at the phase measured"
    u, note = limit / _RECTANGLE, f"within ±{limit:.2g} ({level}), {known}"
    return BudgetInput(name, quantity, "1", 0.0, u, "rectangular", slope * turned, note=note, common=True), ""


def _corner(
    name: str,
    quantity: str,
    corner: Corner,
    response: Factor,
    point: OperatingPoint,
    slope: float,
) -> tuple[BudgetInput | None, str]:
    """A first-order corner, whose `response` is the factor that it puts on rho."""
    if math.isnan(corner.hz):
        return None, quantity
    frequency, ratio = point.beat_frequency, point.ratio
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = float(abs(response(frequency, corner.hz)))
    if not (corner.hz >= 0 and math.isfinite(factor)):
        raise NoBudget(f"{quantity}: a corner of {corner.hz!r} Hz lets no beat through")
    if corner.corrected and 0 < corner.hz < math.inf:
        by_hz = -slope * ratio * _relative_slope(response, frequency, corner)
        note = f"corrected for, by {1 / factor - 1:+.2%} of r"
        return BudgetInput(name, quantity, "Hz", corner.hz, corner.u_hz, "normal", by_hz, note=note), ""
    lost = 1 - factor
    text = (
        "none" if abs(lost) < 1e-12 else f"corner {corner.hz:g} Hz, not corrected for: the whole effect is a limit"
    )
    return BudgetInput(
        name,
        f"{quantity}: share of r lost",
        "1",
        lost,
        abs(lost) / _RECTANGLE,
        "rectangular",
        slope * ratio,
        note=text,
    ), ""


def _relative_slope(response: Factor, frequency: float, corner: Corner) -> float:
    """Relative change of the response by the corner, per Hz, such that this times u is the standard deviation.

    The effect goes with the square of the corner: over an uncertainty of a tenth its slope is not constant, so the
    deviation is taken over the distribution (three-point Gauss-Hermite rule; JCGM 100, 5.1.3 allows it).
    """
    reach = math.sqrt(3) * corner.u_hz if corner.u_hz > 0 else 1e-4 * corner.hz
    if not reach < corner.hz:
        raise NoBudget(
            f"a corner of {corner.hz:g} Hz with an uncertainty of {corner.u_hz:g} Hz is not known at all"
        )
    low, middle, high = (float(abs(response(frequency, corner.hz + side * reach))) for side in (-1, 0, 1))
    mean = (low + 4 * middle + high) / 6
    variance = ((low - mean) ** 2 + 4 * (middle - mean) ** 2 + (high - mean) ** 2) / 6
    return math.copysign(math.sqrt(3 * variance) / (reach * middle), high - low)
