"""What a residual repeats with the beat: errors of the converter, by the level where the waveform stands.

A wrong code, or a step between two, leaves little on each of many harmonics: too little for a line to stand out of
noise. Together they do. The third harmonic is not among them: a smooth curve of third order makes that one alone.
"""

from __future__ import annotations

import itertools

import numpy as np
import scipy.special

from analysis.arrays import Bools, Floats, Samples
from analysis.waveform.series.frequency_search import Sizes
from analysis.waveform.series.harmonic_sums import data_sums

FIRST, LAST = 4, 12
"""Harmonics that are looked at, each in the two bins next to it."""

SEEN, SURE = 2e-3, 1e-6
"""Shares of records of noise alone in which they are so strong that it counts, and that a flag says so."""

THIRD = 3
WORTH_A_LOOK, COUNTS = 0.07, 1e-2
"""The same for the harmonics from the third on in white noise, by the lines of the spectrum and by themselves."""

HIDDEN = 2.0
"""Size of what such an error puts onto the second harmonic, over the root of the power that it leaves on these."""

BESIDE = 24
"""Bins on either side of a harmonic over which the noise is taken to be flat, or half the way to the next one."""

FEWEST_BESIDE = 24
"""Bins of noise without which nothing is said."""

NOTHING = 1e-200


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
    harmonics = [_bins_of(order * line, n_samples, power.size) for order in range(1, LAST + 1)]
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


def by_level(left: Floats, level: Floats, degrees: float) -> tuple[float, bool]:
    """Size (as an amplitude) that may hide on the second harmonic behind what follows the level in a residual.

    Where rate or baseline moves, what a curved or damaged characteristic leaves has no frequency of its own. It is
    a function of the level yet, and polynomials of that take it up.
    """
    lowest, highest = float(level.min()), float(level.max())
    place = (2 * level - lowest - highest) / max(highest - lowest, NOTHING)
    # offset and amplitude are fitted
    basis = np.linalg.qr(np.polynomial.chebyshev.chebvander(place, LAST))[0][:, 2:]
    found, number = float(np.sum((basis.T @ left) ** 2)), basis.shape[1]
    free = max(degrees - number, 1.0)
    variance = max(float(left @ left) - found, NOTHING) / free
    chance = float(scipy.special.fdtrc(number, free, found / number / variance))
    surplus = max(found - number * variance, 0.0)
    return (HIDDEN * float(np.sqrt(2 * surplus / left.size)) if chance < SEEN else 0.0), chance < SURE


def _bins_of(place: float, n_samples: int, n_lines: int) -> tuple[int, int]:
    """Numbers of the two lines of a spectrum next to a (folded) place."""
    folded = int(abs((place + n_samples / 2) % n_samples - n_samples / 2))
    return min(max(folded, 1), n_lines), min(max(folded + 1, 1), n_lines)
