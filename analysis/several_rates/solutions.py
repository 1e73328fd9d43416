"""From the minima of a fit to one value, its uncertainty and an interval that holds all of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple, dataclass

import numpy as np
import scipy.special

from analysis.arrays import NORMAL_95, Floats
from analysis.lockin_rate import size_interval
from analysis.several_rates.points import Points
from analysis.several_rates.ratio_model import N_PARAMETERS, PHASES, Prior, RatioData, RatioFit, profile
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
        for row in np.flatnonzero(np.abs(values - values[0]) > _ANOTHER * us)
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


_ANOTHER = 0.5  # standard uncertainties by which another solution differs at least

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


def with_coupling(
    said: RatesAnswer, fit: RatioFit, data: RatioData, *, failed: bool, by_beats: CouplingSeen | None
) -> RatesAnswer:
    """The answer freed of what coupling without loss is expected to add to it, for a gain corner that is seen."""
    # An angle eps between the backscatter of the two beams makes WL too high by a part of c = (B_s/g_d)^2, B_s =
    # 2 pi K WL tan(eps/2), g_d a third of g_c (docs/several_rates.md), which no ratio shows. Every angle is
    # as likely up to 60 degrees where all fits, and 120 where not; beats and rates that are known weigh them.
    gain_time, u = float(fit.parameters[0, 3]), float(np.sqrt(fit.covariance[0, 3, 3]))
    if not gain_time > _SEEN * u:
        return said
    doubtful = failed or (by_beats is not None and by_beats.significant)
    angles = (_LARGEST_ANGLE if doubtful else _USUAL_ANGLE) * (np.arange(_ANGLES) + 0.5) / _ANGLES
    two_pi_k = float(data.angular[0] / data.beat_rate[0])
    size = two_pi_k * said.value * GAIN_OVER_DIFFERENCE * gain_time
    added = (size * np.tan(angles / 2)) ** 2
    weights = np.ones(_ANGLES) if by_beats is None else by_beats.likelihood(added)
    parts = _PARTS if np.unique(np.sign(data.rate)).size == 2 else _IN_ONE_SENSE
    by_beat = _BY_BEAT if data.reference == "beat" else 0.0
    lag = float(data.angular.min()) * gain_time
    if lag < _SLOW_GAIN:
        parts = (parts + by_beat) / (1 + 5 * lag**2)
    else:  # what equation (4) pushes fades, what else there is was not compared
        parts = 2 * parts - 0.5 + by_beat / (1 + (GAIN_OVER_DIFFERENCE * lag) ** 2)
    more = parts[:, np.newaxis] * added
    shares = np.where(more > 0, 1 / (1 + np.abs(more)), 1 - more)
    mean, square = (float(np.average((shares**power).mean(axis=0), weights=weights)) for power in (1, 2))
    sd = math.sqrt(max(square - mean**2, 0.0))
    others = tuple(
        Alternative(*(mean * size for size in astuple(one)[:4]), *astuple(one)[4:]) for one in said.others
    )
    freed = RatesAnswer(mean * said.value, mean * said.u, mean * said.low, mean * said.high, others)
    return widened(freed, sd / mean)


_PARTS, _IN_ONE_SENSE, _BY_BEAT, _SLOW_GAIN = np.linspace(-0.5, 1.0, 31), np.linspace(-0.5, 3.0, 71), 0.5, 0.5
"""Parts of c by which WL comes out too high, 0.5 to 1 for equal beams, and less than nothing for unequal ones that
are in phase; what is added where the beat, which they push, stands for the rate; and slowest beat over gain corner
up to which they fade as known. By the integrated equations, for a2/a1 up to 2.5 and angles up to 60 deg."""


def widened(said: RatesAnswer, share_u: float) -> RatesAnswer:
    """The answer with one more unknown beside what it counts, of standard deviation `share_u` of its value."""
    extra = share_u * said.value
    reach = NORMAL_95 * extra
    low = said.value - math.hypot(said.value - said.low, reach)
    high = said.value + math.hypot(said.high - said.value, reach)
    return RatesAnswer(said.value, math.hypot(said.u, extra), max(low, 0.0), high, said.others)


_SEEN = 3.3
_LARGEST_ANGLE, _USUAL_ANGLE, _ANGLES = math.radians(120.0), math.radians(60.0), 500
"""Largest angles between the backscatter of the beams, and how many of each are tried."""


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


# --------------------
# Coupling of the beams without loss, as beats and rates show it together.
#
# Backscatter of the two beams whose phases do not add up to zero has a part B_s that takes no energy. It makes the
# lock-in rate that the ratios show too high by c = (B_s/g_d)^2, g_d the rate at which the difference of the beams
# relaxes, and no ratio shows it. But it pushes the beat up, equation (4) of docs/several_rates.md:
#
#     df/f = B_s^2/[2 (w^2 + g_d^2)] = c g_d^2/[2 (w^2 + g_d^2)],      w = 2 pi f
#
# so rates that are known beside the beats tell how large c is. An error that all rates share is one
# factor of all beats, a rate that is there all the time (the earth's) goes as 1/W: both are fitted beside c


GAIN_OVER_DIFFERENCE = 3.0  # g_c/g_d, for a cross saturation of half the self saturation

LEAST_U = 1e-6
"""Of a beat over its rate: no table turns more steadily from one rate to the next, whatever its display says."""


@dataclass(frozen=True)
class CouplingSeen:
    """c = (B_s/g_d)^2, its standard uncertainty, and how many of these 95 % allow."""

    share: float
    u: float
    reach: float

    @property
    def significant(self) -> bool:
        """Whether it is more than chance makes of no coupling."""
        return abs(self.share) > 1.7 * self.reach * self.u

    def likelihood(self, shares: Floats) -> Floats:
        """How likely the beats make these c (n,); where c surely seems negative the rates are wrong by as much."""
        wrong = max(-self.share - self.reach * self.u, 0.0)
        u = math.hypot(self.u * self.reach / NORMAL_95, wrong)
        off = ((shares - max(self.share, 0.0)) / u) ** 2
        return np.asarray(np.exp(-0.5 * (off - off.min())))


def coupling_seen(beats: Floats, lock_in_u: float) -> CouplingSeen | None:
    """Coupling without loss by beats at several rates; ``None`` where rates and beats do not determine it."""
    total = beats[0]
    if total.size == 0:
        return None
    seen, pulled, slowness, drift = beats[1:] / total
    pushed = 0.5 / (1 + (GAIN_OVER_DIFFERENCE * slowness) ** 2)
    columns = np.stack([pushed + pulled, np.ones(total.size), drift / np.abs(drift).max(), pulled], axis=-1)
    free = total.size - columns.shape[1] + 1
    if free < 1:
        return None
    # that WL is known from elsewhere is one more value
    white = np.concatenate([columns * np.sqrt(total)[:, np.newaxis], [[0.0, 0.0, 0.0, 1 / lock_in_u]]])
    aim = np.append(seen * np.sqrt(total), 0.0)
    size = np.linalg.norm(white, axis=0)
    scaled = white / size
    if np.linalg.cond(scaled) > _ALIKE:
        return None
    inverse = np.linalg.inv(scaled.T @ scaled)
    found = inverse @ (scaled.T @ aim)
    left = aim - scaled @ found
    scatter = max(float(left @ left) / free, 1.0)
    u = float(np.sqrt(inverse[0, 0] * scatter)) / size[0]
    # what each beat is known to was stated, and is good for as much as some more beats would tell of it
    return CouplingSeen(float(found[0] / size[0]), u, float(scipy.special.stdtrit(free + _STATED, 0.975)))


def said_by_beats(rate: Floats, mismatch: Floats, mismatch_u: Floats, square: Floats, slowness: Floats) -> Floats:
    """What n records with a beat say: their weights, and weighted values that are to be added up, (5, n)."""
    weights = 1 / (mismatch_u**2 + LEAST_U**2)
    return np.asarray(
        weights * np.stack([np.ones_like(rate), mismatch, square / (1 - square), slowness, 1 / rate])
    )


def beats_of_rates(points: Points, mismatch: Floats, lock_in_rate: float, gain_time: float) -> Floats:
    """What the records of a fit say at each rate in each sense, (5, p), for :func:`coupling_seen`."""
    records, sums = points.records, np.zeros((5, len(points.places)))
    for some, every in records.records.blocks():
        rows = np.flatnonzero(records.used[some] & np.isfinite(mismatch[some]))
        block, frequency = every.take(rows), every.beat_frequency[rows]
        square = (lock_in_rate / block.rate) ** 2
        rate_u = records.rate_u[some][rows] / np.abs(block.rate) / (1 - square)
        us = np.hypot(block.beat_frequency_u / frequency, rate_u)
        slowness = 2 * np.pi * frequency * gain_time
        sums += points.places.sums(block, *said_by_beats(block.rate, mismatch[some][rows], us, square, slowness))
    there = sums[0] > 0
    _, place = np.unique(2 * points.rate_group[there] + (points.points.rate[there] > 0), return_inverse=True)
    return np.stack([np.bincount(place, column) for column in sums[:, there]])


_ALIKE, _STATED = 1e6, 4
"""Condition number from which on the unknowns are not told apart; degrees of freedom of uncertainties stated."""
