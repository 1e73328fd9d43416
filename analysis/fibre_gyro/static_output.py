"""The output without rotation or injection, taken off from the outputs with them: its level, and its drift.

GJB style takes the mean of the static outputs before and after. Where they differ by more than their noise, or
where there are more than two, the level is interpolated in time between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats

_SIGNIFICANT = 3.0


@dataclass(frozen=True)
class StaticLevel:
    """Static output at the time of each point.

    Attributes
    ----------
    level, level_u : ndarray, shape (n,)
        Counts.
    mean, mean_u : float
        Of the static outputs before and after.
    drift, drift_u : float
        Last static output less the first, counts; nan with one alone.
    modelled : bool
        Whether the level follows the static outputs in time.
    unseen_slope_u : float
        Standard uncertainty of a drift that is not modelled, counts per unit of the times; 0 where it is.
    weights : ndarray, shape (n, m)
        Factors of the static outputs in the level of each point.
    """

    level: Floats
    level_u: Floats
    mean: float
    mean_u: float
    drift: float
    drift_u: float
    modelled: bool
    unseen_slope_u: float
    weights: Floats


def static_level(times: ArrayLike, static_times: ArrayLike, static: ArrayLike, static_u: ArrayLike) -> StaticLevel:
    """Level of the static output at some times.

    Parameters
    ----------
    times : (n,)
        Of the points, in any unit.
    static_times, static, static_u : (m,)
        Of the static outputs, in the order in which they were taken; counts.

    Raises
    ------
    ValueError
        There is none.

    Examples
    --------
    >>> static_level([1.0, 2.0, 3.0], [0.0, 4.0], [10.0, 14.0], [0.1, 0.1]).level.tolist()
    [11.0, 12.0, 13.0]
    """
    at, when, level, u = (np.asarray(v, dtype=np.float64) for v in (times, static_times, static, static_u))
    if level.size == 0:
        raise ValueError("there is no static output")
    first, last = level[0], level[-1]
    mean, mean_u = float(first + last) / 2, float(np.hypot(u[0], u[-1])) / 2
    if level.size == 1:
        nan = float("nan")
        alone = np.ones((at.size, 1))
        return StaticLevel(alone @ level, alone @ u, mean, float(u[0]), nan, nan, False, 0.0, alone)
    drift, drift_u = float(last - first), float(np.hypot(u[0], u[-1]))
    span = float(when[-1] - when[0]) or 1.0
    modelled = level.size > 2 or abs(drift) > _SIGNIFICANT * drift_u
    if modelled:
        weights = _interpolation(at, when)
        return StaticLevel(
            weights @ level, np.sqrt(weights**2 @ u**2), mean, mean_u, drift, drift_u, True, 0.0, weights
        )
    halves = np.full((at.size, 2), 0.5)
    left = float(np.hypot(drift, drift_u)) / span
    return StaticLevel(halves @ level, np.full(at.size, mean_u), mean, mean_u, drift, drift_u, False, left, halves)


def drift_in_slope(rates: ArrayLike, weights: ArrayLike, times: ArrayLike) -> float:
    """How much of a drift, counts per unit of the times, a weighted line through outputs takes for its slope.

    Examples
    --------
    Rates in rising order take all of it, alternating ones nearly nothing.

    >>> drift_in_slope([-1.0, 0.0, 1.0], [1.0, 1.0, 1.0], [0.0, 1.0, 2.0])
    1.0
    """
    rate, weight, at = (np.asarray(v, dtype=np.float64) for v in (rates, weights, times))
    total = float(weight.sum())
    centred = rate - float(weight @ rate) / total
    return float(weight @ (centred * (at - float(weight @ at) / total))) / float(weight @ centred**2)


def _interpolation(at: Floats, when: Floats) -> Floats:
    """Factors of the static outputs in the level at each time, (n, m); constant beyond the first and the last."""
    place = np.clip(np.searchsorted(when, at) - 1, 0, when.size - 2)
    part = np.clip((at - when[place]) / (when[place + 1] - when[place]), 0.0, 1.0)
    weights = np.zeros((at.size, when.size))
    weights[np.arange(at.size), place] = 1 - part
    weights[np.arange(at.size), place + 1] += part
    return weights
