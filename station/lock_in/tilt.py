"""The tilt between gyro axis and table axis, from the records of the fast run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis import estimate_lock_in
from analysis.rotation import earth_rate_on_axis, tilt_from_fast_runs
from instrument import Preamble, Waveform
from station.errors import RunError
from station.runs.store import SavedRecord
from station.settings.load import Settings


@dataclass(frozen=True)
class Tilt:
    """Angle between gyro axis and table axis, deg, with its standard uncertainty."""

    tilt_deg: float
    tilt_u_deg: float


@dataclass(frozen=True)
class Azimuth:
    """Table azimuth during a record, deg from north.

    Attributes
    ----------
    middle : float
        nan where nobody knows it.
    turned : float
        Between the readings before and after the record: it was taken somewhere between them.
    """

    middle: float
    turned: float


def evaluate_tilt(records: Sequence[SavedRecord], settings: Settings, lock_in_rate: float = math.nan) -> Tilt:
    """Find the tilt from the records of the fast run.

    Parameters
    ----------
    records : sequence of SavedRecord
        With ``table_rate_dps`` among their conditions.
    settings : Settings
    lock_in_rate : float, optional
        deg/s, from slower records. Without it that of each fast record counts, which the laser's gain weakens.

    Returns
    -------
    Tilt

    Raises
    ------
    RunError
        If beat and table rate do not fit together.
    """
    beats = [_beat(record, settings) for record in records]
    frequency, frequency_u, rate_u, own = np.array(beats).T
    known_lock_in = math.isfinite(lock_in_rate)
    azimuths = [azimuth_of(record, settings) for record in records]
    middle = np.array([azimuth.middle for azimuth in azimuths])
    turned = np.array([azimuth.turned for azimuth in azimuths])
    known = bool(np.isfinite(middle).all())
    try:
        fit = tilt_from_fast_runs(
            frequency,
            frequency_u if known_lock_in else rate_u,
            [float(record.conditions["table_rate_dps"]) for record in records],
            scale_factor=settings.gyro.scale_factor_pulses_per_deg,
            latitude_deg=settings.site.latitude_deg,
            azimuth_deg=middle if known else None,
            # a record lies somewhere between two readings of the azimuth: a uniform distribution
            azimuth_u_deg=turned / math.sqrt(12) if known else 0.0,
            lock_in_rate=lock_in_rate if known_lock_in else own,
        )
    except ValueError as error:
        raise RunError(f"the fast run gives no tilt: {error}") from None
    # where the records scatter more than their noise says, the scatter counts
    scatter = fit.chi_square / fit.degrees_of_freedom if fit.degrees_of_freedom else 1.0
    return Tilt(fit.tilt_deg, fit.tilt_u_deg * math.sqrt(max(scatter, 1.0)))


def azimuth_of(record: SavedRecord, settings: Settings) -> Azimuth:
    """Return the table azimuth during a record."""
    conditions = record.conditions
    if "azimuth_start_deg" not in conditions:
        return Azimuth(math.nan, math.nan)
    start, end = float(conditions["azimuth_start_deg"]), float(conditions["azimuth_end_deg"])
    return Azimuth((start + end) / 2 - settings.table.north_azimuth_deg, abs(end - start))


def horizontal_earth_rate(settings: Settings, tilt_deg: float) -> float:
    """Return the largest rate that the horizontal part of the earth's rotation gives on the axis, deg/s."""
    north, east = (float(earth_rate_on_axis(settings.site.latitude_deg, tilt_deg, a)) for a in (0.0, 90.0))
    return abs(north - east)


def _beat(record: SavedRecord, settings: Settings) -> tuple[float, float, float, float]:
    """Beat frequency, its uncertainty, that with the ratio's part, Hz; the record's lock-in rate, deg/s."""
    wave = Waveform(record.codes, Preamble.parse(record.preamble))
    scale_factor = settings.gyro.scale_factor_pulses_per_deg
    beat = estimate_lock_in(wave.volts, wave.sample_interval, scale_factor=scale_factor, nan_policy="omit")
    frequency, frequency_u, ratio = float(beat.beat_frequency), float(beat.beat_frequency_u), float(beat.ratio)
    # lock-in pulls the beat down by (WL/W)^2 / 2
    both_u = math.hypot(frequency_u, frequency * 4 * ratio * float(beat.ratio_u))
    return frequency, frequency_u, both_u, float(beat.lock_in_rate)
