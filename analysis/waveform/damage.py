"""Samples that must not be believed: clipped at the converter's end, or single spikes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.flags import Flag
from analysis.waveform.geometric_series import Series
from analysis.waveform.records import THINNING, Counts, Records
from analysis.waveform.residuals import Residual, residual_samples

Floats = NDArray[np.float64]
Samples = NDArray[Any]
"""float32 or float64"""
Bools = NDArray[np.bool_]

SHARE_AT_END = 0.012
"""A level that holds less than this share of the samples is not worth calling a clipping limit: the wave would
pass it by less than a thousandth of its amplitude."""

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
        high = _crowded_end(records, records.highest, records.at_highest, 1.0)
        low = -_crowded_end(records, records.lowest, records.at_lowest, -1.0)
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


def _crowded_end(records: Records, end: Samples, at_end: Counts, sign: float) -> Floats:
    """`sign` times the end level where it is a clipping limit, else inf; (R,)."""
    values, weights = records.values, records.weights
    limit = np.full(len(values), np.inf)
    suspects = np.flatnonzero(at_end > SHARE_AT_END * (values.shape[1] / THINNING))
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


def outliers(
    values: Samples, weights: Samples | None, series: Series, residual: Residual, swing: Samples
) -> dict[int, Bools]:
    """Samples (N,) that are single spikes, by record. Many of them are a misfit, not spikes, and are kept.

    Parameters
    ----------
    values : (R, N); weights : (R, N) or None
    series, residual : Series, Residual
        Fitted to them, and what that leaves.
    swing : (R,)
        Range of the record itself: what is next to nothing beside it is arithmetic.
    """
    spikes = {}
    # A single spike cannot hide: it stands out of the rms that it itself has raised. Missing samples are 0.
    rms = np.sqrt(residual.power / values.shape[1])
    for row in map(int, np.flatnonzero(residual.largest > 5 * rms)):
        size = np.abs(residual_samples(values, weights, series, row))
        valid = size if weights is None else size[weights[row] > 0]
        found = size > SPIKE * 1.4826 * float(np.median(valid))
        found &= size > NOTHING * swing[row]
        if found.any() and found.mean() <= 0.02:
            spikes[row] = found
    return spikes
