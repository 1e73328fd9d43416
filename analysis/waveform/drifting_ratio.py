"""A ratio that drifts within the record: the lock-in rate does not, so something else is there.

A second beat close to the first looks like one beat of another ratio, which changes slowly: if the two part by d
turns over the record, the ratio changes by pi d times what it is off by, from the middle of the record to its end.
"""

from __future__ import annotations

import numpy as np

from analysis.arrays import Bools, Floats

UNLIKELY, RARE = 1e-4, 1e-2
"""Shares of records in which noise shows so large a drift that a flag says so, where something moved besides, or
that it counts."""

SURE = 1e-6
"""The same for the flag where nothing else speaks against the record."""

HIDDEN = 2.0
"""What may hide behind a drift from the middle of the record to its end, over that: as with two beats that part by
a seventh of a turn."""


def drift_of_ratio(drift: Floats, covariance: Floats) -> tuple[Floats, Bools]:
    """Standard uncertainty of the ratio (R,) by drifts that noise hardly makes, and where it never does."""
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    x, y = drift.T
    with np.errstate(all="ignore"):  # records without a beat, or without noise
        chi_square = (c * x**2 - 2 * b * x * y + a * y**2) / (a * c - b**2)
        chance = np.where(np.isfinite(chi_square), np.exp(-chi_square / 2), 1.0)
    return np.where(chance < RARE, HIDDEN * np.hypot(x, y), 0.0), chance < SURE
