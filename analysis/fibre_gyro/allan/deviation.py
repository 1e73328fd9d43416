"""Overlapping Allan deviation of output words, for a picture: the fit does not read it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats
from analysis.fibre_gyro.allan.missing_words import with_words_put_in
from analysis.fibre_gyro.allan.terms import RANDOM
from analysis.fibre_gyro.rate_table.outliers import outliers

_POINTS = 60


@dataclass(frozen=True)
class AllanCurve:
    """Overlapping Allan deviation.

    Attributes
    ----------
    tau_s, deviation, deviation_u : ndarray, shape (m,)
        s, and the unit of the words; the uncertainty by the number of independent differences.
    """

    tau_s: Floats
    deviation: Floats
    deviation_u: Floats


def allan_curve(
    words: ArrayLike, interval_s: float, coefficients: Mapping[str, float] | None = None
) -> AllanCurve:
    """Overlapping Allan deviation at times spaced evenly in their logarithm, up to a quarter of the record.

    Parameters
    ----------
    words : (n,)
        nan where one is missing.
    coefficients : mapping of str to float, optional
        Of the noise model: by it missing words and outliers are put in. Without it nothing may be missing.
    """
    import allantools  # type: ignore[import-untyped]

    values = np.asarray(words, dtype=np.float64)
    if coefficients:
        values = _whole(values, interval_s, coefficients)
    most = max(1, values.size // 4)
    steps = np.unique(np.geomspace(1, most, _POINTS).round().astype(np.int64))
    tau, deviation, _, _ = allantools.oadev(
        values - values.mean(), rate=1 / interval_s, data_type="freq", taus=steps * interval_s
    )
    independent = np.maximum(values.size * interval_s / tau - 1, 1.0)
    return AllanCurve(
        np.asarray(tau, dtype=np.float64), np.asarray(deviation), np.asarray(deviation / np.sqrt(2 * independent))
    )


def _whole(values: Floats, interval_s: float, coefficients: Mapping[str, float]) -> Floats:
    """Words without gaps: short ones filled by the noise model, long ones by a straight line."""
    level = float(np.nanmean(values))
    seen = np.where(outliers(values), np.nan, values - level)
    if not np.isnan(seen).any():
        return values
    squares = {name: value**2 for name, value in coefficients.items() if name in RANDOM}
    filled = with_words_put_in(seen, squares, interval_s)
    there = np.flatnonzero(~np.isnan(filled))
    return np.asarray(level + np.interp(np.arange(values.size), there, filled[there]))
