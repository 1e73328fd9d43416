"""Beats against the rates given: by how much each misses its rate, and what all of them have in common."""

from __future__ import annotations

import numpy as np

from analysis.arrays import Floats
from analysis.several_rates.ratio_records import FASTER_THAN_POSSIBLE, RatioRecords, in_blocks

MISMATCH = 0.005
"""A rate that misses the one of the beat by more is worth a flag: it goes 1:1 into the lock-in rate."""

_FAST = 0.5


def rate_mismatch(records: RatioRecords, lock_in_rate: float) -> Floats:
    """f/(K sqrt(W^2 - WL^2)) - 1 of every record, (n,); nan where it is not known."""
    mismatch = np.full(records.rate.shape, np.nan)
    for some, block in records.blocks():
        rate = np.abs(block.rate)
        square = (rate - lock_in_rate) * (rate + lock_in_rate)
        known = records.usable[some] & (square > 0)
        expected = records.scale_factor * np.sqrt(square[known])
        mismatch[some][known] = block.beat_frequency[known] / expected - 1
    return mismatch


def rates_differ(rate: Floats, size: float, u: float, mismatch: Floats, common: float = 0.0) -> bool:
    """Whether a rate of some (n,) does not fit its beat, beyond what a lock-in rate `size` with `u` explains.

    Parameters
    ----------
    common : float
        What all beats have in common against their rates, beside which the others count.
    """
    for some in in_blocks(rate.size):
        beside = (1 + mismatch[some]) / (1 + common) - 1
        if np.any(np.abs(beside) > MISMATCH + 3 * _stretch(np.abs(rate[some]), size, u)):
            return True
    return False


def mismatch_of_all(rate: Floats, size: float, u: float, mismatch: Floats) -> float:
    """What all beats have in common against their rates (n,), by the fast ones; 0 where that may be chance.

    Less than what `rates_differ` asks of a single record is enough. nan where no mismatch is known.
    """
    fastest = 0.0
    for some in in_blocks(rate.size):
        known = np.isfinite(mismatch[some])
        fastest = max(fastest, float(np.max(np.abs(rate[some]), where=known, initial=0.0)))
    if fastest == 0:
        return float("nan")
    seen, explained = [], []
    for some in in_blocks(rate.size):
        speed = np.abs(rate[some])
        fast = np.isfinite(mismatch[some]) & (speed >= _FAST * fastest)
        seen.append(mismatch[some][fast])
        explained.append(_stretch(speed[fast], size, u))
    found, stretch = (float(np.median(np.concatenate(each), overwrite_input=True)) for each in (seen, explained))
    return found if abs(found) > FASTER_THAN_POSSIBLE + 3 * stretch else 0.0


def _stretch(rate: Floats, size: float, u: float) -> Floats:
    """Relative uncertainty of the beats at rates (n,) that a lock-in rate `size` with `u` leaves."""
    with np.errstate(over="ignore"):
        return np.asarray(size**2 / np.maximum(rate**2 - size**2, 1e-300) * (u / size if size else 0.0))
