"""How high each level of a staircase is, and which samples belong to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Bools, Floats, Ints
from analysis.fibre_gyro.staircase.cut import Cut, piece_means, rounding_variance

_SETTLED = 1e-3  # part of a jump that may be left where a level counts as settled
_SHY = 0.75  # samples before an edge that are never used: so uncertain is its position
_ENOUGH = 0.3  # of the usual number of samples that a level must have
_SPIKE = 6.0  # times the noise; a sample farther away does not belong to its level


@dataclass(frozen=True)
class Levels:
    """The levels between the edges."""

    numbers: Ints  # (K,)
    heights: Floats  # (K,)
    counts: Floats
    noise: float
    settling: int
    settled: bool
    slope: float


def read_levels(volts: Floats, cut: Cut) -> Levels:
    """Mean height of every level, without the samples at its edges that have not settled."""
    positions = np.arange(len(volts), dtype=np.float64)
    number = cut.index(positions)
    phase = positions - cut.start - number * cut.period
    after, before, settled = _disturbed(volts, cut.period, number, phase)
    usable = np.isfinite(volts) & (phase >= after) & (cut.period - phase > before)
    usable = _without_spikes(volts, number, usable)
    numbers, counts, heights = piece_means(volts, number, usable)
    # A piece of a level at the ends of the record, or between missing samples, says little and may be all edge.
    usable &= np.isin(number, numbers[counts >= _ENOUGH * np.median(counts)])
    numbers, counts, heights = piece_means(volts, number, usable)
    noise, slope = _within(volts, number, phase, usable, cut.period)
    return Levels(numbers, heights, counts, noise, int(after), settled, slope)


def _disturbed(volts: Floats, period: float, number: Ints, phase: Floats) -> tuple[float, float, bool]:
    """Samples after and before an edge that do not belong to its levels, and whether a level settles at all.

    The mean response to a jump, as a part of the jump, follows from all edges together; the resets weigh most.
    """
    valid = np.isfinite(volts)
    late = valid & (phase > period / 2) & (period - phase > max(_SHY, 0.15 * period))
    numbers, _, heights = piece_means(volts, number, late)
    last = np.interp(number, numbers, heights)
    left = volts - last
    scatter = max(1.5 * float(np.median(np.abs(left[late]))), float(np.sqrt(rounding_variance(volts))))
    jump = last - np.interp(number - 1, numbers, heights)
    response, doubt = _response(left, jump, phase, valid & (period - phase > _SHY), scatter)
    half = max(1, int(np.ceil(period / 2)))
    moving = np.flatnonzero(np.abs(response[:half]) > _SETTLED + doubt[:half])
    after = float(moving[-1] + 1) if moving.size else 0.0
    if moving.size:
        # What is too small to be seen still shifts the level: go on until an exponential has fallen 20 times more.
        seen = min(float(doubt[moving[-1]]) + _SETTLED, 0.3)
        after = min(float(np.ceil(after * (1 + 3 / -np.log(seen)))), max(after, np.floor(0.6 * period)))
    tail, tail_doubt = response[half : int(period)], doubt[half : int(period)]
    change = 0.0
    quarter = tail.size // 2
    if quarter >= 2:
        change = abs(float(tail[:quarter].mean() - tail[quarter:].mean())) - float(tail_doubt.mean())
    next_jump = np.interp(number + 1, numbers, heights) - last
    early, doubt = _response(left, next_jump, period - phase, valid & (phase > period / 2), scatter)
    still = np.flatnonzero(np.abs(early[: half // 2]) <= _SETTLED + doubt[: half // 2])
    before = float(still[0]) if still.size else half / 2
    return after, max(before, _SHY), (not moving.size or moving[-1] + 1 < half) and change <= 2 * _SETTLED


def _response(
    left: Floats, jump: Floats, distance: Floats, usable: Bools, scatter: float
) -> tuple[Floats, Floats]:
    """What is left of a jump at each whole distance from its edge, as a part of it, and four times its noise."""
    at = np.floor(distance[usable]).astype(np.int64)
    weight = np.maximum(np.bincount(at, weights=jump[usable] ** 2), 1e-300)
    response = np.bincount(at, weights=(jump * left)[usable]) / weight
    return np.asarray(response, np.float64), np.asarray(4 * scatter / np.sqrt(weight))


def _without_spikes(volts: Floats, number: Ints, usable: Bools) -> Bools:
    kept = usable.copy()
    places = np.flatnonzero(usable)
    groups = np.split(places, np.flatnonzero(np.diff(number[places])) + 1)
    centre = np.zeros(len(volts))
    for group in groups:
        centre[group] = np.median(volts[group])
    away = np.abs(volts - centre)
    # A converter that rounds leaves most samples without any scatter; one level off is no spike.
    rms = max(1.5 * float(np.median(away[usable])), 0.5 * float(np.sqrt(12 * rounding_variance(volts))))
    kept[usable & (away > _SPIKE * rms)] = False
    return kept


def _within(volts: Floats, number: Ints, phase: Floats, usable: Bools, period: float) -> tuple[float, float]:
    """Rms of the samples about their levels, and the common slope of the levels from edge to edge."""
    numbers, _, heights = piece_means(volts, number, usable)
    _, _, middles = piece_means(phase, number, usable)
    place = np.searchsorted(numbers, number[usable])
    left, along = volts[usable] - heights[place], phase[usable] - middles[place]
    free = max(1, int(usable.sum()) - len(numbers))
    moment = float(np.sum(along**2))
    slope = float(np.sum(along * left)) / moment * period if moment > 0 else 0.0
    return float(np.sqrt(np.sum(left**2) / free)), slope
