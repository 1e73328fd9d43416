"""First values of frequency, fundamental and second harmonic from the spectrum of each record."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from analysis.waveform.records import records_at_once

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Samples = NDArray[Any]
"""float32 or float64"""
Spectrum = NDArray[np.complex64]
Sizes = NDArray[np.float32]


@dataclass(frozen=True)
class SpectralStart:
    """omega (R,) rad per sample; first, second (R,) amplitudes of the strongest line and at twice its frequency,
    phases from the middle of the record."""

    omega: Floats
    first: Complexes
    second: Complexes


def spectrum_of(values: Samples) -> Spectrum:
    """Spectrum of centred records, (R, N) -> (R, N//2 + 1).

    Single precision: it only starts the fits, and eight-bit samples do not fill its 24 bits.
    """
    spectrum: Spectrum = np.empty((len(values), values.shape[1] // 2 + 1), dtype=np.complex64)
    for here, lines in _spectra(values):
        spectrum[here] = lines
    return spectrum


def line_sizes(values: Samples) -> Sizes:
    """Size of each line of the spectrum, (R, N) -> (R, N//2 + 1)."""
    sizes: Sizes = np.empty((len(values), values.shape[1] // 2 + 1), dtype=np.float32)
    for here, lines in _spectra(values):
        np.abs(lines, out=sizes[here])
    return sizes


def _spectra(values: Samples) -> Iterator[tuple[slice, Spectrum]]:
    """Some records' spectra at a time, while they are in the cache."""
    at_once = records_at_once(values.shape[1], np.float32)
    for start in range(0, len(values), at_once):
        here = slice(start, start + at_once)
        yield here, np.asarray(scipy.fft.rfft(values[here].astype(np.float32, copy=False), axis=-1))


def _strongest(spectrum: Spectrum) -> NDArray[np.intp]:
    """Bin of the strongest line beside the mean value, (R,)."""
    strongest = np.empty(len(spectrum), dtype=np.intp)
    at_once = records_at_once(spectrum.shape[1], spectrum.dtype)
    for start in range(0, len(spectrum), at_once):
        here = slice(start, start + at_once)
        strongest[here] = 1 + np.abs(spectrum[here, 1:]).argmax(axis=-1)
    return strongest


def spectral_start(spectrum: Spectrum, n_samples: int) -> SpectralStart:
    """Frequency of the strongest line, its amplitude, and that at twice its frequency.

    The lines are read through the Hann window (a convolution of three bins), whose low side lobes keep the mean
    value, the negative frequency and the other harmonics away; the two highest bins give the fraction of a bin.

    Parameters
    ----------
    spectrum : (R, N//2 + 1)
        Of centred records. The fundamental is taken to be the strongest line, as it is above lock-in.
    n_samples : int
        N.
    """
    rough = _strongest(spectrum)
    windowed, bins = _hann_bins(spectrum, rough, 2, n_samples)
    size = np.abs(windowed)
    rows = np.arange(len(rough))
    peak = 1 + size[:, 1:-1].argmax(axis=-1)
    here, below, above = size[rows, peak], size[rows, peak - 1], size[rows, peak + 1]
    ratio = np.maximum(below, above) / np.where(here > 0, here, 1.0)
    fraction = np.where(above >= below, 1.0, -1.0) * np.clip((2 * ratio - 1) / (ratio + 1), -0.5, 0.5)
    line = np.clip(bins[rows, peak] + fraction, 0.5, n_samples / 2)
    doubled = np.abs((2 * line + n_samples / 2) % n_samples - n_samples / 2)
    second, second_bins = _hann_bins(spectrum, np.rint(doubled).astype(int), 1, n_samples)
    second_amplitude = _amplitude(second, second_bins - doubled[:, np.newaxis], n_samples)
    folded = 2 * line > n_samples / 2
    # A folded line is the conjugate of the harmonic that it comes from.
    second_amplitude = np.where(folded, np.conj(second_amplitude), second_amplitude)
    return SpectralStart(
        line * (2 * np.pi / n_samples),
        _amplitude(windowed, bins - line[:, np.newaxis], n_samples),
        second_amplitude,
    )


def _hann_bins(
    spectrum: Spectrum, centre: NDArray[np.intp], reach: int, n_samples: int
) -> tuple[Complexes, NDArray[np.intp]]:
    """Hann-windowed spectrum in the bins around `centre`, phases from the middle of the record."""
    centre = np.clip(centre, reach + 1, spectrum.shape[1] - reach - 2)
    bins = centre[:, np.newaxis] + np.arange(-reach - 1, reach + 2)
    picked = np.take_along_axis(spectrum, bins, axis=-1).astype(np.complex128)
    picked *= np.exp(1j * np.pi * bins * ((n_samples - 1) / n_samples))
    windowed = picked[:, 1:-1] / 2 + (picked[:, :-2] + picked[:, 2:]) / 4
    return windowed, bins[:, 1:-1]


def _amplitude(windowed: Complexes, distance: Floats, n_samples: int) -> Complexes:
    """Least-squares amplitude of one line seen in a few bins at `distance` (in bins) from it."""
    # The Hann window's response for many samples, sinc(d) / (1 - d^2), which is 1/2 where d is 1.
    away = 1 - distance * distance
    edge = np.abs(away) < 1e-6
    response = np.where(edge, 0.25, np.sinc(distance) / np.where(edge, 2.0, 2 * away))
    return np.asarray(2 / n_samples * np.sum(response * windowed, axis=-1) / np.sum(response**2, axis=-1))


def coarse_frequency(values: Samples) -> Floats:
    """Angular frequency of the strongest line of centred records, rad per sample; (R, N) -> (R,)."""
    return spectral_start(spectrum_of(values), values.shape[-1]).omega


def candidate_frequencies(spectrum: Spectrum, n_samples: int, n_candidates: int = 6) -> Floats:
    """The strongest lines, for records in which the strongest may not be the fundamental.

    Close to lock-in the harmonics are nearly as strong as the fundamental, and where few samples fall into a
    period several of them fold onto one line.

    Returns
    -------
    (R, n_candidates)
        rad per sample, strongest first.
    """
    remaining = spectrum.copy()
    bins = np.arange(spectrum.shape[1])
    candidates = np.empty((len(spectrum), n_candidates))
    for column in range(n_candidates):
        candidates[:, column] = spectral_start(remaining, n_samples).omega
        taken = candidates[:, column, np.newaxis] * (n_samples / (2 * np.pi))
        remaining[np.abs(bins - taken) < 2.5] = 0.0
    return candidates
