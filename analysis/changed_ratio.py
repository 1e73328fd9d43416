"""An estimate with another harmonic ratio: what follows from the ratio follows anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from analysis.arrays import Complexes, Floats
from analysis.flags import Flag
from analysis.lockin_equation import input_rate_from_beat
from analysis.lockin_rate import SIGNIFICANT, LockInEstimate, rate_and_slopes
from analysis.ratio_interval import size_interval


def with_ratio(
    estimate: LockInEstimate,
    ratio: Complexes,
    covariance: Floats,
    sense: Floats | None = None,
) -> LockInEstimate:
    """The estimate with a corrected rho: lock-in rate, interval and phase from it; frequency and noise stay.

    Parameters
    ----------
    estimate : LockInEstimate
    ratio : (...) complex, covariance : (..., 2, 2)
        The corrected rho and the covariance of its two parts.
    sense : (...), optional
        Sign of the rate where the estimate was made without one; without it positive, as in the estimate.
    """
    size = np.abs(ratio)
    unit = ratio / np.where(size > 0, size, 1.0)
    along = np.stack([unit.real, unit.imag], axis=-1)
    across = np.stack([-unit.imag, unit.real], axis=-1)
    radial, tangential = (np.einsum("...i,...ij,...j->...", v, covariance, v) for v in (along, across))
    unbiased = np.sqrt(np.maximum(size**2 - tangential, 0.0))
    beat_rate = estimate.beat_frequency / estimate.scale_factor
    given = estimate.input_rate if estimate.rate_given else None
    value, by_ratio, by_beat_rate = rate_and_slopes(unbiased, beat_rate, given, estimate.relation)
    value_u = np.hypot(
        by_ratio * np.sqrt(radial), by_beat_rate * estimate.beat_frequency_u / estimate.scale_factor
    )
    observed = rate_and_slopes(size, beat_rate, given, estimate.relation)[0]
    low, high = size_interval(observed / value_u)
    if given is not None:
        turning = np.where(given < 0, -1.0, 1.0)
    else:
        turning = np.ones_like(size) if sense is None else sense
    lost = np.where(size > SIGNIFICANT * np.sqrt(radial), 0, int(Flag.RATIO_NOT_SIGNIFICANT))
    # Records without a beat stay nan, whatever the correction was.
    blank = np.where(estimate.usable, 1.0, np.nan)
    return replace(
        estimate,
        lock_in_rate=value * blank,
        lock_in_rate_u=value_u * blank,
        lock_in_rate_low_95=low * value_u * blank,
        lock_in_rate_high_95=high * value_u * blank,
        input_rate=turning * input_rate_from_beat(unbiased, beat_rate) * blank if given is None else given,
        ratio=unbiased * blank,
        ratio_u=np.sqrt(radial) * blank,
        complex_ratio=ratio * blank,
        complex_ratio_covariance=covariance * blank[..., np.newaxis, np.newaxis],
        backscatter_phase=np.angle(-ratio * turning) * turning * blank,
        flags=(estimate.flags & ~int(Flag.RATIO_NOT_SIGNIFICANT)) | lost,
    )
