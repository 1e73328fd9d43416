"""Maximum-likelihood fit of the lock-in waveform: at once where the start is plain, else by a search."""

from __future__ import annotations

import numpy as np

from analysis.arrays import Samples
from analysis.waveform.records import never_alone
from analysis.waveform.series.frequency_search import SpectralStart
from analysis.waveform.series.geometric_series import Series
from analysis.waveform.series.minimise import SeriesFit, Task, gauss_newton, levenberg_marquardt
from analysis.waveform.series.series_start import start_of_series

PLAIN_RATIO = 0.6
"""Up to this ratio of the two lines the spectrum's start is good enough for Gauss-Newton."""

UNEXPLAINED = 0.12
"""The strongest line is the fundamental if it and its ratio explain the power of the record to this share: one
of the harmonics of a gyro close to lock-in would explain less than half of it."""


def fit_series(values: Samples, weights: Samples | None) -> SeriesFit:
    """Fit the waveform to each record, of two at least."""
    n_records, n_samples = values.shape
    task = Task.of(values, weights)
    line = SpectralStart.of(values)
    size = np.abs(line.first)
    ratio = line.second / np.where(size > 0, line.first, 1.0)
    explained = size**2 / 2 * n_samples / (1 - np.minimum(np.abs(ratio), 0.9) ** 2)
    plain = (np.abs(ratio) < PLAIN_RATIO) & (np.abs(explained - task.power) < UNEXPLAINED * task.power)

    start = Series(np.zeros(n_records), line.first, np.where(plain, ratio, 0.0), line.omega)
    chosen = never_alone(np.flatnonzero(plain))
    if plain.all():
        fit, plain = gauss_newton(task, start)
    else:
        fit = SeriesFit.empty(start)
        fitted, plain[chosen] = gauss_newton(task.take(chosen), start.take(chosen))
        fit.put(chosen, fitted)
    hard = never_alone(np.flatnonzero(~plain))
    if hard.size:
        some = task.take(hard)
        fit.put(hard, levenberg_marquardt(some, start_of_series(some.values, some.weights)))
    return fit


def fit_series_again(values: Samples, weights: Samples | None, before: Series) -> SeriesFit:
    """Fit records of which a few samples have changed since `before` was found."""
    task = Task.of(values, weights)
    fit, converged = gauss_newton(task, before)
    far = never_alone(np.flatnonzero(~converged))
    if far.size:
        fit.put(far, levenberg_marquardt(task.take(far), before.take(far)))
    return fit
