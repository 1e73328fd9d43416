"""Overlapping Allan deviation of output words, for a picture: the fit does not read it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats

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


def allan_curve(words: ArrayLike, interval_s: float) -> AllanCurve:
    """Overlapping Allan deviation at times spaced evenly in their logarithm, up to a quarter of the record.

    Parameters
    ----------
    words : (n,)
        Without missing ones.
    """
    import allantools  # type: ignore[import-untyped]

    values = np.asarray(words, dtype=np.float64)
    most = max(1, values.size // 4)
    steps = np.unique(np.geomspace(1, most, _POINTS).round().astype(np.int64))
    tau, deviation, _, _ = allantools.oadev(
        values - values.mean(), rate=1 / interval_s, data_type="freq", taus=steps * interval_s
    )
    independent = np.maximum(values.size * interval_s / tau - 1, 1.0)
    return AllanCurve(
        np.asarray(tau, dtype=np.float64), np.asarray(deviation), np.asarray(deviation / np.sqrt(2 * independent))
    )
