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
from analysis.several_rates.points import rate_groups

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


def coupling_seen(
    rate: Floats, mismatch: Floats, mismatch_u: Floats, square: Floats, slowness: Floats, lock_in_u: float
) -> CouplingSeen | None:
    """Coupling without loss by n records with a beat; ``None`` where rates and beats do not determine it.

    Parameters
    ----------
    rate : (n,)
        deg/s, signed, known beside the beats.
    mismatch, mismatch_u : (n,)
        f/(K sqrt(W^2 - WL^2)) - 1, WL from the ratios, and its standard uncertainty without that of WL.
    square : (n,)
        (WL/W)^2.
    slowness : (n,)
        w/g_c.
    lock_in_u : float
        Relative standard uncertainty of WL by the ratios.
    """
    _, place = np.unique(2 * rate_groups(rate) + (rate > 0), return_inverse=True)
    weights = 1 / (mismatch_u**2 + LEAST_U**2)
    total = np.bincount(place, weights)

    def mean(values: Floats) -> Floats:
        return np.asarray(np.bincount(place, weights * values) / total)

    pulled = mean(square / (1 - square))
    pushed = 0.5 / (1 + (GAIN_OVER_DIFFERENCE * mean(slowness)) ** 2)
    drift = np.abs(rate).min() * mean(1 / rate)
    columns = np.stack([pushed + pulled, np.ones(total.size), drift, pulled], axis=-1)
    free = total.size - columns.shape[1] + 1
    if free < 1:
        return None
    # that WL is known from elsewhere is one more value
    white = np.concatenate([columns * np.sqrt(total)[:, np.newaxis], [[0.0, 0.0, 0.0, 1 / lock_in_u]]])
    aim = np.append(mean(mismatch) * np.sqrt(total), 0.0)
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


_ALIKE = 1e6
"""Condition number from which on the unknowns are not told apart."""
