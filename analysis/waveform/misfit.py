"""What a residual that is not noise may have done to the frequency and to the ratio.

A fit hides the part of a contaminant that looks like the waveform; what it leaves shows how large the rest is. A
line of the size a, next to a beat of the size A, may have a twin where nobody sees it:

- at d bins from the second harmonic its foot there is a/(pi d), and moves the ratio by as much over A; at d bins
  from the fundamental it moves the ratio by r a/(pi d A);
- on a higher harmonic it comes from a curved characteristic, which makes a second harmonic of like size;
- sidebands of the power p (over that of the fundamental) are those of a phase that moves by sqrt(p) rad. Such a
  phase takes exp(-p/2) from the fundamental, exp(-2p) from the second harmonic, so 3p/2 from the ratio; and two
  sidebands make a third of the size p/4, which may fall onto the second harmonic.

All of them enter as standard uncertainties. They are no noise: the ratio is not freed of a bias by them, and what
all records of a bench have in common does not average out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from analysis.arrays import Floats, Samples

LINE_CHANCE = 1e-6
"""A residual line that noise would produce in fewer than this share of records is a misfit."""

NEIGHBOURS = 24
"""Bins on either side over which the spectrum of noise is taken to be flat."""

CLEAR = 6.0
"""Levels of its neighbourhood beyond which the power of a bin counts: noise does so once in 400 bins."""

CURVED = 2.0
"""Size of the second harmonic that a curved characteristic may make, over that of a higher one that is seen."""

ORDERS = 12

FLOOR_PARTS = 8
"""Of so many parts of the spectrum the last but one in power is taken for the noise that a moving phase leaves."""

LEFT_OVER = 6.0
"""Standard deviations by which the whole must exceed it to say that the moving phase is not the right one."""

PEDESTAL = 6.0
"""Standard deviations by which the power about the fundamental must exceed that on its sides."""


@dataclass(frozen=True)
class Misfit:
    """Variance of the frequency over that of white noise, and standard uncertainty of the ratio."""

    frequency: float
    ratio: float


def surroundings(power: Samples) -> Floats:
    """Level of the noise about each line of a spectrum (L,), whatever lines stand in it."""
    from scipy.ndimage import median_filter  # takes longer to import than most that use this module would wait for

    # The median, since a wrong waveform leaves a comb of lines.
    around = median_filter(power.astype(np.float64), size=2 * NEIGHBOURS + 1, mode="mirror") / math.log(2)
    # Below the first whole window the noise may rise as 1/f: its neighbours are then those on the same side.
    bins = np.arange(1, NEIGHBOURS)
    around[: bins.size] = np.maximum(around[NEIGHBOURS], around[: bins.size]) * NEIGHBOURS / bins
    return np.asarray(around)


def line_stands_out(power: Samples, *, few_lines: bool = False) -> bool:
    """Whether a line of a spectrum (L,) stands out of its neighbours, as hardly any does in noise of any colour.

    `few_lines` is the answer where there are too few lines to have neighbours.
    """
    if power.size < 2 * (2 * NEIGHBOURS + 1):
        return few_lines
    strongest = float((power / np.maximum(surroundings(power), 1e-300)).max())
    return strongest > math.log(power.size / LINE_CHANCE)


def misfit_of(power: Samples, n_samples: int, line: float, first: float, ratio: float, pedestal: float) -> Misfit:
    """Judge the lines of one residual."""
    mean = float(power.mean())
    beat = (first * n_samples / 2) ** 2
    around = surroundings(power) if power.size > 2 * NEIGHBOURS else np.full(power.size, mean)
    stands_out = np.where(power > CLEAR * around, power, 0.0) / mean
    at = np.arange(1, power.size + 1)
    feet = [_foot(at - folded) ** 2 for folded in _folded(line * np.arange(1.0, ORDERS + 1), n_samples)]
    by_frequency = float(stands_out @ feet[0])
    curved = CURVED**2 * np.max(feet[2:], axis=0)
    by_ratio = float(stands_out @ (ratio**2 * feet[0] + np.maximum(feet[1], curved)))
    lines = float(stands_out.sum()) * mean / beat
    turned = 1.5 * ratio * pedestal / beat + turned_by(lines, ratio)
    return Misfit(2 * by_frequency, math.sqrt(by_ratio * mean / beat + turned**2))


def turned_by(sidebands: float, ratio: float) -> float:
    """What a moving phase may do to a ratio, by the power of its sidebands over that of the fundamental."""
    return 1.5 * ratio * sidebands + 0.25 * sidebands


def _folded(lines: Floats, n_samples: int) -> Floats:
    """Where lines of any frequency stand in the spectrum of the samples."""
    return np.abs((lines + n_samples / 2) % n_samples - n_samples / 2)


def _foot(distance: Floats) -> Floats:
    """Size of a line's foot at a distance in bins."""
    return np.asarray(1 / np.maximum(np.pi * np.abs(distance), 1.0))


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
    """Power (the sum of lines) that a moving phase leaves beyond the noise; 0 where that may be chance.

    A moving phase that is the right one leaves noise. The noise is read where the spectrum (L,) is lowest, since
    what is wrong stands about the harmonics, often as wide as they are apart.
    """
    parts = np.array_split(power.astype(np.float64), FLOOR_PARTS)
    floor = float(np.sort([np.median(part) for part in parts])[1]) / math.log(2)
    surplus = float(power.sum()) - floor * power.size
    scatter = floor * math.sqrt(FLOOR_PARTS * power.size)
    return surplus if surplus > LEFT_OVER * scatter else 0.0
