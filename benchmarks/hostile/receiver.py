"""Amplifier, cable and converter do not give what they are given."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.signal

from analysis.arrays import Floats
from benchmarks.hostile.gyro import (
    LAST_CODE,
    N_SAMPLES,
    Gyro,
    beat,
    converted,
    draw_gyro,
    levels_of,
    log_uniform,
    noisy,
    record_of,
    recorded,
    steady,
)
from benchmarks.hostile.moving import ABOVE_LOCK_IN, wander
from benchmarks.hostile.record_class import HostileRecord, RecordClass


def _wandering(rng: np.random.Generator) -> tuple[Gyro, Floats]:
    """A gyro that wanders by 1 to 3 rad in 3 to 25 cycles, above lock-in, and its beat."""
    while True:
        gyro = draw_gyro(rng)
        rates = wander(rng, gyro)
        if np.min(rates * np.sign(gyro.input_rate)) > ABOVE_LOCK_IN * gyro.lock_in_rate:
            return gyro, beat(gyro, rates)


def _at_rest(rng: np.random.Generator) -> tuple[Gyro, Floats]:
    gyro = draw_gyro(rng)
    return gyro, beat(gyro, steady(gyro))


def _through(
    rng: np.random.Generator,
    converter: Callable[[Floats], Floats],
    gyro_and_beat: Callable[[np.random.Generator], tuple[Gyro, Floats]] = _at_rest,
) -> HostileRecord:
    """A good signal through a bad converter, from levels to codes."""
    gyro, signal = gyro_and_beat(rng)
    codes = converter(noisy(rng, gyro, levels_of(gyro, signal)))
    return record_of(gyro, np.clip(codes, -LAST_CODE, LAST_CODE))


def missing_codes(rng: np.random.Generator) -> HostileRecord:
    """Some codes never come, at random or each of a number; the next one comes instead."""
    every = np.arange(-LAST_CODE - 1, LAST_CODE + 1)
    there = rng.uniform(size=every.size) > rng.uniform(0.02, 0.4)
    if rng.uniform() < 0.5:
        there = every % int(rng.integers(2, 12)) != 0
    there[-1] = True
    next_one = np.minimum.accumulate(np.where(there, every, LAST_CODE)[::-1])[::-1]
    return _through(rng, lambda levels: next_one[converted(levels).astype(int) + LAST_CODE + 1].astype(float))


def stuck_bit(rng: np.random.Generator) -> HostileRecord:
    """One of the lower six bits is always 0, or always 1."""
    bit, high = 1 << int(rng.integers(0, 6)), rng.uniform() < 0.5

    def converter(levels: Floats) -> Floats:
        unsigned = converted(levels).astype(int) + 128
        return np.asarray((unsigned | bit if high else unsigned & ~bit) - 128.0)

    return _through(rng, converter)


def uneven_thresholds(rng: np.random.Generator) -> HostileRecord:
    """Every threshold of the converter is off by itself, by up to 0.3 levels rms."""
    off = rng.uniform(0.05, 0.3) * rng.normal(size=2 * LAST_CODE + 1)
    return _through(rng, lambda levels: _by_thresholds(levels, off))


def uneven_widths(rng: np.random.Generator) -> HostileRecord:
    """Every code is too wide or too narrow, by up to 0.3 levels rms (DNL): the errors of its thresholds add up."""
    off = np.cumsum(rng.uniform(0.05, 0.3) * rng.normal(size=2 * LAST_CODE + 1))
    return _through(rng, lambda levels: _by_thresholds(levels, off - np.linspace(off[0], off[-1], off.size)))


def _by_thresholds(levels: Floats, off: Floats) -> Floats:
    thresholds = np.sort(np.arange(-LAST_CODE, LAST_CODE + 1) - 0.5 + off)
    return np.searchsorted(thresholds, levels) - LAST_CODE - 1.0


def step_in_the_codes(rng: np.random.Generator) -> HostileRecord:
    """A major carry is wrong: above some code all codes are 1 to 12 too high, or too low."""
    at, step = rng.uniform(-60, 60), rng.integers(1, 13) * rng.choice([-1, 1])
    return _through(rng, lambda levels: converted(levels + step * (levels > at)))


def step_while_the_rate_wanders(rng: np.random.Generator) -> HostileRecord:
    """The same wrong carry under a beat that wanders."""
    at, step = rng.uniform(-60, 60), rng.integers(1, 13) * rng.choice([-1, 1])
    return _through(rng, lambda levels: converted(levels + step * (levels > at)), _wandering)


def soft_clipping(rng: np.random.Generator) -> HostileRecord:
    """The amplifier saturates softly, as tanh, about a level that need not be the middle of the beat."""
    return _saturated(rng, *_at_rest(rng))


def soft_clipping_while_the_rate_wanders(rng: np.random.Generator) -> HostileRecord:
    """The same under a beat that wanders."""
    return _saturated(rng, *_wandering(rng))


def _saturated(rng: np.random.Generator, gyro: Gyro, signal: Floats) -> HostileRecord:
    drive, lift = log_uniform(rng, 0.05, 2.0), rng.uniform(-0.25, 0.25) * (rng.uniform() < 0.5)
    return recorded(rng, gyro, np.tanh(drive * (signal + lift)) / np.tanh(drive * (1 + abs(lift))))


def slow_slewing(rng: np.random.Generator) -> HostileRecord:
    """The amplifier cannot follow the steepest parts of the beat."""
    gyro = draw_gyro(rng, periods=(5.0, 80.0))
    signal = beat(gyro, steady(gyro))
    fastest = np.abs(np.diff(signal)).max() * rng.uniform(0.5, 0.98)
    followed = signal.copy()
    for n in range(1, N_SAMPLES):
        followed[n] = followed[n - 1] + np.clip(signal[n] - followed[n - 1], -fastest, fastest)
    return recorded(rng, gyro, followed)


def two_converters(rng: np.random.Generator) -> HostileRecord:
    """Two converters take turns, and differ in gain and offset."""
    gyro = draw_gyro(rng)
    levels = noisy(rng, gyro, levels_of(gyro, beat(gyro, steady(gyro))))
    levels[::2] = levels[::2] * (1 + rng.normal(scale=0.03)) + rng.normal(scale=2.0)
    return record_of(gyro, converted(levels))


def bow(rng: np.random.Generator) -> HostileRecord:
    """Distortion of second order, -60 to -30 dBc."""
    gyro = draw_gyro(rng)
    signal = beat(gyro, steady(gyro))
    return recorded(rng, gyro, (signal + 2 * 10 ** rng.uniform(-3, -1.5) * signal**2) / 1.1)


def low_pass(rng: np.random.Generator) -> HostileRecord:
    """One pole at 2 to 30 times the beat frequency."""
    gyro = draw_gyro(rng)
    periodic = beat(gyro, steady(gyro))
    pole = np.exp(-2 * np.pi * gyro.periods / N_SAMPLES * log_uniform(rng, 2.0, 30.0))
    start = [pole * periodic[0]]
    filtered, _ = scipy.signal.lfilter([1 - pole], [1, -pole], periodic, zi=start)
    return recorded(rng, gyro, filtered)


def aliased(rng: np.random.Generator) -> HostileRecord:
    """The beat lies above half the sampling rate, and folds to a frequency that looks right."""
    gyro = draw_gyro(rng, periods=(N_SAMPLES * 0.55, N_SAMPLES * 0.95))
    return recorded(rng, gyro, beat(gyro, steady(gyro)))


CLASSES = (
    RecordClass("missing codes", "detect", missing_codes),
    RecordClass("uneven thresholds", "detect", uneven_thresholds),
    RecordClass("uneven widths of codes", "detect", uneven_widths),
    RecordClass("stuck bit", "detect", stuck_bit),
    RecordClass("step in the codes", "detect", step_in_the_codes),
    RecordClass("soft clipping", "detect", soft_clipping),
    RecordClass("step in the codes, the rate wandering", "detect", step_while_the_rate_wanders),
    RecordClass("soft clipping, the rate wandering", "detect", soft_clipping_while_the_rate_wanders),
    RecordClass("slow slewing", "detect", slow_slewing),
    RecordClass("two converters that differ", "detect", two_converters),
    RecordClass("second-order bow", "blind", bow),
    RecordClass("low pass", "blind", low_pass),
    RecordClass("aliased fundamental", "blind", aliased),
)
