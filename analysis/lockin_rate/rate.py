"""From the ratio of the harmonics to the lock-in rate, with its uncertainty and its interval."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from analysis.arrays import Complexes, Floats
from analysis.flags import Flag
from analysis.lockin_equation import Relation, input_rate_from_beat, lock_in_from_beat, lock_in_from_rate
from analysis.lockin_rate.estimate import LockInEstimate
from analysis.lockin_rate.interval import size_interval

SIGNIFICANT = 3.3
"""Noise alone makes a ratio of more than this many of its standard uncertainties in 0.4 % of records."""


def rate_of_ratio(
    size: Floats,
    ratio: Floats,
    beat_rate: Floats,
    covariance: Floats,
    misfit: Floats,
    rate: Floats | None,
    relation: Relation,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Lock-in rate, its standard uncertainty and the ends of its 95 % interval, deg/s."""
    value, by_ratio, by_beat_rate = rate_and_slopes(ratio, beat_rate, rate, relation)
    variance = _variance_along(by_beat_rate, by_ratio, covariance)
    value_u = np.sqrt(np.maximum(variance, 0.0) + (by_ratio * misfit) ** 2)
    observed = rate_and_slopes(size, beat_rate, rate, relation)[0]
    low, high = size_interval(observed / value_u)
    return value, value_u, low * value_u, high * value_u


def _variance_along(x: Floats, y: Floats, covariance: Floats) -> Floats:
    """Variance (...) of x a + y b, from the covariance (..., 2, 2) of a and b.

    Written out: the order in which `einsum` adds depends on how many records there are.
    """
    both = covariance[..., 0, 1] + covariance[..., 1, 0]
    return np.asarray(x * x * covariance[..., 0, 0] + x * y * both + y * y * covariance[..., 1, 1])


def rate_and_slopes(
    ratio: Floats, beat_rate: Floats, rate: Floats | None, relation: Relation
) -> tuple[Floats, Floats, Floats]:
    """Lock-in rate, and its derivatives by the ratio and by f/K; `rate` None: the record is its own reference."""
    r = ratio
    if rate is None and relation == "exact":
        value = lock_in_from_beat(r, beat_rate)
        return value, beat_rate * 2 * (1 + r * r) / (1 - r * r) ** 2, 2 * r / (1 - r * r)
    if rate is None:
        w = beat_rate if relation == "paper-10" else input_rate_from_beat(r, beat_rate)
        by_beat_rate = lock_in_from_rate(r, w / beat_rate, relation)
    else:
        w, by_beat_rate = np.abs(rate), np.zeros_like(r)
    half = 1e-6
    rise = lock_in_from_rate(r + half, w, relation) - lock_in_from_rate(r - half, w, relation)
    return lock_in_from_rate(r, w, relation), rise / (2 * half), by_beat_rate


def backscatter_phase(ratio: Complexes, sense: Floats) -> Floats:
    """Beta less the readout phase, rad, from rho and the sign of the rate."""
    return np.angle(-ratio * sense) * sense


def with_ratio(
    estimate: LockInEstimate,
    ratio: Complexes,
    covariance: Floats,
    sense: Floats | None = None,
    misfit_u: Floats | None = None,
) -> LockInEstimate:
    """The estimate with a corrected rho: lock-in rate, interval and phase from it; frequency and noise stay."""
    misfit_u = estimate.misfit_u if misfit_u is None else misfit_u
    size = np.abs(ratio)
    unit = ratio / np.where(size > 0, size, 1.0)
    radial = _variance_along(unit.real, unit.imag, covariance)
    tangential = _variance_along(-unit.imag, unit.real, covariance)
    unbiased = np.sqrt(np.maximum(size**2 - tangential, 0.0))
    beat_rate = estimate.beat_frequency / estimate.scale_factor
    given = estimate.input_rate if estimate.rate_given else None
    beat_rate_u = estimate.beat_frequency_u / estimate.scale_factor
    both = np.stack([beat_rate_u**2, radial], axis=-1)[..., np.newaxis] * np.eye(2)
    value, value_u, low, high = rate_of_ratio(size, unbiased, beat_rate, both, misfit_u, given, estimate.relation)
    if given is not None:
        turning = np.where(given < 0, -1.0, 1.0)
    else:
        turning = np.ones_like(size) if sense is None else sense
    ratio_u = np.hypot(np.sqrt(radial), misfit_u)
    lost = np.where(size > SIGNIFICANT * ratio_u, 0, int(Flag.RATIO_NOT_SIGNIFICANT))
    # Records without a beat stay nan, whatever the correction was.
    blank = np.where(estimate.usable, 1.0, np.nan)
    return replace(
        estimate,
        lock_in_rate=value * blank,
        lock_in_rate_u=value_u * blank,
        lock_in_rate_low_95=low * blank,
        lock_in_rate_high_95=high * blank,
        input_rate=turning * input_rate_from_beat(unbiased, beat_rate) * blank if given is None else given,
        ratio=unbiased * blank,
        ratio_u=ratio_u * blank,
        misfit_u=misfit_u * blank,
        complex_ratio=ratio * blank,
        complex_ratio_covariance=covariance * blank[..., np.newaxis, np.newaxis],
        backscatter_phase=backscatter_phase(ratio, turning) * blank,
        flags=(estimate.flags & ~int(Flag.RATIO_NOT_SIGNIFICANT)) | lost,
    )
