"""What tests a fit over several rates: the fit without each rate, rates against beats, flags."""

from __future__ import annotations

import numpy as np
import scipy.special

from analysis.several_rates.least_squares import RatioFit, fit_ratios
from analysis.several_rates.points import Points
from analysis.several_rates.ratio_model import Prior
from analysis.several_rates.ratio_records import RatioRecords, inconsistent_rate, mismatch_of_all, rates_differ
from analysis.several_rates.result import RatesFit, RatesFlag, WithoutOneRate
from analysis.several_rates.solutions import lock_in_u

UNLIKELY = 0.001
SIGNIFICANT = 3.3
FREE_OF_DISTORTION = ("lock-in", "gain")
FREE_OF_GAIN = ("lock-in", "distortion")

DISTORTION_COST = 10.0
"""Distortion that costs more than this factor means rates too close together to tell it from lock-in."""

LOOSE = 0.3
"""A lock-in rate with a larger relative uncertainty is not determined."""

MISFITS_BY_CHANCE = 0.05
EXPLAINED = 5.0
"""Third-order distortion of so many standard uncertainties is what the misfit of the records was."""


def leave_out(points: Points, fit: RatioFit, prior: Prior) -> WithoutOneRate:
    """The fit without each rate in turn, from the solution of all.

    A rate disagrees where chi-square falls by more without it than its own values explain: that takes all its
    values together, with their covariance and that of the fit.
    """
    data, group = points.points, points.rate_group
    n_groups = int(group.max()) + 1
    empty = np.empty(0)
    if n_groups < 2:
        return WithoutOneRate(empty, empty, empty, empty, empty)
    kept = (group != np.arange(n_groups)[:, np.newaxis]).astype(float)
    others = fit_ratios(data.weighted(kept), prior, np.repeat(fit.parameters, n_groups, axis=0))
    along = fit.parameters[0, :2] / max(float(np.hypot(*fit.parameters[0, :2])), 1e-300)
    value = np.hypot(others.parameters[:, 0], others.parameters[:, 1])
    u = np.sqrt(np.einsum("i,bij,j->b", along, others.covariance[:, :2, :2], along))
    shift = (others.parameters[:, :2] - fit.parameters[0, :2]) @ along
    # The value of all is made of that of the others and of the rate left out, so variances subtract.
    gained = np.maximum(u**2 - lock_in_u(fit) ** 2, (1e-3 * u) ** 2)
    blank = np.where(others.singular, np.nan, 1.0)
    fall = fit.chi_square[0] - others.chi_square
    known = (data.third_weight > 0) & (prior.sd[5] > 0)
    values = np.array([2 * np.sum(group == g) + np.sum(known & (group == g)) for g in range(n_groups)])
    chance = scipy.special.chdtrc(values, np.maximum(fall, 0.0))
    rates = np.array([np.abs(data.rate[group == g]).mean() for g in range(n_groups)])
    return WithoutOneRate(
        rates,
        value * blank,
        u * blank,
        shift / np.sqrt(gained) * blank,
        np.minimum(chance * n_groups, 1.0) * blank,
    )


def scale_factor_of_rates(scale_factor: float, points: Points, fit: RatioFit) -> tuple[float, float]:
    """K that beats and rates given ask for, pulses per degree: f/W freed of lock-in by r of the fit.

    The uncertainty is that of the mean of all points, from their scatter; an error that all rates share is not in
    it.
    """
    data = points.points
    size = float(np.hypot(*fit.parameters[0, :2]))
    base = np.abs(data.rate) if data.reference == "rate" else data.beat_rate
    x = np.minimum(size / base, 1.0 if data.reference == "rate" else np.inf)
    free = np.sqrt(np.maximum(1 - x**2, 1e-12)) if data.reference == "rate" else 1 / np.sqrt(1 + x**2)
    each = data.beat_rate * scale_factor / np.abs(data.rate) / free
    # what is not known of the lock-in rate weighs with its square over that of the rate
    weights = 1 / (1e-5 + (lock_in_u(fit) / size * x**2) ** 2) if size > 0 else np.ones_like(each)
    mean = float(np.average(each, weights=weights))
    if each.size < 2:
        return mean, float("nan")
    spread = float(np.sqrt(np.average((each - mean) ** 2, weights=weights) / (each.size - 1)))
    return mean, spread


def rates_flags(fit: RatesFit, records: RatioRecords, tested: int) -> int:
    """Bits of `RatesFlag` of a result that has none yet; `tested`: values that the records leave over."""
    size, u = fit.lock_in_rate, fit.lock_in_rate_u
    plain = next((m.lock_in_rate_u for m in fit.models if m.model == "lock-in"), u)
    distorted = next((m.lock_in_rate_u for m in fit.models if m.model == "distortion"), u)
    rate, mismatch = fit.rate, fit.rate_mismatch
    no_beat_above = np.abs(rate[fit.locked]) > fit.lock_in_rate_high_95
    rate_u = fit.each.records.rate_u
    disagree = rates_differ(rate, size, u, mismatch, rate_u) or mismatch_of_all(rate, size, u, mismatch) != 0
    disagree = disagree or bool(np.any(inconsistent_rate(records, rate_u)))
    explained = abs(fit.third_order) > EXPLAINED * fit.third_order_u
    misfits = sum(int(np.sum(block.misfit & fit.used[some])) for some, block in records.blocks())
    conditions = {
        RatesFlag.NOT_SIGNIFICANT: not size > SIGNIFICANT * u,
        RatesFlag.RATES_TOO_CLOSE: fit.model not in FREE_OF_DISTORTION and distorted > DISTORTION_COST * plain,
        RatesFlag.NOT_DETERMINED: u > LOOSE * size,
        RatesFlag.NOT_TESTED: tested <= 0,
        RatesFlag.MISFIT: fit.p_value < UNLIKELY,
        RatesFlag.ONE_RATE_DISAGREES: bool(np.any(fit.left_out.p_value < UNLIKELY)),
        RatesFlag.ONE_SENSE: bool(np.any(rate > 0, where=fit.used) != np.any(rate < 0, where=fit.used)),
        RatesFlag.GAIN_CORNER_ASSUMED_HIGH: fit.model in FREE_OF_GAIN,
        RatesFlag.LOCKED_RECORDS: fit.at_least > 0,
        RatesFlag.NO_BEAT_ABOVE_LOCK_IN: bool(np.any(no_beat_above)),
        RatesFlag.RECORDS_LEFT_OUT: not bool(np.all(fit.used | fit.locked)),
        RatesFlag.RATE_AND_BEAT_DISAGREE: disagree,
        RatesFlag.RATE_BELOW_LOCK_IN: bool(np.any(np.abs(rate) <= size, where=fit.used)),
        RatesFlag.SEVERAL_SOLUTIONS: bool(fit.alternatives),
        RatesFlag.RECORDS_MISFIT: misfits > max(2, MISFITS_BY_CHANCE * fit.used.sum()) and not explained,
    }
    return int(sum(bit for bit, raised in conditions.items() if raised))
