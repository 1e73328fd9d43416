"""Rotation geometry: earth rate on a tilted sensitive axis, and the tilt from a fast table run.

The table axis is vertical. The gyro's sensitive axis makes the angle `tilt` with it and points, in the
horizontal plane, to the azimuth that the table has turned to (0 = north, positive eastwards).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

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


def tilt_from_fast_run(
    beat_frequency: ArrayLike, beat_frequency_u: ArrayLike, table_rate: ArrayLike, scale_factor: float
) -> tuple[float, float]:
    """Tilt between sensitive axis and table axis, deg, and its standard uncertainty, from fast table runs.

    f = K W, since WL does not matter at a fast rate (it changes f by x^2/2). Runs in both senses at the same
    azimuth cancel the earth rate, which adds to one and subtracts from the other.

    Parameters
    ----------
    beat_frequency, beat_frequency_u : (n_runs,)
        Hz, one value a run, and its standard uncertainty.
    table_rate : (n_runs,)
        deg/s, signed.
    scale_factor : float
        Pulses per degree.

    Raises
    ------
    ValueError
        The beat is faster than the table could make it: K or the table rate is wrong.
    """
    f, fu = np.atleast_1d(beat_frequency).astype(float), np.atleast_1d(beat_frequency_u).astype(float)
    fastest = scale_factor * np.abs(np.atleast_1d(table_rate).astype(float))
    cosine = float(np.mean(f / fastest))
    if not 0 <= cosine <= 1:
        raise ValueError(
            f"the beat is {cosine:.4f} times K times the table rate; at most 1 is possible: "
            "check the scale factor and the table rate"
        )
    cosine_u = float(np.sqrt(np.sum((fu / fastest) ** 2)) / f.size)
    tilt = np.arccos(cosine)
    return float(np.rad2deg(tilt)), float(np.rad2deg(cosine_u / max(np.sin(tilt), 1e-9)))
