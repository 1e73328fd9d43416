"""The 95 % interval of a size whose estimate is that of a complex number.

The size t of a complex estimate follows the Rice distribution: it is never negative, it is biased upwards, and
a symmetric error bar about it is wrong when it is comparable with its noise. The interval used here orders by
likelihood ratio (Feldman and Cousins, Phys. Rev. D 57, 3873 (1998)): it covers 95 % for every true size and
passes from an upper limit to the usual two-sided interval by itself.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy.special
from numpy.typing import ArrayLike

from analysis.arrays import Floats

TABLE_END = 9.0
"""Beyond this many standard uncertainties the Rice distribution is Gaussian to the accuracy of the table."""


def size_interval(size: ArrayLike) -> tuple[Floats, Floats]:
    """Lower and upper 95 % limit of a true size, given the observed one, both in standard uncertainties.

    Examples
    --------
    >>> low, high = size_interval([0.5, 20.0])
    >>> [round(float(v), 1) for v in (*low, *high)]
    [0.0, 18.0, 2.0, 21.9]
    """
    observed = np.asarray(size, dtype=np.float64)
    true, accepted_from, accepted_to = _acceptance()
    low = np.interp(observed, accepted_to, true)
    high = np.interp(observed, accepted_from, true)
    centre = observed - 0.5 / np.maximum(observed, 1.0)
    far = observed > TABLE_END - 2.5
    width = -float(scipy.special.ndtri(0.025))
    return np.where(far, centre - width, low), np.where(far, centre + width, high)


@cache
def _acceptance() -> tuple[Floats, Floats, Floats]:
    """For true sizes 0..TABLE_END: the range of observed sizes that is accepted with 95 %."""
    step = 0.005
    observed: Floats = np.arange(step / 2, TABLE_END + 5, step, dtype=np.float64)
    true: Floats = np.linspace(0.0, TABLE_END, 181)
    most_likely = np.sqrt(np.maximum(observed**2 - 1, 0))
    for _ in range(40):
        # Maximum-likelihood size of a Rice variable: its fixed point mu = t I1(t mu)/I0(t mu).
        argument = observed * most_likely
        most_likely = observed * scipy.special.i1e(argument) / scipy.special.i0e(argument)
    density = _rice(observed, true[:, np.newaxis])
    order = density / np.maximum(_rice(observed, most_likely), 1e-300)
    first, last = np.empty_like(true), np.empty_like(true)
    for row, (weights, ranks) in enumerate(zip(density, order, strict=True)):
        chosen = np.argsort(-ranks, kind="stable")
        total = np.cumsum(weights[chosen]) * step
        kept = chosen[: int(np.searchsorted(total, 0.95)) + 1]
        first[row], last[row] = observed[kept.min()] - step / 2, observed[kept.max()] + step / 2
    # Strictly rising, so that the inverse by interpolation is single-valued.
    rise = np.arange(true.size) * 1e-9
    return true, np.maximum.accumulate(first) + rise, np.maximum.accumulate(last) + rise


def _rice(observed: Floats, true: Floats) -> Floats:
    return np.asarray(
        observed * np.exp(-((observed - true) ** 2) / 2) * scipy.special.i0e(observed * true),
        dtype=np.float64,
    )
