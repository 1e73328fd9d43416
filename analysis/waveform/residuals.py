"""What a fit leaves: is it white noise, is there a beat at all, is it the lock-in waveform?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.special

from analysis.arrays import Bools, Complexes, Floats, Indices, Ints, Samples
from analysis.flags import Flag
from analysis.waveform.masks import Masks
from analysis.waveform.misfit import (
    CURVED,
    LINE_CHANCE,
    NEIGHBOURS,
    left_over,
    line_stands_out,
    misfit_of,
    pedestal_power,
)
from analysis.waveform.records import records_at_once, sums_of_squares
from analysis.waveform.repeating import HIDDEN, SEEN, SURE, may_repeat, repeating
from analysis.waveform.series.frequency_search import Sizes, line_sizes, neighbours
from analysis.waveform.series.geometric_series import Series, sampled_blocks, sampled_series
from analysis.waveform.series.harmonic_sums import data_sums

ROUNDING = 1e-12
"""A residual below this share of the power is arithmetic, not a measured signal: a synthetic record."""

FEW_PERIODS = 6.0
VERY_FEW_PERIODS = 3.5

STEEPNESS = np.array([0.0, 0.5, 4.0])
"""Reciprocal variances of slope and curvature of a noise spectrum, on logarithmic scales, before it is seen: a
slope of -1 is common, a curve is rarely sharp."""

GROSS_MISFIT = 0.05
"""Share of the signal's power that a waveform may miss and still be called that of a gyro above lock-in."""

LARGE, SMOOTH = 0.5, 0.5
"""What is left may have so much of the signal's power only if its neighbouring samples do not agree by so much: a
chirp has a flat spectrum too, but is no noise."""

LEFT_BY_MOTION = 0.01
"""The same where a moving phase was fitted, which can follow nearly anything."""

ABOUT_SECOND = 2.0
"""Levels of noise about the second harmonic, in five bins, from which on the ratio may drift: 3 % of records."""

FEWEST_PERIODS = 3.0
GROSS_MISFIT_OF_A_CURVE = 0.002
"""The same with fewer periods than that: any slow curve nearly passes for a beat of two harmonics."""


@dataclass(frozen=True)
class Residual:
    """What a series leaves of (R,) records, without the samples themselves.

    power, largest : (R,) sum of squares and largest size
    lines : (R, N//2 + 1) sizes of the lines of its spectrum
    third : (R,) complex amplitude at three times the beat, its phase that in the middle of the record
    """

    power: Floats
    largest: Samples
    lines: Sizes
    third: Complexes

    @staticmethod
    def of(samples: Samples, omega: Floats) -> Residual:
        """From the samples (R, N), 0 where missing, and the frequencies (R,) of the beats, rad per sample."""
        largest = np.maximum(samples.max(axis=-1), -samples.min(axis=-1))
        third = 2 / samples.shape[1] * data_sums(samples, 3 * omega, 1, 0, 1)[:, 0, 0]
        return Residual(sums_of_squares(samples), largest, line_sizes(samples), third)

    @staticmethod
    def empty(n_records: int, n_samples: int, precision: np.dtype[Any]) -> Residual:
        """Room for the residuals of so many records."""
        lines: Sizes = np.empty((n_records, n_samples // 2 + 1), dtype=np.float32)
        third = np.empty(n_records, dtype=np.complex128)
        return Residual(np.empty(n_records), np.empty(n_records, dtype=precision), lines, third)

    def put(self, part: slice | Indices, other: Residual) -> None:
        """Write the other's records into the places `part` of this one."""
        self.power[part], self.largest[part] = other.power, other.largest
        self.lines[part], self.third[part] = other.lines, other.third


def residual_of(values: Samples, masks: Masks, series: Series) -> Residual:
    """Subtract the waveform from (R, N) records; a few at a time, since the samples left are used up at once."""
    n_records, n_samples = values.shape
    if n_records <= records_at_once(n_samples, values.dtype):
        left = left_by(series, values, None)
        masks.clear(left, slice(None))
        return Residual.of(left, series.omega)
    residual = Residual.empty(n_records, n_samples, values.dtype)
    for rows, model in sampled_blocks(series, n_samples, values.dtype):
        np.subtract(values[rows], model, out=model)
        masks.clear(model, rows)
        residual.put(rows, Residual.of(model, series.omega[rows]))
    return residual


def residual_samples(values: Samples, masks: Masks, series: Series, row: int) -> Samples:
    """What the waveform leaves of one record, (N,)."""
    here = np.array([row])
    return np.asarray(left_by(series.take(here), values[here], masks.of_any(here))[0])


def left_by(series: Series, values: Samples, weights: Samples | None) -> Samples:
    """What the waveforms leave of (R, N) records, (R, N)."""
    left = values - sampled_series(series, values.shape[1], values.dtype)
    return np.asarray(left if weights is None else left * weights)


@dataclass(frozen=True)
class ResidualReport:
    """flags : (R,); excess : (R, 3) variance factors of frequency, ratio size and ratio phase over white noise;
    uneven : (R,) where the spectrum is not flat, by lines or by broad humps; mean : (R,) mean power of a line;
    misfit : (R,) standard uncertainty of the ratio by what is no noise;
    stronger, drifting : (R,) for a closer look, where the noise is white but perhaps not all there is on the
    harmonics, and where the ratio may drift.
    """

    flags: Ints
    excess: Floats
    uneven: Bools
    mean: Floats
    misfit: Floats
    stronger: Bools
    drifting: Bools


def examine_residual(
    residual: Residual, n_samples: int, count: Floats, series: Series, repeated: Bools, *, moved: bool = False
) -> ResidualReport:
    """Judge the residual of each record by its spectrum."""
    sizes, residual_power, n_records = residual.lines, residual.power, len(count)
    omega, first = series.omega, np.abs(series.first)
    flags = np.zeros(n_records, dtype=np.int64)
    n_lines = sizes.shape[1] - 1
    # Parseval: the sum over the lines from the sum over the samples
    total = n_samples * residual_power - np.square(sizes[:, 0], dtype=np.float64)
    if n_samples % 2 == 0:
        total += np.square(sizes[:, -1], dtype=np.float64)
    mean = np.maximum(total / (2 * n_lines), 1e-30)
    line = np.square(sizes[:, 1:].max(axis=-1), dtype=np.float64) / mean
    expected = np.log(n_lines / LINE_CHANCE)

    signal = first**2 / 2 * count
    degrees = np.maximum(count - 6, 1)
    noise = residual_power / degrees
    # For noise alone the strongest of N/2 lines has an exponential tail: N/2 exp(-z).
    strength = signal / 2 / np.maximum(noise, 1e-300)
    flags[strength < np.log(n_samples / 2) + 18] |= Flag.NO_BEAT
    rounding = residual_power <= ROUNDING * signal
    rounding |= repeated
    uneven = (line > expected) & ~rounding
    misfit = uneven.copy()
    for row in np.flatnonzero(uneven):
        # So few periods leave a slow curve, which no neighbours tell from noise that rises to low frequencies.
        few = omega[row] * n_samples < 2 * np.pi * FEW_PERIODS
        misfit[row] = few or line_stands_out(np.square(sizes[row, 1:]), few_lines=True)
    flags[misfit] |= Flag.MISFIT
    for row in np.flatnonzero(uneven):
        power = np.square(sizes[row, 1:])
        lines = power[power > mean[row] * expected].sum() * 2 / n_samples
        few = omega[row] * n_samples < 2 * np.pi * FEWEST_PERIODS
        if lines > (GROSS_MISFIT_OF_A_CURVE if few else GROSS_MISFIT) * signal[row]:
            flags[row] |= Flag.NOT_LOCK_IN_LIKE

    for row in np.flatnonzero((residual_power > LARGE * signal) & ~rounding):
        if _neighbours_agree(sizes[row]) > SMOOTH:
            flags[row] |= Flag.NOT_LOCK_IN_LIKE
            uneven[row] = True

    excess = np.ones((n_records, 3))
    at_first = _local_level(sizes, omega, n_samples) / mean
    at_second = _local_level(sizes, 2 * omega, n_samples) / mean
    coloured = (np.maximum(at_first, at_second) > 1.6) | (np.minimum(at_first, at_second) < 0.6)
    coloured &= ~rounding
    flags[coloured] |= Flag.COLOURED_NOISE
    for row in np.flatnonzero(coloured):
        first_level, second_level = float(at_first[row]), float(at_second[row])
        if (line := omega[row] * n_samples / (2 * np.pi)) < 2 * NEIGHBOURS:
            first_level, second_level = _levels_of_few_periods(np.square(sizes[row, 1:]) / mean[row], line)
        # the ratio knows the noise of the fundamental too, less by the ratio itself
        squared = float(np.abs(series.ratio[row])) ** 2
        of_ratio = max(second_level, (second_level + squared * first_level) / (1 + squared))
        excess[row] = first_level, of_ratio, of_ratio
    ratio_u = np.zeros(n_records)
    for row in np.flatnonzero(misfit | coloured):
        power, beat = np.square(sizes[row, 1:]), (first[row] * n_samples / 2) ** 2
        line = omega[row] * n_samples / (2 * np.pi)
        pedestal = pedestal_power(power, line)
        if pedestal:
            flags[row] |= Flag.MISFIT
        if flags[row] & Flag.MISFIT:
            ratio = float(np.abs(series.ratio[row]))
            found = misfit_of(power, n_samples, line, float(first[row]), ratio, pedestal)
            excess[row, 0] += found.frequency
            ratio_u[row] = found.ratio
        surplus = left_over(power) if moved else 0.0
        if surplus:
            flags[row] |= Flag.MISFIT
            ratio_u[row] = np.hypot(ratio_u[row], np.sqrt(surplus / beat))
            if surplus > LEFT_BY_MOTION * beat:
                flags[row] |= Flag.NOT_LOCK_IN_LIKE
    suspects, stronger, drifting = np.zeros((3, n_records), dtype=bool)
    if not moved:
        by_third, curved = _by_third_harmonic(residual, series, mean, uneven | coloured, n_samples)
        ratio_u = np.maximum(ratio_u, np.where(rounding, 0.0, by_third))
        flags[curved & ~rounding] |= Flag.MISFIT
        suspects, stronger = (found & ~rounding for found in may_repeat(sizes, omega, mean, n_samples))
        stronger &= ~(uneven | coloured)
        drifting = uneven | coloured | (_local_level(sizes, 2 * omega, n_samples, 2) > ABOUT_SECOND * mean)
        drifting &= ~rounding
    for row in np.flatnonzero(suspects):
        beats = omega[row] * n_samples / (2 * np.pi)
        surplus, sure = repeating(np.square(sizes[row, 1:]), beats, n_samples)
        ratio_u[row] = np.hypot(ratio_u[row], HIDDEN * np.sqrt(surplus) / (first[row] * n_samples / 2))
        if sure:
            flags[row] |= Flag.MISFIT
    return ResidualReport(flags, excess, uneven, mean, ratio_u, stronger, drifting)


def _by_third_harmonic(
    residual: Residual, series: Series, mean: Floats, uneven: Bools, n_samples: int
) -> tuple[Floats, Bools]:
    """Standard uncertainty of the ratio (R,) by a third harmonic alone, 0 where noise often has as much, and where
    it is no chance.

    It has one place, so that less than a line anywhere counts.
    """
    third = np.abs(residual.third) * (n_samples / 2)
    level, rows = mean.copy(), np.flatnonzero(uneven)
    level[rows] = np.maximum(level[rows], _local_level(residual.lines[rows], 3 * series.omega[rows], n_samples))
    hidden = CURVED * third / (np.abs(series.first) * n_samples / 2)
    power = third**2 / level
    return np.where(power > -np.log(SEEN), hidden, 0.0), power > -np.log(SURE)


def _levels_of_few_periods(power: Samples, line: float) -> tuple[float, float]:
    """Noise at the fundamental and at the second harmonic, from the lines of a spectrum over their mean."""
    levels = _low_levels(power, line)
    if line < FEW_PERIODS:
        # So few periods do not keep the lines apart: the stronger noise reaches both, and what is below.
        strongest = float(levels[0 if line < VERY_FEW_PERIODS else 1 :].max())
        return strongest, strongest
    return float(levels[1]), float(levels[2])


def _neighbours_agree(sizes: Samples) -> float:
    """Correlation of neighbouring samples, from the lines (N/2 + 1,) of a spectrum."""
    power = np.square(sizes, dtype=np.float64)
    return float(power @ np.cos(np.linspace(0, np.pi, power.size)) / max(float(power.sum()), 1e-300))


def _low_levels(power: Samples, line: float) -> Floats:
    """Noise level at half a line of few periods, at the line and at its double, (3,).

    Near zero frequency the noise may change within a few bins, so that an average over neighbours would not do.
    Instead its logarithm is fitted by a parabola in the logarithm of the frequency, by maximum likelihood: the
    power of each bin scatters about the level as an exponential variable. White and 1/f noise are exact cases.
    The bins of the lines themselves are left out: the fit has emptied them. A level that rests on few bins is
    raised by what Student's distribution asks for. Where none is left the noise counts as white.
    """
    bins = np.arange(1, min(int(4 * line) + 12, power.size) + 1)
    free = (np.abs(bins - line) > 1.5) & (np.abs(bins - 2 * line) > 1.5)
    if not free.any():
        return np.ones(3)
    position = np.log(bins / line)
    columns = np.stack([np.ones(bins.size), position, position**2], axis=-1)[free]
    seen = power[: bins.size][free].astype(np.float64)
    curve = np.array([np.log(seen.mean() + 1e-300), 0.0, 0.0])
    information = columns.T @ columns + np.diag(STEEPNESS)
    spread = np.linalg.inv(information)
    for _ in range(12):
        surplus = np.clip(seen / np.exp(columns @ curve) - 1, -1.0, 3.0)
        change = spread @ (columns.T @ surplus - STEEPNESS * curve)
        curve = curve + change
        if np.abs(change).max() < 1e-3:
            break
    levels = []
    for place in np.log([0.5, 1.0, 2.0])[:, np.newaxis] ** np.arange(3):
        # a power estimated with v degrees of freedom has a relative variance of 2/v
        degrees = 2 / float(place @ spread @ place)
        student = float(scipy.special.stdtrit(degrees, 0.975) / scipy.special.ndtri(0.975))
        levels.append(float(np.exp(curve @ place)) * student**2)
    return np.array(levels)


def _local_level(sizes: Sizes, omega: Floats, n_samples: int, most: int = NEIGHBOURS) -> Floats:
    """Mean power of the bins around a (folded) frequency, so many on either side; (R,)."""
    folded = np.abs((omega + np.pi) % (2 * np.pi) - np.pi)
    centre = np.rint(folded * n_samples / (2 * np.pi)).astype(int)
    n_lines = sizes.shape[1] - 1
    reach = min(most, (n_lines - 1) // 2)
    found = neighbours(sizes, np.clip(centre, reach + 1, n_lines - reach) - reach, 2 * reach + 1)
    return np.asarray(np.vecdot(found, found) / found.shape[1], dtype=np.float64)
