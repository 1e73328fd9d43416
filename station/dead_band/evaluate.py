"""What the records of a sweep say: a beat or none at each rate, and from that the dead band."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis import (
    FATAL,
    DeadBand,
    FrequencyFit,
    earth_rate_on_axis,
    estimate_lock_in,
    find_dead_band,
    fit_frequencies,
)
from analysis.dead_band import COUNTED_U
from analysis.lock_in_run import rows_of_batches
from instrument import Waveform
from station.dead_band.settings import DeadBandSettings
from station.dead_band.take import PURPOSE
from station.errors import NoUsableSignal
from station.results.result import LeftOut
from station.ring_laser.records import saved_waveform
from station.runs.store import SavedRecord, SavedRun

Array = NDArray[np.float64]

_SMOOTHED = 5  # samples; a slip of the phase lasts longer, noise does not
_TURNS_FROM = 0.5  # of the swing of a whole turn: a locked phase only trembles
_TURNS_TO_FIT = 2.0  # with fewer in a record, the uncertainty of a frequency tells too little


@dataclass(frozen=True)
class Records:
    """The records of a sweep in the order in which they were taken, one element for each."""

    direction: tuple[str, ...]  # ``"up"`` or ``"down"``
    table_rate: Array  # (n,): deg/s, signed: of the table, and on the axis without the vertical earth rate
    rate: Array
    duration: Array  # (n,): s
    # (n,): Hz, not negative: 0 of a gyro that is locked, nan where there is less than a beat that could be fitted
    beat: Array
    beat_u: Array
    swing: Array  # (n,): V, largest less smallest
    clock: Array  # (n,): s, from any beginning; the number of the record where nobody wrote down the time
    azimuth_known: bool  # whether the horizontal earth rate is in the rates

    @property
    def turns(self) -> Array:
        """Periods of the beat in each record; one where it turns, but cannot be fitted."""
        return np.where(np.isnan(self.beat), 1.0, np.maximum(self.beat * self.duration, 1.0 * (self.beat > 0)))

    @property
    def step(self) -> NDArray[np.int64]:
        """Number of the step that each record was taken at, from 0."""
        before = [(None, math.nan), *zip(self.direction, self.table_rate, strict=True)]
        changed = [now != then for now, then in zip(before[1:], before[:-1], strict=True)]
        return np.cumsum(changed, dtype=np.int64) - 1


@dataclass(frozen=True)
class DeadBandFound:
    """What a sweep says."""

    records: Records
    band: DeadBand  # edges, lock-in rate and bias with what steps, hysteresis and noise leave open
    lock_in_rate_u: float  # deg/s, with everything that is known to spoil them
    bias_rate_u: float
    parts: dict[str, float]  # standard uncertainties that ``lock_in_rate_u`` is made of, deg/s, by name
    hyperbola: FrequencyFit | None  # beat frequency against rate; ``None`` where too few rates gave a beat
    earth_rate: float  # deg/s: the vertical earth rate on the axis
    scale_factor: float  # pulses per degree, as used
    left_out: tuple[LeftOut, ...]


def evaluate(run: SavedRun, settings: DeadBandSettings, choices: Mapping[str, Any]) -> DeadBandFound:
    """Evaluate the records of a sweep."""
    taken = run.taken_for(PURPOSE)
    damaged = [one.key for one in taken if not one.intact]
    intact = [one for one in taken if one.intact]
    if not intact:
        raise NoUsableSignal(f"{run.path}: the run holds no record of a sweep")
    scale_factor = float(choices.get("scale_factor", settings.gyro.scale_factor_pulses_per_deg))
    records = _read(intact, [saved_waveform(one, run.path) for one in intact], settings)
    band = _dead_band(records, scale_factor, settings.table.rate_u_dps)
    parts = _parts(records, band, settings, scale_factor)
    latitude, tilt = settings.site.latitude_deg, settings.table.tilt_deg
    others = [parts[name] for name in ("table", "earth_rate")]
    return DeadBandFound(
        records=records,
        band=band,
        lock_in_rate_u=math.hypot(*parts.values()),
        bias_rate_u=math.hypot(band.bias_rate_u, *others),
        parts=parts,
        hyperbola=_hyperbola(records, band, settings.table.rate_u_dps),
        earth_rate=float(earth_rate_on_axis(latitude, tilt, 90.0)),
        scale_factor=scale_factor,
        left_out=tuple(LeftOut(key, "its checksum is not that of the saved record") for key in damaged),
    )


def _read(taken: Sequence[SavedRecord], waveforms: Sequence[Waveform], settings: DeadBandSettings) -> Records:
    """Find the beat of every record."""
    intervals = np.array([wave.sample_interval for wave in waveforms])
    sizes = np.array([wave.codes.size for wave in waveforms], dtype=np.int64)
    swing = np.array([_swing(wave.volts) for wave in waveforms])
    locked = swing < _TURNS_FROM * swing.max()
    beat, beat_u = np.where(locked, 0.0, math.nan), np.full(swing.shape, math.nan)
    turning = np.flatnonzero(~locked)
    for batch in rows_of_batches(intervals[turning], sizes[turning]):
        rows = turning[batch]
        volts = np.array([waveforms[row].volts for row in rows])
        fit = estimate_lock_in(volts, float(intervals[rows[0]]), scale_factor=1.0, nan_policy="omit")
        whole = (fit.beat_frequency * intervals[rows] * sizes[rows] >= 1) & ((fit.flags & int(FATAL)) == 0)
        beat[rows], beat_u[rows] = np.where(whole, (fit.beat_frequency, fit.beat_frequency_u), math.nan)
    table_rate = np.array([float(one.conditions["table_rate_dps"]) for one in taken])
    azimuth = _azimuths(taken)
    return Records(
        direction=tuple(str(one.conditions["direction"]) for one in taken),
        table_rate=table_rate,
        rate=_rate_on_axis(table_rate, azimuth - settings.table.north_azimuth_deg, settings),
        duration=intervals * sizes,
        beat=beat,
        beat_u=beat_u,
        swing=swing,
        clock=_clock(taken),
        azimuth_known=bool(np.isfinite(azimuth).all()),
    )


def _clock(taken: Sequence[SavedRecord]) -> Array:
    """Time of each record, s; of a simulated sweep that was gone on with, whose clock began again, its number."""
    clock = np.array([float(one.conditions.get("clock_s", math.nan)) for one in taken])
    if np.isfinite(clock).all() and np.all(np.diff(clock) >= 0):
        return clock
    return np.arange(len(taken), dtype=np.float64)


def _swing(volts: Array) -> float:
    """Largest less smallest value of a smoothed record; samples without data are left out."""
    whole = volts.size // _SMOOTHED * _SMOOTHED
    smooth = volts[:whole].reshape(-1, _SMOOTHED).mean(axis=-1)
    smooth = smooth[np.isfinite(smooth)]
    return float(np.ptp(smooth)) if smooth.size else 0.0


def _rate_on_axis(table_rate: Array, azimuth: Array, settings: DeadBandSettings) -> Array:
    """Rates on the axis, with the horizontal earth rate where the azimuth is known."""
    tilt, latitude = settings.table.tilt_deg, settings.site.latitude_deg
    horizontal = earth_rate_on_axis(latitude, tilt, azimuth) - earth_rate_on_axis(latitude, tilt, 90.0)
    return np.asarray(table_rate * math.cos(math.radians(tilt)) + np.where(np.isnan(azimuth), 0.0, horizontal))


def _azimuths(taken: Sequence[SavedRecord]) -> Array:
    """Azimuth in the middle of each record, deg; nan where it is not known."""
    ends = [(one.conditions.get("azimuth_start_deg"), one.conditions.get("azimuth_end_deg")) for one in taken]
    known = [(math.nan, math.nan) if None in pair else pair for pair in ends]
    return np.asarray(np.mean(np.array(known, dtype=np.float64), axis=-1))


def _dead_band(records: Records, scale_factor: float, rate_u: float) -> DeadBand:
    """Dead band from the turns at each step, as a counter would have shown them."""
    step = records.step
    count = np.bincount(step)
    dwell = float(np.max(records.duration) * count.max())
    # the time base differs from step to step: turns of the same time everywhere
    seconds = np.bincount(step, records.duration)
    turns = np.bincount(step, records.turns)
    pulses = np.maximum(turns / seconds * dwell, 1.0 * (turns > 0))
    # a frequency that was fitted is far finer than a count; one turn that was not is as coarse as one
    by_table = scale_factor * rate_u
    each_u = np.where(
        np.isfinite(records.beat_u), np.hypot(records.beat_u, by_table), COUNTED_U / records.duration
    )
    each_u = np.where(records.beat == 0, by_table, each_u)
    try:
        return find_dead_band(
            np.bincount(step, records.rate) / count,
            pulses,
            dwell,
            scale_factor=scale_factor,
            pulses_u=np.sqrt(np.bincount(step, each_u**2)) / count * dwell,
            times=np.bincount(step, records.clock) / count,
        )
    except ValueError:
        if not (turns > 0).all() and (turns > 0).any():
            raise NoUsableSignal(
                "the sweep was too short: no sense holds both rates with a beat and rates without"
            ) from None
        which, advice = ("a", "smaller") if (turns > 0).any() else ("no", "larger")
        raise NoUsableSignal(f"there is {which} beat at every rate of the sweep: take {advice} rates") from None


def drift_of(records: Records, band: DeadBand) -> Array:
    """How far the bias had drifted at each record since the middle of the sweep, deg/s; 0 where nobody knows."""
    span = float(np.ptp(records.clock))
    if not math.isfinite(band.drift) or span == 0:
        return np.zeros(records.rate.shape)
    return np.asarray(band.drift * ((records.clock - records.clock[0]) / span - 0.5))


def _parts(records: Records, band: DeadBand, settings: DeadBandSettings, scale_factor: float) -> dict[str, float]:
    """Standard uncertainties of the lock-in rate, deg/s, by their cause."""
    tilt, latitude = settings.table.tilt_deg, settings.site.latitude_deg
    # a beat of less than a turn in the record is not seen: the true edge may lie so much below the one found
    slowest = 1 / (scale_factor * float(np.max(records.duration)))
    unseen = band.lock_in_rate - math.sqrt(max(band.lock_in_rate**2 - slowest**2, 0.0))
    swing = float(earth_rate_on_axis(latitude, tilt, 0.0) - earth_rate_on_axis(latitude, tilt, 90.0))
    senses = max(int(np.isfinite(band.edges).any(axis=1).sum()), 1)
    return {
        "steps_hysteresis_noise": band.lock_in_rate_u,
        "slow_beats": unseen / math.sqrt(3),
        "table": settings.table.rate_u_dps / math.sqrt(senses),
        "earth_rate": 0.0 if records.azimuth_known else abs(swing) / math.sqrt(2),
    }


def _hyperbola(records: Records, band: DeadBand, rate_u: float) -> FrequencyFit | None:
    """Fit f^2 = K^2 [(W - W0)^2 - WL^2] to the records with some periods, less the drift; K is fitted too."""
    used = records.beat * records.duration >= _TURNS_TO_FIT
    rate = (records.rate - drift_of(records, band))[used]
    try:
        return fit_frequencies(rate, records.beat[used], records.beat_u[used], input_rate_u=rate_u)
    except ValueError:  # NoFit, or a frequency without an uncertainty
        return None
