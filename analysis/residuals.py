"""What a fit leaves: is it white noise, is there a beat at all, is it the lock-in waveform?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.flags import Flag
from analysis.frequency_search import power_of, spectrum_of

Floats = NDArray[np.float64]
Samples = NDArray[Any]
"""float32 or float64"""

NEIGHBOURS = 16
"""Bins on either side of a harmonic from which the local noise is taken."""

LINE_CHANCE = 1e-6
"""A residual line that noise would produce in fewer than this share of records is a misfit."""

ROUNDING = 1e-12
"""A residual below this share of the power is arithmetic, not a measured signal: a synthetic record."""

FEW_PERIODS = 6.0

GROSS_MISFIT = 0.05
"""Share of the signal's power that a waveform may miss and still be called that of a gyro above lock-in."""


FEWEST_PERIODS = 3.0
GROSS_MISFIT_OF_A_CURVE = 0.002
"""The same with fewer periods than that: any slow curve nearly passes for a beat of two harmonics."""


@dataclass(frozen=True)
class ResidualReport:
    """flags : (R,); excess : (R, 3) variance factors of frequency, ratio size and ratio phase over white noise."""

    flags: NDArray[np.int64]
    excess: Floats


def examine_residual(
    left: Samples, count: Floats, omega: Floats, first: Floats, residual_power: Floats
) -> ResidualReport:
    """Judge the residual of each record by its spectrum.

    Parameters
    ----------
    left : (R, N)
        Residual, 0 where missing.
    count, omega, first, residual_power : (R,)
        Valid samples, rad per sample, size of the fundamental, sum of squares of the residual.
    """
    n_records, n_samples = left.shape
    flags = np.zeros(n_records, dtype=np.int64)
    power = power_of(spectrum_of(left))
    power[:, 0] = 0.0
    n_lines = power.shape[1] - 1
    mean = np.maximum(power.sum(axis=-1) / n_lines, 1e-30)
    line = power.max(axis=-1) / mean
    expected = np.log(n_lines / LINE_CHANCE)

    signal = first**2 / 2 * count
    degrees = np.maximum(count - 6, 1)
    noise = residual_power / degrees
    # For noise alone the strongest of N/2 lines has an exponential tail: N/2 exp(-z).
    strength = signal / 2 / np.maximum(noise, 1e-300)
    flags[strength < np.log(n_samples / 2) + 18] |= Flag.NO_BEAT
    rounding = residual_power <= ROUNDING * signal
    misfit = (line > expected) & ~rounding
    flags[misfit] |= Flag.MISFIT
    for row in np.flatnonzero(misfit):
        lines = power[row][power[row] > mean[row] * expected].sum() * 2 / n_samples
        few = omega[row] * n_samples < 2 * np.pi * FEWEST_PERIODS
        if lines > (GROSS_MISFIT_OF_A_CURVE if few else GROSS_MISFIT) * signal[row]:
            flags[row] |= Flag.NOT_LOCK_IN_LIKE

    excess = np.ones((n_records, 3))
    at_first = _local_level(power, omega, n_samples) / mean
    at_second = _local_level(power, 2 * omega, n_samples) / mean
    coloured = (np.maximum(at_first, at_second) > 1.8) | (np.minimum(at_first, at_second) < 0.45)
    coloured &= ~rounding
    flags[coloured] |= Flag.COLOURED_NOISE
    for row in np.flatnonzero(coloured):
        line = omega[row] * n_samples / (2 * np.pi)
        first_level, second_level = float(at_first[row]), float(at_second[row])
        if line < 2 * NEIGHBOURS:
            first_level, second_level = _low_levels(power[row, 1:] / mean[row], line)
        if line < FEW_PERIODS:
            # So few periods do not keep the two lines apart: the stronger noise reaches both.
            first_level = second_level = max(first_level, second_level)
        excess[row] = first_level, second_level, second_level
    return ResidualReport(flags, excess)


def _low_levels(power: Samples, line: float) -> tuple[float, float]:
    """Noise level at a line of few periods and at its double: white and 1/f noise fitted to the lowest bins.

    Near zero frequency the noise may change within a few bins, so that an average over neighbours would not do.
    The bins of the lines themselves are left out: the fit has emptied them.
    """
    bins = np.arange(1, min(int(4 * line) + 12, power.size) + 1)
    free = (np.abs(bins - line) > 1.5) & (np.abs(bins - 2 * line) > 1.5)
    columns = np.stack([np.ones(bins.size), 1.0 / bins])[:, free]
    seen = power[: bins.size][free]
    level = np.full(seen.size, seen.mean())
    for _ in range(8):
        # Each bin's power scatters as much as its mean: weights 1/level^2.
        solution = np.linalg.solve((columns / level**2) @ columns.T, (columns / level**2) @ seen)
        solution = np.maximum(solution, [0.0, 0.0])
        level = np.maximum(solution @ columns, 0.05 * seen.mean())
    return float(solution[0] + solution[1] / line), float(solution[0] + solution[1] / (2 * line))


def _local_level(power: Samples, omega: Floats, n_samples: int) -> Floats:
    """Mean power of the bins around a (folded) frequency; (R,)."""
    folded = np.abs((omega + np.pi) % (2 * np.pi) - np.pi)
    centre = np.rint(folded * n_samples / (2 * np.pi)).astype(int)
    n_lines = power.shape[1] - 1
    reach = min(NEIGHBOURS, (n_lines - 1) // 2)
    around = np.clip(centre, reach + 1, n_lines - reach)[:, np.newaxis] + np.arange(-reach, reach + 1)
    return np.asarray(np.take_along_axis(power, around, axis=-1).mean(axis=-1), dtype=np.float64)
