"""Something is added to the beat that is not white noise; and nothing but white noise, as a yardstick."""

from __future__ import annotations

import numpy as np

from analysis.arrays import Floats
from benchmarks.estimator.noise import first_order, one_over_f
from benchmarks.hostile.gyro import (
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
    sample_times,
    steady,
)
from benchmarks.hostile.record_class import HostileRecord, RecordClass


def _with(rng: np.random.Generator, gyro: Gyro, added: Floats) -> HostileRecord:
    levels = noisy(rng, gyro, levels_of(gyro, beat(gyro, steady(gyro))))
    return record_of(gyro, converted(levels + added))


def nothing(rng: np.random.Generator) -> HostileRecord:
    """White noise and rounding, as the estimator takes for granted."""
    gyro = draw_gyro(rng, periods=(3.0, 200.0))
    return recorded(rng, gyro, beat(gyro, steady(gyro)))


def shot(rng: np.random.Generator) -> HostileRecord:
    """Photons: the noise goes with the root of the light, and the beat takes up to 99 % of it."""
    gyro = draw_gyro(rng)
    wave = levels_of(gyro, beat(gyro, steady(gyro)))
    swing = float(np.ptp(wave)) / 2
    mean = swing / rng.uniform(0.3, 0.99)
    per_level = mean / gyro.noise**2 / 2
    photons = rng.poisson(np.maximum(mean + wave - (wave.max() + wave.min()) / 2, 0.0) * per_level)
    return record_of(gyro, converted(photons / per_level - mean))


def coloured(rng: np.random.Generator) -> HostileRecord:
    """Noise with a memory of some samples, which the estimator allows for."""
    gyro = draw_gyro(rng)
    return _with(rng, gyro, gyro.noise * first_order(rng, 1, N_SAMPLES, rng.uniform(0.2, 0.9))[0])


def pink(rng: np.random.Generator) -> HostileRecord:
    """1/f noise of 0.3 to 6 levels."""
    return _with(
        rng, draw_gyro(rng, amplitude=(40.0, 100.0)), log_uniform(rng, 0.3, 6) * one_over_f(rng, 1, N_SAMPLES)[0]
    )


def spike_train(rng: np.random.Generator) -> HostileRecord:
    """A spike at regular distances, from a switching supply: 3 to 100 levels high, one to five samples wide."""
    gyro = draw_gyro(rng, amplitude=(40.0, 80.0))
    distance = log_uniform(rng, 5.0, 400.0)
    since = (np.arange(N_SAMPLES) + rng.uniform(0, distance)) % distance
    shape = np.exp(-since / log_uniform(rng, 0.3, 2.0)) * (since < 5)
    height = log_uniform(rng, 3.0, 100.0) * float(rng.choice([-1, 1]))
    return _with(rng, gyro, np.asarray(height * shape))


def mains_hum(rng: np.random.Generator) -> HostileRecord:
    """A line of any frequency from a fifth of a turn in the record on, with two harmonics; 0.3 to 30 levels."""
    gyro = draw_gyro(rng, amplitude=(40.0, 80.0))
    turns, size = log_uniform(rng, 0.2, 500.0), log_uniform(rng, 0.3, 30.0)
    hum = np.zeros(N_SAMPLES)
    for order, share in ((1, 1.0), (2, rng.uniform(0, 0.3)), (3, rng.uniform(0, 0.3))):
        hum += share * np.cos(2 * np.pi * order * turns * sample_times() + rng.uniform(0, 2 * np.pi))
    return _with(rng, gyro, size * hum)


def impulsive(rng: np.random.Generator) -> HostileRecord:
    """0.3 to 20 % of the samples have noise 5 to 30 times as strong, one by one."""
    gyro = draw_gyro(rng, amplitude=(40.0, 80.0), noise=(0.2, 1.0))
    hit = rng.uniform(size=N_SAMPLES) < log_uniform(rng, 0.003, 0.2)
    return _with(rng, gyro, hit * rng.normal(scale=gyro.noise * rng.uniform(5, 30), size=N_SAMPLES))


def burst(rng: np.random.Generator) -> HostileRecord:
    """The noise is 3 to 20 times as strong for a part of the record."""
    gyro = draw_gyro(rng, amplitude=(40.0, 80.0), noise=(0.2, 1.0))
    first, share = rng.uniform(0, 0.9), rng.uniform(0.03, 0.5)
    there = (sample_times() >= first) & (sample_times() < first + share)
    return _with(rng, gyro, there * rng.normal(scale=gyro.noise * rng.uniform(3, 20), size=N_SAMPLES))


def telegraph(rng: np.random.Generator) -> HostileRecord:
    """Popcorn noise: the level jumps to and fro, by 1 to 20 levels, 3 to 100 times in the record."""
    gyro = draw_gyro(rng, amplitude=(40.0, 80.0))
    jumps = rng.uniform(size=N_SAMPLES) < log_uniform(rng, 3.0, 100.0) / N_SAMPLES
    return _with(rng, gyro, np.asarray(log_uniform(rng, 1.0, 20.0) * (np.cumsum(jumps) % 2), dtype=np.float64))


CLASSES = (
    RecordClass("nothing is wrong", "ideal", nothing),
    RecordClass("coloured noise", "ideal", coloured),
    RecordClass("shot noise", "ideal", shot),
    RecordClass("1/f noise", "detect", pink),
    RecordClass("spike train", "detect", spike_train),
    RecordClass("mains hum", "detect", mains_hum),
    RecordClass("impulsive noise", "detect", impulsive),
    RecordClass("bursts of noise", "detect", burst),
    RecordClass("telegraph noise", "detect", telegraph),
)
