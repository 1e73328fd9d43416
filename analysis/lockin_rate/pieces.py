"""Do the parts of a record agree? Asked where the residual of the whole is not white noise.

The lock-in rate does not change while a record is taken. A part that was blocked, jumped, was taken with another
time base or inside lock-in shows another one than the rest, or no beat at all. What the parts differ by beyond
their noise enters the uncertainty of the whole.
"""

from __future__ import annotations

import numpy as np
import scipy.special

from analysis.arrays import Bools, Complexes, Floats, Indices, Ints
from analysis.flags import FATAL, Flag
from analysis.lockin_rate.beat import Beat
from analysis.lockin_rate.rate import rate_and_slopes
from analysis.waveform.records import Stack, never_alone
from analysis.waveform.waveform_fit import WaveformFit, fit_waveform

SUSPECT = Flag.MISFIT | Flag.RATE_WANDER
"""What makes the parts worth a look; noise that is not white does where it is stronger at the beat than elsewhere,
since what happens in one part never leaves less there."""

PERIODS = 4.0
SAMPLES = 100
MOST_PIECES = 4
"""A part has at least so many periods and samples; a record is cut into at most so many parts."""

UNLIKELY, RARE = 1e-4, 1e-2
"""Shares of records in which noise makes parts differ so much that a flag says so, or the difference counts."""


def compare_pieces(
    beat: Beat, fit: WaveformFit, stack: Stack, clipped: Bools | None, sample_interval: float
) -> tuple[Beat, Ints]:
    """Beats, their uncertainty enlarged by what their parts say, and the flags plus that of parts that differ."""
    flags = fit.flags
    louder = ((flags & int(Flag.COLOURED_NOISE)) != 0) & (fit.excess.max(axis=-1) > 1)
    suspect = (((flags & int(SUSPECT)) != 0) | louder) & ((flags & int(FATAL)) == 0)
    pieces = np.minimum(np.minimum(beat.periods / PERIODS, stack.n_samples / SAMPLES), MOST_PIECES)
    number = np.where(suspect & np.isfinite(pieces), pieces, 0).astype(int)
    for n_pieces in range(2, MOST_PIECES + 1):
        rows = never_alone(np.flatnonzero(number == n_pieces))
        if rows.size:
            parts = _beats_of_parts(stack, clipped, rows, n_pieces, sample_interval)
            ratio_u, differ = _disagreement(beat, rows, *parts)
            beat = beat.widened(rows, ratio_u)
            flags[rows[differ]] |= Flag.PARTS_DIFFER
    return beat, flags


def _beats_of_parts(
    stack: Stack, clipped: Bools | None, rows: Indices, n_pieces: int, sample_interval: float
) -> tuple[Beat, Ints]:
    length = stack.n_samples // n_pieces

    def cut(samples: np.ndarray) -> np.ndarray:
        return samples[rows, : length * n_pieces].reshape(-1, length)

    parts = Stack(cut(stack.volts), (rows.size * n_pieces,), stack.nan_policy)
    fit = fit_waveform(parts, None if clipped is None else cut(clipped))
    return Beat.of(fit, length, sample_interval), fit.flags


def _disagreement(whole: Beat, rows: Indices, parts: Beat, part_flags: Ints) -> tuple[Floats, Bools]:
    """Standard uncertainty of the ratio by what parts differ by beyond noise, (r,), and where it is no chance."""
    value, radial, tangential = _lock_in(parts)
    values, variances = value.reshape(rows.size, -1), ((radial + tangential) / 2).reshape(rows.size, -1)
    lost = ((part_flags & int(FATAL)) != 0).reshape(values.shape) | ~np.isfinite(values) | ~(variances > 0)
    weights = np.where(lost, 0.0, 1 / np.where(lost, 1.0, variances))
    values = np.where(lost, 0.0, values)
    mean = np.sum(weights * values, axis=-1) / np.maximum(weights.sum(axis=-1), 1e-300)
    chi_square = np.sum(weights * np.abs(values - mean[:, np.newaxis]) ** 2, axis=-1)
    kept = values.shape[1] - lost.sum(axis=-1)
    chance = np.where(kept > 1, scipy.special.chdtrc(2 * np.maximum(kept - 1, 1), chi_square), 1.0)
    chance[lost.any(axis=-1)] = 0.0
    own = whole.take(rows)
    away = np.where(lost, 0.0, np.abs(values - _lock_in(own)[0][:, np.newaxis])) ** 2
    surplus = np.sum(away / 2 - np.where(lost, 0.0, variances), axis=-1) / np.maximum(kept, 1)
    slope = rate_and_slopes(own.size, own.frequency, None, "exact")[1]
    return np.where(chance < RARE, np.sqrt(np.maximum(surplus, 0.0)) / slope, 0.0), chance < UNLIKELY


def _lock_in(beat: Beat) -> tuple[Complexes, Floats, Floats]:
    """The lock-in rate, in units of 1/K, along the phase of rho, and its variances along and across."""
    value, by_ratio, by_frequency = rate_and_slopes(beat.size, beat.frequency, None, "exact")
    radial = by_ratio**2 * beat.ratio_u**2 + by_frequency**2 * beat.frequency_u**2
    across = np.where(beat.size > 0, value / np.where(beat.size > 0, beat.size, 1.0), by_ratio)
    direction = np.exp(1j * np.angle(beat.rho))
    return (
        np.asarray(value * direction),
        radial,
        np.asarray(across**2 * (beat.covariance[:, 2, 2] + beat.misfit**2)),
    )
