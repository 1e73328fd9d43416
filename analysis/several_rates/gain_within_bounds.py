"""The answer over every gain time that is possible, where few rates leave it to its bound.

Two rates in one sense are four values for six unknowns. The minimum then lies where the priors, bells about zero,
put it, and a bench whose gain time is anywhere within its bound may lie far along the bent valley. So this is
followed: at every gain time the rest is fitted, and what these fits give is averaged over the bound.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.special

from analysis.arrays import Bools, Floats, Indices
from analysis.several_rates.least_squares import RatioFit, fit_ratios, with_distortion_alone
from analysis.several_rates.ratio_model import N_PARAMETERS, Prior, RatioData
from analysis.several_rates.solutions import Answer, minimum_volumes, size_us

_GAIN_TIME = 3
_OF_THE_BOUND = np.concatenate([np.linspace(0.0, 1.0, 15), [1.2, 1.5, 2.0, 2.5]])
_ABOUT_A_MINIMUM = np.linspace(-4.0, 4.0, 17)
_SAME_SHARE, _SAME_U = 1e-3, 0.5
_INTERVAL, _TAILS, _STEPS = (0.025, 0.975), 6.0, 4001


def over_gain_times(said: Answer, found: RatioFit, data: RatioData, prior: Prior, widen: float) -> Answer:
    """The same value with what any gain time within its bound may make of it.

    The bench may have no gain time to speak of, as `said` takes it, or one anywhere within the bound: both count
    half, so that u is the root of the mean of both squares. The interval holds that of either.
    """
    times = _gain_times(found, prior, widen)
    if times.size < 2:
        return said
    fits, at = _fits_at(times, found, data, prior)
    heights = 0.5 * (fits.chi_square - fits.chi_square.min()) / widen
    weights = (_shares(times, prior)[at] * minimum_volumes(fits)) * np.exp(-heights)
    weights /= weights.sum()
    values, us = np.hypot(fits.parameters[:, 0], fits.parameters[:, 1]), size_us(fits) * math.sqrt(widen)
    square = float(np.sum(weights * (us**2 + (values - said.value) ** 2)))
    low, high = _interval(weights, values, us)
    u = math.sqrt((said.u**2 + square) / 2)
    return Answer(said.value, u, min(said.low, max(low, 0.0)), max(said.high, high), said.others)


def _gain_times(found: RatioFit, prior: Prior, widen: float) -> Floats:
    """Rising gain times, s: all that is possible beforehand, and closer about every minimum."""
    mean, sd = prior.mean[_GAIN_TIME], prior.sd[_GAIN_TIME]
    bound = math.sqrt(3) * sd
    times = [mean + sd * _ABOUT_A_MINIMUM if mean > 0 else bound * _OF_THE_BOUND]
    for minimum, variance in zip(found.parameters, found.covariance[:, _GAIN_TIME, _GAIN_TIME], strict=True):
        times.append(minimum[_GAIN_TIME] + math.sqrt(variance * widen) * _ABOUT_A_MINIMUM)
    rising = np.unique(np.concatenate(times))
    return np.asarray(rising[rising >= 0])


def _shares(times: Floats, prior: Prior) -> Floats:
    """Probability beforehand about each gain time: of a bell where it is known, else of a rectangle."""
    mean, sd = prior.mean[_GAIN_TIME], prior.sd[_GAIN_TIME]
    beyond = times - mean if mean > 0 else np.maximum(times - math.sqrt(3) * sd, 0.0)
    middles = (times[1:] + times[:-1]) / 2
    edges = np.concatenate([times[:1], middles, times[-1:]])
    return np.asarray(np.diff(edges) * np.exp(-0.5 * (beyond / sd) ** 2))


def _fits_at(times: Floats, found: RatioFit, data: RatioData, prior: Prior) -> tuple[RatioFit, Indices]:
    """Every minimum (F,) of the other parameters at each gain time, and the index of its time (F,)."""
    held = np.arange(N_PARAMETERS) == _GAIN_TIME
    rest = Prior(np.where(held, 0.0, prior.mean), np.where(held, 0.0, prior.sd))
    starts = np.repeat(found.parameters, times.size, axis=0)
    starts[:, _GAIN_TIME] = np.tile(times, len(found.parameters))
    starts = np.concatenate([starts, with_distortion_alone(starts, data, rest)])
    fits = fit_ratios(data, rest, starts)
    kept = np.flatnonzero(_different(fits, times.size))
    return fits[kept], kept % times.size


def _different(fits: RatioFit, times: int) -> Bools:
    """Which of the fits, all gain times from one start after the other, is not a better one found again."""
    z = (fits.parameters[:, 0] + 1j * fits.parameters[:, 1]).reshape(-1, times)
    reach = _SAME_U * np.sqrt(np.trace(fits.covariance[:, :2, :2], axis1=-2, axis2=-1)).reshape(z.shape)
    height = fits.chi_square.reshape(z.shape)
    order = np.argsort(height, axis=0, kind="stable")
    z, reach = (np.take_along_axis(each, order, axis=0) for each in (z, reach))
    new = np.ones(z.shape, dtype=bool)
    for row in range(1, len(z)):
        close = np.abs(z[:row] - z[row]) < _SAME_SHARE * np.abs(z[row]) + reach[row]
        new[row] = ~np.any(close & new[:row], axis=0)
    different = np.empty_like(new)
    np.put_along_axis(different, order, new, axis=0)
    return different.ravel()


def _interval(weights: Floats, values: Floats, us: Floats) -> tuple[float, float]:
    """95 % of the sum of bells."""
    sizes = np.linspace(np.min(values - _TAILS * us), np.max(values + _TAILS * us), _STEPS)
    below = scipy.special.ndtr((sizes[:, np.newaxis] - values) / us) @ weights
    low, high = np.interp(_INTERVAL, below, sizes)
    return float(low), float(high)
