"""Legendre polynomials over a record: slow motions of rate, amplitude and offset are sums of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre

from analysis.arrays import Floats

HIGHEST = 260
"""Degree: enough for a motion of eighty cycles in the record."""


@dataclass(frozen=True)
class Polynomials:
    """P_0 .. P_HIGHEST on the samples; time runs from -1 to 1 over the record.

    values, integrals : (HIGHEST + 1, N) P_j, and its integral over the samples
    means : (HIGHEST + 1, N - 1) mean of P_j between neighbouring samples
    """

    values: Floats
    integrals: Floats
    means: Floats


@lru_cache(maxsize=4)
def polynomials(n_samples: int) -> Polynomials:
    """All polynomials that are used."""
    time = (np.arange(n_samples) - (n_samples - 1) / 2) * (2 / n_samples)
    values = legendre.legvander(time, HIGHEST + 1).T.copy()
    # (2j + 1) P_j is the derivative of P_(j+1) - P_(j-1)
    integrals = np.empty((HIGHEST + 1, n_samples))
    integrals[0] = time
    integrals[1:] = (values[2:] - values[:-2]) / (2 * np.arange(1, HIGHEST + 1)[:, np.newaxis] + 1)
    integrals *= n_samples / 2
    return Polynomials(values[:-1], integrals, np.diff(integrals, axis=1))
