"""Rotation geometry: earth rate on a tilted sensitive axis, and the rate on it during a record.

The table axis is vertical. The gyro's sensitive axis makes the angle `tilt` with it and points, in the
horizontal plane, to the azimuth that the table has turned to: 0 = north, growing with a positive table rate. The
earth rate depends on its cosine only, so it does not matter here which way round that is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Bools, Floats

EARTH_RATE_DPS = 15.041067 / 3600.0
"""Sidereal rotation rate of the earth, deg/s."""


def earth_rate_on_axis(latitude_deg: ArrayLike, tilt_deg: ArrayLike, azimuth_deg: ArrayLike) -> Floats:
    """Earth rate along the sensitive axis, deg/s; arguments broadcast.

    Examples
    --------
    The paper's bench, latitude 28.2 deg and tilt 88.693 deg: plus or minus 13.25 deg/h over a turn.

    >>> swing = earth_rate_on_axis(28.2, 88.693, 0.0) - earth_rate_on_axis(28.2, 88.693, 180.0)
    >>> round(float(swing) / 2 * 3600, 2)
    13.25
    """
    latitude, tilt, azimuth = (np.deg2rad(v) for v in (latitude_deg, tilt_deg, azimuth_deg))
    vertical, north = np.sin(latitude), np.cos(latitude)
    along = vertical * np.cos(tilt) + north * np.sin(tilt) * np.cos(azimuth)
    return np.asarray(EARTH_RATE_DPS * along, dtype=np.float64)


def rate_on_axis(
    table_rate: ArrayLike, tilt_deg: ArrayLike, latitude_deg: ArrayLike, azimuth_deg: ArrayLike
) -> Floats:
    """Input rate of the gyro, deg/s: W = W_table cos(tilt) + earth rate along the axis."""
    turned = np.asarray(table_rate, dtype=np.float64) * np.cos(np.deg2rad(tilt_deg))
    return np.asarray(turned + earth_rate_on_axis(latitude_deg, tilt_deg, azimuth_deg), dtype=np.float64)


def earth_rate_swing(latitude_deg: ArrayLike, tilt_deg: ArrayLike) -> Floats:
    """Amplitude of the earth rate on the axis over a turn of the table, deg/s: its horizontal part.

    Examples
    --------
    >>> round(3600 * float(earth_rate_swing(28.2, 88.693)), 2)
    13.25
    """
    north, tilt = np.cos(np.deg2rad(latitude_deg)), np.sin(np.deg2rad(tilt_deg))
    return np.asarray(EARTH_RATE_DPS * np.abs(north * tilt), dtype=np.float64)


def rate_in_record(
    times: ArrayLike,
    table_rate: ArrayLike,
    tilt_deg: ArrayLike,
    latitude_deg: ArrayLike,
    start_azimuth_deg: ArrayLike,
) -> Floats:
    """W(t) on the axis while the table turns steadily, deg/s.

    Parameters
    ----------
    times : (n,)
        Seconds since the table stood at the azimuth `start_azimuth_deg`.
    table_rate, tilt_deg, latitude_deg, start_azimuth_deg : (...)
        Table rate in deg/s, signed.

    Returns
    -------
    (..., n)
    """
    t = np.asarray(times, dtype=np.float64)
    rate, tilt, latitude, start = (
        np.asarray(v, dtype=np.float64)[..., np.newaxis]
        for v in (table_rate, tilt_deg, latitude_deg, start_azimuth_deg)
    )
    return rate_on_axis(rate, tilt, latitude, start + rate * t)


@dataclass(frozen=True)
class RecordRate:
    """Rate on the axis over records, deg/s: mean, and how far it moves.

    mean : of W(t), exact
    moved : largest less smallest W(t)
    wander_rms : of W(t) about its mean
    """

    mean: Floats
    moved: Floats
    wander_rms: Floats


def mean_rate_in_record(
    duration: ArrayLike,
    table_rate: ArrayLike,
    tilt_deg: ArrayLike,
    latitude_deg: ArrayLike,
    middle_azimuth_deg: ArrayLike,
) -> RecordRate:
    """Mean rate on the axis over records of some duration, in closed form; arguments broadcast.

    The swing of the earth rate is averaged over the angle D = |table rate| T that the table turns meanwhile: its
    mean is cos(middle azimuth) sin(D/2)/(D/2), which is zero over whole turns.

    Parameters
    ----------
    duration : (...)
        Seconds.
    table_rate, tilt_deg, latitude_deg, middle_azimuth_deg : (...)
        The azimuth is that in the middle of the record.
    """
    if np.any(np.asarray(duration) < 0):
        raise ValueError("duration must not be negative (s)")
    turned = np.abs(np.asarray(table_rate, dtype=np.float64) * np.asarray(duration, dtype=np.float64))
    middle = np.deg2rad(np.asarray(middle_azimuth_deg, dtype=np.float64))
    swing = earth_rate_swing(latitude_deg, tilt_deg) * np.sign(np.sin(np.deg2rad(tilt_deg)))
    still = np.asarray(rate_on_axis(table_rate, tilt_deg, latitude_deg, 90.0))
    first, second = np.sinc(turned / 360), np.sinc(turned / 180)
    mean = np.cos(middle) * first
    square = (1 + np.cos(2 * middle) * second) / 2 - mean**2
    half = np.deg2rad(turned / 2)
    largest = np.where(_passes(middle, half, 0.0), 1.0, np.maximum(np.cos(middle - half), np.cos(middle + half)))
    smallest = np.where(
        _passes(middle, half, np.pi), -1.0, np.minimum(np.cos(middle - half), np.cos(middle + half))
    )
    return RecordRate(
        mean=np.asarray(still + swing * mean),
        moved=np.asarray(np.abs(swing) * (largest - smallest)),
        wander_rms=np.asarray(np.abs(swing) * np.sqrt(np.maximum(square, 0.0))),
    )


def _passes(middle: Floats, half: Floats, angle: float) -> Bools:
    """Whether middle - half .. middle + half, rad, holds the angle."""
    away = np.abs((middle - angle + np.pi) % (2 * np.pi) - np.pi)
    return np.asarray(away <= half)


def whole_turns(duration: float, table_rate: float) -> float:
    """The longest time within `duration` in which the table makes whole turns, s; 0 if it makes none.

    Examples
    --------
    >>> whole_turns(540.0, 21.0)
    531.4285714285714
    """
    if table_rate == 0:
        return 0.0
    turn = 360 / abs(table_rate)
    # A turn more where only rounding is missing.
    return float(np.floor(duration / turn + 1e-9) * turn)
