"""Words that are missing, put in as the noise model says of them, given all that are there.

A straight line over a gap takes power out of the fast noise and tears apart what quantization keeps together: the
sum of its words is the difference of two angles. A draw from the conditional distribution keeps both: under the
model the whole series then has the distribution that it would have had. The model is found from the series with
its gaps put in, so both are found in turn; each time some of the error of the model is left.

The words are drawn all at once: a series of the model with no gaps, plus what is expected of the missing words if
it differs from the true one by what is seen where words are. That expectation makes the energy of the series, each
frequency weighted by the inverse of its spectrum, the least (conjugate gradients, products by Fourier transforms).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.fft
from scipy.sparse.linalg import LinearOperator, cg

from analysis.arrays import Bools, Floats
from analysis.fibre_gyro.allan.terms import increment_spectrum

_LONGEST = 64  # words in a row that are put in
_MARGIN = 256  # words behind the last one that nobody has seen: the transform joins both ends
_POINTS = 4096  # of the spectrum, joined by lines in its logarithm
_TOLERANCE = 1e-3
_MOST_STEPS = 60


def fillable(values: Floats) -> Bools:
    """Tell which words are missing in so short a gap that they are put in."""
    gone = np.isnan(values)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], gone, [False]]).astype(np.int8)))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if end - begin > _LONGEST:
            gone[begin:end] = False
    return gone


def on_lines(values: Floats) -> Floats:
    """Put missing words on straight lines, to begin with; nan stays where a gap is too long."""
    put_in, there = fillable(values), ~np.isnan(values)
    filled = values.copy()
    filled[put_in] = np.interp(np.flatnonzero(put_in), np.flatnonzero(there), values[there])
    return filled


def with_words_put_in(values: Floats, squares: Mapping[str, float], interval_s: float) -> Floats:
    """Draw missing words, with the same random numbers each time."""
    size = int(scipy.fft.next_fast_len(values.size + _MARGIN, real=True))
    known = np.zeros(size)
    gone = np.ones(size, dtype=np.bool_)
    gone[: values.size] = np.isnan(values)
    known[~gone] = values[~np.isnan(values)]
    spectrum = _spectrum_of_words(squares, size, interval_s)
    weight = np.concatenate([[0.0], float(np.median(spectrum)) / spectrum])  # the level may be anything
    white = scipy.fft.rfft(np.random.default_rng(0).normal(size=size))
    drawn = scipy.fft.irfft(white * np.concatenate([[0.0], np.sqrt(spectrum)]), size)

    def weighted(series: Floats) -> Floats:
        return np.asarray(scipy.fft.irfft(weight * scipy.fft.rfft(series), size)[gone])

    def of_the_missing(words: Floats) -> Floats:
        series = np.zeros(size)
        series[gone] = words
        return weighted(series)

    count = int(gone.sum())
    operator = LinearOperator((count, count), matvec=of_the_missing, dtype=np.float64)
    expected, _ = cg(operator, -weighted(np.where(gone, 0.0, known - drawn)), rtol=_TOLERANCE, maxiter=_MOST_STEPS)
    known[gone] = drawn[gone] + expected
    return np.where(np.isnan(values) & ~fillable(values), np.nan, known[: values.size])


def _spectrum_of_words(squares: Mapping[str, float], size: int, interval_s: float) -> Floats:
    """Spectrum of the words at the frequencies of a transform, without 0; its mean is their variance."""
    omega = 2 * np.pi * np.arange(1, size // 2 + 1) / size
    grid = np.geomspace(omega[0], np.pi, _POINTS)
    shape = sum(square * increment_spectrum(name, grid, interval_s) for name, square in squares.items())
    return np.exp(np.interp(np.log(omega), np.log(grid), np.log(shape / (4 * np.sin(grid / 2) ** 2))))
