"""The simulations of Zhan et al., Acta Optica Sinica 29, 960 (2009): their gyro, and their spectra and ours.

K = 2000 pulses per degree, no backscatter phase, no noise, 20 kHz for 3 s, lock-in rate by their equation (13)
from the two highest lines of a spectrum. What they do not say, the window, is a parameter here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.fft
import scipy.signal
from numpy.typing import ArrayLike

from analysis.arrays import Floats
from analysis.lockin_equation import Relation, beat_signal, lock_in_from_rate
from analysis.lockin_rate import estimate_lock_in

SCALE_FACTOR = 2000.0
SAMPLING_HZ = 20_000.0
DURATION_S = 3.0
SAMPLES = round(SAMPLING_HZ * DURATION_S)

OSCILLOSCOPE_SAMPLES = 2500

NEIGHBOURS = 2
"""Bins on either side of twice the strongest bin in which the second line is looked for."""

WINDOWS = ("boxcar", "hann", "blackmanharris", "flattop")

_AT_ONCE = 24


@dataclass(frozen=True)
class Gyros:
    """Gyros to simulate; the fields broadcast to one shape: deg/s, deg/s, rad."""

    input_rate: Floats
    lock_in_rate: Floats
    initial_phase: Floats

    @staticmethod
    def of(input_rate: ArrayLike, lock_in_rate: ArrayLike, initial_phase: ArrayLike) -> Gyros:
        """Broadcast against each other."""
        arrays = (np.asarray(a, dtype=np.float64) for a in (input_rate, lock_in_rate, initial_phase))
        return Gyros(*(a.copy() for a in np.broadcast_arrays(*arrays)))

    @property
    def shape(self) -> tuple[int, ...]:
        """Of every field."""
        return self.input_rate.shape

    def parts(self) -> Iterator[tuple[slice, Gyros]]:
        """Some gyros at a time, flattened: what fits into memory."""
        flat = [field.ravel() for field in (self.input_rate, self.lock_in_rate, self.initial_phase)]
        for first in range(0, flat[0].size, _AT_ONCE):
            where = slice(first, first + _AT_ONCE)
            yield where, Gyros(*(field[where] for field in flat))


def records(gyros: Gyros, samples: int = SAMPLES) -> Floats:
    """Detector signal of amplitude 1, (..., samples), in closed form."""
    return beat_signal(
        np.arange(samples) / SAMPLING_HZ,
        scale_factor=SCALE_FACTOR,
        input_rate=gyros.input_rate,
        lock_in_rate=gyros.lock_in_rate,
        initial_phase=gyros.initial_phase,
    )


def spectrum(volts: Floats, window: str = "boxcar") -> Floats:
    """One-sided amplitudes, less the mean: a line in the middle of its bin shows its own amplitude."""
    weights = scipy.signal.get_window(window, volts.shape[-1])
    swing = volts - volts.mean(axis=-1, keepdims=True)
    return np.asarray(np.abs(scipy.fft.rfft(swing * weights, axis=-1)) * (2 / weights.sum()))


def peak_ratio(amplitudes: Floats) -> Floats:
    """A2/A1 as read from the two highest lines of spectra (R, bins)."""
    first = amplitudes.argmax(axis=-1)
    near = 2 * first[:, np.newaxis] + np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
    second = np.take_along_axis(amplitudes, np.clip(near, 0, amplitudes.shape[-1] - 1), axis=-1).max(axis=-1)
    return np.asarray(second / amplitudes[np.arange(first.size), first])


def errors_by_peaks(
    gyros: Gyros, windows: tuple[str, ...] = ("boxcar",), relation: Relation = "paper-13"
) -> dict[str, Floats]:
    """Relative error of the lock-in rate from spectral peaks, of the shape of `gyros`, for each window."""
    found = {window: np.empty(gyros.input_rate.size) for window in windows}
    for where, some in gyros.parts():
        volts = records(some)
        for window in windows:
            ratio = peak_ratio(spectrum(volts, window))
            found[window][where] = lock_in_from_rate(ratio, some.input_rate, relation) / some.lock_in_rate - 1
    return {window: values.reshape(gyros.shape) for window, values in found.items()}


def errors_by_fit(gyros: Gyros, samples: int = OSCILLOSCOPE_SAMPLES) -> Floats:
    """Relative error of the lock-in rate by the waveform's fit and the exact relation, rate given.

    The first samples of the same records are enough: as many as the oscilloscope holds, 1/24 of them.
    """
    found = np.empty(gyros.input_rate.size)
    for where, some in gyros.parts():
        estimate = estimate_lock_in(
            records(some, samples), 1 / SAMPLING_HZ, scale_factor=SCALE_FACTOR, input_rate=some.input_rate
        )
        found[where] = estimate.lock_in_rate / some.lock_in_rate - 1
    return found.reshape(gyros.shape)
