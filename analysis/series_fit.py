"""Maximum-likelihood fit of the lock-in waveform: the fast way where it is safe, else the safe way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.frequency_search import spectral_start, spectrum_of
from analysis.geometric_series import Series
from analysis.periodic_fit import Step
from analysis.series_by_samples import fit_by_samples
from analysis.series_by_sums import fit_by_sums

Floats = NDArray[np.float64]

EASY_RATIO = 0.5
"""Up to this ratio the sums of harmonics are faster than the samples."""

UNEXPLAINED = 0.12
"""The strongest line is the fundamental if it and its ratio explain the power of the record to this share: one
of the harmonics of a gyro close to lock-in would explain less than half of it."""


def fit_series(values: Floats, weights: Floats | None) -> tuple[Series, Step]:
    """Fit the waveform to each record.

    Parameters
    ----------
    values : (R, N)
        Centred, 0 where missing.
    weights : (R, N) or None
        1 for a valid sample, 0 for a missing one.

    Returns
    -------
    Series, Step
        Parameters, and the normal equations in the order c0, Re H, Im H, Re q, Im q, w (w in rad at the
        record's ends) with the residual power that goes with the parameters.
    """
    n_records, n_samples = values.shape
    spectrum = spectrum_of(values)
    line = spectral_start(spectrum, n_samples)
    size = np.abs(line.first)
    ratio = line.second / np.where(size > 0, line.first, 1.0)
    power = np.einsum("rn,rn->r", values, values)
    explained = size**2 / 2 * n_samples / (1 - np.minimum(np.abs(ratio), 0.9) ** 2)
    easy = (np.abs(ratio) < EASY_RATIO) & (np.abs(explained - power) < UNEXPLAINED * power)

    series = Series(np.zeros(n_records), line.first, np.where(easy, ratio, 0.0), line.omega)
    step = Step(np.zeros((n_records, 6, 6)), np.zeros((n_records, 6)), np.zeros(n_records))
    chosen = np.flatnonzero(easy)
    if chosen.size == n_records:
        series, step, easy = fit_by_sums(values, weights, series)
    elif chosen.size:
        some = None if weights is None else weights[chosen]
        fitted, fitted_step, easy[chosen] = fit_by_sums(values[chosen], some, series.take(chosen))
        series.put(chosen, fitted)
        step.put(chosen, fitted_step)
    hard = np.flatnonzero(~easy)
    if hard.size:
        some = None if weights is None else weights[hard]
        fitted, fitted_step = fit_by_samples(values[hard], some, spectrum[hard])
        series.put(hard, fitted)
        step.put(hard, fitted_step)
    return series, step
