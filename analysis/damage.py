"""Samples that must not be believed: clipped at the converter's end, or single spikes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.flags import Flag

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

SHARE_AT_END = 0.004
"""A level that holds less than this share of the samples is not worth calling a clipping limit."""

CROWDING = 4.0
"""A smooth extremum of a quantised wave puts at most about 2.4 times as many samples into its last level as
into the one before, a clipped one many times more."""

SPIKE = 7.0
"""Residuals beyond this many (robust) standard deviations are no noise: once in 10^12 samples."""


@dataclass(frozen=True)
class Damage:
    """weights : (R, N) with clipped samples left out, or None if none is; limits : (R, 2) the range between the
    clipping limits, +-inf where not clipped; flags : (R,)."""

    weights: Floats | None
    limits: Floats | None
    flags: NDArray[np.int64]


def find_damage(values: Floats, weights: Floats | None, clipped: Bools | None) -> Damage:
    """Find clipped samples, from the caller's mask or from levels that are too crowded.

    Parameters
    ----------
    values : (R, N)
    weights : (R, N) or None
        0 for a missing sample.
    clipped : (R, N) of bool or None
        The caller's own knowledge; replaces the search where it is given.
    """
    n_records = len(values)
    flags = np.zeros(n_records, dtype=np.int64)
    if clipped is None:
        low, high = _crowded_ends(values, weights)
    else:
        known = clipped if weights is None else clipped & (weights > 0)
        low = np.where(known & (values < 0), values, -np.inf).max(axis=-1)
        high = np.where(known & (values >= 0), values, np.inf).min(axis=-1)
    if weights is not None:
        flags[(weights == 0).any(axis=-1)] |= Flag.DAMAGED
    hit = np.isfinite(low) | np.isfinite(high)
    if not hit.any():
        return Damage(None, None, flags)
    flags[hit] |= Flag.CLIPPED
    kept = (values > low[:, np.newaxis]) & (values < high[:, np.newaxis])
    undamaged = kept.astype(np.float64) if weights is None else kept * weights
    return Damage(undamaged, np.stack([low, high], axis=-1), flags)


def _crowded_ends(values: Floats, weights: Floats | None) -> tuple[Floats, Floats]:
    """Lowest and highest level where they are clipping limits, else -inf and inf; (R,) each."""
    low, high = np.full(len(values), -np.inf), np.full(len(values), np.inf)
    top, bottom = values.max(axis=-1), values.min(axis=-1)
    enough = SHARE_AT_END * values.shape[1]
    at_top = (values == top[:, np.newaxis]).sum(axis=-1) > enough
    at_bottom = (values == bottom[:, np.newaxis]).sum(axis=-1) > enough
    for row in np.flatnonzero(at_top | at_bottom):
        valid = values[row] if weights is None else values[row][weights[row] > 0]
        levels, counts = np.unique(valid, return_counts=True)
        if levels.size < 4:
            continue
        if counts[-1] > max(enough, CROWDING * counts[-2]):
            high[row] = levels[-1]
        if counts[0] > max(enough, CROWDING * counts[1]):
            low[row] = levels[0]
    return low, high


def outliers(left: Floats, weights: Floats | None) -> Bools:
    """Residuals that are single spikes, (R, N). Many of them are a misfit, not spikes, and are kept."""
    size = np.abs(left) if weights is None else np.abs(left) * weights
    rms = np.sqrt(np.einsum("rn,rn->r", size, size) / size.shape[1])
    spikes = np.zeros(size.shape, dtype=bool)
    # A single spike cannot hide: it is at least 5 times the rms that it itself has raised.
    for row in np.flatnonzero(size.max(axis=-1) > 5 * rms):
        robust = 1.4826 * float(np.median(size[row])) + 1e-12
        found = size[row] > SPIKE * robust
        if found.mean() <= 0.02:
            spikes[row] = found
    return spikes
