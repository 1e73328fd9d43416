"""How much of a power is no noise, where the variance of the noise was measured too and is uncertain itself.

The interval of Feldman and Cousins: a size of the signal belongs to it if the power that was seen is among the
95 % that are likeliest under it, likeliest against the size that suits each power best. It holds as often as it
says whatever the signal is, and is never empty: a power that chance made less than the noise has on the average
would leave nothing of an interval with equal tails. (G. J. Feldman, R. D. Cousins, "Unified approach to the
classical statistical analysis of small signals", Phys. Rev. D 57, 3873, 1998.)
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import scipy.optimize
import scipy.special

from analysis.arrays import Floats

_LEVELS = (np.arange(40) + 0.5) / 40
_CLEAR = 1e-4  # chance of noise alone to have so much power, below which equal tails are as good
_MOST_POWERS = 400.0  # with more degrees of freedom noise has no tail to speak of
_FEWEST = 4.0  # degrees of freedom of the measured variance
_NONE = 1e-9  # of the power of the noise
_FAR = 200.0  # argument of the Bessel function
_SIGNALS, _POWERS, _VARIANCES = 48, 180, 8


def signal_interval(power: float, own: float, freedom: float) -> tuple[float, float]:
    """95 % interval of the power of a signal.

    Power over the variance of the noise is chi-square with the signal's power over the same variance as
    noncentrality; the variance is the one that was measured times `freedom` over chi-square.

    Examples
    --------
    >>> [round(end) for end in signal_interval(4.0, 10.0, 1e6)]
    [0, 5]
    >>> [round(end) for end in signal_interval(1000.0, 10.0, 1e6)]
    [871, 1119]
    """
    variance = _variances(freedom, _LEVELS)
    noise_alone = float(np.mean(scipy.special.chdtrc(own, power / variance)))
    if noise_alone < _CLEAR or own > _MOST_POWERS or freedom < _FEWEST:
        return _with_probability(power, own, variance, 0.975), _with_probability(power, own, variance, 0.025)
    plane = _plane(own, freedom)
    seen = _log_density(np.array([max(power, _NONE * own)]), plane.signal, own, plane.variances)
    favour = seen - seen.max()
    # of the powers that a signal favours more than the one that was seen
    before = np.sum(plane.share * (plane.favour > favour), axis=1)
    best = int(np.argmax(favour))
    falling, rising = (np.maximum.accumulate(one) for one in (before[best::-1], before[best:]))
    low = float(np.interp(0.95, falling, plane.signal[best::-1])) if falling[-1] > 0.95 else 0.0
    return low, float(np.interp(0.95, rising, plane.signal[best:]))


@dataclass(frozen=True)
class _Plane:
    """Signals against powers, for all powers that noise alone may have."""

    signal: Floats  # (s,)
    # (s, p): Logarithm of the density of a power over that under the signal that suits it best; probability
    favour: Floats
    share: Floats
    variances: Floats  # (v,)


@functools.lru_cache(maxsize=16)
def _plane(own: float, freedom: float) -> _Plane:
    every, variances = (_variances(freedom, (np.arange(n) + 0.5) / n) for n in (_LEVELS.size, _VARIANCES))
    most = 2.0 * own
    while float(np.mean(scipy.special.chdtrc(own, most / every))) > _CLEAR:
        most *= 1.2
    top = 2.0 * _with_probability(most, own, every, 0.005)
    signal = top * np.linspace(0.0, 1.0, _SIGNALS) ** 2
    most = 1.5 * (own + top) + 10.0 * float(np.sqrt(own + 2 * top))
    edges = most * np.linspace(0.0, 1.0, _POWERS + 1) ** 2
    chance = _log_density((edges[:-1] + edges[1:]) / 2, signal, own, variances)
    return _Plane(signal, chance - chance.max(axis=0), np.exp(chance) * np.diff(edges), variances)


def _variances(freedom: float, levels: Floats) -> Floats:
    """True variances of the noise over the measured one that are equally likely."""
    return np.asarray(freedom / scipy.special.chdtri(freedom, levels), dtype=np.float64)


def _log_density(power: Floats, signal: Floats, own: float, variances: Floats) -> Floats:
    """Logarithm of the density of each power under each signal, shape (signals, powers)."""
    total = np.full((signal.size, power.size), -np.inf)
    for variance in variances:
        x, size = power / variance, signal[:, np.newaxis] / variance
        alone = (own / 2 - 1) * np.log(x / 2) - x / 2 - scipy.special.gammaln(own / 2) - np.log(2 * variance)
        total = np.logaddexp(total, alone - size / 2 + _log_hyp0f1(own / 2, np.sqrt(size * x)))
    return np.asarray(total - np.log(variances.size), dtype=np.float64)


def _log_hyp0f1(b: float, z: Floats) -> Floats:
    """Logarithm of 0F1(b; z^2/4), which is a Bessel function where it would overflow."""
    found = np.log(scipy.special.hyp0f1(b, np.minimum(z, _FAR) ** 2 / 4))
    far = z > _FAR
    bessel = np.log(scipy.special.ive(b - 1, z[far])) + z[far]
    found[far] = scipy.special.gammaln(b) + (1 - b) * np.log(z[far] / 2) + bessel
    return np.asarray(found, dtype=np.float64)


def _with_probability(power: float, own: float, variance: Floats, probability: float) -> float:
    """Signal power with which so much power or less has this probability; 0 if there is none."""

    def chance(size: float) -> float:
        return float(np.mean(scipy.special.chndtr(power / variance, own, size / variance)))

    if chance(0.0) < probability:
        return 0.0
    high = 4.0 * power + 100.0
    while chance(high) > probability:
        high *= 2.0
    found = scipy.optimize.brentq(lambda size: chance(size) - probability, 0.0, high, xtol=1e-4 * (1 + power))
    return float(found)
