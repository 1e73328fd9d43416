"""The tilt between gyro axis and table axis, from the records of the fast run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis import estimate_lock_in
from analysis.rotation import earth_rate_on_axis, tilt_from_fast_run
from instrument import Preamble, Waveform
from station.errors import RunError
from station.runs import SavedRecord
from station.settings import Settings

Array = NDArray[np.float64]


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


@dataclass(frozen=True)
class _FastRun:
    """Records of one sense of rotation: rates on the axis (deg/s) and their uncertainties, azimuths."""

    rates: Array
    rates_u: Array
    azimuths: Array
    turned: Array


def evaluate_tilt(records: Sequence[SavedRecord], settings: Settings) -> Tilt:
    """Find the tilt from the records of the fast run.

    Parameters
    ----------
    records : sequence of SavedRecord
        With ``table_rate_dps`` among their conditions.
    settings : Settings

    Returns
    -------
    Tilt

    Raises
    ------
    RunError
        If beat and table rate do not fit together.
    """
    senses = {float(record.conditions["table_rate_dps"]) for record in records}
    runs = {rate: _fast_run(_at_rate(records, rate), settings) for rate in sorted(senses)}
    try:
        first = _tilt(runs, settings, None)
        # the earth rate on the axis depends on the tilt, but so weakly that one more step is enough
        return _tilt(runs, settings, first.tilt_deg)
    except ValueError as error:
        raise RunError(f"the fast run gives no tilt: {error}") from None


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


def _at_rate(records: Sequence[SavedRecord], rate: float) -> list[SavedRecord]:
    return [record for record in records if float(record.conditions["table_rate_dps"]) == rate]


def _fast_run(records: Iterable[SavedRecord], settings: Settings) -> _FastRun:
    rows = []
    for record in records:
        wave = Waveform(record.codes, Preamble.parse(record.preamble))
        beat = estimate_lock_in(
            wave.volts, wave.sample_interval, scale_factor=settings.gyro.scale_factor_pulses_per_deg
        )
        # the rate, not the beat frequency: lock-in pulls that down by (WL/W)^2 / 2
        rate, ratio = float(beat.input_rate), float(beat.ratio)
        parts = (float(beat.beat_frequency_u) / float(beat.beat_frequency), 4 * ratio * float(beat.ratio_u))
        azimuth = azimuth_of(record, settings)
        rows.append((rate, rate * math.hypot(*parts), azimuth.middle, azimuth.turned))
    return _FastRun(*np.array(rows).T)


def _tilt(runs: dict[float, _FastRun], settings: Settings, known_tilt_deg: float | None) -> Tilt:
    """Tilt from all senses; with a tilt known roughly, freed of the earth rate that the azimuth shows."""
    scale_factor, latitude = settings.gyro.scale_factor_pulses_per_deg, settings.site.latitude_deg
    means, us = [], []
    for table_rate, run in runs.items():
        rates, between = run.rates, 0.0
        if known_tilt_deg is not None and np.isfinite(run.azimuths).all():
            earth = earth_rate_on_axis(latitude, known_tilt_deg, run.azimuths)
            slope = earth_rate_on_axis(latitude, known_tilt_deg, run.azimuths + 90.0)
            slope = slope - earth_rate_on_axis(latitude, known_tilt_deg, 90.0)
            rates = rates - math.copysign(1.0, table_rate) * earth
            # a record lies somewhere between two readings of the azimuth (a uniform distribution), and
            # every record of a run at the same place between them: this part does not average out
            between = float(np.mean(np.abs(slope) * np.radians(run.turned))) / math.sqrt(12)
        elif known_tilt_deg is not None:
            # the horizontal earth rate is in it with a phase that nobody knows
            between = horizontal_earth_rate(settings, known_tilt_deg) / math.sqrt(2)
        means.append(scale_factor * float(np.mean(rates)))
        us.append(scale_factor * math.hypot(_mean_u(rates, run.rates_u), between))
    return Tilt(*tilt_from_fast_run(means, us, list(runs), scale_factor))


def _mean_u(values: Array, us: Array) -> float:
    """Standard uncertainty of a mean: the larger of what is known of each value and what the scatter says."""
    each = float(np.sqrt(np.sum(us**2))) / values.size
    if values.size < 2:
        return each
    return max(each, float(np.std(values, ddof=1)) / math.sqrt(values.size))
