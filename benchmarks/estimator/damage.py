"""Records that are not as they should be: clipped, spiked, with gaps, or with a rate that moves; (R, N) each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from analysis import rate_varying_beat
from analysis.arrays import Floats
from benchmarks.estimator.gyros import CLIP, N_SAMPLES, Gyros, codes_of, draw_gyros, white_noise

VOLTS_PER_CODE, VOLTS_AT_ZERO = 0.0371, 0.013
"""Volts whose clipping limit nobody would guess."""

N_SPIKES = 5
BLANK = 250
NO_DATA = -128
RIPPLE_RAD = 3.0


def too_large(rng: np.random.Generator, n_records: int) -> Gyros:
    """Gyros whose beat goes beyond the converter's last code, so that up to a fifth of a sine is lost."""
    return replace(draw_gyros(rng, n_records), amplitude=rng.uniform(126.0, 133.0, n_records))


def clean(rng: np.random.Generator, gyros: Gyros) -> Floats:
    """Codes with white noise."""
    return codes_of(gyros, white_noise(rng, gyros))


def as_volts(rng: np.random.Generator, gyros: Gyros) -> Floats:
    """The same in volts, from which the last code cannot be told."""
    return clean(rng, gyros) * VOLTS_PER_CODE + VOLTS_AT_ZERO


def spiked(rng: np.random.Generator, gyros: Gyros) -> Floats:
    """A few samples of each record are wrong by 20 to 200 codes."""
    codes = clean(rng, gyros)
    places = rng.integers(0, N_SAMPLES, (len(gyros), N_SPIKES))
    rows = np.arange(len(gyros))[:, np.newaxis]
    heights = rng.uniform(20, 200, places.shape) * rng.choice([-1, 1], places.shape)
    codes[rows, places] = np.clip(np.rint(codes[rows, places] + heights), 1 - CLIP, CLIP - 1)
    return codes


def with_gap(rng: np.random.Generator, gyros: Gyros) -> Floats:
    """A tenth of each record holds the code for "no data"."""
    codes = clean(rng, gyros)
    first = rng.integers(0, N_SAMPLES - BLANK, len(gyros))
    since = np.arange(N_SAMPLES) - first[:, np.newaxis]
    codes[(since >= 0) & (since < BLANK)] = NO_DATA
    return codes


def many_periods(rng: np.random.Generator, n_records: int) -> Gyros:
    """Gyros in whose beat a slow ripple of the rate can be seen."""
    return draw_gyros(rng, n_records, periods=(40.0, 595.0), rate_over_lock_in=(1.1, 100.0))


def with_ripple(rng: np.random.Generator, gyros: Gyros) -> Floats:
    """The table's rate ripples: the beat's phase wanders by up to 3 rad, half a time to three times a record."""
    turns, start = rng.uniform(0.5, 3.0, (len(gyros), 1)), rng.uniform(0, 2 * np.pi, (len(gyros), 1))
    wander = rng.uniform(0.1, RIPPLE_RAD, (len(gyros), 1))
    times = (np.arange(N_SAMPLES - 1) + 0.5) / N_SAMPLES
    beat_moves = wander * turns * np.cos(2 * np.pi * turns * times + start) / N_SAMPLES
    rate = np.abs(gyros.input_rate)[:, np.newaxis]
    volts = rate_varying_beat(
        rate + beat_moves * gyros.frequency[:, np.newaxis] / rate,
        1.0,
        scale_factor=1.0,
        lock_in_rate=gyros.lock_in_rate,
        amplitude=gyros.amplitude,
        initial_phase=gyros.theta,
        readout_phase=gyros.delta,
    )
    codes = np.rint(gyros.offset[:, np.newaxis] + volts + white_noise(rng, gyros))
    return np.asarray(np.clip(codes, -CLIP, CLIP))
