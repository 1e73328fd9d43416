"""Noise that is not white: each returns (R, N) of standard deviation 1 over the ensemble."""

from __future__ import annotations

import numpy as np
import scipy.fft
import scipy.signal

from analysis.arrays import Floats

_SETTLING = 500


def first_order(rng: np.random.Generator, n_records: int, n_samples: int, memory: float) -> Floats:
    """AR(1): x[n] = memory x[n-1] + white."""
    drive = rng.normal(size=(n_records, n_samples + _SETTLING)) * np.sqrt(1 - memory**2)
    return np.asarray(scipy.signal.lfilter([1.0], [1.0, -memory], drive, axis=1)[:, _SETTLING:])


def one_over_f(rng: np.random.Generator, n_records: int, n_samples: int) -> Floats:
    """Power density falling as 1/f, cut from a sequence four times as long, so that it is not periodic."""
    length = 4 * n_samples
    spectrum = scipy.fft.rfft(rng.normal(size=(n_records, length)), axis=1)
    shape = np.zeros(spectrum.shape[1])
    shape[1:] = 1 / np.sqrt(np.arange(1, len(shape)))
    shape /= np.sqrt(2 * np.sum(shape**2) / length)
    return np.asarray(scipy.fft.irfft(spectrum * shape, length, axis=1)[:, :n_samples])
