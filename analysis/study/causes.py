"""The error of the paper's method taken apart into its causes, one by one.

Every cause is computed with the others absent:

formula      equation (13) with the exact ratio
peak         the lines read at the middle of their bins instead of at f and 2f (the picket fence)
leakage      the lines read at f and 2f exactly, but in the skirts of each other, of their images and of the mean
solver       the lock-in equation integrated in steps of the sampling interval
rounding     the 2500 eight-bit points of an oscilloscope instead of 60 000 exact ones, with our method
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.signal

from analysis.arrays import Floats
from analysis.lockin_equation import beat_frequency, harmonic_ratio, lock_in_from_rate
from analysis.lockin_rate import estimate_lock_in
from analysis.study.paper_figures import largest_over_phases
from analysis.study.simulation import (
    DURATION_S,
    OSCILLOSCOPE_SAMPLES,
    SAMPLES,
    SAMPLING_HZ,
    SCALE_FACTOR,
    WINDOWS,
    Gyros,
    errors_by_fit,
    errors_by_peaks,
    records,
)

POINTS = ((0.2, 0.01), (1.0, 0.05), (2.0, 0.1), (0.5, 0.01), (0.5, 0.03), (0.2, 0.15), (1.0, 0.1), (1.0, 0.5))
"""Input rate and lock-in rate, deg/s: three at 20 times lock-in, the paper's Fig. 4, ends of its Figs. 5 and 6."""

LEVELS = 100
_PHASES = 8


@dataclass(frozen=True)
class Causes:
    """Relative errors of the lock-in rate of n gyros, largest over initial phases; by window where it matters."""

    points: tuple[tuple[float, float], ...]  # (float, float): Input rate, lock-in rate, deg/s
    bin_offset: Floats  # distance of the beat from the middle of its bin, in bins
    together: dict[str, Floats]  # the paper's method: peaks and equation (13)
    formula: Floats
    peak: dict[str, Floats]
    leakage: dict[str, Floats]
    euler: Floats  # integrated with 20 kHz in first and fourth order
    runge_kutta: Floats
    rounding: Floats  # ours on eight bits; its rms over phases
    ours: Floats


@dataclass(frozen=True)
class PeakReading:
    """What reading a peak costs when the beat lies anywhere in its bin: largest and rms relative error."""

    window: str
    largest: float
    rms: float


def find_causes(points: tuple[tuple[float, float], ...] = POINTS, windows: tuple[str, ...] = WINDOWS) -> Causes:
    """Take the error apart for some gyros."""
    rate, lock_in = np.array(points).T
    phases = np.arange(_PHASES) * (2 * np.pi / _PHASES)
    gyros = Gyros.of(rate[:, np.newaxis], lock_in[:, np.newaxis], phases)
    ratio = harmonic_ratio(lock_in / rate)
    bins = beat_frequency(SCALE_FACTOR, rate, lock_in) * DURATION_S
    together = errors_by_peaks(gyros, windows)
    return Causes(
        points=points,
        bin_offset=bins - np.rint(bins),
        together={name: largest_over_phases(errors) for name, errors in together.items()},
        formula=np.asarray(lock_in_from_rate(ratio, rate, "paper-13") / lock_in - 1),
        peak={name: _exact(ratio * _peak_factor(name, bins), rate, lock_in) for name in windows},
        leakage={name: _leakage(gyros, name) for name in windows},
        euler=_by_solver(gyros, 1),
        runge_kutta=_by_solver(gyros, 4),
        rounding=_rounding(gyros),
        ours=largest_over_phases(errors_by_fit(gyros)),
    )


def peak_readings(
    windows: tuple[str, ...] = WINDOWS, ratio: float = 0.025, points: int = 401
) -> list[PeakReading]:
    """Error of a ratio read from two peaks, the beat being anywhere in its bin."""
    bins = 3000 + np.linspace(-0.5, 0.5, points)
    found = []
    for name in windows:
        errors = _exact(
            ratio * _peak_factor(name, bins), np.ones(points), np.full(points, 2 * ratio / (1 + ratio**2))
        )
        found.append(PeakReading(name, float(np.abs(errors).max()), float(np.sqrt((errors**2).mean()))))
    return found


def _exact(ratio: Floats, rate: Floats, lock_in: Floats) -> Floats:
    return np.asarray(lock_in_from_rate(ratio, rate) / lock_in - 1)


def _peak_factor(window: str, bins: Floats) -> Floats:
    """Factor on A2/A1 because each line is read in the nearest bin; `bins` is f in bins."""
    first, second = (_main_lobe(window, order * bins - np.rint(order * bins)) for order in (1, 2))
    return np.asarray(second / first)


def _main_lobe(window: str, offset: Floats) -> Floats:
    """Response of a window at a distance of `offset` bins, of one shape with `offset`; 1 in the middle."""
    length = 4096
    weights = scipy.signal.get_window(window, length)
    index = np.arange(length) - length / 2
    turning = np.exp(2j * np.pi / length * np.multiply.outer(offset, index))
    return np.asarray(np.abs(turning @ weights) / weights.sum())


def _leakage(gyros: Gyros, window: str) -> Floats:
    weights = scipy.signal.get_window(window, SAMPLES)
    rate, lock_in = gyros.input_rate[:, 0], gyros.lock_in_rate[:, 0]
    frequency = beat_frequency(SCALE_FACTOR, rate, lock_in)
    times = np.arange(SAMPLES) / SAMPLING_HZ
    found = np.empty(gyros.shape)
    for place, hertz in enumerate(frequency):
        row = Gyros(gyros.input_rate[place], gyros.lock_in_rate[place], gyros.initial_phase[place])
        turning = np.exp(-2j * np.pi * hertz * times)
        lines = [np.abs(records(row) @ (weights * turning**order)) for order in (1, 2)]
        found[place] = _exact(lines[1] / lines[0], rate[place], lock_in[place])
    return largest_over_phases(found)


def _by_solver(gyros: Gyros, order: int) -> Floats:
    """Error that the integration leaves, found by our method: Euler's rule or the classical fourth-order one."""
    step = 1 / SAMPLING_HZ
    phase = gyros.initial_phase.copy()
    volts = np.empty((*gyros.shape, OSCILLOSCOPE_SAMPLES))

    def slope(angle: Floats) -> Floats:
        return np.asarray(
            2 * np.pi * SCALE_FACTOR * (gyros.input_rate - gyros.lock_in_rate * np.sin(angle)), dtype=np.float64
        )

    for index in range(OSCILLOSCOPE_SAMPLES):
        volts[..., index] = np.sin(phase)
        first = slope(phase)
        if order == 1:
            phase = phase + step * first
            continue
        second = slope(phase + step / 2 * first)
        third = slope(phase + step / 2 * second)
        phase = phase + step / 6 * (first + 2 * second + 2 * third + slope(phase + step * third))
    found = estimate_lock_in(volts, step, scale_factor=SCALE_FACTOR, input_rate=gyros.input_rate)
    return largest_over_phases(found.lock_in_rate / gyros.lock_in_rate - 1)


def _rounding(gyros: Gyros) -> Floats:
    codes = np.rint(LEVELS * records(gyros, OSCILLOSCOPE_SAMPLES))
    found = estimate_lock_in(codes, 1 / SAMPLING_HZ, scale_factor=SCALE_FACTOR, input_rate=gyros.input_rate)
    errors = found.lock_in_rate / gyros.lock_in_rate - 1
    return np.asarray(np.sqrt(np.nanmean(errors**2, axis=-1)))
