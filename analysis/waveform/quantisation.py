"""Rounding of the converter where it is not noise.

With less than about a third of a level of noise, the error of rounding is a function of the waveform itself: it
stands on the harmonics and does not average out. Its mean over the noise is known. For a waveform value v, in
levels from a code, and Gaussian noise of s levels,

    e(v) = sum over m >= 1 of (-1)^m / (pi m) exp(-2 pi^2 m^2 s^2) sin(2 pi m v)

(the Fourier series of the sawtooth, damped by the noise). Taken out of the record, it leaves less than the twelfth
of a squared level that white rounding would.
"""

from __future__ import annotations

import numpy as np

from analysis.arrays import Bools, Floats, Samples
from analysis.waveform.residuals import Residual
from analysis.waveform.series.frequency_search import Sizes

QUIET = 0.42
"""Residual rms in levels below which rounding is taken out: 0.3 of noise and 0.29 of rounding. Above it would win
less than 1 % of the uncertainty."""

TERMS = 8
SMALLEST_TERM = 1e-4

SILENT = 0.36
"""Residual rms in levels above which no rounding error repeats, and one correction is enough: 0.2 of noise."""

LEAST_RMS = 0.08
"""Residual rms in levels that the truncated series leaves of a record without any noise."""

LEFTOVER, LEFTOVER_FALL = 0.22, 0.075
"""Relative surplus of the uncertainty there, and the rms over which it falls to a third."""

REPEATED = 1.3
LOCKED = 6.0
"""Repetition from which on the rounding errors are too few to be told from the waveform itself."""

SAME_PHASE = 0.05
"""Beat periods by which a cycle may drift over the record and still repeat."""

AS_OFTEN = 2.5
"""The spectrum's lines scatter, so the repetition found may exceed the number of cycles by this factor."""

FEW_ERRORS = 1.25
"""Factor of the variance for so few errors, which are not Gaussian, from random records as above."""

RUNS = (50, 400)
"""So many neighbouring samples of a record are compared to see whether rounding might matter at all; then more of
those of which the first have not cleared it."""


def level_spacing(values: Samples, residual_rms: Floats) -> Floats:
    """Spacing of the converter's levels where rounding is not white in a record, else 0; (R,)."""
    # No two different values are closer than the spacing, so any small difference clears a record.
    suspects = np.arange(len(values))
    for run in RUNS:
        some = values[suspects, :run]
        differences = np.abs(np.diff(some, axis=-1))
        limit = (residual_rms[suspects] / QUIET).astype(values.dtype)[:, np.newaxis]
        tiny = 1e-6 * np.abs(some).max(axis=-1, keepdims=True)
        suspects = suspects[~((differences > tiny) & (differences < limit)).any(axis=-1)]
    spacing = np.zeros(len(values))
    if suspects.size:
        exact = _exact_spacing(values[suspects])
        spacing[suspects] = np.where(residual_rms[suspects] < QUIET * exact, exact, 0.0)
    return spacing


def of_few_levels(volts: Samples, amplitude: Floats, residual_rms: Floats, fewest: Floats) -> Bools:
    """Where the amplitude of the beat is less than so many levels of the converter, (R,)."""
    few = np.zeros(len(volts), dtype=bool)
    # rounding leaves the root of a twelfth of a level at least
    suspects = np.flatnonzero(amplitude < fewest * np.sqrt(12) * residual_rms)
    for run in RUNS:
        differences = np.abs(np.diff(volts[suspects, :run].astype(np.float64), axis=-1))
        limit = (amplitude[suspects] / fewest[suspects])[:, np.newaxis]
        finer = (differences > 1e-6 * limit) & (differences < limit * (1 - 1e-6))
        coarse = ~finer.any(axis=-1)
        suspects = suspects[coarse]
    # where they are all the same they say nothing
    few[suspects] = differences[coarse].any(axis=-1)
    return few


def _exact_spacing(values: Samples) -> Floats:
    """Spacing of equidistant levels, 0 where the values do not lie on such; (R, N) -> (R,)."""
    lowest = values.min(axis=-1, keepdims=True)
    span = (values.max(axis=-1, keepdims=True) - lowest).astype(np.float64)
    gaps = np.abs(np.diff(values, axis=-1))
    gaps[gaps < 1e-6 * span] = np.inf
    smallest = gaps.min(axis=-1, keepdims=True)
    steps = np.rint(span / smallest)
    spacing = span / np.maximum(steps, 1)
    away = (values - lowest) / spacing.astype(values.dtype)
    # More levels than an eight-bit converter has twice over: a finer one, or a file of decimals.
    on_grid = (steps >= 2) & (steps < 600) & (np.abs(away - np.rint(away)).max(axis=-1, keepdims=True) < 0.02)
    return np.asarray(np.where(on_grid, spacing, 0.0)[:, 0])


def mean_rounding(model: Samples, values: Samples, spacing: Floats, residual_rms: Floats) -> Samples:
    """Mean of the rounding error on each sample, (R, N), in the unit of `values`."""
    noise = np.sqrt(np.maximum((residual_rms / spacing) ** 2 - 1 / 12, 0.0))
    step = spacing.astype(values.dtype)[:, np.newaxis]
    level = (model - values[:, :1]) / step
    level -= np.rint(level)
    angle = 2 * np.pi * level
    error = np.zeros_like(model)
    for m in range(1, TERMS + 1):
        size = (-1) ** m / (np.pi * m) * np.exp(-2 * (np.pi * m * noise) ** 2)
        size[np.abs(size) < SMALLEST_TERM] = 0.0
        if not size.any():
            break
        error += size.astype(values.dtype)[:, np.newaxis] * np.sin(m * angle)
    return np.asarray(error * step)


def repetition(lines: Sizes) -> Floats:
    """How many times over the same errors occur in a residual, from its lines, (R, L) -> (R,): 1 for white noise.

    Where the sampling is locked to the beat, a few rounding errors repeat over the whole record. Their spectrum is
    then a few lines, while the lines of white noise scatter as much as their mean.
    """
    power = np.square(lines[:, 1:], dtype=np.float64)
    total = np.maximum(power.sum(axis=-1), 1e-300)
    return np.asarray(np.vecdot(power, power) * power.shape[1] / (2 * total**2))


def locked_to_the_beat(omega: Floats, repeated: Floats, n_samples: int) -> Bools:
    """Whether a residual that repeats (R,) does so because the sampling is locked to the beat.

    After some number of samples the beat must stand at the same phase again, all through the record; its errors
    can then repeat no more often than the record holds such cycles. A waveform of another shape repeats too, but
    with every beat, and so more often.
    """
    locked = repeated > LOCKED
    cycles = np.arange(2, n_samples // 2)
    turns = omega[locked, np.newaxis] / (2 * np.pi) * cycles
    drift = np.abs(turns - np.rint(turns)) * (n_samples / cycles)
    in_phase = (drift < SAME_PHASE) & (turns > 0.5)
    most = np.where(in_phase.any(axis=-1), n_samples / cycles[in_phase.argmax(axis=-1)], 0.0)
    locked[locked] = repeated[locked] < AS_OFTEN * most
    return locked


def leftover_excess(residual: Residual, n_samples: int, spacing: Floats) -> Floats:
    """Factor by which the variance of the estimates exceeds that of white noise of the residual's strength, (R,).

    What the correction leaves of the rounding error is not white noise: it sits on the few samples next to a
    change of level, and follows the waveform. The factor is calibrated on random records (`benchmarks.estimator`).
    """
    rms = np.sqrt(residual.power / n_samples) / spacing
    along = 1 + LEFTOVER * np.exp((LEAST_RMS - rms) / LEFTOVER_FALL)
    silent = np.flatnonzero(rms < SILENT)
    repeated = np.ones(rms.size)
    repeated[silent] = repetition(residual.lines[silent])
    return np.asarray(along**2 * np.where(repeated > REPEATED, repeated, 1.0))
