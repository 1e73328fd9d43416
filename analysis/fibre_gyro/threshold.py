"""Threshold, resolution and dead zone of a gyro: what it makes of rates near zero, without whole turns.

The terms are those of IEEE Std 528. With r the change of the output over the change that K times the change of the
input would give:

    threshold    largest, of both senses, of the smallest inputs whose output has r >= 0.5
    resolution   the same of changes about an input that is beyond the threshold
    dead zone    inputs about zero whose output has r < 0.1

A ladder of inputs says of each size whether it passes, with a probability, since r has an uncertainty. The edge
lies between the largest size that fails and the smallest that passes:

    P(edge between rungs j and j + 1)  ~  prod_{i <= j} P(r_i < part)  prod_{i > j} P(r_i >= part)

and anywhere there, evenly in the logarithm (below the first rung: evenly in the rate). So the result needs no
model of the dead zone, its interval holds what the ladder leaves open, and without a dead zone it is a bound.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.special
from numpy.typing import ArrayLike

from analysis.arrays import NORMAL_95, Bools, Floats
from analysis.fibre_gyro.injection import static_level

THRESHOLD_PART, DEAD_PART = 0.5, 0.1
_STRAIGHT, _SURE = 0.2, 4.0  # by which a slope may differ from K, and standard uncertainties beyond which it does
_GRID, _DRAWS = 2000, 300


@dataclass(frozen=True)
class Ladder:
    """Sizes of the input, and how long each is recorded."""

    rate_dps: Floats  # (n,): rising
    seconds: Floats
    too_noisy: tuple[tuple[float, float], ...]  # sizes that are left out, and the seconds that each would take


def plan_ladder(
    lowest_dps: float,
    highest_dps: float,
    angle_random_walk: float,
    *,
    per_decade: int = 3,
    ratio_u: float = 0.05,
    seconds: tuple[float, float] = (10.0, 600.0),
) -> Ladder:
    """Choose a ladder of rates so that the noise of each output is a given part of it.

    Parameters
    ----------
    angle_random_walk : float
        deg/sqrt(h).
    per_decade : int, optional
        With 3 the rungs are 1, 2, 5.
    ratio_u : float, optional
        Wanted standard uncertainty of r, of the output and the one without input together.
    seconds : tuple of float, optional
        Shortest and longest record. A rate that even the longest gives to 5 ratio_u only is left out.

    Examples
    --------
    >>> plan_ladder(0.001, 0.02, 0.02).rate_dps.tolist()
    [0.001, 0.002, 0.005, 0.01, 0.02]
    """
    decades = math.log10(highest_dps / lowest_dps)
    exact = lowest_dps * 10 ** (np.arange(math.floor(decades * per_decade + 1e-9) + 1) / per_decade)
    rungs = sorted({_rounded(float(rate)) for rate in exact} | {highest_dps})
    rate = np.array([one for one in rungs if lowest_dps * 0.999 <= one <= highest_dps], dtype=np.float64)
    needed = 2 * (angle_random_walk / 60 / (ratio_u * rate)) ** 2
    possible = needed <= 25 * seconds[1]
    left_out = tuple((float(r), float(s / 25)) for r, s in zip(rate[~possible], needed[~possible], strict=True))
    return Ladder(rate[possible], np.clip(needed[possible], *seconds), left_out)


def _rounded(rate: float) -> float:
    """One significant digit, of 1, 2, 5 where it is near one of these."""
    decade = 10.0 ** math.floor(math.log10(rate) + 1e-9)
    digit = min((1.0, 2.0, 5.0, 10.0), key=lambda one: abs(math.log(rate / decade / one)))
    chosen = digit if abs(math.log(rate / decade / digit)) < 0.08 else rate / decade
    return float(f"{chosen * decade:.2g}")


@dataclass(frozen=True)
class Responses:
    """What the output makes of each input."""

    input_dps: Floats  # (n,): change of the input against the reference, signed
    ratio: Floats  # (n,): r, and its standard uncertainty
    ratio_u: Floats
    # standard deviation by which the output without input walks from one reference to the next, beyond its noise;
    # in the unit of the output
    wander: float


@dataclass(frozen=True)
class References:
    """Outputs at the reference input: `at` in the unit of the times, `output` and `output_u` in counts; (m,)."""

    at: Floats
    output: Floats
    output_u: Floats


def responses(
    inputs_dps: ArrayLike,
    at: ArrayLike,
    outputs: ArrayLike,
    outputs_u: ArrayLike,
    references: References,
    scale_factor: float,
    *,
    reference_dps: float = 0.0,
    unseen_dps: ArrayLike = 0.0,
) -> Responses:
    """Ratios of found to expected changes of the output, the output at the reference interpolated in time."""
    values = (np.asarray(one, dtype=np.float64) for one in (inputs_dps, at, outputs, outputs_u))
    size, when, output, output_u = values
    if np.any(size == 0):
        raise ValueError("an input of zero is a reference, not a rung of the ladder")
    level = static_level(when, references.at, references.output, references.output_u)
    walk = _wander(references)
    place = np.clip(np.searchsorted(references.at, when) - 1, 0, max(references.at.size - 2, 0))
    bridge = np.ones(size.size)
    if references.at.size > 1:
        part = (when - references.at[place]) / (references.at[place + 1] - references.at[place])
        # between two references a walk is a bridge, beyond the last it goes on
        bridge = np.where((part > 0) & (part < 1), part * (1 - part), np.abs(part - np.clip(part, 0, 1)))
    variance = output_u**2 + level.level_u**2 + walk**2 * bridge
    unseen = np.asarray(unseen_dps, dtype=np.float64)
    found = (output - level.level) / scale_factor + reference_dps
    u = np.sqrt(variance / scale_factor**2 + unseen**2)
    return Responses(size, found / size, u / np.abs(size), walk)


def _wander(references: References) -> float:
    """Walk of the output from one reference to the next, from second differences beyond their noise."""
    if references.output.size < 3:
        return 0.0
    second = np.diff(references.output, 2)
    u = references.output_u
    noise = u[:-2] ** 2 + 4 * u[1:-1] ** 2 + u[2:] ** 2
    return float(np.sqrt(max(float(np.mean(second**2 - noise)) / 2, 0.0)))


@dataclass(frozen=True)
class Edge:
    """Where the output begins."""

    value: float  # median, deg/s; nan where only a bound is known
    low_95: float  # deg/s; 0 and a bound where the smallest rung passes already, infinite where the largest fails
    high_95: float
    undecided_dps: tuple[float, ...]  # inputs whose r lies so near the limit that its 95 % interval holds it

    @property
    def seen(self) -> bool:
        """Whether there is an edge, not only a bound."""
        return math.isfinite(self.value)


@dataclass(frozen=True)
class SmallRates:
    """Threshold and dead zone, or the resolution as threshold of changes."""

    senses: tuple[int, ...]  # those that were measured, 1 and -1
    threshold: Edge  # of the sense with the larger one
    # edges of the dead zone: of positive and of negative inputs, as sizes. Of a sense that was not measured
    # nothing is known.
    rising: Edge
    falling: Edge
    width: Edge  # of the dead zone, both edges together


def small_rates(found: Responses) -> SmallRates:
    """Threshold and dead zone from the responses of a ladder.

    Raises
    ------
    ValueError
        There is no response.

    Examples
    --------
    Nothing up to 0.02 deg/s, everything from 0.05 deg/s on: the edge is between them.

    >>> ladder = np.array([0.01, 0.02, 0.05, 0.1, -0.01, -0.02, -0.05, -0.1])
    >>> ratio = np.array([0.0, 0, 1, 1, 0, 0, 1, 1])
    >>> edge = small_rates(Responses(ladder, ratio, np.full(8, 0.01), 0.0)).rising
    >>> 0.02 < edge.low_95 < edge.value < edge.high_95 < 0.05
    True
    """
    size = np.abs(found.input_dps)
    if size.size == 0:
        raise ValueError("there is no output at a small rate")
    grid = np.concatenate([[0.0], np.geomspace(size.min() / 1000, size.max(), _GRID)])
    senses = tuple(sense for sense in (1, -1) if np.any(sense * found.input_dps > 0))
    halves = {sense: found.input_dps * sense > 0 for sense in senses}
    passed = [_below(grid, size[k], found.ratio[k], found.ratio_u[k], THRESHOLD_PART) for k in halves.values()]
    dead = {
        sense: _below(grid, size[k], found.ratio[k], found.ratio_u[k], DEAD_PART) for sense, k in halves.items()
    }
    smallest = float(max(size[k].min() for k in halves.values()))
    threshold = _edge(grid, np.prod(passed, axis=0), smallest, _undecided(found, THRESHOLD_PART))
    near = _undecided(found, DEAD_PART)
    edges = {
        sense: _edge(grid, below, float(size[halves[sense]].min()), tuple(r for r in near if sense * r > 0))
        for sense, below in dead.items()
    }
    nothing = Edge(math.nan, 0.0, math.inf, ())
    width = nothing if len(senses) < 2 else _width(grid, dead[1], dead[-1], edges[1], edges[-1])
    return SmallRates(senses, threshold, edges.get(1, nothing), edges.get(-1, nothing), width)


def _below(grid: Floats, size: Floats, ratio: Floats, ratio_u: Floats, part: float) -> Floats:
    """Probability that the edge lies below each point of the grid; what is left at its end: above the ladder."""
    rungs, place = np.unique(size, return_inverse=True)
    weight = np.bincount(place, ratio_u**-2.0)
    mean = np.bincount(place, ratio * ratio_u**-2.0) / weight
    distance = (mean - part) * np.sqrt(weight)
    passes, fails = scipy.special.log_ndtr(distance), scipy.special.log_ndtr(-distance)
    score = np.concatenate([[0.0], np.cumsum(fails)]) + np.concatenate([np.cumsum(passes[::-1])[::-1], [0.0]])
    share = np.exp(score - score.max())
    cumulated = np.cumsum(share / share.sum())
    # even in the rate up to the first rung, then in the logarithm
    beyond = np.interp(np.log(np.maximum(grid, 1e-300)), np.log(rungs), cumulated[:-1])
    return np.asarray(np.where(grid < rungs[0], cumulated[0] * grid / rungs[0], beyond), dtype=np.float64)


def _edge(grid: Floats, below: Floats, smallest: float, undecided: tuple[float, ...]) -> Edge:
    low, middle, high = (_quantile(grid, below, part) for part in (0.025, 0.5, 0.975))
    if low < smallest:
        # what lies below the smallest rung is not known: a bound, which that rung itself is at least
        return Edge(math.nan, 0.0, max(_quantile(grid, below, 0.95), smallest), undecided)
    return Edge(middle if math.isfinite(high) else math.nan, min(low, float(grid[-1])), high, undecided)


def _quantile(grid: Floats, below: Floats, part: float) -> float:
    return float(np.interp(part, below, grid)) if below[-1] >= part else math.inf


def _width(grid: Floats, rising: Floats, falling: Floats, one: Edge, other: Edge) -> Edge:
    if not (math.isfinite(one.high_95) and math.isfinite(other.high_95)):
        return Edge(math.nan, one.low_95 + other.low_95, math.inf, ())
    if not (one.seen and other.seen):
        return Edge(math.nan, one.low_95 + other.low_95, one.high_95 + other.high_95, ())
    part = (np.arange(_DRAWS) + 0.5) / _DRAWS
    sums = np.add.outer(np.interp(part, rising, grid), np.interp(part, falling, grid)).ravel()
    low, middle, high = np.quantile(sums, (0.025, 0.5, 0.975))
    return Edge(float(middle), float(low), float(high), ())


def _undecided(found: Responses, part: float) -> tuple[float, ...]:
    near: Bools = np.abs(found.ratio - part) < NORMAL_95 * found.ratio_u
    return tuple(float(rate) for rate in found.input_dps[near])


def slopes_beyond(found: Responses) -> list[tuple[float, float, float, float]]:
    """Steps of the ladder beyond the threshold in which the output does not follow K.

    A dead zone that does not lie about zero, or another scale factor there.

    Returns
    -------
    list of tuple
        Inputs at both ends, deg/s, slope over K and its standard uncertainty.

    Examples
    --------
    Six tenths of K up to 0.1 deg/s:

    >>> inputs = np.array([0.01, 0.02, 0.05, 0.1, 0.2])
    >>> found = Responses(inputs, np.array([0.6, 0.6, 0.6, 0.6, 0.8]), np.full(5, 0.001), 0.0)
    >>> [(low, high, round(slope, 2)) for low, high, slope, _ in slopes_beyond(found)]
    [(0.02, 0.05, 0.6), (0.05, 0.1, 0.6)]
    """
    steps = []
    for sense in (1, -1):
        of_sense = sense * found.input_dps > 0
        size, place = np.unique(np.abs(found.input_dps[of_sense]), return_inverse=True)
        weight = np.bincount(place, found.ratio_u[of_sense] ** -2.0)
        ratio = np.bincount(place, found.ratio[of_sense] * found.ratio_u[of_sense] ** -2.0) / weight
        passing = np.flatnonzero(ratio >= THRESHOLD_PART)
        # At the first rung that passes the output may still be on its way out of the dead zone.
        for low in range(int(passing[0]) + 1 if passing.size else size.size, size.size - 1):
            apart = size[low + 1] - size[low]
            slope = (ratio[low + 1] * size[low + 1] - ratio[low] * size[low]) / apart
            u = math.hypot(*(size[[low, low + 1]] * weight[[low, low + 1]] ** -0.5)) / apart
            if abs(slope - 1) > max(_STRAIGHT, _SURE * u):
                steps.append((sense * float(size[low]), sense * float(size[low + 1]), float(slope), u))
    return steps


def refined(found: Responses, count: int) -> Sequence[float]:
    """Further inputs, signed, between the largest that fails and the smallest that passes; none without an edge.

    Examples
    --------
    >>> found = Responses(np.array([0.01, 0.04, 0.08]), np.array([0.0, 1.0, 1.0]), np.full(3, 0.01), 0.0)
    >>> refined(found, 1)
    [0.02]
    """
    inputs: list[float] = []
    for sense in (1, -1):
        of_sense = sense * found.input_dps > 0
        size, ratio = np.abs(found.input_dps[of_sense]), found.ratio[of_sense]
        failing = size[ratio < THRESHOLD_PART]
        passing = size[(ratio >= THRESHOLD_PART) & (size > (failing.max() if failing.size else math.inf))]
        if passing.size:
            between = np.geomspace(failing.max(), passing.min(), count + 2)[1:-1]
            inputs += [sense * float(f"{rate:.6g}") for rate in between]
    return inputs
