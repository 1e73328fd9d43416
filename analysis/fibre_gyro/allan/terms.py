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
    """Generalised covariance of the means of two blocks, for a coefficient of 1.

    Parameters
    ----------
    lags : ndarray
        Whole blocks between the begins of both.
    block_s : float
    """
    distance = np.abs(lags)
    if term == "quantization":
        return np.asarray(((distance == 0) * 2.0 - (distance == 1)) / block_s**2)

    def grown(t: Floats) -> Floats:
        """Function whose second derivative is twice the covariance of the rate."""
        size = np.abs(t)
        if term == "angle_random_walk":
            return np.asarray(size * block_s)
        if term == "bias_instability":
            return np.asarray(-(t**2) * np.log(np.maximum(size, 1e-300)) * block_s**2 / np.pi)
        return np.asarray(-(size**3) * block_s**3 / 6)

    return np.asarray(0.5 * (grown(distance + 1) - 2 * grown(distance) + grown(distance - 1)) / block_s**2)


def increment_spectrum(term: str, omega: Floats, interval_s: float) -> Floats:
    """Spectrum of the increments from word to word, for a coefficient of 1; its mean is their variance.

    Parameters
    ----------
    omega : ndarray
        rad per word, within 0 and pi.
    """
    square = 4 * np.sin(omega / 2) ** 2
    if term == "quantization":
        return np.asarray(square**2 / interval_s**2)
    if term == "angle_random_walk":
        return np.asarray(square / interval_s)
    if term == "rate_random_walk":
        return np.asarray(interval_s * (2 + np.cos(omega)) / 3)
    turns = omega[..., np.newaxis] + 2 * np.pi * np.arange(-_ALIASES, _ALIASES + 1)
    return np.asarray(square * np.sum(square[..., np.newaxis] / np.abs(turns) ** 3, axis=-1))
