"""Figures 2 to 6 of Zhan et al., Acta Optica Sinica 29, 960 (2009), again and exactly; causes of their error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft
import scipy.signal
from numpy.typing import ArrayLike

from analysis.arrays import NORMAL_95, Floats
from analysis.harmonics import fit_harmonics
from analysis.lockin_equation import beat_frequency, beat_signal, harmonic_ratio, lock_in_from_rate
from analysis.lockin_rate import estimate_lock_in
from analysis.rotation import earth_rate_on_axis
from analysis.several_rates import fit_rates

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
    return _largest(
        rates, curves, Gyros.of(rates[:, np.newaxis], np.reshape(lock_in_rates, (-1, 1, 1)), _phases())
    )


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


# --------------------
# Bias of the paper's formulas, and the error of the exact relation on exact records


RATE_RATIOS = (0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98)


@dataclass(frozen=True)
class BiasTable:
    """Arrays of shape (n,)."""

    rate_ratio: Floats  # x = WL/W
    ratio: Floats  # r = A2/A1 = tan(asin(x)/2)
    # relative bias of the paper's equations, the ratio being exact: (1 + r^2)/sqrt(1 + 4 r^2) - 1 and r^2
    formula_13: Floats
    formula_10: Floats
    # largest relative error of the whole exact method on records of the exact solution, several phases
    ours: Floats


def bias_table(rate_ratios: tuple[float, ...] = RATE_RATIOS) -> BiasTable:
    """Compute the table for W = 1 deg/s and K = 2000 pulses per degree."""
    x = np.asarray(rate_ratios, dtype=np.float64)
    r = harmonic_ratio(x)
    gyros = Gyros.of(1.0, x[:, np.newaxis], np.array([0.0, 1.0, 4.0]))
    return BiasTable(
        rate_ratio=x,
        ratio=r,
        formula_13=np.asarray(lock_in_from_rate(r, 1.0, "paper-13") / x - 1),
        formula_10=np.asarray(lock_in_from_rate(r, 1.0, "paper-10") / x - 1),
        ours=np.asarray(np.abs(errors_by_fit(gyros)).max(axis=-1)),
    )


# --------------------
# The 6.8 % of the paper's experiment taken apart into its causes, one by one, at several rates.
#
# The paper (its section 4) tells the oscilloscope (8 bits, 2500 points a screen), that lines of a spectrum were
# read, the angle between the axes (88.693 deg), the latitude (28.2 deg) and equation (13); not the lock-in rate,
# the rate, the window, or what the 6.8 % were taken from. So every cause is computed at several rates, with the
# others absent:
#
# formula      equation (13) with the exact ratio
# reading      two lines of a 2500-point spectrum, the beat lying anywhere, and its phase
# noise        white noise and eight bits, lines read with a Hann window, f known
# earth        the horizontal earth rate at an azimuth that nobody knows; the table's rate is the reference
# tilt         the angle between the axes known to 0.01 deg, and the same reference
# distortion   a second harmonic of -50 dBc made by detector and oscilloscope, at any readout phase
# ours         noise, eight bits and that distortion together: a record in each sense, one fit, the beat as
# reference


PAPER = 0.068
OVER_LOCK_IN = (2.0, 5.0, 10.0, 20.0)
LOCK_IN_RATE = 0.01  # deg/s: only the earth rate depends on it

TILT_DEG, LATITUDE_DEG = 88.693, 28.2
TILT_U_DEG = 0.01
DISTORTION = 10 ** (-50 / 20)
NOISE = 0.01
EXPERIMENT_LEVELS = 100  # of the converter, in the amplitude

_PERIODS = (20.0, 50.0)
_TRIALS = 128
_PAIRS = 24
_HANN_BANDWIDTH = 1.5


@dataclass(frozen=True)
class Cause:
    """One cause at each rate, relative errors of the lock-in rate, (n,)."""

    name: str
    rms: Floats  # over phases, places in the bin, azimuths or noise
    largest: Floats  # of noise and tilt, which have no largest, that of 95 %


@dataclass(frozen=True)
class ExperimentCauses:
    """The causes at W/WL of `over_lock_in`; `together` is their root sum of squares with a Hann window, rms."""

    over_lock_in: tuple[float, ...]
    causes: tuple[Cause, ...]
    together: Floats
    ours: Cause


def find_experiment_causes(over_lock_in: tuple[float, ...] = OVER_LOCK_IN, seed: int = 1) -> ExperimentCauses:
    """Compute every cause at every rate; rates in lock-in rates."""
    over = np.asarray(over_lock_in, dtype=np.float64)
    ratio, rate = np.asarray(harmonic_ratio(1 / over)), over * LOCK_IN_RATE
    rng = np.random.default_rng(seed)
    formula = np.asarray(lock_in_from_rate(ratio, rate, "paper-13") / LOCK_IN_RATE - 1)
    noise = (
        np.hypot(NOISE, 12**-0.5 / EXPERIMENT_LEVELS) * np.sqrt(2 * _HANN_BANDWIDTH / OSCILLOSCOPE_SAMPLES) / ratio
    )
    swing = np.ptp(earth_rate_on_axis(LATITUDE_DEG, TILT_DEG, np.array([0.0, 180.0]))) / 2
    tilt = np.tan(np.radians(TILT_DEG)) * np.radians(TILT_U_DEG) * np.ones(over.size)
    hann = _cause("reading, Hann", [_read(one, "hann", rng) for one in over])
    causes = (
        Cause("formula", np.abs(formula), np.abs(formula)),
        _cause("reading, no window", [_read(one, "boxcar", rng) for one in over]),
        hann,
        _cause("reading, flat top", [_read(one, "flattop", rng) for one in over]),
        Cause("noise", noise, NORMAL_95 * noise),
        Cause("earth", swing / rate / np.sqrt(2), swing / rate),
        Cause("tilt", tilt, NORMAL_95 * tilt),
        _cause("distortion", [_distorted(one) for one in over]),
    )
    counted = [cause.rms for cause in causes if not cause.name.startswith("reading") or cause is hann]
    together = np.sqrt(np.sum(np.square(counted), axis=0))
    return ExperimentCauses(over_lock_in, causes, together, _cause("ours", [_ours(one, rng) for one in over]))


def _cause(name: str, errors: list[Floats]) -> Cause:
    rms = np.array([np.sqrt(np.mean(one**2)) for one in errors])
    return Cause(name, rms, np.array([np.abs(one).max() for one in errors]))


def _records(over: float, readout: Floats, periods: Floats, sense: int = 1) -> tuple[Floats, float]:
    """Screens (n, 2500) of amplitude 1 that hold so many periods, at the time base of the first; its interval."""
    rate = sense * over * LOCK_IN_RATE
    frequency = float(beat_frequency(SCALE_FACTOR, rate, LOCK_IN_RATE))
    interval = float(periods[0]) / frequency / OSCILLOSCOPE_SAMPLES
    times = np.arange(OSCILLOSCOPE_SAMPLES) * interval * (periods / periods[0])[:, np.newaxis]
    phase = 2 * np.pi * np.random.default_rng(7).random(readout.size)
    volts = [
        beat_signal(
            time,
            scale_factor=SCALE_FACTOR,
            input_rate=rate,
            lock_in_rate=LOCK_IN_RATE,
            initial_phase=start,
            readout_phase=turned,
        )
        for time, start, turned in zip(times, phase, readout, strict=True)
    ]
    return np.array(volts), interval


def _read(over: float, window: str, rng: np.random.Generator) -> Floats:
    """Errors of A2/A1 from two lines of the screen's spectrum, by the exact relation."""
    volts, _ = _records(over, 2 * np.pi * rng.random(_TRIALS), rng.uniform(*_PERIODS, _TRIALS))
    ratio = peak_ratio(spectrum(volts, window))
    return np.asarray(lock_in_from_rate(ratio, over * LOCK_IN_RATE) / LOCK_IN_RATE - 1)


def _distorted(over: float) -> Floats:
    """Errors by the exact method with the table's rate, which knows nothing of the distortion."""
    readout = 2 * np.pi * np.arange(_PAIRS) / _PAIRS
    volts, interval = _records(over, readout, np.full(_PAIRS, _PERIODS[0]))
    found = estimate_lock_in(
        volts + 2 * DISTORTION * volts**2, interval, scale_factor=SCALE_FACTOR, input_rate=over * LOCK_IN_RATE
    )
    return np.asarray(found.lock_in_rate / LOCK_IN_RATE - 1)


def _ours(over: float, rng: np.random.Generator) -> Floats:
    """Errors of pairs of records, one in each sense, eight bits, with noise and distortion."""
    readout, periods = 2 * np.pi * rng.random(_PAIRS), np.full(_PAIRS, _PERIODS[0])
    screens = []
    for sense in (1, -1):
        volts, interval = _records(over, readout, periods, sense)
        volts = volts + 2 * DISTORTION * volts**2 + rng.normal(scale=NOISE, size=volts.shape)
        screens.append(np.rint(EXPERIMENT_LEVELS * volts))
    rates = over * LOCK_IN_RATE * np.array([1.0, -1.0])
    both = estimate_lock_in(np.stack(screens, axis=1), interval, scale_factor=SCALE_FACTOR)
    found = [
        fit_rates(both[pair], input_rate=rates, reference="beat", model="distortion").lock_in_rate
        for pair in range(_PAIRS)
    ]
    return np.asarray(np.array(found) / LOCK_IN_RATE - 1)


# --------------------
# The simulations of Zhan et al., Acta Optica Sinica 29, 960 (2009): their gyro, and their spectra and ours.
#
# K = 2000 pulses per degree, no backscatter phase, no noise, 20 kHz for 3 s, lock-in rate by their equation (13)
# from the two highest lines of a spectrum. What they do not say, the window, is a parameter here


SCALE_FACTOR = 2000.0
SAMPLING_HZ = 20_000.0
DURATION_S = 3.0
SAMPLES = round(SAMPLING_HZ * DURATION_S)

OSCILLOSCOPE_SAMPLES = 2500

NEIGHBOURS = 2  # bins on either side of twice the strongest bin in which the second line is looked for

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


def errors_by_peaks(gyros: Gyros, windows: tuple[str, ...] = ("boxcar",)) -> dict[str, Floats]:
    """Relative error of the lock-in rate from spectral peaks, of the shape of `gyros`, for each window."""
    found = {window: np.empty(gyros.input_rate.size) for window in windows}
    for where, some in gyros.parts():
        volts = records(some)
        for window in windows:
            ratio = peak_ratio(spectrum(volts, window))
            found[window][where] = lock_in_from_rate(ratio, some.input_rate, "paper-13") / some.lock_in_rate - 1
    return {window: values.reshape(gyros.shape) for window, values in found.items()}


def errors_by_fit(gyros: Gyros) -> Floats:
    """Relative error of the lock-in rate by the waveform's fit and the exact relation, rate given."""
    # The first samples of the same records are enough: as many as the oscilloscope holds, 1/24 of them.
    found = np.empty(gyros.input_rate.size)
    for where, some in gyros.parts():
        volts = records(some, OSCILLOSCOPE_SAMPLES)
        estimate = estimate_lock_in(volts, 1 / SAMPLING_HZ, scale_factor=SCALE_FACTOR, input_rate=some.input_rate)
        found[where] = estimate.lock_in_rate / some.lock_in_rate - 1
    return found.reshape(gyros.shape)


# --------------------
# The error of the paper's method taken apart into its causes, one by one.
#
# Every cause is computed with the others absent:
#
# formula      equation (13) with the exact ratio
# peak         the lines read at the middle of their bins instead of at f and 2f (the picket fence)
# leakage      the lines read at f and 2f exactly, but in the skirts of each other, of their images and of the mean
# solver       the lock-in equation integrated in steps of the sampling interval
# rounding     the 2500 eight-bit points of an oscilloscope instead of 60 000 exact ones, with our method


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
    codes = np.rint(LEVELS * records(gyros, OSCILLOSCOPE_SAMPLES))
    found = estimate_lock_in(codes, 1 / SAMPLING_HZ, scale_factor=SCALE_FACTOR, input_rate=gyros.input_rate)
    of_codes = found.lock_in_rate / gyros.lock_in_rate - 1
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
        rounding=np.sqrt(np.nanmean(of_codes**2, axis=-1)),
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
