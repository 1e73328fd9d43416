"""Terms of the noise model of IEEE Std 952, in deg and s, and what each is in three views.

    quantization Q          deg               white noise of the angle at the ends of the words
    angle random walk N     deg/sqrt(s)       white noise of the rate
    bias instability B      deg/s             flicker of the rate, spectrum B^2/(2 pi f)
    rate random walk K      deg/s/sqrt(s)     integrated white noise
    rate ramp R             deg/s/s           a constant drift: no noise, but in the Allan deviation as one

Views, for words that are means over an interval: Allan variance; generalised covariance of the means of blocks
(what only increments of the means depend on, since bias instability and rate random walk have no variance);
spectrum of the increments of words.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats

TERMS = ("quantization", "angle_random_walk", "bias_instability", "rate_random_walk", "rate_ramp")
RANDOM = TERMS[:4]
_ALIASES = 12


def allan_variance(coefficients: Mapping[str, float], tau_s: ArrayLike) -> Floats:
    """Allan variance, (deg/s)^2, of the terms together, by their coefficients in deg and s.

    Examples
    --------
    >>> float(allan_variance({"angle_random_walk": 2.0}, 4.0))
    1.0
    """
    tau = np.asarray(tau_s, dtype=np.float64)
    shapes = {
        "quantization": 3 / tau**2,
        "angle_random_walk": 1 / tau,
        "bias_instability": np.full(tau.shape, 2 * np.log(2) / np.pi),
        "rate_random_walk": tau / 3,
        "rate_ramp": tau**2 / 2,
    }
    return np.asarray(sum(value**2 * shapes[name] for name, value in coefficients.items()), dtype=np.float64)


def block_covariance(term: str, lags: Floats, block_s: float) -> Floats:
    """Generalised covariance of the means of two blocks, for a coefficient of 1."""
    distance = np.abs(lags)
    if term == "quantization":
        return np.asarray(((distance == 0) * 2.0 - (distance == 1)) / block_s**2)
    outer = _grown(term, (distance + 1) * block_s) + _grown(term, (distance - 1) * block_s)
    return np.asarray(0.5 * (outer - 2 * _grown(term, distance * block_s)) / block_s**2)


def window_covariance(coefficients: Mapping[str, float], begin_s: ArrayLike, end_s: ArrayLike) -> Floats:
    """Generalised covariance of the means over windows anywhere in time, (deg/s)^2.

    It gives the variance of whatever combines the means with factors that add up to zero.

    Parameters
    ----------
    coefficients : mapping
        Of the terms, in deg and s; a ramp is no noise and not counted.
    begin_s, end_s : (n,)

    Returns
    -------
    ndarray, shape (n, n)

    Examples
    --------
    White noise has the variance N^2/T, a random walk of the rate K^2 T between the means of neighbours, about.

    >>> window_covariance({"angle_random_walk": 2.0}, [0.0], [8.0]).tolist()
    [[0.5]]
    >>> walk = window_covariance({"rate_random_walk": 1.0}, [0.0, 10.0], [1.0, 11.0])
    >>> round(float(walk[0, 0] + walk[1, 1] - 2 * walk[0, 1]), 3)
    9.667
    """
    begin, end = np.asarray(begin_s, dtype=np.float64), np.asarray(end_s, dtype=np.float64)
    products = np.outer(end - begin, end - begin)
    first, last, total = begin[:, np.newaxis], end[:, np.newaxis], np.zeros(products.shape)
    for term, value in coefficients.items():
        if term == "quantization":
            met = (begin == first).astype(np.float64) + (end == last) - (begin == last) - (end == first)
        elif term in RANDOM:
            apart = _grown(term, end - first) + _grown(term, begin - last)
            met = 0.5 * (apart - _grown(term, begin - first) - _grown(term, end - last))
        else:
            continue
        total += value**2 * met / products
    return np.asarray(total, dtype=np.float64)


def _grown(term: str, time_s: Floats) -> Floats:
    """Function of the time whose second derivative is twice the covariance of the rate, for a coefficient of 1."""
    size = np.abs(time_s)
    if term == "angle_random_walk":
        return size
    if term == "bias_instability":
        return np.asarray(-(size**2) * np.log(np.maximum(size, 1e-300)) / np.pi)
    return np.asarray(-(size**3) / 6)


def increment_spectrum(term: str, omega: Floats, interval_s: float) -> Floats:
    """Spectrum of the increments from word to word, for a coefficient of 1; its mean is their variance."""
    square = 4 * np.sin(omega / 2) ** 2
    if term == "quantization":
        return np.asarray(square**2 / interval_s**2)
    if term == "angle_random_walk":
        return np.asarray(square / interval_s)
    if term == "rate_random_walk":
        return np.asarray(interval_s * (2 + np.cos(omega)) / 3)
    turns = omega[..., np.newaxis] + 2 * np.pi * np.arange(-_ALIASES, _ALIASES + 1)
    return np.asarray(square * np.sum(square[..., np.newaxis] / np.abs(turns) ** 3, axis=-1))
