"""Every input of a lock-in rate: its standard uncertainty, and the derivative of the rate by it.

With the record as its own reference WL = (f/K) 2r/(1-r^2): table, tilt and earth rate have no derivative. With the
rate given WL = W 2r/(1+r^2): K and the time base have none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from analysis.budget.bounded import Bounded, bounded
from analysis.budget.channel_inputs import channel_inputs
from analysis.budget.combination import Budget, BudgetInput, Reference
from analysis.budget.knowledge import BenchKnowledge, OperatingPoint, TableGeometry, ratio_slope
from analysis.budget.unstated import SCALE_FACTOR_LIMIT, TABLE_RATE_LIMIT
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
