"""First values of frequency, fundamental and second harmonic from the spectrum of each record."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
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


@dataclass(frozen=True)
class Spectra:
    """lines (R, N//2 + 1); strongest (R,) the bin of the strongest line beside the mean value."""

    lines: Spectrum
    strongest: NDArray[np.intp]

    @staticmethod
    def of(values: Samples) -> Spectra:
        """Spectra of centred records, (R, N).

        Single precision: they only start the fits, and eight-bit samples do not fill its 24 bits.
        """
        n_records, n_samples = values.shape
        spectra = Spectra(
            np.empty((n_records, n_samples // 2 + 1), dtype=np.complex64), np.empty(n_records, dtype=np.intp)
        )
        at_once = records_at_once(n_samples, np.float32)
        for start in range(0, n_records, at_once):
            here = slice(start, start + at_once)
            spectra.lines[here] = lines = _transformed(values[here])
            spectra.strongest[here] = _strongest(lines)
        return spectra

    def take(self, part: NDArray[np.intp]) -> Spectra:
        """Some of the records."""
        return Spectra(self.lines[part], self.strongest[part])


def line_sizes(values: Samples) -> Sizes:
    """Size of each line of the spectra, (R, N) -> (R, N//2 + 1)."""
    return np.asarray(np.abs(_transformed(values)))


def _transformed(values: Samples) -> Spectrum:
    return np.asarray(scipy.fft.rfft(values.astype(np.float32, copy=False), axis=-1))


def _strongest(lines: Spectrum) -> NDArray[np.intp]:
    sizes = np.abs(lines)
    sizes[:, 0] = 0.0
    return np.asarray(sizes.argmax(axis=-1))


def spectral_start(spectra: Spectra, n_samples: int) -> SpectralStart:
    """Frequency of the strongest line, its amplitude, and that at twice its frequency.

    The lines are read through the Hann window (a convolution of three bins), whose low side lobes keep the mean
    value, the negative frequency and the other harmonics away; the two highest bins give the fraction of a bin.

    Parameters
    ----------
    spectra : Spectra
        Of centred records. The fundamental is taken to be the strongest line, as it is above lock-in.
    n_samples : int
        N.
    """
    windowed, bins = _hann_bins(spectra.lines, spectra.strongest, 2, n_samples)
    size = np.abs(windowed)
    rows = np.arange(len(size))
    peak = 1 + size[:, 1:-1].argmax(axis=-1)
    here, below, above = size[rows, peak], size[rows, peak - 1], size[rows, peak + 1]
    ratio = np.maximum(below, above) / np.where(here > 0, here, 1.0)
    fraction = np.where(above >= below, 1.0, -1.0) * np.clip((2 * ratio - 1) / (ratio + 1), -0.5, 0.5)
    line = np.clip(bins[rows, peak] + fraction, 0.5, n_samples / 2)
    doubled = np.abs((2 * line + n_samples / 2) % n_samples - n_samples / 2)
    second, second_bins = _hann_bins(spectra.lines, np.rint(doubled).astype(int), 1, n_samples)
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
    lines: Spectrum, centre: NDArray[np.intp], reach: int, n_samples: int
) -> tuple[Complexes, NDArray[np.intp]]:
    """Hann-windowed spectrum in the bins around `centre`, phases from the middle of the record."""
    n_bins = 2 * reach + 3
    first = np.clip(centre - reach - 1, 0, max(lines.shape[1] - n_bins, 0))
    bins = first[:, np.newaxis] + np.arange(n_bins)
    picked = neighbours(lines, first, n_bins) * _to_the_middle(n_samples)[bins]
    windowed = picked[:, 1:-1] / 2 + (picked[:, :-2] + picked[:, 2:]) / 4
    return windowed, bins[:, 1:-1]


def neighbours(lines: NDArray[Any], first: NDArray[np.intp], n_bins: int) -> NDArray[Any]:
    """`n_bins` bins of each row from bin `first` (R,) on, (R, n_bins); zeros behind the end of a short row."""
    if lines.shape[1] < n_bins:
        lines = np.pad(lines, ((0, 0), (0, n_bins - lines.shape[1])))
    windows = np.lib.stride_tricks.sliding_window_view(lines, n_bins, axis=-1)
    return np.asarray(windows[np.arange(len(first)), first])


@cache
def _to_the_middle(n_samples: int) -> Complexes:
    """Factors that make the phases of a spectrum count from the middle of the record."""
    return np.asarray(np.exp(1j * np.pi * np.arange(n_samples) * ((n_samples - 1) / n_samples)))


def _amplitude(windowed: Complexes, distance: Floats, n_samples: int) -> Complexes:
    """Least-squares amplitude of one line seen in a few bins at `distance` (in bins) from it."""
    # The Hann window's response for many samples, sinc(d) / (1 - d^2), which is 1/2 where d is 1.
    away = 1 - distance * distance
    edge = np.abs(away) < 1e-6
    response = np.where(edge, 0.25, np.sinc(distance) / np.where(edge, 2.0, 2 * away))
    return np.asarray(2 / n_samples * np.sum(response * windowed, axis=-1) / np.sum(response**2, axis=-1))


def coarse_frequency(values: Samples) -> Floats:
    """Angular frequency of the strongest line of centred records, rad per sample; (R, N) -> (R,)."""
    return spectral_start(Spectra.of(values), values.shape[-1]).omega


def candidate_frequencies(spectra: Spectra, n_samples: int, n_candidates: int = 6) -> Floats:
    """The strongest lines, for records in which the strongest may not be the fundamental.

    Close to lock-in the harmonics are nearly as strong as the fundamental, and where few samples fall into a
    period several of them fold onto one line.

    Returns
    -------
    (R, n_candidates)
        rad per sample, strongest first.
    """
    remaining = spectra.lines.copy()
    bins = np.arange(remaining.shape[1])
    candidates = np.empty((len(remaining), n_candidates))
    for column in range(n_candidates):
        strongest = spectra.strongest if column == 0 else _strongest(remaining)
        candidates[:, column] = spectral_start(Spectra(remaining, strongest), n_samples).omega
        taken = candidates[:, column, np.newaxis] * (n_samples / (2 * np.pi))
        remaining[np.abs(bins - taken) < 2.5] = 0.0
    return candidates
