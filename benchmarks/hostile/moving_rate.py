"""The rate moves, or seems to move, in a way that no smooth curve describes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from analysis.arrays import Floats
from benchmarks.hostile.gyro import (
    N_SAMPLES,
    STEPS,
    Gyro,
    beat,
    draw_gyro,
    log_uniform,
    recorded,
    steady,
    step_times,
)
from benchmarks.hostile.record_class import HostileRecord, RecordClass


def random_walk(rng: np.random.Generator, least: float, most: float) -> HostileRecord:
    """White noise of the rate: the phase walks at random, by `least` to `most` rad (rms) over the record."""
    gyro = draw_gyro(rng)
    return recorded(rng, gyro, beat(gyro, random_walk_rates(rng, gyro, rng.uniform(least, most))))


def random_walk_rates(rng: np.random.Generator, gyro: Gyro, walk_rad: float) -> Floats:
    """Rates in deg/s under which the phase walks at random by so much (rms) over the record."""
    steps = rng.normal(scale=walk_rad / np.sqrt(N_SAMPLES), size=N_SAMPLES)
    return np.asarray(gyro.input_rate + np.repeat(steps / gyro.radians, STEPS))


def ramp_into_lock_in(rng: np.random.Generator) -> HostileRecord:
    """The table slows down until the gyro locks, or through zero and out on the other side."""
    gyro = draw_gyro(rng, rate_over_lock_in=(1.5, 30.0))
    reached = rng.uniform(0.3, 1.2)
    rates = gyro.input_rate * (1 - step_times() / reached)
    return recorded(rng, gyro, beat(gyro, rates))


def vibration(rng: np.random.Generator) -> HostileRecord:
    """The rate vibrates at 0.1 to 2 times the beat: by 0.003 to 3 rad of phase."""
    gyro = draw_gyro(rng)
    return recorded(rng, gyro, beat(gyro, _vibrating(rng, gyro, rng.uniform(0.1, 2.0) * gyro.periods)))


def vibration_at_the_beat(rng: np.random.Generator) -> HostileRecord:
    """The rate vibrates at the beat's own frequency: a sideband falls onto the second harmonic."""
    gyro = draw_gyro(rng)
    return recorded(rng, gyro, beat(gyro, _vibrating(rng, gyro, gyro.periods)))


def _vibrating(rng: np.random.Generator, gyro: Gyro, turns: float) -> Floats:
    size = log_uniform(rng, 0.003, 3.0) * 2 * np.pi * turns / N_SAMPLES / gyro.radians
    return gyro.input_rate + size * np.cos(2 * np.pi * turns * step_times() + rng.uniform(0, 2 * np.pi))


def rate_step(rng: np.random.Generator, place: float = 0.5) -> HostileRecord:
    """Another rate from a place on, as a share of the record: by 0.1 to 50 %."""
    gyro = draw_gyro(rng)
    rates = steady(gyro)
    step = log_uniform(rng, 0.001, 0.5)
    rates[step_times() > place] *= 1 + step * rng.choice([-1, 1])
    return recorded(rng, gyro, beat(gyro, rates))


def other_time_base(rng: np.random.Generator, place: float = 0.5, largest: float = 0.3) -> HostileRecord:
    """Another time base from a place on, as a share of the record: longer or shorter by 0.1 % to `largest`."""
    gyro = draw_gyro(rng)
    interval = np.full(N_SAMPLES * STEPS, gyro.sample_interval)
    interval[step_times() > place] *= (1 + log_uniform(rng, 0.001, largest)) ** rng.choice([-1.0, 1.0])
    return recorded(rng, gyro, beat(gyro, steady(gyro), interval))


def phase_jump(rng: np.random.Generator) -> HostileRecord:
    """Samples are missing between two, by a tenth of a radian of the beat to a whole turn."""
    gyro = draw_gyro(rng)
    interval = np.full(N_SAMPLES * STEPS, gyro.sample_interval)
    place = int(rng.uniform(0.05, 0.95) * N_SAMPLES) * STEPS
    lost = rng.uniform(0.1, 2 * np.pi - 0.1) / (2 * np.pi) * N_SAMPLES / gyro.periods
    interval[place : place + STEPS] *= 1 + lost
    return recorded(rng, gyro, beat(gyro, steady(gyro), interval))


def shaken_in_lock_in(rng: np.random.Generator) -> HostileRecord:
    """A dither about zero, or about a rate inside lock-in: the gyro is locked now and then, or always."""
    gyro = draw_gyro(rng, rate_over_lock_in=(1.5, 10.0))
    shaken = log_uniform(rng, 0.3, 30.0) * gyro.lock_in_rate
    turns = log_uniform(rng, 0.5, 100.0)
    mean = rng.uniform(-0.9, 0.9) * gyro.lock_in_rate
    rates = mean + shaken * np.cos(2 * np.pi * turns * step_times() + rng.uniform(0, 2 * np.pi))
    return recorded(rng, gyro, beat(gyro, rates))


def swings_in_lock_in(rng: np.random.Generator) -> HostileRecord:
    """A dither that never leaves the lock-in zone, and that began long before the record: a steady swing."""
    gyro = draw_gyro(rng, rate_over_lock_in=(1.5, 10.0))
    mean = rng.uniform(-0.5, 0.5) * gyro.lock_in_rate
    shaken = rng.uniform(0.1, 0.97) * (gyro.lock_in_rate - abs(mean))
    turns = log_uniform(rng, 2.0, 150.0)
    rates = mean + shaken * np.cos(2 * np.pi * turns * step_times() + rng.uniform(0, 2 * np.pi))
    settled = np.arcsin(rates[0] / gyro.lock_in_rate) - gyro.backscatter
    return recorded(rng, gyro, beat(replace(gyro, start=settled), rates))


def swings_through_zero(rng: np.random.Generator) -> HostileRecord:
    """A slow swing about zero: it turns round and back."""
    gyro = draw_gyro(rng, rate_over_lock_in=(1.5, 30.0))
    turns = rng.uniform(0.5, 3.0)
    rates = gyro.input_rate * np.cos(2 * np.pi * turns * step_times() + rng.uniform(0, 2 * np.pi))
    return recorded(rng, gyro, beat(gyro, rates))


def sampling_jitter(rng: np.random.Generator) -> HostileRecord:
    """The samples are taken too early or too late at random, by 1 to 30 % of the sample interval."""
    gyro = draw_gyro(rng)
    shift = rng.normal(scale=log_uniform(rng, 0.01, 0.3), size=N_SAMPLES)
    interval = gyro.sample_interval * (1 + np.diff(shift, append=0.0).clip(-0.99))
    return recorded(rng, gyro, beat(gyro, steady(gyro), np.repeat(interval, STEPS)))


CLASSES = (
    RecordClass("random-walk phase, 3 to 10 rad", "detect", lambda rng: random_walk(rng, 3.0, 10.0)),
    RecordClass("ramp into the lock-in zone", "detect", ramp_into_lock_in),
    RecordClass("vibration at 0.1 to 2 times the beat", "detect", vibration),
    RecordClass("another rate in the second half", "detect", rate_step),
    RecordClass("another time base in the second half", "detect", other_time_base),
    RecordClass("another rate for a part", "detect", lambda rng: rate_step(rng, rng.uniform(0.2, 0.8))),
    RecordClass(
        "another time base for a part", "detect", lambda rng: other_time_base(rng, rng.uniform(0.2, 0.8), 1.5)
    ),
    RecordClass("phase jump", "detect", phase_jump),
    RecordClass("shaken inside lock-in", "detect", shaken_in_lock_in),
    RecordClass("swings inside lock-in", "detect", swings_in_lock_in),
    RecordClass("swings through zero", "detect", swings_through_zero),
    RecordClass("sampling jitter", "detect", sampling_jitter),
    RecordClass("vibration at the beat frequency itself", "blind", vibration_at_the_beat),
)
