"""How much of a power is no noise, where the variance of the noise was measured too and is uncertain itself."""

from __future__ import annotations

import numpy as np
import scipy.optimize
import scipy.special

_LEVELS = (np.arange(40) + 0.5) / 40


def noncentrality(power: float, own: float, freedom: float, probability: float) -> float:
    """Signal power with which so much power or less has this probability; 0 if there is none.

    Power over the variance of the noise is chi-square with the signal's power over the same variance as
    noncentrality; the variance is the one that was measured times `freedom` over chi-square.

    Parameters
    ----------
    power : float
        Sum of squares over the measured variance of the noise; so is the result.
    own : float
        Degrees of freedom of the power: how many squares.
    freedom : float
        Of the measured variance: the fewer, the more power may be noise.

    Examples
    --------
    >>> noncentrality(10.0, 10.0, 1e6, 0.975), round(noncentrality(100.0, 10.0, 1e6, 0.5), 1)
    (0.0, 91.0)
    """
    variance = freedom / scipy.special.chdtri(freedom, _LEVELS)

    def chance(size: float) -> float:
        return float(np.mean(scipy.special.chndtr(power / variance, own, size / variance)))

    if chance(0.0) < probability:
        return 0.0
    high = 4.0 * power + 100.0
    while chance(high) > probability:
        high *= 2.0
    found = scipy.optimize.brentq(lambda size: chance(size) - probability, 0.0, high, xtol=1e-4 * (1 + power))
    return float(found)
