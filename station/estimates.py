"""From waveforms to estimates: records of one shape together, in batches that fit into memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis import Flag, LockInEstimate, combine_estimates, estimate_lock_in
from analysis.lockin_equation import Relation
from instrument import Preamble, Waveform
from instrument.errors import InstrumentError
from instrument.waveform import CLIPPED_CODE
from station.errors import RunError
from station.runs import SavedRecord, SavedRun

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
    """
    try:
        return Waveform(record.codes, Preamble.parse(record.preamble))
    except InstrumentError as error:
        raise RunError(f"{run.path}: record {record.number} cannot be read: {error}") from None


def estimate_records(
    waveforms: Sequence[Waveform], method: Method, input_rates: Array | None = None
) -> tuple[LockInEstimate, LockInEstimate]:
    """Estimate each record and combine them, those of one time base and length together.

    Parameters
    ----------
    waveforms : sequence of Waveform
    method : Method
    input_rates : ndarray, shape (n,), optional
        Rates on the gyro's axis in deg/s, signed, instead of the one of the method.

    Returns
    -------
    each : LockInEstimate
        Fields of shape (n,).
    combined : LockInEstimate
        Fields of shape ().
    """
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
