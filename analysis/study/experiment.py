"""The 6.8 % of the paper's experiment taken apart into its causes, one by one, at several rates.

The paper (its section 4) tells the oscilloscope (8 bits, 2500 points a screen), that lines of a spectrum were
read, the angle between the axes (88.693 deg), the latitude (28.2 deg) and equation (13); not the lock-in rate, the
rate, the window, or what the 6.8 % were taken from. So every cause is computed at several rates, with the others
absent:

formula      equation (13) with the exact ratio
reading      two lines of a 2500-point spectrum, the beat lying anywhere, and its phase
noise        white noise and eight bits, lines read with a Hann window, f known
earth        the horizontal earth rate at an azimuth that nobody knows; the table's rate is the reference
tilt         the angle between the axes known to 0.01 deg, and the same reference
distortion   a second harmonic of -50 dBc made by detector and oscilloscope, at any readout phase
ours         noise, eight bits and that distortion together: a record in each sense, one fit, the beat as reference
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Floats
from analysis.lockin_equation import beat_frequency, beat_signal, harmonic_ratio, lock_in_from_rate
from analysis.lockin_rate import estimate_lock_in
from analysis.rotation import earth_rate_on_axis
from analysis.several_rates import fit_rates
from analysis.study.simulation import OSCILLOSCOPE_SAMPLES, SCALE_FACTOR, peak_ratio, spectrum

PAPER = 0.068
OVER_LOCK_IN = (2.0, 5.0, 10.0, 20.0)
LOCK_IN_RATE = 0.01
"""deg/s: only the earth rate depends on it."""

TILT_DEG, LATITUDE_DEG = 88.693, 28.2
TILT_U_DEG = 0.01
DISTORTION = 10 ** (-50 / 20)
NOISE = 0.01
LEVELS = 100
"""Of the converter, in the amplitude."""

_PERIODS = (20.0, 50.0)
_TRIALS = 128
_PAIRS = 24
_NORMAL_95 = 1.959964
_HANN_BANDWIDTH = 1.5


@dataclass(frozen=True)
class Cause:
    """One cause at each rate, relative errors of the lock-in rate, (n,).

    rms : over phases, places in the bin, azimuths or noise
    largest : of noise and tilt, which have no largest, that of 95 %
    """

    name: str
    rms: Floats
    largest: Floats


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
    noise = np.hypot(NOISE, 12**-0.5 / LEVELS) * np.sqrt(2 * _HANN_BANDWIDTH / OSCILLOSCOPE_SAMPLES) / ratio
    swing = np.ptp(earth_rate_on_axis(LATITUDE_DEG, TILT_DEG, np.array([0.0, 180.0]))) / 2
    tilt = np.tan(np.radians(TILT_DEG)) * np.radians(TILT_U_DEG) * np.ones(over.size)
    hann = _cause("reading, Hann", [_read(one, "hann", rng) for one in over])
    causes = (
        Cause("formula", np.abs(formula), np.abs(formula)),
        _cause("reading, no window", [_read(one, "boxcar", rng) for one in over]),
        hann,
        _cause("reading, flat top", [_read(one, "flattop", rng) for one in over]),
        Cause("noise", noise, _NORMAL_95 * noise),
        Cause("earth", swing / rate / np.sqrt(2), swing / rate),
        Cause("tilt", tilt, _NORMAL_95 * tilt),
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
        volts + 2 * DISTORTION * volts**2,
        interval,
        scale_factor=SCALE_FACTOR,
        input_rate=over * LOCK_IN_RATE,
    )
    return np.asarray(found.lock_in_rate / LOCK_IN_RATE - 1)


def _ours(over: float, rng: np.random.Generator) -> Floats:
    """Errors of pairs of records, one in each sense, eight bits, with noise and distortion."""
    readout, periods = 2 * np.pi * rng.random(_PAIRS), np.full(_PAIRS, _PERIODS[0])
    screens = []
    for sense in (1, -1):
        volts, interval = _records(over, readout, periods, sense)
        volts = volts + 2 * DISTORTION * volts**2 + rng.normal(scale=NOISE, size=volts.shape)
        screens.append(np.rint(LEVELS * volts))
    rates = over * LOCK_IN_RATE * np.array([1.0, -1.0])
    both = estimate_lock_in(np.stack(screens, axis=1), interval, scale_factor=SCALE_FACTOR)
    found = [
        fit_rates(both[pair], input_rate=rates, reference="beat", model="distortion").lock_in_rate
        for pair in range(_PAIRS)
    ]
    return np.asarray(np.array(found) / LOCK_IN_RATE - 1)
