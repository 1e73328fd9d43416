"""First values of frequency, fundamental and second harmonic from the spectrum of each record."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from analysis.arrays import Complexes, Floats, Indices, Samples
from analysis.waveform.records import records_at_once

Sizes = NDArray[np.float32]

TAKEN = 2.5
"""Bins on either side of a line that are taken to belong to it."""


@dataclass(frozen=True)
class SpectralStart:
    """omega (R,) rad per sample; first, second (R,) amplitudes of the strongest line and at twice its frequency,
    phases from the middle of the record.
    """

    omega: Floats
    first: Complexes
    second: Complexes

    @staticmethod
    def of(values: Samples) -> SpectralStart:
        """From centred records (R, N), a few at a time: their spectra are used up at once."""
        n_records, n_samples = values.shape
        start = SpectralStart(np.empty(n_records), *np.empty((2, n_records), dtype=np.complex128))
        at_once = records_at_once(n_samples, np.float32)
        for first in range(0, n_records, at_once):
            here = slice(first, first + at_once)
            some = Spectra.of(values[here]).start()
            start.omega[here], start.first[here], start.second[here] = some.omega, some.first, some.second
        return start


@dataclass(frozen=True)
class Spectra:
    """Spectra of centred records.

    Single precision: they only start the fits, and eight-bit samples do not fill its 24 bits.

    lines : (R, N//2 + 1) complex64
    strongest : (R,) bin of the strongest line beside the mean value
    n_samples : N
    """

    lines: NDArray[np.complex64]
    strongest: Indices
    n_samples: int

    @staticmethod
    def of(values: Samples) -> Spectra:
        """Spectra of centred records (R, N)."""
        lines = _transformed(values)
        return Spectra(lines, _strongest(lines), values.shape[1])

    def start(self) -> SpectralStart:
        """Frequency of the strongest line, its amplitude, and that at twice its frequency.

        The strongest line is taken to be the fundamental, as it is above lock-in. The lines are read through the
        Hann window (a convolution of three bins), whose low side lobes keep the mean value, the negative frequency
        and the other harmonics away. A line and its neighbours have the same phase there.
        """
        n = self.n_samples
        seen, bins = self._windowed(self.strongest)
        here = seen[:, 1]
        slope = ((seen[:, 2] - seen[:, 0]) * np.conj(here)).real / np.maximum(np.abs(here) ** 2, 1e-300)
        line = np.clip(bins[:, 1] + np.interp(slope, *_slope_at()), 0.5, n / 2)
        doubled = np.abs((2 * line + n / 2) % n - n / 2)
        at_second, second_bins = self._windowed(np.rint(doubled).astype(np.intp))
        second = _amplitude(at_second, second_bins - doubled[:, np.newaxis], n)
        # A folded line is the conjugate of the harmonic that it comes from.
        second = np.where(2 * line > n / 2, np.conj(second), second)
        return SpectralStart(line * (2 * np.pi / n), _amplitude(seen, bins - line[:, np.newaxis], n), second)

    def candidates(self, n_candidates: int) -> Floats:
        """Frequencies of the strongest lines, for records in which the strongest may not be the fundamental.

        Close to lock-in the harmonics are nearly as strong as the fundamental, and where few samples fall into a
        period several of them fold onto one line.
        """
        remaining, strongest = self.lines.copy(), self.strongest
        bins = np.arange(remaining.shape[1])
        found = np.empty((len(remaining), n_candidates))
        for column in range(n_candidates):
            found[:, column] = Spectra(remaining, strongest, self.n_samples).start().omega
            line = found[:, column, np.newaxis] * (self.n_samples / (2 * np.pi))
            remaining[np.abs(bins - line) < TAKEN] = 0.0
            strongest = _strongest(remaining)
        return found

    def _windowed(self, centre: Indices) -> tuple[Complexes, Indices]:
        """Three Hann-windowed bins around `centre`, phases from the middle of the record, and their numbers."""
        first = np.clip(centre - 2, 0, max(self.lines.shape[1] - 5, 0))
        bins = first[:, np.newaxis] + np.arange(5)
        picked = neighbours(self.lines, first, 5) * _to_the_middle(self.n_samples)[bins]
        return picked[:, 1:-1] / 2 + (picked[:, :-2] + picked[:, 2:]) / 4, bins[:, 1:-1]


def _transformed(values: Samples) -> NDArray[np.complex64]:
    return np.asarray(scipy.fft.rfft(values.astype(np.float32, copy=False), axis=-1))


def _strongest(lines: NDArray[np.complex64]) -> Indices:
    sizes = np.abs(lines)
    sizes[:, 0] = 0.0
    return np.asarray(sizes.argmax(axis=-1))


def neighbours(lines: Samples, first: Indices, n_bins: int) -> Samples:
    """`n_bins` bins of each row from bin `first` (R,) on, (R, n_bins)."""
    shape = (len(lines), lines.shape[1] - n_bins + 1, n_bins)
    windows = np.lib.stride_tricks.as_strided(lines, shape, (*lines.strides, lines.strides[1]), writeable=False)
    return np.asarray(windows[np.arange(len(first)), first])


@cache
def _to_the_middle(n_samples: int) -> Complexes:
    """Factors that make the phases of a spectrum count from the middle of the record."""
    return np.asarray(np.exp(1j * np.pi * np.arange(n_samples) * ((n_samples - 1) / n_samples)))


@cache
def _slope_at() -> tuple[Floats, Floats]:
    """Difference of the bins above and below a bin over that bin, and where between them the line is."""
    place = np.linspace(-0.75, 0.75, 301)
    rise = _hann_response(1 - place) - _hann_response(1 + place)
    return rise / _hann_response(place), place


def _hann_response(distance: Floats) -> Floats:
    """Size of a line seen through the Hann window at a distance in bins, for many samples; 1/2 at its own bin."""
    away = 1 - distance * distance
    edge = np.abs(away) < 1e-6
    return np.asarray(np.where(edge, 0.25, np.sinc(distance) / np.where(edge, 2.0, 2 * away)))


def _amplitude(seen: Complexes, distance: Floats, n_samples: int) -> Complexes:
    """Least-squares amplitude of one line seen in a few bins at `distance` (in bins) from it."""
    response = _hann_response(distance)
    return np.asarray(2 / n_samples * np.sum(response * seen, axis=-1) / np.sum(response**2, axis=-1))


def line_sizes(values: Samples) -> Sizes:
    """Size of each line of the spectra, (R, N) -> (R, N//2 + 1)."""
    return np.asarray(np.abs(_transformed(values)))


def coarse_frequency(values: Samples) -> Floats:
    """Angular frequency of the strongest line of centred records, rad per sample; (R, N) -> (R,)."""
    return SpectralStart.of(values).omega
