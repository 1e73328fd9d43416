"""What every method gives, and the two relations from a harmonic ratio to the lock-in rate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from analysis.arrays import Floats

Relation = Callable[[Floats, Floats, Floats], Floats]


@dataclass(frozen=True)
class Reading:
    """frequency (R,) cycles per sample; lock_in_rate (R,); nan where the method gave up."""

    frequency: Floats
    lock_in_rate: Floats


def exact(ratio: Floats, frequency: Floats, _rate: Floats) -> Floats:
    """WL = f 2r/(1 - r^2): the record is its own reference. No number for a ratio of one or more."""
    r = np.where(ratio < 1, ratio, np.nan)
    return np.asarray(frequency * 2 * r / (1 - r * r))


def formula_13(ratio: Floats, _frequency: Floats, rate: Floats) -> Floats:
    """WL = W / sqrt(1 + (A1/2A2)^2), equation (13) of Zhan et al. (2009), W from the table."""
    return np.asarray(rate * 2 * ratio / np.sqrt(1 + 4 * ratio * ratio))
