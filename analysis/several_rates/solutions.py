"""From the minima of a fit to one value, its uncertainty and an interval that holds all of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.special

from analysis.arrays import NORMAL_95, Floats
from analysis.lockin_rate import size_interval
from analysis.several_rates.laser_fit import DISTORTION, LaserFit, laplace
from analysis.several_rates.ratio_model import N_PARAMETERS, PHASES, Prior, RatioData, RatioFit, Reference, profile
from analysis.several_rates.result import Alternative

POSSIBLE = 9.0
"""A minimum whose chi-square is above the best by no more than this is a possible answer: three standard
deviations of one unknown."""


@dataclass(frozen=True)
class RatesAnswer:
    """Lock-in rate of all possible minima: value of the best, uncertainty and interval of all, deg/s."""

    value: float
    u: float
    low: float
    high: float
    others: tuple[Alternative, ...]


def answer(found: RatioFit, widen: float, degrees: int) -> RatesAnswer:
    """The lock-in rate that a fit with one or several minima gives."""
    above = (found.chi_square - found.chi_square[0]) / widen
    possible = found.take(above <= POSSIBLE)
    each = [_size(possible.take(slice(row, row + 1)), widen, degrees) for row in range(possible.chi_square.size)]
    values, us = (np.array([one[k] for one in each]) for k in (0, 1))
    # where phases turn there may be several ways to one lock-in rate
    others = tuple(
        Alternative(*each[row], float(possible.parameters[row, 2]), float(above[above <= POSSIBLE][row]))
        for row in np.flatnonzero(np.abs(values - values[0]) > ANOTHER * us)
    )
    # By Laplace: the share of the probability under each minimum goes with its height and its volume.
    weights = minimum_volumes(possible) * np.exp(-0.5 * above[above <= POSSIBLE])
    weights = weights / weights.sum()
    u = math.sqrt(float(np.sum(weights * (us**2 + (values - values[0]) ** 2))))
    return RatesAnswer(float(values[0]), u, min(one[2] for one in each), max(one[3] for one in each), others)


def largest_possible(found: RatioFit, data: RatioData) -> float:
    """Lock-in rate beyond which beats would contradict their rates, deg/s; inf where they say nothing."""
    # A gyro that beats turns faster than its lock-in rate. That holds if the rates given are those at which the
    # records were taken, and not just senses: if they agree with the beats for one of the minima found.
    rate, sizes = np.abs(data.rate), np.hypot(found.parameters[:, 0], found.parameters[:, 1])
    off = np.abs(np.hypot(data.beat_rate, sizes[:, np.newaxis]) / rate - 1)
    if not np.any(np.all(off < _SAME_RATE, axis=-1)):
        return math.inf
    return float(np.sqrt(np.min((_OTHER_RATE * rate) ** 2 - data.beat_rate**2)))


def up_to(found: RatioFit, most: float) -> RatioFit:
    """The minima whose lock-in rate is not above `most`, deg/s, and at least that of the least."""
    sizes = np.hypot(found.parameters[:, 0], found.parameters[:, 1])
    return found.take(sizes <= max(most, sizes.min()))


ANOTHER = 0.5  # standard uncertainties by which another solution differs at least

_SAME_RATE, _OTHER_RATE = 0.1, 1.5
"""Shares by which a rate may be off and still be that of its beat, and a factor by which none is off."""


def by_profile(
    said: RatesAnswer, found: RatioFit, data: RatioData, prior: Prior, widen: float, degrees: int, most: float
) -> RatesAnswer:
    """The interval from chi-square itself, and an uncertainty to match, where straight lines would not do."""
    # In one sense distortion and gain corner together bend the valley in which the answer lies. The interval holds
    # every lock-in rate for which chi-square is above the best by no more than 95 % allow, the rest being free,
    # and which is not above `most`.
    if not said.value > _WELL_KNOWN * said.u:
        return said
    student = float(scipy.special.stdtrit(degrees, 0.975)) if degrees else NORMAL_95
    minima = range(1 + len(said.others))
    units = [lock_in_u(found.take(slice(row, row + 1))) * math.sqrt(widen) for row in minima]
    around = [float(np.hypot(*found.parameters[row, :2])) + units[row] * _REACH for row in minima]
    tried = np.append(np.concatenate(around), most)
    starts = found.parameters[list(minima)]

    def height(sizes: Floats) -> Floats:
        lowest = np.min([profile(data, prior, start, sizes) for start in starts], axis=0)
        return np.asarray(lowest - found.chi_square[0])

    tried = tried[(tried > 0) & (tried <= most) & np.isfinite(tried)]
    low, high = _ends(height, np.sort(tried), widen * student**2)
    low, high = min(low, said.value), max(high, said.value)
    # one side may be much longer than the other: the root of their mean square, as of a deviation to either side
    u = math.hypot(high - said.value, said.value - low) / math.sqrt(2) / student
    return RatesAnswer(said.value, u, low, high, said.others)


_WELL_KNOWN = 6.0
_OUTWARDS = np.array([1.2, 1.7, 2.2, 2.8, 3.5, 4.5, 6.0, 8.0, 11.0, 15.0, 20.0, 28.0, 40.0])
_REACH = np.concatenate([-_OUTWARDS[::-1], [0.0], _OUTWARDS])
"""Standard uncertainties about a minimum, as its curvature has them, at which the valley is sounded: a bent one is
much longer than that says."""


def _ends(height: Callable[[Floats], Floats], sizes: Floats, allowed: float) -> tuple[float, float]:
    """First and last of rising sizes where a height crosses what is allowed; the valley may have steep walls."""
    for _ in range(1 + _REFINEMENTS):
        inside = np.flatnonzero(height(sizes) <= allowed)
        if inside.size == 0:
            return math.inf, -math.inf
        first, last = int(inside[0]), int(inside[-1])
        before, after = sizes[max(first - 1, 0)], sizes[min(last + 1, sizes.size - 1)]
        low, high = float(sizes[first]), float(sizes[last])
        sizes = np.concatenate([np.linspace(before, low, _FINER), np.linspace(high, after, _FINER)])
    return (low + float(before)) / 2, (high + float(after)) / 2


_REFINEMENTS, _FINER = 1, 6


def widened(said: RatesAnswer, share_u: float) -> RatesAnswer:
    """The answer with one more unknown beside what it counts, of standard deviation `share_u` of its value."""
    extra = share_u * said.value
    reach = NORMAL_95 * extra
    low = said.value - math.hypot(said.value - said.low, reach)
    high = said.value + math.hypot(said.high - said.value, reach)
    return RatesAnswer(said.value, math.hypot(said.u, extra), max(low, 0.0), high, said.others)


def polar_covariance(fit: RatioFit) -> Floats:
    """Covariance (P, P) of |z|, its angle, and the other parameters, of the first set."""
    x, y = fit.parameters[0, :2]
    size = max(float(np.hypot(x, y)), 1e-300)
    turn = np.eye(N_PARAMETERS)
    turn[0, :2], turn[1, :2] = (x / size, y / size), (-y / size**2, x / size**2)
    return np.asarray(turn @ fit.covariance[0] @ turn.T)


def lock_in_u(fit: RatioFit) -> float:
    """Standard uncertainty of |z| of the first set."""
    return float(size_us(fit)[0])


def size_us(fits: RatioFit) -> Floats:
    """Standard uncertainty of every |z|, (B,), deg/s."""
    z = fits.parameters[:, :2]
    along = z / np.maximum(np.hypot(z[:, 0], z[:, 1]), 1e-300)[:, np.newaxis]
    return np.asarray(np.sqrt(np.einsum("bi,bij,bj->b", along, fits.covariance[:, :2, :2], along)))


def _size(fit: RatioFit, widen: float, degrees: int) -> tuple[float, float, float, float]:
    """Value freed of the bias that noise gives to the size of a complex number, its u and 95 % interval."""
    covariance = polar_covariance(fit) * widen
    size = float(np.hypot(*fit.parameters[0, :2]))
    # a phase that turns makes the angle uncertain, and the size none the larger
    turns = PHASES.start + np.flatnonzero(np.diagonal(covariance)[PHASES] > 0)
    shared = covariance[turns, 1:2]
    by_turns = float(np.vecdot(shared[:, 0], np.linalg.solve(covariance[np.ix_(turns, turns)], shared)[:, 0]))
    across = size**2 * max(float(covariance[1, 1]) - by_turns, 0.0)
    u = float(np.sqrt(covariance[0, 0]))
    student = float(scipy.special.stdtrit(degrees, 0.975)) / NORMAL_95 if degrees else 1.0
    low, high = size_interval(size / (u * student))
    return float(np.sqrt(max(size**2 - across, 0.0))), u, float(low) * u * student, float(high) * u * student


def minimum_volumes(possible: RatioFit) -> Floats:
    """Root of the determinant of each covariance, without what is held."""
    held = np.diagonal(possible.covariance, axis1=-2, axis2=-1) == 0
    matrices = possible.covariance + np.eye(N_PARAMETERS) * held[:, np.newaxis, :]
    scale = np.sqrt(np.diagonal(matrices, axis1=-2, axis2=-1))
    correlation = matrices / scale[:, :, np.newaxis] / scale[:, np.newaxis, :]
    volume = np.sqrt(np.maximum(np.linalg.det(correlation), 1e-300))
    relative = (scale / scale[0]).prod(axis=-1)
    return np.asarray(volume * relative)


def answer_of_lasers(found: list[LaserFit], widen: float, reference: Reference) -> RatesAnswer:
    """The lock-in rate that lasers fitted to the beat give."""
    points, best = found[0].model.data.points, found[0].chi_square
    scale = 2 * math.pi * points.records.records.scale_factor
    of_all, *each = ([one / scale for one in a] for a in laplace(found, widen, per_rate=reference == "rate"))
    others = tuple(
        Alternative(
            own[0], own[1], own[2], own[3], float(laser.parameters[DISTORTION]), (laser.chi_square - best) / widen
        )
        for laser, own in zip(found, each, strict=False)  # parts of one valley are no others
        if abs(own[0] - of_all[0]) > ANOTHER * own[1]
    )
    return RatesAnswer(of_all[0], of_all[1], of_all[2], of_all[3], others)
