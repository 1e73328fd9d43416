"""Terms of the noise model of IEEE Std 952, in deg and s, and what each is in three views.

    quantization Q          deg               white noise of the angle at the ends of the words
    angle random walk N     deg/sqrt(s)       white noise of the rate
    bias instability B      deg/s             flicker of the rate, spectrum B^2/(2 pi f)
    rate random walk K      deg/s/sqrt(s)     integrated white noise
    rate ramp R             deg/s/s           a constant drift: no noise, but in the Allan deviation as one
    correlated noise        deg/s             Markov noise, its standard deviation; correlation exp(-t/T)

Views, for words that are means over an interval: Allan variance; generalised covariance of the means of blocks
(what only increments of the means depend on, since bias instability and rate random walk have no variance);
spectrum of the increments of words. Of correlated noise the name of a term holds its time: "correlated_noise 3.4".
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats

TERMS = ("quantization", "angle_random_walk", "bias_instability", "rate_random_walk", "rate_ramp")
RANDOM = TERMS[:4]
CORRELATED = "correlated_noise"
CORRELATION_TIME = "correlation_time"  # s; stands beside the coefficient of that term
_ALIASES = 12
_PERIODOGRAM_POINTS = 60


def term_of(name: str) -> str:
    """Return the term without its correlation time."""
    return name.split(" ")[0]


def correlated(time_s: float) -> str:
    """Return the name of correlated noise of such a time."""
    return f"{CORRELATED} {time_s:.9g}"


def random_terms(coefficients: Mapping[str, float]) -> Iterator[tuple[str, float]]:
    """Names and coefficients of the terms that are noise."""
    for term, value in coefficients.items():
        if term in RANDOM:
            yield term, value
        elif term == CORRELATED:
            yield correlated(coefficients[CORRELATION_TIME]), value


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
    if CORRELATED in coefficients:
        name = correlated(coefficients[CORRELATION_TIME])
        shapes[CORRELATED] = (4 * _grown(name, tau) - _grown(name, 2 * tau)) / (2 * tau**2)
    total = sum(value**2 * shapes[name] for name, value in coefficients.items() if name in shapes)
    return np.asarray(total, dtype=np.float64)


def sinusoid_variance(frequency_hz: float, amplitude: float, tau_s: ArrayLike) -> Floats:
    """Allan variance of a sinusoid (IEEE Std 952, C.2.7)."""
    phase = np.pi * frequency_hz * np.asarray(tau_s, dtype=np.float64)
    return np.asarray((amplitude * np.sin(phase) ** 2 / phase) ** 2)


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
    for term, value in random_terms(coefficients):
        if term == "quantization":
            met = (begin == first).astype(np.float64) + (end == last) - (begin == last) - (end == first)
        else:
            apart = _grown(term, end - first) + _grown(term, begin - last)
            met = 0.5 * (apart - _grown(term, begin - first) - _grown(term, end - last))
        total += value**2 * met / products
    return np.asarray(total, dtype=np.float64)


def _grown(term: str, time_s: Floats) -> Floats:
    """Function of the time whose second derivative is twice the covariance of the rate, for a coefficient of 1."""
    size = np.abs(time_s)
    if term == "angle_random_walk":
        return size
    if term == "bias_instability":
        return np.asarray(-(size**2) * np.log(np.maximum(size, 1e-300)) / np.pi)
    if term_of(term) == CORRELATED:
        time = float(term.split(" ")[1])
        return np.asarray(2 * time**2 * (np.expm1(-size / time) + size / time))
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
    if term_of(term) == CORRELATED:
        # means of words: their covariance is a power of `keep`, but for that of a word with itself
        time = float(term.split(" ")[1])
        keep = float(np.exp(-interval_s / time))
        first = (time / interval_s * np.expm1(-interval_s / time)) ** 2
        own = 2 * (time / interval_s) ** 2 * (np.expm1(-interval_s / time) + interval_s / time)
        tail = 2 * first * (np.cos(omega) - keep) / (1 - 2 * keep * np.cos(omega) + keep**2)
        return np.asarray(square * (own + tail))
    turns = omega[..., np.newaxis] + 2 * np.pi * np.arange(-_ALIASES, _ALIASES + 1)
    return np.asarray(square * np.sum(square[..., np.newaxis] / np.abs(turns) ** 3, axis=-1))


def low_passed(omega: Floats, corner: float) -> Floats:
    """Power that a first-order low-pass leaves, both in rad a word."""
    return np.asarray(1 / (1 + (omega / corner) ** 2))


def noise_spectrum(
    coefficients: Mapping[str, float], frequency_hz: ArrayLike, interval_s: float, filter_hz: float = np.inf
) -> Floats:
    """One-sided spectrum of output words behind a low-pass of such a corner, (deg/s)^2/Hz."""
    omega = 2 * np.pi * np.asarray(frequency_hz, dtype=np.float64) * interval_s
    terms = random_terms(coefficients)
    total = sum((value**2 * increment_spectrum(name, omega, interval_s) for name, value in terms), 0 * omega)
    passed = low_passed(omega, 2 * np.pi * filter_hz * interval_s)
    return np.asarray(2 * interval_s * passed * total / (4 * np.sin(omega / 2) ** 2))


def averaged_periodogram(words: ArrayLike, interval_s: float) -> tuple[Floats, Floats, Floats]:
    """Frequencies (Hz), one-sided spectrum of the words (their unit squared per Hz) and its u, for a picture.

    Stretches of a 32nd of the record, half of each the next one's too, under a Hann window; then means over bands
    that are even in the logarithm. Missing words stand on straight lines.
    """
    import scipy.signal

    values = np.asarray(words, dtype=np.float64)
    there = np.flatnonzero(np.isfinite(values))
    values = np.interp(np.arange(values.size), there, values[there])
    frequency, power = scipy.signal.welch(values, 1 / interval_s, nperseg=max(256, values.size // 32))
    into = np.unique(np.geomspace(1, frequency.size, _PERIODOGRAM_POINTS).astype(int))
    found = [
        (frequency[first:last].mean(), power[first:last].mean(), last - first)
        for first, last in itertools.pairwise(into)
    ]
    at, level, lines = (np.array(one) for one in zip(*found, strict=True))
    # the window makes two lines of three, and stretches that overlap by a half count for one and a half
    return at, level, level / np.sqrt(np.maximum(lines / 1.5, 1.0) * 32 * 2 / 1.9)
