"""From waveforms to estimates: records of one shape together, in batches that fit into memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis import Flag, LockInEstimate, estimate_lock_in
from analysis.changed_ratio import with_ratio
from analysis.lockin_equation import Relation
from instrument import Preamble, Waveform
from instrument.errors import InstrumentError
from station.errors import NoUsableSignal, RunError
from station.runs.store import SavedRecord, SavedRun

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


def saved_waveform(record: SavedRecord, run: SavedRun) -> Waveform:
    """Return a saved record as the waveform that the scope sent.

    Raises
    ------
    RunError
        If codes and preamble do not belong together.
    NoUsableSignal
        If it is no record over time.
    """
    try:
        waveform = Waveform(record.codes, Preamble.parse(record.preamble))
    except InstrumentError as error:
        raise RunError(f"{run.path}: record {record.number} cannot be read: {error}") from None
    check_over_time(waveform, f"{run.path}: record {record.number}")
    return waveform


def check_over_time(waveform: Waveform, name: str) -> None:
    """Refuse what only looks like a record.

    Raises
    ------
    NoUsableSignal
        A spectrum, or pairs of minima and maxima.
    """
    unit = waveform.preamble.xunit
    if unit.lower() != "s":
        raise NoUsableSignal(f"{name}: is a spectrum ({unit}), not a record over time: save the channel itself")
    if waveform.preamble.pt_fmt == "ENV" or "pk detect" in waveform.preamble.wfid.lower():
        raise NoUsableSignal(
            f"{name}: was taken with Peak Detect: it holds minima and maxima, not samples; use SAMPLE mode"
        )


def estimate_records(waveforms: Sequence[Waveform], method: Method) -> LockInEstimate:
    """Estimate each record, those of one time base and length together.

    Parameters
    ----------
    waveforms : sequence of Waveform
    method : Method

    Returns
    -------
    LockInEstimate
        Fields of shape (n,).
    """
    parts, order = [], []
    for indices in batches(waveforms):
        parts.append(_estimate_batch([waveforms[index] for index in indices], method))
        order += indices
    return only_beats(joined(parts, np.argsort(order)))


def at_known_rates(each: LockInEstimate, rates: Array) -> LockInEstimate:
    """Take the rates of the table as reference instead of the beat.

    Parameters
    ----------
    each : LockInEstimate
        Fields of shape (n,).
    rates : ndarray, shape (n,)
        On the gyro's axis, deg/s, signed.

    Returns
    -------
    LockInEstimate
        The same ratios, with the lock-in rates that follow from these rates.
    """
    given = replace(each, input_rate=rates, rate_given=True)
    return with_ratio(given, each.complex_ratio, each.complex_ratio_covariance)


def batches(waveforms: Sequence[Waveform]) -> list[list[int]]:
    """Sort waveforms into batches of one time base and length, small enough for the memory."""
    groups: dict[tuple[float, int], list[int]] = {}
    for index, wave in enumerate(waveforms):
        groups.setdefault((wave.sample_interval, wave.codes.size), []).append(index)
    return [rows[first : first + _BATCH] for rows in groups.values() for first in range(0, len(rows), _BATCH)]


def only_beats(each: LockInEstimate) -> LockInEstimate:
    """Withhold what rests on a piece of some curve: fewer than 3 periods that do not fit either."""
    curve = int(Flag.FEW_PERIODS | Flag.MISFIT)
    pieces = (each.flags & curve) == curve
    rates = ("lock_in_rate", "lock_in_rate_u", "lock_in_rate_low_95", "lock_in_rate_high_95")
    withheld: dict[str, Any] = {name: np.where(pieces, np.nan, getattr(each, name)) for name in rates}
    flags = np.where(pieces, each.flags | int(Flag.NOT_LOCK_IN_LIKE), each.flags)
    return replace(each, flags=flags, **withheld)


def clipped_samples(waveforms: Sequence[Waveform]) -> NDArray[np.bool_]:
    """Samples that stand at the end of the converter's range, shape (n_records, n_samples)."""
    return np.array([wave.clipped_samples for wave in waveforms])


def _estimate_batch(waveforms: Sequence[Waveform], method: Method) -> LockInEstimate:
    return estimate_lock_in(
        np.array([wave.volts for wave in waveforms]),
        waveforms[0].sample_interval,
        scale_factor=method.scale_factor,
        input_rate=method.input_rate,
        relation=method.relation,
        clipped=clipped_samples(waveforms),
        nan_policy="omit",
    )


def joined(parts: list[LockInEstimate], order: NDArray[np.intp]) -> LockInEstimate:
    """Put estimates of several batches behind each other, in the order of the records."""
    values: dict[str, Any] = {}
    for field in fields(LockInEstimate):
        each = [getattr(part, field.name) for part in parts]
        if np.ndim(each[0]):
            values[field.name] = np.concatenate(each)[order]
    return replace(parts[0], **values)
