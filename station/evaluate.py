"""From saved records to the result: always computed again, never remembered."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from statistics import fmean
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis import (
    FATAL,
    Flag,
    LockInEstimate,
    combine_estimates,
    estimate_lock_in,
    flag_names,
)
from analysis.lockin_equation import Relation
from analysis.rotation import earth_rate_on_axis
from instrument import InstrumentError, Preamble, Waveform
from instrument.waveform import CLIPPED_CODE
from station.errors import RunError
from station.runs import SavedRecord, SavedRun
from station.settings import Settings
from station.tilt import Tilt, azimuth_of, evaluate_tilt, horizontal_earth_rate

Array = NDArray[np.float64]
_BATCH = 1000  # records analysed at once: 20 MB of samples
METHODS = {
    "exact": "harmonic ratio, exact relation",
    "paper-13": "harmonic ratio, relation (13) of the paper",
    "paper-10": "harmonic ratio, relation (10) of the paper",
}


@dataclass(frozen=True)
class Method:
    """How records are turned into a lock-in rate.

    Attributes
    ----------
    scale_factor : float
        K, pulses per degree.
    relation : {"exact", "paper-13", "paper-10"}
    input_rate : float or None
        Rate on the gyro's axis in deg/s; ``None``: each record is its own reference.
    """

    scale_factor: float
    relation: Relation = "exact"
    input_rate: float | None = None

    @property
    def text(self) -> str:
        """Describe the method in words."""
        reference = "self-referenced" if self.input_rate is None else "input rate given"
        return f"{METHODS[self.relation]}, {reference}"


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
class Evaluation:
    """What some records at one rate say.

    Attributes
    ----------
    method : Method
    names : tuple of str
        What each record is called: its number in the run, or its file.
    waveforms : tuple of Waveform
    each : LockInEstimate
        Fields of shape (n_records,).
    combined : LockInEstimate
        Fields of shape ().
    damaged : tuple of str
        Records that were left out because they are not what was once saved.
    tilt, table_check : Tilt, TableCheck or None
        Where a table with known rate was used.
    truth : dict or None
        The true values of a simulated run.
    """

    method: Method
    names: tuple[str, ...]
    waveforms: tuple[Waveform, ...]
    each: LockInEstimate
    combined: LockInEstimate
    damaged: tuple[str, ...] = ()
    tilt: Tilt | None = None
    table_check: TableCheck | None = None
    truth: dict[str, float] | None = None

    @property
    def usable(self) -> bool:
        """Whether a lock-in rate can be given at all."""
        return bool(np.isfinite(self.combined.lock_in_rate)) and not int(self.combined.flags) & int(FATAL)

    @property
    def flags(self) -> list[str]:
        """Names of the flags of the combined result, and of the store."""
        names = flag_names(int(self.combined.flags))
        return [*names, "damaged"] if self.damaged and "damaged" not in names else names

    @property
    def records_rejected(self) -> int:
        """Records that do not count in the combined result."""
        return int(self.combined.records_rejected) + len(self.damaged)


def evaluate_run(run: SavedRun, method: Method | None = None) -> Evaluation:
    """Evaluate the records that a run took at its slow rate.

    Parameters
    ----------
    run : SavedRun
    method : Method, optional
        By default the run's own scale factor, exact, self-referenced.

    Returns
    -------
    Evaluation

    Raises
    ------
    RunError
        If the run holds no such record.
    """
    settings = saved_settings(run)
    method = method or Method(settings.gyro.scale_factor_pulses_per_deg)
    taken = run.taken_for("measure")
    records = [record for record in taken if record.intact]
    damaged = tuple(str(count) for count, record in enumerate(taken, start=1) if not record.intact)
    if not records:
        what = "only damaged records" if damaged else "no record at the slow rate"
        raise RunError(f"{run.path}: the run holds {what}")
    waveforms = tuple(saved_waveform(record, run) for record in records)
    # counted among the records at the slow rate: those of the fast run have numbers too
    number = {record.number: str(count) for count, record in enumerate(taken, start=1)}
    names = tuple(number[record.number] for record in records)
    each, combined = _estimate(waveforms, method)
    tilt = evaluate_tilt(run.taken_for("tilt"), settings) if _has_tilt(run, settings) else None
    check = None
    if tilt is not None and method.input_rate is None:
        check = _table_check(records, waveforms, combined, tilt, settings, method)
    return Evaluation(method, names, waveforms, each, combined, damaged, tilt, check, _mean_truth(records))


def evaluate_waveforms(waveforms: Sequence[Waveform], names: Sequence[str], method: Method) -> Evaluation:
    """Evaluate records that come from files.

    Parameters
    ----------
    waveforms : sequence of Waveform
        At least one.
    names : sequence of str
    method : Method

    Returns
    -------
    Evaluation
    """
    each, combined = _estimate(tuple(waveforms), method)
    return Evaluation(method, tuple(names), tuple(waveforms), each, combined)


def saved_settings(run: SavedRun) -> Settings:
    """Return the settings that a run was taken with.

    Raises
    ------
    RunError
        If the run holds none that this version understands.
    """
    try:
        return Settings.model_validate(run.facts["settings"])
    except (KeyError, ValueError):
        raise RunError(f"{run.path}: the settings of this run cannot be read") from None


def saved_waveform(record: SavedRecord, run: SavedRun) -> Waveform:
    """Return a saved record as the waveform that the scope sent.

    Raises
    ------
    RunError
        If codes and preamble do not belong together.
    """
    try:
        return Waveform(record.codes, Preamble.parse(record.preamble))
    except InstrumentError as error:
        raise RunError(f"{run.path}: record {record.number} cannot be read: {error}") from None


def _estimate(
    waveforms: tuple[Waveform, ...], method: Method, input_rates: Array | None = None
) -> tuple[LockInEstimate, LockInEstimate]:
    """Estimate each record and combine them, those of one time base and length together."""
    groups: dict[tuple[float, int], list[int]] = {}
    for index, wave in enumerate(waveforms):
        groups.setdefault((wave.sample_interval, wave.codes.size), []).append(index)
    parts, order = [], []
    for (interval, _), indices in groups.items():
        for first in range(0, len(indices), _BATCH):
            batch = indices[first : first + _BATCH]
            rates = None if input_rates is None else input_rates[batch]
            parts.append(_estimate_batch([waveforms[index] for index in batch], interval, method, rates))
            order += batch
    each = _only_beats(_joined(parts, np.argsort(order)))
    return each, combine_estimates(each)


def _only_beats(each: LockInEstimate) -> LockInEstimate:
    """Withhold what rests on a piece of some curve: fewer than 3 periods that do not fit either."""
    curve = int(Flag.FEW_PERIODS | Flag.MISFIT)
    pieces = (each.flags & curve) == curve
    rates = ("lock_in_rate", "lock_in_rate_u", "lock_in_rate_low_95", "lock_in_rate_high_95")
    withheld: dict[str, Any] = {name: np.where(pieces, np.nan, getattr(each, name)) for name in rates}
    flags = np.where(pieces, each.flags | int(Flag.NOT_LOCK_IN_LIKE), each.flags)
    return replace(each, flags=flags, **withheld)


def _estimate_batch(
    waveforms: Sequence[Waveform], interval: float, method: Method, input_rates: Array | None
) -> LockInEstimate:
    volts = np.array([wave.volts for wave in waveforms])
    codes = np.array([wave.codes for wave in waveforms])
    highest = CLIPPED_CODE if codes.dtype == np.int8 else 256 * CLIPPED_CODE
    return estimate_lock_in(
        volts,
        interval,
        scale_factor=method.scale_factor,
        input_rate=method.input_rate if input_rates is None else input_rates,
        relation=method.relation,
        # a sample without data is nan, not clipped, though its code is the lowest of all
        clipped=(np.abs(codes.astype(np.int32)) >= highest) & np.isfinite(volts),
    )


def _joined(parts: list[LockInEstimate], order: NDArray[np.intp]) -> LockInEstimate:
    """Put estimates of several batches behind each other, in the order of the records."""
    joined: dict[str, Any] = {}
    for field in fields(LockInEstimate):
        values = [getattr(part, field.name) for part in parts]
        if np.ndim(values[0]):
            joined[field.name] = np.concatenate(values)[order]
    return replace(parts[0], **joined)


def _table_check(
    records: Sequence[SavedRecord],
    waveforms: tuple[Waveform, ...],
    combined: LockInEstimate,
    tilt: Tilt,
    settings: Settings,
    method: Method,
) -> TableCheck | None:
    table = np.array([float(record.conditions["table_rate_dps"]) for record in records])
    cosine = math.cos(math.radians(tilt.tilt_deg))
    azimuths = np.array([azimuth_of(record, settings).middle for record in records])
    # where nobody knows the azimuth, only the vertical part of the earth rate is left: that at east
    known = np.where(np.isfinite(azimuths), azimuths, 90.0)
    rates = table * cosine + earth_rate_on_axis(settings.site.latitude_deg, tilt.tilt_deg, known)
    _, by_table = _estimate(waveforms, method, rates)
    if not np.isfinite(by_table.lock_in_rate):
        return None
    # tilt and unknown azimuth are common to all records: their parts do not average out
    mean = float(np.mean(rates))
    tilt_part = math.tan(math.radians(tilt.tilt_deg)) * math.radians(tilt.tilt_u_deg)
    earth_part = 0.0
    if not np.isfinite(azimuths).all():
        earth_part = horizontal_earth_rate(settings, tilt.tilt_deg) / math.sqrt(2) / abs(mean)
    rate_u = float(by_table.lock_in_rate) * math.hypot(tilt_part, earth_part)
    return TableCheck(
        lock_in_rate=float(by_table.lock_in_rate),
        lock_in_rate_u=math.hypot(float(by_table.lock_in_rate_u), rate_u),
        input_rate=mean,
        beat_over_table=float(combined.input_rate) / abs(mean),
    )


def _has_tilt(run: SavedRun, settings: Settings) -> bool:
    """Whether the fast run is whole: all senses, and a table rate with every slow record."""
    senses = {record.conditions.get("table_rate_dps") for record in run.taken_for("tilt")}
    slow_known = all(record.conditions.get("table_rate_dps") is not None for record in run.taken_for("measure"))
    return slow_known and len(senses) == (2 if settings.table.both_senses else 1)


def _mean_truth(records: Sequence[SavedRecord]) -> dict[str, float] | None:
    truths = [record.conditions["truth"] for record in records if record.conditions.get("truth")]
    if not truths:
        return None
    return {name: fmean(truth[name] for truth in truths) for name in truths[0]}
