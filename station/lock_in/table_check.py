"""The rate of the table as reference instead of the beat: the rate on the axis, and what it says of WL."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis import LockInEstimate
from analysis.rotation import earth_rate_on_axis
from station.lock_in.tilt import Tilt, azimuth_of, horizontal_earth_rate
from station.runs.store import SavedRecord, SavedRun
from station.settings.load import Settings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TableCheck:
    """The same records, with the rate of the table as reference instead of the beat frequency.

    Attributes
    ----------
    lock_in_rate, lock_in_rate_u : float
        deg/s.
    input_rate : float
        Mean rate on the gyro's axis from table, tilt and earth rate, deg/s.
    beat_over_table : float
        Rate by the beat over rate by the table: 1 if scale factor, tilt and table agree.
    """

    lock_in_rate: float
    lock_in_rate_u: float
    input_rate: float
    beat_over_table: float


@dataclass(frozen=True)
class AxisRates:
    """Rates on the gyro's axis by the table.

    Attributes
    ----------
    rates : ndarray, shape (n,)
        deg/s, signed, one for each record.
    common_u : ndarray, shape (n,)
        Relative standard uncertainty of them that all records share: tilt, and an azimuth that nobody knows.
    azimuth_u : ndarray, shape (n,)
        deg/s; standard uncertainty from the place of a record between two readings of the azimuth. It is much the
        same for all records at one rate.
    """

    rates: Array
    common_u: Array
    azimuth_u: Array


def axis_rates(records: Sequence[SavedRecord], tilt: Tilt, settings: Settings) -> AxisRates:
    """Work out the rate on the axis during each record from table rate, tilt and earth rate.

    Parameters
    ----------
    records : sequence of SavedRecord
        With ``table_rate_dps`` among their conditions.
    tilt : Tilt
    settings : Settings

    Returns
    -------
    AxisRates
    """
    table = np.array([float(record.conditions["table_rate_dps"]) for record in records])
    read = [azimuth_of(record, settings) for record in records]
    azimuths = np.array([azimuth.middle for azimuth in read])
    turned_deg = np.array([azimuth.turned for azimuth in read])
    # where nobody knows the azimuth, only the vertical part of the earth rate is left: that at east
    known = np.where(np.isfinite(azimuths), azimuths, 90.0)
    turned = table * math.cos(math.radians(tilt.tilt_deg))
    latitude = settings.site.latitude_deg
    rates = turned + earth_rate_on_axis(latitude, tilt.tilt_deg, known)
    vertical = earth_rate_on_axis(latitude, tilt.tilt_deg, 90.0)
    slope = np.abs(earth_rate_on_axis(latitude, tilt.tilt_deg, known + 90.0) - vertical)
    between = np.where(np.isfinite(azimuths), slope * np.radians(turned_deg) / math.sqrt(12), 0.0)
    tilt_part = math.tan(math.radians(tilt.tilt_deg)) * math.radians(tilt.tilt_u_deg)
    swing = horizontal_earth_rate(settings, tilt.tilt_deg) / math.sqrt(2)
    earth_part = np.where(np.isfinite(azimuths), 0.0, swing / np.abs(rates))
    return AxisRates(rates, np.hypot(tilt_part, earth_part), between)


def table_check(own: LockInEstimate, by_table: LockInEstimate, axis: AxisRates) -> TableCheck | None:
    """Compare the result by the beat with that by the table, for records at one rate.

    Parameters
    ----------
    own, by_table : LockInEstimate
        Fields of shape (): combined with the beat and with the table as reference.
    axis : AxisRates
        Of the same records.

    Returns
    -------
    TableCheck or None
        ``None`` if the table's rate gives no lock-in rate.
    """
    if not np.isfinite(by_table.lock_in_rate):
        return None
    mean, value = float(np.mean(axis.rates)), float(by_table.lock_in_rate)
    shared = math.hypot(float(np.max(axis.common_u)), float(np.max(axis.azimuth_u)) / abs(mean))
    return TableCheck(
        lock_in_rate=value,
        lock_in_rate_u=math.hypot(float(by_table.lock_in_rate_u), value * shared),
        input_rate=mean,
        beat_over_table=float(own.input_rate) / abs(mean),
    )


def fast_run_is_whole(run: SavedRun, settings: Settings) -> bool:
    """Whether the fast run has all its senses, and every slow record a table rate."""
    senses = {record.conditions.get("table_rate_dps") for record in run.taken_for("tilt")}
    slow_known = all(record.conditions.get("table_rate_dps") is not None for record in run.taken_for("measure"))
    return slow_known and len(senses) == (2 if settings.table.both_senses else 1)
