"""The rate, the intensity or the baseline moves smoothly: what a careful fit cures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from analysis.arrays import Floats
from benchmarks.hostile.gyro import (
    N_SAMPLES,
    STEPS,
    Gyro,
    beat,
    converted,
    draw_gyro,
    log_uniform,
    noisy,
    record_of,
    sample_times,
    steady,
    step_times,
)
from benchmarks.hostile.moving_rate import random_walk_rates
from benchmarks.hostile.record_class import HostileRecord, RecordClass

RATE_OVER_LOCK_IN = (1.3, 30.0)
PERIODS = (5.0, 100.0)
NOISE = (0.6, 0.6)
AMPLITUDE = (90.0, 90.0)

ABOVE_LOCK_IN = 1.02
"""The least rate over the lock-in rate that a motion may reach; one that goes below is drawn again."""

LEVELS = 20.0
"""Of a drift or a step of the baseline."""

INTENSITY = 0.2

Motion = Callable[[np.random.Generator, Gyro], Floats]
"""Rates of a gyro in every step of the record, deg/s."""


def wander(rng: np.random.Generator, gyro: Gyro) -> Floats:
    """A sine of 1 to 3 rad with 3 to 25 cycles in the record, at most a third of the beats."""
    return _swinging(rng, gyro, rng.uniform(1.0, 3.0), rng.uniform(3.0, min(25.0, max(gyro.periods / 3, 3.01))))


def fast_modulation(rng: np.random.Generator, gyro: Gyro) -> Floats:
    """A sine of 0.1 to 1 rad between a tenth and a third of the beat frequency."""
    return _swinging(rng, gyro, rng.uniform(0.1, 1.0), gyro.periods * log_uniform(rng, 0.1, 1 / 3))


def one_slow_swing(rng: np.random.Generator, gyro: Gyro) -> Floats:
    """A sine of 1 rad with 1.3 cycles."""
    return _swinging(rng, gyro, 1.0, 1.3)


def smooth_wander(rng: np.random.Generator, gyro: Gyro) -> Floats:
    """Random and smooth, of 1 to 3 rad: cycles up to a number drawn from 2 to a quarter of the beats."""
    cycles = np.arange(1, rng.integers(2, max(3, int(min(25, gyro.periods / 4)) + 1)) + 1)
    sizes, phases = rng.normal(size=cycles.size) / cycles, rng.uniform(0, 2 * np.pi, cycles.size)
    angles = 2 * np.pi * cycles[:, np.newaxis] * step_times() + phases[:, np.newaxis]
    phase, slope = sizes @ np.sin(angles), (sizes * 2 * np.pi * cycles / N_SAMPLES) @ np.cos(angles)
    return gyro.input_rate + slope * rng.uniform(1.0, 3.0) / (np.sqrt(2) * phase.std()) / gyro.radians


def random_walk(rng: np.random.Generator, gyro: Gyro) -> Floats:
    """White noise of the rate: the phase walks by 1 rad over the record."""
    return random_walk_rates(rng, gyro, 1.0)


def random_walk_about_a_line(rng: np.random.Generator, gyro: Gyro) -> Floats:
    """White noise of the rate: the phase departs from its straight line by 1 rad (rms)."""
    rates = random_walk_rates(rng, gyro, 1.0)
    phase = np.cumsum(rates - rates.mean()) * gyro.radians / STEPS
    times = step_times() - 0.5
    phase -= phase.mean() + times * (times @ phase) / (times @ times)
    return np.asarray(rates.mean() + (rates - rates.mean()) / phase.std())


def at_rest(_rng: np.random.Generator, gyro: Gyro) -> Floats:
    """A steady rate."""
    return steady(gyro)


def all_together(rng: np.random.Generator, gyro: Gyro) -> Floats:
    """A wander, slow or fast."""
    cycles = rng.uniform(1.0, min(25.0, max(gyro.periods / 4, 1.5)))
    return _swinging(rng, gyro, rng.uniform(1.0, 3.0), cycles)


def _swinging(rng: np.random.Generator, gyro: Gyro, wander_rad: float, cycles: float) -> Floats:
    size = wander_rad * 2 * np.pi * cycles / N_SAMPLES / gyro.radians
    return gyro.input_rate + size * np.cos(2 * np.pi * cycles * step_times() + rng.uniform(0, 2 * np.pi))


def _moving(
    motion: Motion,
    *,
    intensity: float = 0.0,
    drift: float = 0.0,
    step: float = 0.0,
    periods: tuple[float, float] = PERIODS,
) -> Callable[[np.random.Generator], HostileRecord]:
    """Draws records: a motion, and the largest share of the intensity and levels of the baseline that change."""

    def make(rng: np.random.Generator) -> HostileRecord:
        while True:
            gyro = draw_gyro(
                rng, rate_over_lock_in=RATE_OVER_LOCK_IN, periods=periods, noise=NOISE, amplitude=AMPLITUDE
            )
            rates = motion(rng, gyro)
            slowest = np.min(rates * np.sign(gyro.input_rate))
            if motion in (random_walk, random_walk_about_a_line) or slowest > ABOVE_LOCK_IN * gyro.lock_in_rate:
                break
        times = sample_times()
        swing = 1 + intensity * rng.uniform(-1, 1) * _bent(rng, times)
        baseline = drift * rng.choice([-1, 1]) * _bent(rng, times)
        baseline = baseline + step * rng.choice([-1, 1]) * (times > rng.uniform(0.1, 0.9))
        levels = gyro.offset + gyro.amplitude * swing * beat(gyro, rates) + baseline
        found = record_of(gyro, converted(noisy(rng, gyro, levels)))
        return HostileRecord(
            found.volts, found.sample_interval, found.scale_factor, found.lock_in_rate, float(np.mean(rates))
        )

    return make


def _bent(rng: np.random.Generator, times: Floats) -> Floats:
    """From 0 to 1: a straight line, or a parabola."""
    return np.asarray(times if rng.random() < 0.5 else times**2)


CLASSES: tuple[RecordClass, ...] = (
    RecordClass("wander of 1 to 3 rad, 3 to 25 cycles", "cure", _moving(wander)),
    RecordClass("modulation between f/10 and f/3", "cure", _moving(fast_modulation)),
    RecordClass("random smooth wander of 1 to 3 rad", "cure", _moving(smooth_wander)),
    RecordClass("1 rad in 1.3 cycles, 60 periods", "cure", _moving(one_slow_swing, periods=(60.0, 60.0))),
    RecordClass("intensity drifts by up to 20 %", "cure", _moving(at_rest, intensity=INTENSITY)),
    RecordClass("baseline drifts by 20 levels", "cure", _moving(at_rest, drift=LEVELS)),
    RecordClass("baseline steps by 20 levels", "cure", _moving(at_rest, step=LEVELS)),
    RecordClass("random-walk phase of 1 rad", "cure", _moving(random_walk)),
    RecordClass("random-walk phase of 1 rad about a line", "cure", _moving(random_walk_about_a_line)),
    RecordClass("wander, drifts of both", "cure", _moving(all_together, intensity=INTENSITY, drift=10.0)),
    RecordClass("wander, drift and baseline step", "cure", _moving(all_together, intensity=0.1, step=LEVELS)),
)
"""Classes that are to be cured."""
