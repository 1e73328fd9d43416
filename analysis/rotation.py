"""Rotation geometry: the rate on a tilted sensitive axis, earth rate included, and the tilt from fast table runs.

The table axis is vertical. The gyro's sensitive axis makes the angle `tilt` with it and points, in the
horizontal plane, to the azimuth that the table has turned to: 0 = north, growing with a positive table rate. The
earth rate depends on its cosine only, so it does not matter here which way round that is.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats, NoTilt

EARTH_RATE_DPS = 15.041067 / 3600.0  # sidereal rotation rate of the earth, deg/s

ROUNDS = 50
SMALLEST_U_DPS = 1e-15
FASTER_THAN_POSSIBLE = 1e-3  # earth rate and noise may make the beat so much faster than K times the table rate


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


@dataclass(frozen=True)
class TiltFit:
    """Tilt between sensitive axis and table axis, deg, from fast runs.

    tilt_deg, tilt_u_deg : with all that was given to the fit
    chi_square, degrees_of_freedom : of the runs about it
    earth_rate_part_deg : what leaving the earth rate away would change
    """

    tilt_deg: float
    tilt_u_deg: float
    chi_square: float
    degrees_of_freedom: int
    earth_rate_part_deg: float


def tilt_from_fast_runs(
    beat_frequency: ArrayLike,
    beat_frequency_u: ArrayLike,
    table_rate: ArrayLike,
    *,
    scale_factor: float,
    latitude_deg: float,
    azimuth_deg: ArrayLike | None = None,
    azimuth_u_deg: ArrayLike = 0.0,
    turned_deg: ArrayLike = 0.0,
    lock_in_rate: ArrayLike = 0.0,
    scale_factor_u: float = 0.0,
    table_rate_u: float = 0.0,
    by_scatter: bool = False,
) -> TiltFit:
    """Tilt from fast runs in one or both senses, earth rate and lock-in taken into account.

    Each run measures W = sign(table rate) sqrt((f/K)^2 + WL^2) = (table rate + vertical earth rate) cos(tilt)
    + horizontal earth rate sin(tilt) cos(azimuth); the tilt is found by weighted least squares. What the azimuth
    leaves open does not average out over runs at one table rate: they may all stand at the same azimuth.

    Parameters
    ----------
    beat_frequency, beat_frequency_u, table_rate : (n_runs,)
        Hz; deg/s, signed.
    scale_factor, scale_factor_u : float
        K in pulses per degree; its uncertainty is common to all runs.
    azimuth_deg : (n_runs,), optional
        In the middle of each run. Without it, the horizontal earth rate is an uncertainty of each run.
    azimuth_u_deg : (n_runs,)
        Standard uncertainty of the azimuths.
    turned_deg : (n_runs,)
        Angle that the table turned in each run; whole turns need no azimuth.
    lock_in_rate : float or (n_runs,)
        deg/s, roughly; it matters by half its square.
    table_rate_u : float
        Relative, common to all runs.
    by_scatter : bool
        Where the runs scatter by more than their own uncertainties say, the scatter counts instead of those.

    Raises
    ------
    NoTilt
        A beat faster than the table could make it: K or the table rate is wrong. Runs that do not fit in shape.
    """
    f, fu, table = (
        np.atleast_1d(np.asarray(v, dtype=np.float64)) for v in (beat_frequency, beat_frequency_u, table_rate)
    )
    if not f.shape == fu.shape == table.shape or not np.all(np.isfinite(f + fu + table)) or np.any(table == 0):
        raise NoTilt("every fast run needs a beat frequency, its uncertainty and a table rate that is not zero")
    measured = np.sign(table) * np.hypot(f / scale_factor, lock_in_rate)
    own = np.maximum(fu / scale_factor, SMALLEST_U_DPS)
    cosine = float(np.sum(measured * table) / np.sum(table**2))
    noise = float(np.linalg.norm(own * table) / np.sum(table**2))
    if cosine > 1 + FASTER_THAN_POSSIBLE + 4 * noise:
        raise NoTilt(
            f"the beat is {cosine:.4f} times K times the table rate; at most 1 is possible: "
            "check the scale factor and the table rate"
        )
    first = float(np.arccos(min(cosine, 1.0)))
    turned = np.broadcast_to(np.asarray(turned_deg, dtype=np.float64), f.shape)
    latitude = np.deg2rad(latitude_deg)
    swing = EARTH_RATE_DPS * np.cos(latitude) * np.sinc(turned / 360)
    turning = table + EARTH_RATE_DPS * np.sin(latitude)
    if azimuth_deg is None:
        # A cosine at a phase that nobody knows has a mean square of one half.
        crossing, unknown = np.zeros(f.shape), np.abs(swing) * np.sin(first) / np.sqrt(2)
    else:
        azimuth = np.deg2rad(np.broadcast_to(np.asarray(azimuth_deg, dtype=np.float64), f.shape))
        crossing = swing * np.cos(azimuth)
        unknown = np.abs(swing * np.sin(azimuth)) * np.sin(first) * np.deg2rad(azimuth_u_deg)
    # Weights alike for all azimuths: a run at a lucky one must not stand for both senses, or a drift would count.
    us = np.hypot(own, np.sqrt(np.mean(unknown**2)))
    tilt = _least_squares(measured, us, turning, crossing, first)
    left = measured - turning * np.cos(tilt) - crossing * np.sin(tilt)
    common = np.hypot(scale_factor_u / scale_factor, table_rate_u) * np.cos(tilt)
    chi_square, degrees = float(np.sum((left / np.hypot(own, unknown)) ** 2)), f.size - 1
    scatter = np.sqrt(max(chi_square / degrees, 1.0)) if by_scatter and degrees else 1.0
    # `own` is independent in each run, `unknown` common at one table rate
    weights = turning / us**2
    shared = [np.sum(np.abs(weights[table == rate]) * unknown[table == rate]) for rate in np.unique(table)]
    mean_u = np.hypot(np.linalg.norm(weights * own), np.linalg.norm(shared)) / np.sum(weights * turning)
    cosine_u = float(np.hypot(mean_u * scatter, common))
    return TiltFit(
        tilt_deg=float(np.rad2deg(tilt)),
        # Near zero tilt the cosine is flat: what is left is how far the axis may lean unseen.
        tilt_u_deg=float(np.rad2deg(np.sqrt(np.sin(tilt) ** 2 + 2 * cosine_u) - np.sin(tilt))),
        chi_square=chi_square,
        degrees_of_freedom=degrees,
        earth_rate_part_deg=float(np.rad2deg(tilt - first)),
    )


def _least_squares(measured: Floats, us: Floats, turning: Floats, crossing: Floats, start: float) -> float:
    """Tilt, rad, of measured = turning cos(tilt) + crossing sin(tilt)."""
    tilt = start
    for _ in range(ROUNDS):
        left = measured - turning * np.cos(tilt) - crossing * np.sin(tilt)
        slope = crossing * np.cos(tilt) - turning * np.sin(tilt)
        power = float(np.sum((slope / us) ** 2))
        change = float(np.sum(slope * left / us**2)) / power if power > 0 else 0.0
        tilt = float(np.clip(tilt + np.clip(change, -0.1, 0.1), 0.0, np.pi / 2))
        if abs(change) < 1e-14:
            break
    return tilt
