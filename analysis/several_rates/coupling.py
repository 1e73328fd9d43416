"""Coupling of the beams without loss, as beats and rates show it together.

Backscatter of the two beams whose phases do not add up to zero has a part B_s that takes no energy. It makes the
lock-in rate that the ratios show too high by c = (B_s/g_d)^2, g_d the rate at which the difference of the beams
relaxes, and no ratio shows it. But it pushes the beat up, equation (4) of docs/several_rates.md:

    df/f = B_s^2/[2 (w^2 + g_d^2)] = c g_d^2/[2 (w^2 + g_d^2)],      w = 2 pi f

so rates that are known beside the beats tell how large c can be at most. An error that all rates share is one
factor of all beats, a rate that is there all the time (the earth's) goes as 1/W: both are fitted beside c.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.special

from analysis.arrays import Floats
from analysis.several_rates.points import Points

GAIN_OVER_DIFFERENCE = 3.0
"""g_c/g_d, for a cross saturation of half the self saturation."""

LEAST_U = 1e-6
"""Of a beat over its rate: no table turns more steadily from one rate to the next, whatever its display says."""


@dataclass(frozen=True)
class CouplingSeen:
    """c = (B_s/g_d)^2, its standard uncertainty, and how many of these 95 % allow."""

    share: float
    u: float
    reach: float

    @property
    def significant(self) -> bool:
        """Whether it is more than chance makes of no coupling."""
        return abs(self.share) > 1.7 * self.reach * self.u

    @property
    def most(self) -> float:
        """Largest c that is likely. It is never negative: where it surely seems so, the rates are wrong."""
        if self.share < -self.reach * self.u:
            return abs(self.share) + self.reach * self.u
        return max(self.share + self.reach * self.u, self.u)


def coupling_seen(beats: Floats, lock_in_u: float) -> CouplingSeen | None:
    """Coupling without loss by beats at several rates; ``None`` where rates and beats do not determine it."""
    total = beats[0]
    if total.size == 0:
        return None
    seen, pulled, slowness, drift = beats[1:] / total
    pushed = 0.5 / (1 + (GAIN_OVER_DIFFERENCE * slowness) ** 2)
    columns = np.stack([pushed + pulled, np.ones(total.size), drift / np.abs(drift).max(), pulled], axis=-1)
    free = total.size - columns.shape[1] + 1
    if free < 1:
        return None
    # that WL is known from elsewhere is one more value
    white = np.concatenate([columns * np.sqrt(total)[:, np.newaxis], [[0.0, 0.0, 0.0, 1 / lock_in_u]]])
    aim = np.append(seen * np.sqrt(total), 0.0)
    size = np.linalg.norm(white, axis=0)
    scaled = white / size
    if np.linalg.cond(scaled) > _ALIKE:
        return None
    inverse = np.linalg.inv(scaled.T @ scaled)
    found = inverse @ (scaled.T @ aim)
    left = aim - scaled @ found
    scatter = max(float(left @ left) / free, 1.0)
    u = float(np.sqrt(inverse[0, 0] * scatter)) / size[0]
    return CouplingSeen(float(found[0] / size[0]), u, float(scipy.special.stdtrit(free, 0.975)))


def said_by_beats(rate: Floats, mismatch: Floats, mismatch_u: Floats, square: Floats, slowness: Floats) -> Floats:
    """What n records with a beat say: their weights, and weighted values that are to be added up, (5, n)."""
    weights = 1 / (mismatch_u**2 + LEAST_U**2)
    return np.asarray(
        weights * np.stack([np.ones_like(rate), mismatch, square / (1 - square), slowness, 1 / rate])
    )


def beats_of_rates(points: Points, mismatch: Floats, lock_in_rate: float, gain_time: float) -> Floats:
    """What the records of a fit say at each rate in each sense, (5, p), for :func:`coupling_seen`."""
    records, sums = points.records, np.zeros((5, len(points.places)))
    for some, every in records.records.blocks():
        rows = np.flatnonzero(records.used[some] & np.isfinite(mismatch[some]))
        block, frequency = every[rows], every.beat_frequency[rows]
        square = (lock_in_rate / block.rate) ** 2
        rate_u = records.rate_u[some][rows] / np.abs(block.rate) / (1 - square)
        us = np.hypot(block.beat_frequency_u / frequency, rate_u)
        slowness = 2 * np.pi * frequency * gain_time
        sums += points.places.sums(block, *said_by_beats(block.rate, mismatch[some][rows], us, square, slowness))
    there = sums[0] > 0
    _, place = np.unique(2 * points.rate_group[there] + (points.points.rate[there] > 0), return_inverse=True)
    return np.stack([np.bincount(place, column) for column in sums[:, there]])


_ALIKE = 1e6
"""Condition number from which on the unknowns are not told apart."""
