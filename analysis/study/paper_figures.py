"""Figures 2 to 6 of Zhan et al., Acta Optica Sinica 29, 960 (2009), computed again, and with the exact method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.arrays import Floats
from analysis.harmonics import fit_harmonics
from analysis.lockin_equation import beat_frequency, harmonic_ratio, lock_in_from_rate
from analysis.study.simulation import (
    DURATION_S,
    NEIGHBOURS,
    SAMPLES,
    SAMPLING_HZ,
    SCALE_FACTOR,
    Gyros,
    errors_by_fit,
    errors_by_peaks,
    records,
    spectrum,
)

ORDERS = 5
PHASES = 8
READINGS = ("boxcar", "hann", "flattop")
"""Windows with which the paper's peaks are read; it names none, and none is the rectangular one."""


@dataclass(frozen=True)
class WaveformStudy:
    """One gyro in time and frequency (the paper's Figs. 2 and 3)."""

    input_rate: float  # deg/s
    lock_in_rate: float
    beat_frequency: float  # Hz
    times: Floats  # (n,): The whole record, s; amplitude 1
    volts: Floats
    frequencies: Floats  # (m,): Its spectrum without a window, Hz
    amplitudes: Floats
    # (ORDERS,): Amplitudes of the harmonics: by theory, the highest line near each, by least squares
    exact: Floats
    peaks: Floats
    fitted: Floats

    def lock_in_by(self, amplitudes: Floats) -> tuple[float, float]:
        """Lock-in rate in deg/s from A2/A1 by the paper's equation (13) and by the exact relation."""
        ratio = float(amplitudes[1] / amplitudes[0])
        return (
            float(lock_in_from_rate(ratio, self.input_rate, "paper-13")),
            float(lock_in_from_rate(ratio, self.input_rate)),
        )


@dataclass(frozen=True)
class ErrorStudy:
    """Relative error of the lock-in rate along one axis, a row for each curve."""

    axis: Floats  # (n,): Initial phase in rad, input rate or lock-in rate in deg/s
    # (float, float): Input rate and lock-in rate of each curve, deg/s; nan for the one that is the axis
    curves: tuple[tuple[float, float], ...]
    # for each window (n_curves, n): error of the paper's method; the largest over initial phases unless the phase
    # is the axis
    by_peaks: dict[str, Floats]
    formula: Floats  # (n_curves, n): Error of the paper's equation (13) alone, the ratio being exact
    ours: Floats  # (n_curves, n): Error of the exact method, from the first 2500 samples of the same records


def waveform_study(lock_in_rate: float, input_rate: float = 1.0) -> WaveformStudy:
    """Waveform and spectrum of one gyro: lock-in rate 0.5 deg/s is the paper's Fig. 2, 0.1 deg/s its Fig. 3."""
    volts = records(Gyros.of(input_rate, lock_in_rate, 0.0))
    amplitudes = spectrum(volts)
    frequency = float(beat_frequency(SCALE_FACTOR, input_rate, lock_in_rate))
    ratio = float(harmonic_ratio(lock_in_rate / input_rate))
    places = np.arange(1, ORDERS + 1) * frequency * DURATION_S
    near = np.rint(places).astype(int)[:, np.newaxis] + np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
    fit = fit_harmonics(volts, 1 / SAMPLING_HZ, harmonics=ORDERS)
    return WaveformStudy(
        input_rate=input_rate,
        lock_in_rate=lock_in_rate,
        beat_frequency=frequency,
        times=np.arange(SAMPLES) / SAMPLING_HZ,
        volts=volts,
        frequencies=np.arange(amplitudes.size) / DURATION_S,
        amplitudes=amplitudes,
        exact=np.asarray((1 - ratio**2) * ratio ** np.arange(ORDERS), dtype=np.float64),
        peaks=amplitudes[near].max(axis=-1),
        fitted=np.abs(fit.amplitudes),
    )


def phase_study(curves: Sequence[tuple[float, float]], points: int = 37) -> ErrorStudy:
    """Error against the initial phase (Fig. 4), for pairs of input rate and lock-in rate."""
    axis = np.linspace(0, 2 * np.pi, points)
    rate, lock_in = np.array(curves).T
    gyros = Gyros.of(rate[:, np.newaxis], lock_in[:, np.newaxis], axis)
    return ErrorStudy(axis, tuple(curves), errors_by_peaks(gyros, READINGS), _formula(gyros), errors_by_fit(gyros))


def rate_study(lock_in_rates: Sequence[float], rates: Floats) -> ErrorStudy:
    """Largest error over the initial phase against the input rate (Fig. 5)."""
    curves = tuple((float("nan"), lock_in) for lock_in in lock_in_rates)
    return _largest(rates, curves, Gyros.of(rates[:, np.newaxis], _column(lock_in_rates), _phases()))


def lock_in_study(lock_in_rates: Floats, input_rate: float = 1.0) -> ErrorStudy:
    """Largest error over the initial phase against the lock-in rate (Fig. 6)."""
    gyros = Gyros.of(input_rate, lock_in_rates[np.newaxis, :, np.newaxis], _phases())
    return _largest(lock_in_rates, ((input_rate, float("nan")),), gyros)


def largest_over_phases(errors: Floats) -> Floats:
    """The value of the largest size along the last axis, with its sign."""
    place = np.abs(errors).argmax(axis=-1)
    return np.asarray(np.take_along_axis(errors, place[..., np.newaxis], axis=-1)[..., 0])


def _largest(axis: Floats, curves: tuple[tuple[float, float], ...], gyros: Gyros) -> ErrorStudy:
    by_peaks = {name: largest_over_phases(found) for name, found in errors_by_peaks(gyros, READINGS).items()}
    # the exact method knows no initial phase; every other one is enough to show it
    some = Gyros(*(field[..., ::4] for field in (gyros.input_rate, gyros.lock_in_rate, gyros.initial_phase)))
    ours = largest_over_phases(errors_by_fit(some))
    return ErrorStudy(axis, curves, by_peaks, _formula(gyros)[..., 0], ours)


def _formula(gyros: Gyros) -> Floats:
    ratio = harmonic_ratio(gyros.lock_in_rate / gyros.input_rate)
    return np.asarray(lock_in_from_rate(ratio, gyros.input_rate, "paper-13") / gyros.lock_in_rate - 1)


def _phases() -> Floats:
    return np.linspace(0, 2 * np.pi, PHASES, endpoint=False)


def _column(values: Sequence[float]) -> Floats:
    return np.asarray(values, dtype=np.float64)[:, np.newaxis, np.newaxis]
