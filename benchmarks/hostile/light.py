"""The light on the photodiode is not that of one steady beat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from analysis.arrays import Floats
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


def _part(rng: np.random.Generator, least: float, most: float) -> Floats:
    """Where a part of the record of that share lies; it may reach its end."""
    share = log_uniform(rng, least, most)
    first = rng.uniform(0, 1 - share / 2)
    times = sample_times()
    return np.asarray((times >= first) & (times < first + share))


def beam_blocked(rng: np.random.Generator) -> HostileRecord:
    """Something stands in the beam for 2 to 70 % of the record, and lets 0 to 95 % through."""
    gyro = draw_gyro(rng)
    level = rng.uniform(-0.3, 0.3) if rng.uniform() < 0.5 else 0.0
    through, hidden = rng.choice([0.0, rng.uniform(0, 0.95)]), _part(rng, 0.02, 0.7)
    signal = beat(gyro, steady(gyro))
    return recorded(rng, gyro, np.where(hidden, level + through * (signal - level), signal))


def signal_lost(rng: np.random.Generator) -> HostileRecord:
    """The cable has a bad contact: for a part of the record the converter sees one level without noise."""
    gyro = draw_gyro(rng)
    levels = noisy(rng, gyro, levels_of(gyro, beat(gyro, steady(gyro))))
    gone = _part(rng, 0.02, 0.7)
    held = levels[np.flatnonzero(gone)[0]] if rng.uniform() < 0.5 else rng.uniform(-20, 20)
    return record_of(gyro, converted(np.where(gone, held, levels)))


def dead_samples(rng: np.random.Generator) -> HostileRecord:
    """Single samples, or short runs of them, hold zero or the value before."""
    gyro = draw_gyro(rng)
    codes = converted(noisy(rng, gyro, levels_of(gyro, beat(gyro, steady(gyro)))))
    dead = np.zeros(N_SAMPLES, dtype=bool)
    run = int(rng.integers(1, 20))
    for first in rng.integers(1, N_SAMPLES - run, max(1, int(log_uniform(rng, 0.001, 0.1) * N_SAMPLES / run))):
        dead[first : first + run] = True
    live = np.maximum.accumulate(np.where(dead, 0, np.arange(N_SAMPLES)))
    return record_of(gyro, codes[live] if rng.uniform() < 0.5 else np.where(dead, 0.0, codes))


SEEN_APART = 0.15
"""Turns by which two beats must part over the record to be seen as two; below they are one, of another ratio."""


def second_beat(rng: np.random.Generator) -> HostileRecord:
    """A second mode beats too, at phases of its own: within 10 % in frequency, 0.3 to 50 % of the amplitude."""
    gyro = draw_gyro(rng, amplitude=(40.0, 80.0))
    return _with_second_beat(rng, gyro, log_uniform(rng, SEEN_APART, max(0.1 * gyro.periods, 2 * SEEN_APART)))


def second_beat_unseen(rng: np.random.Generator) -> HostileRecord:
    """The same so close that the two part by less than a seventh of a turn."""
    gyro = draw_gyro(rng, amplitude=(40.0, 80.0))
    return _with_second_beat(rng, gyro, log_uniform(rng, SEEN_APART / 30, SEEN_APART))


def _with_second_beat(rng: np.random.Generator, gyro: Gyro, turns_apart: float) -> HostileRecord:
    frequency = np.sqrt(gyro.input_rate**2 - gyro.lock_in_rate**2)
    frequency *= 1 + turns_apart / gyro.periods * rng.choice([-1, 1])
    start, backscatter, readout = rng.uniform(-np.pi, np.pi, 3)
    other = replace(
        gyro,
        input_rate=float(np.hypot(frequency, gyro.lock_in_rate) * np.sign(gyro.input_rate)),
        start=start,
        backscatter=backscatter,
        readout=readout,
    )
    signal = beat(gyro, steady(gyro)) + log_uniform(rng, 0.003, 0.5) * beat(other, steady(other))
    return recorded(rng, gyro, signal)


def intensity_ripple(rng: np.random.Generator) -> HostileRecord:
    """The pump ripples at 0.05 to 2 times the beat: 0.1 to 20 % of the light, the mean level with it."""
    gyro = draw_gyro(rng, amplitude=(40.0, 80.0))
    turns = rng.uniform(0.05, 2.0) * gyro.periods
    ripple = log_uniform(rng, 0.001, 0.2) * np.cos(2 * np.pi * turns * sample_times() + rng.uniform(0, 2 * np.pi))
    mean = rng.uniform(0, 1.5)
    return recorded(rng, gyro, (mean + beat(gyro, steady(gyro))) * (1 + ripple) - mean)


def intensity_ripple_at_the_beat(rng: np.random.Generator) -> HostileRecord:
    """The pump ripples at the beat's own frequency."""
    gyro = draw_gyro(rng, amplitude=(40.0, 80.0))
    turn = 2 * np.pi * gyro.periods * sample_times() + rng.uniform(0, 2 * np.pi)
    return recorded(rng, gyro, beat(gyro, steady(gyro)) * (1 + log_uniform(rng, 0.001, 0.2) * np.cos(turn)))


CLASSES = (
    RecordClass("beam blocked for a part", "detect", beam_blocked),
    RecordClass("signal lost for a part", "detect", signal_lost),
    RecordClass("dead samples", "detect", dead_samples),
    RecordClass("second beat within 10 %", "detect", second_beat),
    RecordClass("second beat less than a seventh of a turn apart", "blind", second_beat_unseen),
    RecordClass("intensity ripple at 0.05 to 2 times the beat", "detect", intensity_ripple),
    RecordClass("intensity ripple at the beat frequency itself", "blind", intensity_ripple_at_the_beat),
)
