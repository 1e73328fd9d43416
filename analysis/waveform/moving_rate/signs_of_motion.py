"""Whether what a steady fit leaves of a record may come from a motion of the rate, the intensity, the baseline."""

from __future__ import annotations

import numpy as np

from analysis.arrays import Floats

BESIDE = 0.5
"""Share of its frequency about the fundamental in which sidebands are looked for."""

LOWEST, NEXT = slice(0, 3), slice(7, 24)
"""Lines 1 to 3, where a drift or a step of the baseline stands, and lines 8 to 24."""

STEEP = 30.0
"""A drift falls as the square of the frequency, by about 90 from the ones to the others; noise as 1/f by 9."""

LARGE = 0.1
"""Share of the power of the beat from which on what is left has no direction: the phase moves by 0.3 rad."""

MOST_REPEATING = 0.5
"""Share of what stands above the noise that may repeat with the beat; a motion leaves sidebands, which do not."""

HARMONICS = 8

ONE_SIDED = 6.0
"""Surplus of the stronger of phase and amplitude over the other, in its scatter for noise."""


def may_be_motion(left: Floats, omega: float, first: complex, ratio: float) -> bool:
    """Whether what the fit at a steady rate leaves is that of a moving phase, amplitude or baseline.

    Distortion leaves harmonics, which no motion would mend. A wander of s rad wanders by k s at the k-th harmonic,
    so its sidebands there have k^2 r^(2k-2) of the power of those about the fundamental; the ratio found at a
    steady rate is too small, which the power 1.5 allows for. Noise of whatever colour moves phase and amplitude
    alike, a motion of the rate the phase alone, one of the intensity the amplitude.
    """
    power = np.abs(np.fft.rfft(left)[1:]) ** 2
    if _repeats(left, omega, power):
        return False
    if power.size > NEXT.stop and power[LOWEST].mean() > STEEP * np.median(power[NEXT]) / np.log(2):
        return True
    floor = float(np.median(power)) / np.log(2)
    line = omega * left.size / (2 * np.pi)
    bins = np.arange(1, power.size + 1)
    beside = (bins > (1 - BESIDE) * line) & (bins < (1 + BESIDE) * line)
    of_fundamental = (1 - ratio**2) ** 3 / (1 + ratio**2)
    surplus, of_all = float((power[beside] - floor).sum()), float((power - floor).sum())
    if not surplus > 0.5 * of_fundamental**1.5 * of_all:
        return False
    return bool(left @ left > LARGE * abs(first) ** 2 / 2 * left.size) or _has_direction(left, omega, first, line)


def _repeats(left: Floats, omega: float, power: Floats) -> bool:
    """Whether most of what the fit leaves beside noise is harmonics of the beat, as a filter leaves them."""
    time = np.arange(left.size) - (left.size - 1) / 2
    turns = np.exp(1j * omega * np.outer(np.arange(1, HARMONICS + 1), time))
    columns = np.concatenate([turns.real, turns.imag]).T
    found, _, rank, _ = np.linalg.lstsq(columns, left, rcond=1e-6)
    noise = float(np.median(power)) / np.log(2) / left.size  # variance of a sample
    repeating = float(np.sum((columns @ found) ** 2)) - noise * int(rank)
    return bool(repeating > MOST_REPEATING * (float(left @ left) - noise * left.size))


def _has_direction(left: Floats, omega: float, first: complex, line: float) -> bool:
    """Whether the residual about the fundamental moves its phase and its amplitude by different amounts."""
    time = np.arange(left.size) - (left.size - 1) / 2
    lines = np.fft.fft(left * np.exp(-1j * omega * time) * np.conj(first))
    reach = max(BESIDE * line, 1.0)
    lines[np.abs(np.fft.fftfreq(left.size, 1 / left.size)) > reach] = 0.0
    moved = np.fft.ifft(lines)
    weaker, stronger = np.linalg.eigvalsh(np.cov(moved.real, moved.imag))
    return bool(stronger > (1 + ONE_SIDED / np.sqrt(reach)) * weaker)
