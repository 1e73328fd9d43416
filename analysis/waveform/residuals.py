"""What a fit leaves: white noise, a beat at all, the lock-in waveform; masks; what misfit costs."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.special

from analysis.arrays import Bools, Complexes, Floats, Indices, Ints, Samples, Stacked
from analysis.flags import Flag
from analysis.waveform.frequency import Sizes, line_sizes, neighbours, records_at_once, sums_of_squares
from analysis.waveform.series import Series, data_sums, sampled_blocks, sampled_series

# --------------------
# What a residual that is not noise may have done to the frequency and to the ratio.
#
# A fit hides the part of a contaminant that looks like the waveform; what it leaves shows how large the rest is. A
# line of the size a, next to a beat of the size A, may have a twin where nobody sees it:
#
# - at d bins from the second harmonic its foot there is a/(pi d), and moves the ratio by as much over A; at d bins
#   from the fundamental it moves the ratio by r a/(pi d A);
# - on a higher harmonic it comes from a curved characteristic, which makes a second harmonic of like size;
# - sidebands of the power p (over that of the fundamental) are those of a phase that moves by sqrt(p) rad. Such a
#   phase takes exp(-p/2) from the fundamental, exp(-2p) from the second harmonic, so 3p/2 from the ratio; and two
#   sidebands make a third of the size p/4, which may fall onto the second harmonic.
#
# All of them enter as standard uncertainties. They are no noise: the ratio is not freed of a bias by them, and
# what all records of a bench have in common does not average out


LINE_CHANCE = 1e-6  # a residual line that noise would produce in fewer than this share of records is a misfit
NEIGHBOURS = 24  # bins on either side over which the spectrum of noise is taken to be flat
CLEAR = 6.0  # levels of its neighbourhood beyond which the power of a bin counts: noise does so once in 400 bins

CURVED = 2.0
"""Size of the second harmonic that a curved characteristic may make, over that of a higher one that is seen."""

ORDERS = 12

FLOOR_PARTS = 8
"""Of so many parts of the spectrum the last but one in power is taken for the noise that a moving phase leaves."""

LEFT_OVER = 6.0
"""Standard deviations by which the whole must exceed it to say that the moving phase is not the right one."""

PEDESTAL = 6.0  # standard deviations by which the power about the fundamental must exceed that on its sides


def surroundings(power: Samples) -> Floats:
    """Level of the noise about each line of a spectrum (L,), whatever lines stand in it."""
    from scipy.ndimage import median_filter  # takes longer to import than most that use this module would wait for

    # The median, since a wrong waveform leaves a comb of lines.
    around = median_filter(power.astype(np.float64), size=2 * NEIGHBOURS + 1, mode="mirror") / math.log(2)
    # Below the first whole window the noise may rise as 1/f: its neighbours are then those on the same side.
    bins = np.arange(1, NEIGHBOURS)
    around[: bins.size] = np.maximum(around[NEIGHBOURS], around[: bins.size]) * NEIGHBOURS / bins
    return np.asarray(around)


def line_stands_out(power: Samples, chance: float = LINE_CHANCE, *, few_lines: bool = False) -> bool:
    """Whether a line of a spectrum (L,) stands out of its neighbours, as hardly any does in any noise."""
    # `few_lines` is the answer where there are too few lines to have neighbours.
    if power.size < 2 * (2 * NEIGHBOURS + 1):
        return few_lines
    strongest = float((power / np.maximum(surroundings(power), 1e-300)).max())
    return strongest > math.log(power.size / chance)


def misfit_of(
    power: Samples, n_samples: int, line: float, first: float, ratio: float, pedestal: float
) -> tuple[float, float]:
    """Variance of the frequency over that of white noise, and u of the ratio, by residual lines."""
    mean = float(power.mean())
    beat = (first * n_samples / 2) ** 2
    around = surroundings(power) if power.size > 2 * NEIGHBOURS else np.full(power.size, mean)
    stands_out = np.where(power > CLEAR * around, power, 0.0) / mean
    at = np.arange(1, power.size + 1)
    # where lines of any frequency stand in the spectrum of the samples, and the size of a foot at so many bins
    folded = np.abs((line * np.arange(1.0, ORDERS + 1) + n_samples / 2) % n_samples - n_samples / 2)
    feet = [1 / np.maximum(np.pi * np.abs(at - one), 1.0) ** 2 for one in folded]
    by_frequency = float(stands_out @ feet[0])
    curved = CURVED**2 * np.max(feet[2:], axis=0)
    by_ratio = float(stands_out @ (ratio**2 * feet[0] + np.maximum(feet[1], curved)))
    lines = float(stands_out.sum()) * mean / beat
    turned = 1.5 * ratio * pedestal / beat + float(turned_by(lines, ratio))
    return 2 * by_frequency, math.sqrt(by_ratio * mean / beat + turned**2)


def turned_by(sidebands: float | Floats, ratio: float | Floats) -> Floats:
    """What a moving phase may do to a ratio, by the power of its sidebands over that of the fundamental."""
    return np.asarray(1.5 * ratio * sidebands + 0.25 * sidebands)


def pedestal_power(power: Samples, line: float) -> float:
    """Power of what rises towards the fundamental on both sides; 0 where that may be chance."""
    at = np.arange(1, power.size + 1)
    away = np.abs(at - line) / line
    inside, below, above = away < 0.25, (away >= 0.25) & (away < 0.5) & (at < line), (away >= 0.25) & (away < 0.5)
    above &= at > line
    if min(below.sum(), above.sum()) < 2:
        return 0.0
    side = max(float(power[below].mean()), float(power[above].mean()))
    scatter = side * math.sqrt(1 / inside.sum() + 1 / min(below.sum(), above.sum()))
    surplus = float(power[inside].mean()) - side
    return surplus * float(inside.sum()) if surplus > PEDESTAL * scatter else 0.0


def left_over(power: Samples) -> float:
    """Power (the sum of lines) that a moving phase leaves beyond the noise; 0 where that may be chance."""
    # A moving phase that is the right one leaves noise. The noise is read where the spectrum (L,) is lowest, since
    # what is wrong stands about the harmonics, often as wide as they are apart.
    if power.size < FLOOR_PARTS:
        return 0.0
    parts = np.array_split(power.astype(np.float64), FLOOR_PARTS)
    floor = float(np.sort([np.median(part) for part in parts])[1]) / math.log(2)
    surplus = float(power.sum()) - floor * power.size
    scatter = floor * math.sqrt(FLOOR_PARTS * power.size)
    return surplus if surplus > LEFT_OVER * scatter else 0.0


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

LEFT_BY_MOTION = 0.01  # the same where a moving phase was fitted, which can follow nearly anything

ABOUT_SECOND = 2.0
"""Levels of noise about the second harmonic, in five bins, from which on the ratio may drift: 3 % of records."""

FEWEST_PERIODS = 3.0
GROSS_MISFIT_OF_A_CURVE = 0.002
"""The same with fewer periods than that: any slow curve nearly passes for a beat of two harmonics."""


@dataclass(frozen=True)
class Residual(Stacked):
    """What a series leaves of (R,) records, without the samples themselves."""

    power: Floats  # (R,) sum of squares and largest size
    largest: Samples
    lines: Sizes  # (R, N//2 + 1) sizes of the lines of its spectrum
    third: Complexes  # (R,) complex amplitude at three times the beat, its phase that in the middle of the record

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
class ResidualReport(Stacked):
    """What the residuals of R records say."""

    flags: Ints
    excess: Floats  # (R, 3) variance factors of frequency, ratio size and ratio phase over white noise
    uneven: Bools  # where the spectrum is not flat, by lines or by broad humps
    mean: Floats  # power of a line
    misfit: Floats  # standard uncertainty of the ratio by what is no noise
    repeats: Bools  # for a closer look: harmonics may be stronger than noise,
    stronger: Bools  # the same where the noise is white,
    drifting: Bools  # and the ratio may drift


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
    for row in np.flatnonzero(uneven):
        power = np.square(sizes[row, 1:])
        lines = power[power > mean[row] * expected].sum() * 2 / n_samples
        few = omega[row] * n_samples < 2 * np.pi * FEWEST_PERIODS
        if lines > (GROSS_MISFIT_OF_A_CURVE if few else GROSS_MISFIT) * signal[row]:
            flags[row] |= Flag.NOT_LOCK_IN_LIKE
    for row in np.flatnonzero((residual_power > LARGE * signal) & ~rounding):
        power = np.square(sizes[row], dtype=np.float64)
        # correlation of neighbouring samples
        if power @ np.cos(np.linspace(0, np.pi, power.size)) > SMOOTH * max(float(power.sum()), 1e-300):
            flags[row] |= Flag.NOT_LOCK_IN_LIKE
            uneven[row] = True

    levels = np.stack([_local_level(sizes, k * omega, n_samples) for k in (1, 2)], axis=1) / mean[:, np.newaxis]
    coloured = levels.max(axis=1) > 1.6
    if not moved:  # a motion takes noise from where it has its sidebands, and u knows of it
        coloured |= levels.min(axis=1) < 0.6
    coloured &= ~rounding
    flags[coloured] |= Flag.COLOURED_NOISE
    excess, ratio_u = np.ones((n_records, 3)), np.zeros(n_records)
    excess[coloured, :2] = levels[coloured]
    suspects, stronger, drifting = np.zeros((3, n_records), dtype=bool)
    if not moved:
        by_third, curved = _by_third_harmonic(residual, series, mean, uneven | coloured, n_samples)
        ratio_u = np.where(rounding, 0.0, by_third)
        flags[curved & ~rounding] |= Flag.MISFIT
        suspects, stronger = (found & ~rounding for found in may_repeat(sizes, omega, mean, n_samples))
        stronger &= ~(uneven | coloured)
        drifting = uneven | coloured | (_local_level(sizes, 2 * omega, n_samples, 2) > ABOUT_SECOND * mean)
        drifting &= ~rounding
    return ResidualReport(flags, excess, uneven, mean, ratio_u, suspects, stronger, drifting)


def examine_lines(
    report: ResidualReport, residual: Residual, n_samples: int, series: Series, rows: Bools, *, moved: bool = False
) -> None:
    """What the lines of some spectra say more; the report is changed."""
    sizes, omega, first = residual.lines, series.omega, np.abs(series.first)
    lines = omega * n_samples / (2 * np.pi)
    for row in np.flatnonzero(report.uneven & rows):
        # So few periods leave a slow curve, which no neighbours tell from noise that rises to low frequencies.
        few = lines[row] < FEW_PERIODS
        if few or line_stands_out(np.square(sizes[row, 1:]), few_lines=True):
            report.flags[row] |= Flag.MISFIT
    coloured = (report.flags & int(Flag.COLOURED_NOISE)) != 0
    for row in np.flatnonzero(coloured & rows):
        first_level, second_level = (float(level) for level in report.excess[row, :2])
        if lines[row] < 2 * NEIGHBOURS:
            power = np.square(sizes[row, 1:]) / report.mean[row]
            first_level, second_level = _levels_of_few_periods(power, float(lines[row]))
        # the ratio knows the noise of the fundamental too, less by the ratio itself
        squared = float(np.abs(series.ratio[row])) ** 2
        of_ratio = max(second_level, (second_level + squared * first_level) / (1 + squared))
        report.excess[row] = first_level, of_ratio, of_ratio
    misfit = (report.flags & int(Flag.MISFIT)) != 0
    for row in np.flatnonzero((misfit | coloured) & rows):
        power, beat = np.square(sizes[row, 1:]), (first[row] * n_samples / 2) ** 2
        pedestal = pedestal_power(power, lines[row])
        ratio_u = 0.0
        if pedestal:
            report.flags[row] |= Flag.MISFIT
        if report.flags[row] & Flag.MISFIT:
            ratio = float(np.abs(series.ratio[row]))
            by_frequency, ratio_u = misfit_of(power, n_samples, lines[row], float(first[row]), ratio, pedestal)
            report.excess[row, 0] += by_frequency
        surplus = left_over(power) if moved else 0.0
        if surplus:
            report.flags[row] |= Flag.MISFIT
            ratio_u = math.hypot(ratio_u, math.sqrt(surplus / beat))
            if surplus > LEFT_BY_MOTION * beat:
                report.flags[row] |= Flag.NOT_LOCK_IN_LIKE
        report.misfit[row] = max(report.misfit[row], ratio_u)
    for row in np.flatnonzero(report.repeats & rows):
        surplus, sure = repeating(np.square(sizes[row, 1:]), lines[row], n_samples)
        hidden = HIDDEN * np.sqrt(surplus) / (first[row] * n_samples / 2)
        report.misfit[row] = np.hypot(report.misfit[row], hidden)
        if sure:
            report.flags[row] |= Flag.MISFIT


def _by_third_harmonic(
    residual: Residual, series: Series, mean: Floats, uneven: Bools, n_samples: int
) -> tuple[Floats, Bools]:
    """Uncertainty of the ratio (R,) by a third harmonic, 0 where noise often has it; and where it is no chance."""
    # It has one place, so that less than a line anywhere counts.
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


def _low_levels(power: Samples, line: float) -> Floats:
    """Noise level at half a line of few periods, at the line and at its double, (3,)."""
    # Near zero frequency the noise may change within a few bins, so that an average over neighbours would not do.
    # Instead its logarithm is fitted by a parabola in the logarithm of the frequency, by maximum likelihood: the
    # power of each bin scatters about the level as an exponential variable. White and 1/f noise are exact cases.
    # The bins of the lines themselves are left out: the fit has emptied them. A level that rests on few bins is
    # raised by what Student's distribution asks for. Where none is left the noise counts as white.
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


# --------------------
# Which samples of records count. Few records have any that do not, and only of those the samples are kept


@dataclass(frozen=True)
class Masks:
    """Masks of (R,) records."""

    place: Indices  # (R,) of a record in `known`, -1 where all its samples count
    known: Samples  # (M, N) 1 where a sample counts, 0 where it is left out; in the precision of the samples

    @staticmethod
    def of(values: Samples, weights: Samples | None) -> Masks:
        """Of (R, N) records all of which have a mask (R, N), or none."""
        if weights is None:
            return Masks(np.full(len(values), -1), np.empty((0, values.shape[1]), dtype=values.dtype))
        return Masks(np.arange(len(values)), weights)

    def changed(self, rows: Indices, masks: Samples) -> Masks:
        """With other masks (r, N) of some records (r,)."""
        place = self.place.copy()
        place[rows] = len(self.known) + np.arange(rows.size)
        return Masks(place, np.concatenate([self.known, masks]))

    def of_one(self, row: int) -> Samples | None:
        """Mask (N,) of a record, None where all samples count."""
        place = self.place[row]
        return None if place < 0 else np.asarray(self.known[place])

    def of_all(self, rows: Indices) -> Samples:
        """Masks (r, N) of records of which some may have none."""
        masks: Samples = np.ones((rows.size, self.known.shape[1]), dtype=self.known.dtype)
        place = self.place[rows]
        masks[place >= 0] = self.known[place[place >= 0]]
        return masks

    def of_any(self, rows: Indices) -> Samples | None:
        """The same, None where none of them has one."""
        return self.of_all(rows) if np.any(self.place[rows] >= 0) else None

    def whole(self, rows: Indices) -> Bools:
        """Whether all samples of each of these records count, (r,)."""
        place = self.place[rows]
        whole = place < 0
        whole[~whole] = self.known[place[~whole]].all(axis=-1)
        return whole

    def clear(self, samples: Samples, rows: slice | Indices) -> None:
        """Set what does not count to 0 in samples (r, N) of these records."""
        place = self.place[rows]
        masked = np.flatnonzero(place >= 0)
        if masked.size:
            samples[masked] *= self.known[place[masked]]

    def counted(self, count: Floats) -> Floats:
        """How many samples of each record count, (R,): `count` where all of them do."""
        masked = np.flatnonzero(self.place >= 0)
        found = count.copy()
        found[masked] = self.known[self.place[masked]].sum(axis=-1, dtype=np.float64)
        return found


# --------------------
# What a residual repeats with the beat: errors of the converter, by the level where the waveform stands.
#
# A wrong code, or a step between two, leaves little on each of many harmonics: too little for a line to stand out
# of noise. Together they do. The third harmonic is not among them: a smooth curve of third order makes that one
# alone


FIRST, LAST = 4, 12  # harmonics that are looked at, each in the two bins next to it

SEEN, SURE = 2e-3, 1e-6
"""Shares of records of noise alone in which they are so strong that it counts, and that a flag says so."""

THIRD = 3
WORTH_A_LOOK, COUNTS = 0.07, 1e-2
"""The same for the harmonics from the third on in white noise, by the lines of the spectrum and by themselves."""

HIDDEN = 2.0
"""Size of what such an error puts onto the second harmonic, over the root of the power that it leaves on these."""

BESIDE = 24
"""Bins on either side of a harmonic over which the noise is taken to be flat, or half the way to the next one."""

FEWEST_BESIDE = 24  # bins of noise without which nothing is said

NOTHING, ROUNDED = 1e-200, 1e-6  # the latter of sums in single precision


def may_repeat(sizes: Sizes, omega: Floats, mean: Floats, n_samples: int) -> tuple[Bools, Bools]:
    """Where the harmonics are stronger than white noise explains: a first look at all records."""
    turns = omega[:, np.newaxis] / (2 * np.pi) * np.arange(THIRD, LAST + 1)
    below = (np.abs(turns - np.rint(turns)) * n_samples).astype(np.intp)
    below = np.clip(below, 1, sizes.shape[1] - 2)
    rows = np.arange(len(sizes))[:, np.newaxis]
    found = np.square(sizes[rows, below]) + np.square(sizes[rows, below + 1])
    number, higher = 2 * below.shape[1], found[:, FIRST - THIRD :].sum(axis=-1)
    often = higher > scipy.special.gammainccinv(number - 2, SEEN) * mean
    return often, (higher + found[:, 0]) > scipy.special.gammainccinv(number, WORTH_A_LOOK) * mean


def hidden_by_harmonics(left: Samples, omega: Floats, mean: Floats) -> Floats:
    """Size (as a line's) that may hide on the second harmonic behind those from the third on, (R,)."""
    power = np.abs(data_sums(left, omega, LAST, 0, lowest=1)[:, 0, THIRD - 1 :]) ** 2
    # folded ones fall onto each other where the sampling is nearly locked to the beat
    power[omega[:, np.newaxis] * np.arange(THIRD, LAST + 1) > np.pi] = 0.0
    number = np.count_nonzero(power, axis=-1)
    total = power.sum(axis=-1)
    stronger = scipy.special.gammaincc(np.maximum(number, 1), total / mean) < COUNTS
    return np.asarray(HIDDEN * np.sqrt(np.where(stronger, np.maximum(total - number * mean, 0.0), 0.0)))


def repeating(power: Samples, line: float, n_samples: int) -> tuple[float, bool]:
    """Power (sum of lines) on the harmonics beyond that of the noise beside them, and whether that is flagged."""
    # of each (folded) harmonic the two lines of the spectrum next to it
    places = line * np.arange(1.0, LAST + 1) + n_samples / 2
    folded = np.abs(places % n_samples - n_samples / 2).astype(int)
    harmonics = np.clip(np.stack([folded, folded + 1], axis=-1), 1, power.size).tolist()
    free = np.ones(power.size + 1)
    free[[0, *itertools.chain(*harmonics)]] = 0.0
    # sums of what lies below, so that every neighbourhood is one difference
    lines_below, power_below = np.cumsum(free), np.cumsum(free * np.append(0.0, power))
    touched = set(itertools.chain(*harmonics[: FIRST - 1]))  # by the fit, or counted before
    reach = int(min(max(line / 2, 2), BESIDE))
    surplus, times, n_on, n_beside = 0.0, 0.0, 0, 0
    for bins in harmonics[FIRST - 1 :]:
        before, last = max(bins[0] - reach, 1) - 1, min(bins[-1] + reach, power.size)
        beside = int(lines_below[last] - lines_below[before])
        if beside < 2 or touched.intersection(bins):
            continue
        touched.update(bins)
        # arithmetic without noise may leave exactly nothing beside a harmonic
        on = sum(float(power[number - 1]) for number in bins)
        level = max(float(power_below[last] - power_below[before]) / beside, NOTHING)
        surplus, times = surplus + on - level * len(bins), times + on / level
        n_on, n_beside = n_on + len(bins), n_beside + beside
    if n_beside < FEWEST_BESIDE:
        return 0.0, False
    chance = float(scipy.special.fdtrc(2 * n_on, 2 * n_beside, times / n_on))
    return (surplus if chance < SEEN else 0.0), chance < SURE


def by_level(left: Floats, level: Floats, degrees: Floats) -> tuple[Floats, Bools]:
    """Sizes (as amplitudes, (R,)) that may hide on the second harmonic behind what follows the level."""
    # Where rate or baseline moves, what a curved or damaged characteristic leaves has no frequency of its own. It
    # is a function of the level yet, and polynomials of that (Chebyshev's) take it up.
    lowest, highest = level.min(axis=1, keepdims=True), level.max(axis=1, keepdims=True)
    place = ((2 * level - lowest - highest) / np.maximum(highest - lowest, NOTHING)).astype(np.float32)
    columns = np.empty((len(left), LAST + 1, left.shape[1]), dtype=np.float32)
    columns[:, 0], columns[:, 1] = 1.0, place
    place *= 2
    for order in range(2, LAST + 1):
        np.multiply(place, columns[:, order - 1], out=columns[:, order])
        columns[:, order] -= columns[:, order - 2]
    normal = (columns @ columns.transpose(0, 2, 1)).astype(np.float64)
    factor = np.linalg.cholesky(normal + ROUNDED * left.shape[1] * np.eye(LAST + 1))
    # offset and amplitude are fitted
    scale = np.maximum(np.abs(left).max(axis=1, keepdims=True), NOTHING)
    along = np.linalg.solve(factor, columns @ (left / scale).astype(np.float32)[..., np.newaxis])[:, 2:, 0] * scale
    found, number = np.vecdot(along, along), along.shape[1]
    free = np.maximum(degrees - number, 1.0)
    variance = np.maximum(np.vecdot(left, left) - found, NOTHING) / free
    chance = scipy.special.fdtrc(number, free, found / number / variance)
    surplus = np.maximum(found - number * variance, 0.0)
    hidden = np.where(chance < SEEN, HIDDEN * np.sqrt(2 * surplus / left.shape[1]), 0.0)
    return hidden, np.asarray(chance < SURE)


HEIGHTS, FINE = 200, 60
"""Heights of the beat whose mean errors are looked at, and the degree up to which polynomials of the height go."""

_SIZES, _FALLS = np.geomspace(1e-3, 1e5, 65)[:, np.newaxis], np.linspace(0.0, 3.0, 13)
"""Powers of codes' errors in the second degree, over that of noise, and how they fall with the degree."""

NOT_CODES = 1e-3


def by_code(left: Floats, level: Floats) -> float | None:
    """Size (an amplitude) that the codes of a converter put onto the second harmonic; ``None``: not they."""
    # Thresholds that are wrong each by itself leave as much in polynomials of every degree of the level; widths
    # that are, add up to errors whose power falls with the square of the degree. So it is C (2/n)^a beside the
    # noise, with C and a by their likelihood: the second degree, the one that hides, has C. A curve of low
    # degrees, a step, and what is no function of the level, are something else.
    edges = np.linspace(level.min(), level.max(), HEIGHTS + 1)
    height = np.clip(np.searchsorted(edges, level) - 1, 0, HEIGHTS - 1)
    count = np.bincount(height, minlength=HEIGHTS)
    there = count > 0
    mean = np.bincount(height, left, HEIGHTS) / np.maximum(count, 1)
    within = left - mean[height]
    lines = np.square(line_sizes(within[np.newaxis])[0, 1:])
    noise = float(within @ within) / max(left.size - int(there.sum()), 1)
    degree = np.arange(3, min(FINE, int(there.sum()) // 2) + 1)
    if noise <= 0 or degree.size < 2 * LAST or lines.max() > lines.mean() * np.log(lines.size / NOT_CODES):
        return None
    if scipy.special.chdtrc(int(there.sum()), float(count @ mean**2) / noise) > NOT_CODES:
        return None
    root, place = np.sqrt(count[there]), np.linspace(-1.0, 1.0, HEIGHTS)[there]
    basis = np.linalg.qr(root[:, np.newaxis] * np.polynomial.chebyshev.chebvander(place, degree[-1]))[0][:, 3:]
    power = (basis.T @ (root * mean[there])) ** 2 / noise
    expected = 1 + _SIZES[..., np.newaxis] * (2 / degree) ** _FALLS[:, np.newaxis]
    height_of = -0.5 * np.sum(power / expected + np.log(expected), axis=-1)
    best = expected[np.unravel_index(height_of.argmax(), height_of.shape)]
    chances = scipy.special.chdtrc(1, power / best)
    of_all = float(scipy.special.chdtrc(power.size, np.sum(power / best)))
    if min(float(chances.min()) * chances.size, of_all) < NOT_CODES:
        return None
    fine = power[degree > LAST]
    below = np.cumsum(np.append(0.0, mean[there]))
    step = below[2 * STEP :] - 2 * below[STEP:-STEP] + below[: -2 * STEP]
    # widths of codes do not step by the height at one place
    one_step = np.max(step**2) > ONE_STEP * np.mean(step**2)
    if scipy.special.chdtrc(fine.size, fine.sum()) > NOT_CODES or one_step:
        return None
    weights = np.exp(height_of - height_of.max())
    return float(np.sqrt(2 * noise * np.sum(weights * _SIZES) / weights.sum() / left.size))


STEP, ONE_STEP = 8, 12.0  # heights on either side of a step, and times by which it exceeds the others in power
