"""Samples that must not be believed: clipped at the converter's end, or single spikes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.flags import Flag
from analysis.waveform.records import Records
from analysis.waveform.residuals import Residual

Floats = NDArray[np.float64]
Samples = NDArray[Any]
"""float32 or float64"""
Bools = NDArray[np.bool_]

SHARE_AT_END = 0.012
"""A level that holds less than this share of the samples is not worth calling a clipping limit: the wave would
pass it by less than a thousandth of its amplitude."""

THINNING = 5
"""Every fifth sample is enough to see whether a level may be crowded."""

CROWDING = 4.0
"""A smooth extremum of a quantised wave puts at most about 2.4 times as many samples into its last level as
into the one before, a clipped one many times more."""

NOTHING = 1e-8

SPIKE = 7.0
"""Residuals beyond this many (robust) standard deviations are no noise: once in 10^12 samples."""


@dataclass(frozen=True)
class Damage:
    """weights : (R, N) with clipped samples left out, or None if none is; limits : (R, 2) the range between the
    clipping limits, +-inf where not clipped; flags : (R,)."""

    weights: Samples | None
    limits: Floats | None
    flags: NDArray[np.int64]


def find_damage(records: Records, clipped: Bools | None) -> Damage:
    """Find clipped samples, from the caller's mask or from levels that are too crowded.

    Parameters
    ----------
    records : Records
    clipped : (R, N) of bool or None
        The caller's own knowledge; replaces the search where it is given.
    """
    values, weights = records.values, records.weights
    flags = np.zeros(len(values), dtype=np.int64)
    if clipped is None:
        high = _crowded_end(values, weights, records.highest, 1.0)
        low = -_crowded_end(values, weights, records.lowest, -1.0)
    else:
        known = clipped if weights is None else clipped & (weights > 0)
        low = np.where(known & (values < 0), values, -np.inf).max(axis=-1)
        high = np.where(known & (values >= 0), values, np.inf).min(axis=-1)
    if weights is not None:
        flags[(weights == 0).any(axis=-1)] |= Flag.DAMAGED
    hit = (np.isfinite(low) | np.isfinite(high)) & ~records.constant
    if not hit.any():
        return Damage(None, None, flags)
    flags[hit] |= Flag.CLIPPED
    kept = (values > low[:, np.newaxis]) & (values < high[:, np.newaxis])
    undamaged = kept.astype(values.dtype) if weights is None else kept * weights
    return Damage(undamaged, np.stack([low, high], axis=-1), flags)


def _crowded_end(values: Samples, weights: Samples | None, end: Samples, sign: float) -> Floats:
    """`sign` times the end level where it is a clipping limit, else inf; (R,)."""
    limit = np.full(len(values), np.inf)
    few = values[:, ::THINNING]
    at_end = few >= end[:, np.newaxis] if sign > 0 else few <= end[:, np.newaxis]
    crowds = at_end.view(np.uint8).sum(axis=-1, dtype=np.uint32)  # several times faster than counting booleans
    suspects = np.flatnonzero(crowds > SHARE_AT_END * few.shape[1])
    for thinning in (THINNING, 1):
        if suspects.size == 0:
            return limit
        some, top = sign * values[suspects, ::thinning], sign * end[suspects, np.newaxis]
        at_top = some >= top
        crowd = np.count_nonzero(at_top, axis=-1)
        at_top |= False if weights is None else weights[suspects, ::thinning] == 0
        below = np.where(at_top, -np.inf, some)
        second = below.max(axis=-1, keepdims=True)
        # Thinned counts are small numbers: only a clear crowd of the next level clears the suspicion.
        factor = CROWDING if thinning == 1 else CROWDING / 2
        crowded = crowd > factor * np.count_nonzero(below == second, axis=-1)
        crowded &= crowd > SHARE_AT_END * some.shape[1]
        suspects = suspects[crowded]
    limit[suspects] = sign * end[suspects]
    return limit


def outliers(left: Residual, weights: Samples | None, swing: Samples) -> Bools:
    """Residuals that are single spikes, (R, N). Many of them are a misfit, not spikes, and are kept.

    Parameters
    ----------
    left : Residual
    weights : (R, N) or None
    swing : (R,)
        Range of the record itself: what is next to nothing beside it is arithmetic.
    """
    spikes = np.zeros(left.samples.shape, dtype=bool)
    # A single spike cannot hide: it stands out of the rms that it itself has raised. Missing samples are 0.
    rms = np.sqrt(left.power / left.samples.shape[1])
    for row in np.flatnonzero(left.largest > 5 * rms):
        size = np.abs(left.samples[row])
        valid = size if weights is None else size[weights[row] > 0]
        found = size > SPIKE * 1.4826 * float(np.median(valid))
        if found.mean() <= 0.02:
            spikes[row] = found & (size > NOTHING * swing[row])
    return spikes
