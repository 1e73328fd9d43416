"""What the converter does: clipped samples and spikes that must not be believed, and rounding."""

import math
from dataclasses import dataclass

import numpy as np

from analysis.arrays import Bools, Floats, Indices, Ints, Samples
from analysis.flags import Flag
from analysis.waveform.frequency import LARGEST_CODE, THINNING, Counts, Records, Sizes, never_alone
from analysis.waveform.residuals import Masks, Residual, residual_samples
from analysis.waveform.series import Series, sampled_series
from analysis.waveform.series_fit import SeriesFit

SHARE_AT_END = 0.006
"""A level that holds less than this share of the samples is not worth calling a clipping limit."""

SHARE_AT_LAST_CODE = 0.001
"""The same where the level is the last one of eight-bit codes, which no smooth wave need explain."""

CROWDING, CROWDING_IN_NOISE = 4.0, 1.5
"""A smooth crest of a quantised wave puts at most about 2.4 times as many samples into its last level as into the
one before, and less than as many if there is noise; one clipped by some levels many times more. Where a crest is
sampled at a few of its phases only, again and again, it may look clipped: a few good samples are then left out."""

NOISY = 0.6  # levels of residual rms from which on there is noise in this sense

EXCESS = 0.17
"""Levels by which the fitted wave may lie beyond the samples in its last level, in the mean: a crest that just
fills its level lies 1/6 beyond, one clipped by a level mostly twice as far."""

NOTHING = 1e-8

NEARLY_WHOLE = 1e-3  # single precision and the mean that was taken off leave codes whole to much better than this
SPIKE = 7.0  # residuals beyond this many (robust) standard deviations are no noise: once in 10^12 samples
LONGEST_SPIKE = 4  # samples in a row beyond which it is no spike, but a piece of another signal
SETTLING = 20  # samples from the first one on in which something that dies away so soon may be seen
BESIDE = 3.5  # the same for a sample beside one beyond `SPIKE`: noise has one there in a thousand spikes
TOGETHER = 1e-6  # share of records in which as many spikes at random places stand as close together


@dataclass(frozen=True)
class SampleDamage:
    """flags : (R,); rows : (H,) of the clipped records; weights : (H, N) of them, clipped samples left out;
    limits : (H, 2) the range between their clipping limits, +-inf on the side where not clipped.
    """

    flags: Ints
    rows: Indices
    weights: Samples
    limits: Floats


def find_damage(records: Records, fit: SeriesFit, clipped: Bools | None) -> SampleDamage:
    """Find clipped samples, from the caller's mask, in raw codes, or at levels that are too crowded."""
    values, weights = records.values, records.weights
    flags = np.zeros(len(values), dtype=np.int64)
    if clipped is None:
        high = _limit(records, fit, _crowded(records, records.highest, records.at_highest), 1)
        low = _limit(records, fit, _crowded(records, records.lowest, records.at_lowest), -1)
        # One clipped end makes the other suspect, however few samples a narrow crest leaves there.
        high = np.minimum(high, _limit(records, fit, np.flatnonzero(np.isfinite(low) & ~np.isfinite(high)), 1))
        low = -np.minimum(low, _limit(records, fit, np.flatnonzero(np.isfinite(high) & ~np.isfinite(low)), -1))
    else:
        low, high = _known_limits(values, weights, clipped)
    if weights is not None:
        flags[(weights == 0).any(axis=-1)] |= Flag.DAMAGED
    rows = never_alone(np.flatnonzero((np.isfinite(low) | np.isfinite(high)) & ~records.constant))
    flags[rows] |= Flag.CLIPPED
    some, limits = values[rows], np.stack([low, high], axis=-1)[rows]
    kept = (some > limits[:, :1]) & (some < limits[:, 1:])
    undamaged = kept.astype(values.dtype) if weights is None else kept * weights[rows]
    return SampleDamage(flags, rows, undamaged, limits)


def _known_limits(values: Samples, weights: Samples | None, clipped: Bools) -> tuple[Samples, Samples]:
    """Values (R,) between which nothing is clipped, as the caller knows it; -inf and inf where nothing is."""
    low, high = (np.full(len(values), end, dtype=values.dtype) for end in (-np.inf, np.inf))
    rows = np.flatnonzero(clipped.any(axis=-1))
    known, some = clipped[rows], values[rows]
    if weights is not None:
        known &= weights[rows] > 0
    low[rows] = np.where(known & (some < 0), some, -np.inf).max(axis=-1)
    high[rows] = np.where(known & (some >= 0), some, np.inf).min(axis=-1)
    return low, high


def _crowded(records: Records, end: Samples, at_end: Counts) -> Indices:
    """Records of which many samples have the extreme value `end` (R,), or whose extreme value is the last code."""
    many = at_end > SHARE_AT_END * records.values.shape[1] / THINNING
    return np.flatnonzero(many | _is_last_code(end + records.centre))


def _is_last_code(value: Floats) -> Bools:
    return np.asarray(np.abs(np.abs(value) - LARGEST_CODE) < NEARLY_WHOLE)


def _limit(records: Records, fit: SeriesFit, suspects: Indices, sign: int) -> Floats:
    """`sign` times the highest (1) or lowest (-1) value where that is a clipping limit, else inf; (R,)."""
    n_samples = records.values.shape[1]
    limit = np.full(len(records.values), np.inf)
    if suspects.size == 0:
        return limit
    end = records.highest if sign > 0 else records.lowest
    values, top = sign * records.values[suspects], sign * end[suspects]
    at_top = values >= top[:, np.newaxis]
    crowd = _how_many(at_top)
    if records.weights is not None:
        values[records.weights[suspects] == 0] = -np.inf
    np.copyto(values, -np.inf, where=at_top)
    second = values.max(axis=-1)
    level = top - second
    in_second = _how_many(values == second[:, np.newaxis])
    noisy = np.sqrt(fit.residual_power[suspects] / n_samples) > NOISY * level
    # What a moving rate leaves is no noise: that shows between neighbouring samples too.
    for place in np.flatnonzero(noisy & (crowd > CROWDING_IN_NOISE * in_second) & (crowd <= CROWDING * in_second)):
        noisy[place] = np.std(np.diff(records.values[suspects[place]], n=2)) > np.sqrt(6) * NOISY * level[place]
    found = crowd > np.where(noisy, CROWDING_IN_NOISE, CROWDING) * in_second
    # What one level of clipping does to the counts, a smooth crest may nearly do.
    for place in np.flatnonzero(~found & (crowd > CROWDING_IN_NOISE * in_second)):
        model = sign * sampled_series(fit.series.take(suspects[[place]]), n_samples)[0]
        found[place] = np.mean(model[at_top[place]]) - top[place] > EXCESS * level[place]
    found &= crowd > SHARE_AT_END * n_samples
    last_code = _is_last_code(end[suspects] + records.centre[suspects])
    for place in np.flatnonzero(last_code & (crowd > SHARE_AT_LAST_CODE * n_samples)):
        row = suspects[place]
        codes = records.values[row] + records.centre[row]
        if records.weights is not None:
            codes = codes[records.weights[row] > 0]
        found[place] = np.abs(codes - np.rint(codes)).max() < NEARLY_WHOLE
    limit[suspects[found]] = top[found]
    return limit


def _how_many(found: Bools) -> Counts:
    """True values of each row; several times faster than `np.count_nonzero`."""
    return np.asarray(found.view(np.uint8).sum(axis=-1, dtype=np.uint32))


def outliers(
    values: Samples, masks: Masks, series: Series, residual: Residual, swing: Samples
) -> dict[int, tuple[Bools, bool]]:
    """Samples (N,) of each record that are no noise, and whether they are part of another signal, not spikes."""
    # Many of them are a misfit, and are kept.
    spikes = {}
    # A single spike cannot hide: it stands out of the rms that it itself has raised. Missing samples are 0.
    rms = np.sqrt(residual.power / values.shape[1])
    for row in map(int, np.flatnonzero(residual.largest > 5 * rms)):
        left, mask = residual_samples(values, masks, series, row), masks.of_one(row)
        size, valid = np.abs(left), slice(None) if mask is None else mask > 0
        wave = values[row] - left
        edges = np.quantile(wave[valid], np.linspace(0.0, 1.0, HEIGHTS + 1)[1:-1])
        height = np.searchsorted(edges, wave)
        whole, held = 1.4826 * float(np.median(size[valid])), height[valid]
        at_heights = [np.median(some) if (some := size[valid][held == k]).size else 0.0 for k in range(HEIGHTS)]
        noise = np.maximum(1.4826 * np.array(at_heights), whole)[height]
        found = size > np.maximum(SPIKE * noise, NOTHING * float(swing[row]))
        if found.any() and found.mean() <= 0.02:
            spikes[row] = found, is_a_piece(found, size > BESIDE * noise)
    return spikes


HEIGHTS = 8  # parts of the beat, from its lowest samples to its highest, that have a noise of their own


def is_a_piece(found: Bools, suspect: Bools) -> bool:
    """Whether outliers (N,) stand closer together than spikes do, or go on in what is `suspect` (N,) there."""
    # Where they stand in the very first samples only they are the end of something that dies away, as a gyro that
    # settles does.
    if found[0] and not found[SETTLING:].any():
        return True
    edges = np.flatnonzero(np.diff(suspect, prepend=False, append=False)).reshape(-1, 2)
    if any(stop - start > LONGEST_SPIKE and found[start:stop].any() for start, stop in edges):
        return True
    # noise breaks up what is left of a piece
    at = np.flatnonzero(found)
    for count in range(LONGEST_SPIKE + 1, at.size + 1):
        span = float(np.min(at[count - 1 :] - at[: at.size - count + 1]))
        # so many others within the span behind any of them
        chance = at.size * np.exp((count - 1) * np.log(at.size * span / found.size) - math.lgamma(count))
        if chance < TOGETHER:
            return True
    return False


# --------------------
# Rounding of the converter where it is not noise.
#
# With less than about a third of a level of noise, the error of rounding is a function of the waveform itself: it
# stands on the harmonics and does not average out. Its mean over the noise is known. For a waveform value v, in
# levels from a code, and Gaussian noise of s levels,
#
#     e(v) = sum over m >= 1 of (-1)^m / (pi m) exp(-2 pi^2 m^2 s^2) sin(2 pi m v)
#
# (the Fourier series of the sawtooth, damped by the noise). Taken out of the record, it leaves less than the
# twelfth of a squared level that white rounding would


QUIET = 0.42
"""Residual rms in levels below which rounding is taken out: 0.3 of noise and 0.29 of rounding. Above it would win
less than 1 % of the uncertainty."""

TERMS = 8
SMALLEST_TERM = 1e-4

SILENT = 0.36
"""Residual rms in levels above which no rounding error repeats, and one correction is enough: 0.2 of noise."""

LEAST_RMS = 0.08  # residual rms in levels that the truncated series leaves of a record without any noise

LEFTOVER, LEFTOVER_FALL = 0.22, 0.075
"""Relative surplus of the uncertainty there, and the rms over which it falls to a third."""

REPEATED = 1.3
LOCKED = 6.0  # repetition from which on the rounding errors are too few to be told from the waveform itself
SAME_PHASE = 0.05  # beat periods by which a cycle may drift over the record and still repeat

AS_OFTEN = 2.5
"""The spectrum's lines scatter, so the repetition found may exceed the number of cycles by this factor."""

FEW_ERRORS = 1.25  # factor of the variance for so few errors, which are not Gaussian, from random records as above

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
    """How many times the same errors occur in a residual, from its lines, (R, L) -> (R,): 1 for white noise."""
    # Where the sampling is locked to the beat, a few rounding errors repeat over the whole record. Their spectrum
    # is then a few lines, while the lines of white noise scatter as much as their mean.
    power = np.square(lines[:, 1:], dtype=np.float64)
    total = np.maximum(power.sum(axis=-1), 1e-300)
    return np.asarray(np.vecdot(power, power) * power.shape[1] / (2 * total**2))


def locked_to_the_beat(omega: Floats, repeated: Floats, n_samples: int) -> Bools:
    """Whether a residual that repeats (R,) does so because the sampling is locked to the beat."""
    # After some number of samples the beat must stand at the same phase again, all through the record; its errors
    # can then repeat no more often than the record holds such cycles. A waveform of another shape repeats too, but
    # with every beat, and so more often.
    locked = repeated > LOCKED
    cycles = np.arange(2, n_samples // 2)
    turns = omega[locked, np.newaxis] / (2 * np.pi) * cycles
    drift = np.abs(turns - np.rint(turns)) * (n_samples / cycles)
    in_phase = (drift < SAME_PHASE) & (turns > 0.5)
    most = np.where(in_phase.any(axis=-1), n_samples / cycles[in_phase.argmax(axis=-1)], 0.0)
    locked[locked] = repeated[locked] < AS_OFTEN * most
    return locked


def leftover_excess(residual: Residual, n_samples: int, spacing: Floats) -> Floats:
    """Factor (R,) by which the variance of the estimates exceeds that of white noise as strong as the residual."""
    # What the correction leaves of the rounding error is not white noise: it sits on the few samples next to a
    # change of level, and follows the waveform. The factor is calibrated on random records
    # (`benchmarks.estimator`).
    rms = np.sqrt(residual.power / n_samples) / spacing
    along = 1 + LEFTOVER * np.exp((LEAST_RMS - rms) / LEFTOVER_FALL)
    silent = np.flatnonzero(rms < SILENT)
    repeated = np.ones(rms.size)
    repeated[silent] = repetition(residual.lines[silent])
    return np.asarray(along**2 * np.where(repeated > REPEATED, repeated, 1.0))
