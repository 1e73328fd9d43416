"""The rate table: tilt of the gyro's axis from the fast run, rate on the axis, and what that says of WL."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from analysis.arrays import Floats
from analysis.flags import Flag
from analysis.lock_in_run.estimates import Method, estimate_records
from analysis.lock_in_run.records import RecordArrays, RunArrays, RunKnowledge
from analysis.lockin_rate import LockInEstimate
from analysis.rotation import earth_rate_on_axis, tilt_from_fast_runs

_UNIFORM = math.sqrt(12)
"""Width over standard deviation: a record lies somewhere between two readings of the azimuth."""

_EAST, _NORTH = 90.0, 0.0
_AT_ONCE = 1 << 14


@dataclass(frozen=True)
class Tilt:
    """Angle between gyro axis and table axis, deg.

    Its standard uncertainty counts the frequencies, the scale factor and the rate of the table.
    """

    tilt_deg: float
    tilt_u_deg: float


@dataclass(frozen=True)
class AxisRates:
    """Rates on the gyro's axis by the table."""

    rates: Floats  # (n,): deg/s, signed, one for each record
    # (n,): Relative standard uncertainty of them that all records share: tilt, with the scale factor by which it
    # was found, and an azimuth that nobody knows
    common_u: Floats
    # (n,): deg/s; standard uncertainty from the place of a record between two readings of the azimuth. It is much
    # the same for all records at one rate.
    azimuth_u: Floats


def axis_rate_is_known(run: RunArrays, knowledge: RunKnowledge) -> bool:
    """Whether the fast run has all its senses, and every slow record a table rate."""
    senses = 2 if knowledge.both_senses else 1
    return bool(np.isfinite(run.slow.table_rate).all()) and np.unique(run.fast.table_rate).size == senses


def find_tilt(fast: RecordArrays, knowledge: RunKnowledge, lock_in_rate: float = math.nan) -> Tilt:
    """Find the tilt from the records of the fast run."""
    each = fast_estimates(fast, knowledge)
    frequency, frequency_u = each.beat_frequency, each.beat_frequency_u
    pulling: float | Floats = lock_in_rate
    if not math.isfinite(lock_in_rate):
        # lock-in pulls the beat down by (WL/W)^2 / 2, nearly 2 r^2; a ratio in the noise bounds it
        seen = (each.flags & int(Flag.RATIO_NOT_SIGNIFICANT)) == 0
        seen &= seen.mean() > 0.5  # otherwise it is one by chance
        pulling = np.where(seen, each.lock_in_rate, 0.0)
        unknown = np.where(seen, 4 * each.ratio * each.ratio_u, 2 * (each.ratio**2 + each.ratio_u**2))
        frequency_u = np.hypot(frequency_u, frequency * unknown)
    oriented = bool(np.isfinite(fast.azimuth).all())
    fit = tilt_from_fast_runs(
        frequency,
        frequency_u,
        fast.table_rate,
        scale_factor=knowledge.scale_factor,
        latitude_deg=knowledge.latitude_deg,
        azimuth_deg=fast.azimuth - knowledge.north_azimuth_deg if oriented else None,
        azimuth_u_deg=fast.turned / _UNIFORM if oriented else 0.0,
        lock_in_rate=pulling,
        scale_factor_u=knowledge.scale_factor * knowledge.relative_scale_u,
        table_rate_u=knowledge.relative_table_u,
        by_scatter=True,
    )
    return Tilt(fit.tilt_deg, fit.tilt_u_deg)


def fast_estimates(fast: RecordArrays, knowledge: RunKnowledge) -> LockInEstimate:
    """Estimate each record of the fast run, fields of shape (n,)."""
    return estimate_records(fast, Method(knowledge.scale_factor))


def axis_rates(slow: RecordArrays, tilt: Tilt, knowledge: RunKnowledge) -> AxisRates:
    """Work out the rate on the axis during each record from table rate, tilt and earth rate."""

    def earth_rate(azimuth_deg: float | Floats) -> Floats:
        return earth_rate_on_axis(knowledge.latitude_deg, tilt.tilt_deg, azimuth_deg)

    found = AxisRates(*(np.empty(len(slow)) for _ in range(3)))
    vertical = earth_rate(_EAST)
    tilt_part = math.tan(math.radians(tilt.tilt_deg)) * math.radians(tilt.tilt_u_deg)
    # the horizontal part at an azimuth that nobody knows: a cosine has a mean square of one half
    swing = abs(float(earth_rate(_NORTH) - vertical)) / math.sqrt(2)
    for first in range(0, len(slow), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        middle = (slow.azimuth_start[some] + slow.azimuth_end[some]) / 2
        oriented = np.isfinite(middle)
        # then only the vertical part of the earth rate is left: that at east
        azimuth = np.where(oriented, middle - knowledge.north_azimuth_deg, _EAST)
        rates = slow.table_rate[some] * math.cos(math.radians(tilt.tilt_deg)) + earth_rate(azimuth)
        slope = np.abs(earth_rate(azimuth + 90.0) - vertical)
        turned = np.abs(slow.azimuth_end[some] - slow.azimuth_start[some])
        found.rates[some] = rates
        found.azimuth_u[some] = np.where(oriented, slope * np.radians(turned) / _UNIFORM, 0.0)
        found.common_u[some] = np.hypot(tilt_part, np.where(oriented, 0.0, swing / np.abs(rates)))
    return found
