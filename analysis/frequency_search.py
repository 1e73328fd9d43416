"""First value of the beat frequency of each record, good enough for every fit that follows to converge."""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def coarse_frequency(volts: Floats) -> Floats:
    """Angular frequency of the strongest line of each record, rad per sample.

    The spectrum is windowed by the Hann window (as a convolution of three bins), whose low side lobes keep
    the mean value, the negative frequency and the other harmonics from pulling the peak; the two highest
    bins then give the fraction of a bin.

    Parameters
    ----------
    volts : (R, N)
        Finite values. The fundamental is taken to be the strongest line, as it is above lock-in.

    Returns
    -------
    (R,)
    """
    spectrum = scipy.fft.rfft(volts - volts.mean(axis=-1, keepdims=True), axis=-1)
    return _interpolated_peak(spectrum, volts.shape[-1])


def _interpolated_peak(spectrum: NDArray[np.complex128], n_samples: int) -> Floats:
    rows = np.arange(spectrum.shape[0])
    windowed = np.zeros_like(spectrum)
    windowed[:, 1:-1] = spectrum[:, 1:-1] - (spectrum[:, :-2] + spectrum[:, 2:]) / 2
    power = windowed.real**2 + windowed.imag**2
    peak = np.clip(power.argmax(axis=-1), 1, spectrum.shape[1] - 2)
    here, below, above = (np.sqrt(power[rows, peak + d]) for d in (0, -1, 1))
    side = np.where(above >= below, 1.0, -1.0)
    ratio = np.divide(np.maximum(below, above), here, out=np.zeros_like(here), where=here > 0)
    fraction = side * np.clip((2 * ratio - 1) / (ratio + 1), -0.5, 0.5)
    return np.asarray((peak + fraction) * (2 * np.pi / n_samples))


def other_candidates(volts: Floats, omega: Floats, n_candidates: int = 6) -> Floats:
    """Further frequencies worth a try where the strongest line may not be the fundamental.

    Close to lock-in the harmonics are nearly as strong as the fundamental, and where few samples fall into a
    period several of them fold onto one line. The other strong lines of the spectrum are then candidates.

    Returns
    -------
    (R, n_candidates)
        rad per sample; the first column is `omega`.
    """
    n_records, n_samples = volts.shape
    spectrum = scipy.fft.rfft(volts - volts.mean(axis=-1, keepdims=True), axis=-1)
    candidates = np.empty((n_records, n_candidates))
    candidates[:, 0] = omega
    bins = np.arange(spectrum.shape[1])
    for column in range(1, n_candidates):
        taken = candidates[:, column - 1, np.newaxis] * (n_samples / (2 * np.pi))
        spectrum = np.where(np.abs(bins - taken) < 2.5, 0.0, spectrum)
        candidates[:, column] = _interpolated_peak(spectrum, n_samples)
    return candidates
