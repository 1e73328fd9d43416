"""Whether what a fit leaves is there all the time, as noise is, or in one part of the record only.

The start of a motion, a gyro that settles into lock-in, a beam that comes back: each leaves a smooth curve in one
part of the record. Its spectrum is as flat as that of coloured noise; in time it stands alone. Noise that is
louder for a while is no curve: its neighbouring samples do not agree.

A curve so slow that no part stands out, as a motion leaves that dies away over the record, shows itself by the
phases of its lines: they turn evenly from one to the next, while those of noise are independent.
"""

from __future__ import annotations

import numpy as np
import scipy.special

from analysis.arrays import Floats

PARTS = 20

CHANCE = 1e-6
"""Share of records in which noise leaves so much more in one part than in the others."""

LINES, IN_PHASE, FIRST_LINES, STRONGER = 24, 0.8, 3, 4.0
"""So many lines from the lowest on are looked at. Steps from one to the next whose directions have a mean of this
length come by chance in 2 of 10^7 records."""

LONGEST_RUN, FAR = 20, 5.0
"""Samples of one sign in a row beyond so many (robust) standard deviations that no noise has."""

SMOOTH = 3.0
"""Standard deviations by which the products of neighbouring samples must exceed those of white noise."""


def passing_power(left: Floats) -> float:
    """Sum of squares of a curve in one part of a residual (N,), beyond its steady noise; 0 where there is none.

    The power of a part of m samples has as many degrees of freedom as its noise has independent values: m for
    white noise, and m (mean S)^2/mean(S^2) for one of the spectrum S, which the residual itself shows.
    """
    if left.size < PARTS:
        return 0.0
    if far := _power_of_runs(left):
        return far
    length = left.size // PARTS
    cut = left[: length * PARTS].reshape(PARTS, length)
    parts = np.sum(cut**2, axis=1)
    power = np.abs(np.fft.rfft(left)[1:]) ** 2
    spread = float(np.mean(power**2))
    if not spread > 0:
        return 0.0
    # a line of noise scatters as an exponential variable, with a mean square of twice the squared mean
    degrees = float(min(max(2 * length * float(np.mean(power)) ** 2 / spread, 1.0), length))
    # Half of the parts may be disturbed: the quieter half tells the noise. Its mean is below that of all.
    below = float(scipy.special.chdtr(degrees + 2, float(scipy.special.chdtri(degrees, 0.5))) / 0.5)
    quiet = np.argsort(parts)[: PARTS // 2]
    level = float(parts[quiet].mean()) / below
    largest = float(parts.max()) / max(level, 1e-300)
    chance = PARTS * float(scipy.special.fdtrc(degrees, degrees * PARTS / 2, largest))
    if not chance < CHANCE:
        return 0.0
    products = cut[:, 1:] * cut[:, :-1]
    alike = products.sum(axis=1)
    curve = float(np.sum(alike - alike[quiet].mean()))
    return curve if curve > SMOOTH * float(np.linalg.norm(products)) else 0.0


def _power_of_runs(left: Floats) -> float:
    """Sum of squares of long runs of one sign far beyond what the rest of a residual (N,) shows; 0 without."""
    far = np.sign(left) * (np.abs(left) > FAR * 1.4826 * np.median(np.abs(left)))
    starts = np.concatenate([[0], np.flatnonzero(np.diff(far)) + 1])
    lengths = np.diff(np.append(starts, far.size))
    in_long_run = np.repeat(lengths >= LONGEST_RUN, lengths) & (far != 0)
    return float(np.sum(left[in_long_run] ** 2))


def slow_curve_power(left: Floats) -> float:
    """Sum of squares of a curve in a residual (N,) whose lowest lines have the phases of one event; 0 without.

    So have the lines of noise that is louder for a while: they must be stronger than all others are. And so have
    the feet of a line that lies among them: the strongest must be one of the first.
    """
    spectrum = np.fft.rfft(left)[1:]
    lines, power = spectrum[: LINES + 1], np.abs(spectrum) ** 2
    steps = lines[1:] * np.conj(lines[:-1])
    sizes = np.abs(steps)
    if power.size <= LINES + 1 or not sizes.min() > 0 or abs(np.mean(steps / sizes)) < IN_PHASE:
        return 0.0
    low, others = power[: LINES + 1], power[LINES + 1 :]
    if int(low.argmax()) >= FIRST_LINES or not low.mean() > STRONGER * others.mean():
        return 0.0
    return float(2 * low.sum() / left.size)
