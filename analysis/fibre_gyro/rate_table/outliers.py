"""Output words that no gyro sent: single words far beyond the noise around them.

Few and far is what makes an outlier. Words far out that come often belong to the gyro: with a 2 pi error and all
samples used, each fall of the staircase leaves a pulse in its word, and their mean is part of the output.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Bools, Floats

_BLOCK = 64  # words whose median is the level around a word: drift and the earth rate's sine count in it
_FAR = 8.0  # standard deviations
_STEPS = 10.0  # of a word that hardly moves, in its smallest steps
_FEW = 0.002  # of all words, or three


def outliers(words: ArrayLike) -> Bools:
    """Tell which words are outliers; nan is none.

    Examples
    --------
    >>> outliers([5.0, 5.1, 4.9, 5.0, 1e6, 5.1, 4.9, 5.0]).tolist().index(True)
    4
    """
    values = np.asarray(words, dtype=np.float64)
    none = np.zeros(values.size, dtype=np.bool_)
    if values.size < 8:
        return none
    left = np.abs(values - _level(values))
    known = left[np.isfinite(left)]
    spread = 1.4826 * float(np.median(known)) if known.size else 0.0
    if known.size == 0 or (spread > 0 and float(known.max()) <= _FAR * spread):
        return none
    far = left > max(_FAR * spread, _FAR / 3.3 * float(np.quantile(known, 0.9)), _STEPS * _step(values))
    return far if 0 < far.sum() <= max(3.0, _FEW * values.size) else none


def _level(values: Floats) -> Floats:
    """Level around each word: the medians of blocks, joined by straight lines."""
    count = max(1, values.size // _BLOCK)
    edges = np.linspace(0, values.size, count + 1).round().astype(np.intp)
    width = int(np.diff(edges).min())
    blocks = np.stack([values[begin : begin + width] for begin in edges[:-1]])
    gone = np.isnan(blocks)
    medians = np.full(count, np.nan)
    whole = ~gone.any(axis=1)
    if whole.any():
        medians[whole] = np.median(blocks[whole], axis=1)
    for place in np.flatnonzero(~whole & ~gone.all(axis=1)):
        medians[place] = np.nanmedian(blocks[place])
    there = np.isfinite(medians)
    if not there.any():
        return np.zeros(values.size)
    centres = edges[:-1] + (width - 1) / 2
    return np.asarray(np.interp(np.arange(values.size), centres[there], medians[there]), dtype=np.float64)


def _step(values: Floats) -> float:
    """Smallest difference between two different words."""
    steps = np.diff(np.unique(values[np.isfinite(values)]))
    return float(steps.min()) if steps.size else 0.0
