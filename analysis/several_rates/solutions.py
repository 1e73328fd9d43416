"""From the minima of a fit to one value, its uncertainty and an interval that holds all of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple, dataclass, replace

import numpy as np
import scipy.special

from analysis.arrays import NORMAL_95, Bools, Complexes, Floats
from analysis.lockin_rate import size_interval
from analysis.several_rates.points import Points
from analysis.several_rates.ratio_model import (
    N_PARAMETERS,
    PHASES,
    Prior,
    RatioData,
    RatioFit,
    fit_ratios,
    lock_in_at,
    profile,
    ratio_of_light,
    residual,
)
from analysis.several_rates.result import Alternative
from analysis.two_mode_laser import lines_in_time, periodic_states, steps_of_a_turn

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


# --------------------
# Backscatter of the beams that is unequal, or whose phases do not add up to zero.
#
# It shows in the harmonics as another lock-in rate, by shares of c = (B_s/g_d)^2: B_s the part of the backscatter
# that takes no energy, g_d the rate at which the difference of the beams relaxes. And it pushes the beat up,
# equation (4) of docs/several_rates.md:
#
#     df/f = B_s^2/[2 (w^2 + g_d^2)] = c g_d^2/[2 (w^2 + g_d^2)],      w = 2 pi f
#
# Equation (1) has neither. So lasers with backscatter of every kind are tried: each adds to the ratios what the
# equations of a two-mode laser say, and the records freed of it are fitted again. What 48 of them leave of ratios
# and beats is a smooth function of the laser, which gives it for 5000 others. The answer is their mean, each
# weighed by how likely it makes all data; where few share the weight, these are looked at closer. Beats may have
# in common a factor (the scale factor), and a part that goes as 1/W (a rate that is always there: the earth's)


LEAST_U = 1e-6
"""Of a beat over its rate: no table turns more steadily from one rate to the next, whatever its display says."""

BACKSCATTER = np.array([[-math.radians(60.0), -math.log(2.5), 0.35], [math.radians(60.0), math.log(2.5), 0.65]])
"""Between which a laser usually is: sum of the phases, rad; logarithm of a2/a1; cross over self saturation."""

_SEEN = 3.3  # standard uncertainties of a gain time that is known well enough to say what coupling does
_BEYOND = np.array([[-0.8, -0.7, -0.2], [0.8, 0.7, 0.2]])  # three standard deviations of what is unusual
_DOUBTFUL = np.array([1.5, 1.0, 1.0])  # times as large an angle where records misfit
_LASERS, _ENOUGH, _MANY, _LOOKS = 48, 36, 5000, 8  # integrated, with a beat at least, all; how often
_LEAST_NUMBER, _NEARLY = 50.0, 0.4  # of lasers that share the weight; power of the likelihood that will do
_MIDDLES, _NARROWER = 100, 0.25  # bells that the next ones are drawn from, and their width over that of all
_ALIKE, _SHORTEST = 1e-6, 1e-12  # unknowns that beats do not tell apart; a gain time, s
_STATED = 4  # degrees of freedom of uncertainties stated
_EVEN = np.array([0.8191725134, 0.6710436067, 0.5497004779])  # steps that fill a cube evenly
_POWERS = 0.5 * 0.7 ** np.arange(60)  # of the likelihood: data hold more than lasers and noise


def with_coupling(
    said: RatesAnswer,
    fit: RatioFit,
    data: RatioData,
    prior: Prior,
    widen: float,
    *,
    doubtful: bool,
    beats: tuple[Floats, Floats, Floats] | None,
) -> RatesAnswer:
    """The answer freed of what unequal or turned backscatter adds to it, for a gain corner that is seen."""
    gain_time, gain_time_u = float(fit.parameters[0, 3]), float(np.sqrt(fit.covariance[0, 3, 3]))
    size = math.hypot(*fit.parameters[0, :2])
    if not (gain_time > _SEEN * gain_time_u and size > 0):
        return said
    usual, mean, sd = BACKSCATTER * (_DOUBTFUL if doubtful else 1.0), 1.0, 0.0
    box, at, rng, density, before = usual + _BEYOND, fit.parameters, np.random.default_rng(0), np.ones(_MANY), 0.0
    many = box[0] + (np.arange(1, 1 + _MANY)[:, np.newaxis] * _EVEN) % 1 * np.ptp(box, axis=0)
    for _ in range(_LOOKS):
        lasers = many[:_LASERS]
        ratio, push, found = ratios_of_lasers(at, lasers, data)
        if found.sum() <= _ENOUGH:  # who would be locked at a rate with a beat is none of these
            many = many * [0.5, 0.5, 1.0]
            continue
        freed = replace(data, ratio=data.ratio - ratio[found] + ratio_of_light(at, data))
        fits = fit_ratios(freed, prior, np.repeat(at, found.sum(), axis=0))
        shares = np.hypot(fits.parameters[:, 0], fits.parameters[:, 1]) / size
        each = [np.log(shares)[:, np.newaxis], residual(fits.parameters, freed, prior) / math.sqrt(widen)]
        if beats is not None:
            seen, by_push, by_lock_in = beats
            each.append(seen - push[found] @ by_push + np.outer(shares**2 - 1, by_lock_in))
        seen, ways = np.concatenate(each, axis=1), _powers_of(lasers[found])
        square = np.sum(seen[:, 1:] ** 2, axis=1)
        near = 1 / (1 + (square - square.min())[:, np.newaxis] / seen.shape[1])  # to the likely ones
        smooth = np.linalg.lstsq(near * ways, near * seen, rcond=None)[0]
        rough = float(np.sum((near * (seen - ways @ smooth))[:, 1:] ** 2)) / (found.sum() - ways.shape[1])
        seen = _powers_of(many) @ smooth
        unusual = np.sum(((many - np.clip(many, *usual)) / _BEYOND[1] * 3) ** 2, axis=1)
        shares = np.exp(np.clip(seen[:, 0], *np.log([shares.min(), shares.max()])))
        power, weights = _weights(seen[:, 1:], each[1].shape[1], rough, unusual, density)
        if power < before:
            break
        before = power
        mean = float(np.average(shares, weights=weights))
        sd = math.sqrt(float(np.average((shares - mean) ** 2, weights=weights)))
        if power > _NEARLY:
            break
        along = np.linalg.lstsq(near * ways, near * fits.parameters, rcond=None)[0]
        at = np.average(_powers_of(many) @ along, axis=0, weights=weights)
        at = np.clip(at, fits.parameters.min(axis=0), fits.parameters.max(axis=0))[np.newaxis]
        # the next ones lie about likely ones
        middles = many[rng.choice(_MANY, _MIDDLES, p=weights / weights.sum())]
        spread = np.linalg.cholesky(_NARROWER**2 * np.cov(many.T, aweights=weights) + 1e-14 * np.eye(3))
        many = middles[np.arange(_MANY) % _MIDDLES] + rng.normal(size=many.shape) @ spread.T
        many = np.clip(many, *box)
        white = np.linalg.inv(spread).T
        away = np.sum(((many @ white)[:, np.newaxis] - middles @ white) ** 2, axis=-1)
        density = np.exp(-0.5 * away).sum(axis=1)
    others = tuple(
        Alternative(*(mean * size for size in astuple(one)[:4]), *astuple(one)[4:]) for one in said.others
    )
    freed_of = RatesAnswer(mean * said.value, mean * said.u, mean * said.low, mean * said.high, others)
    return widened(freed_of, math.hypot(sd, 2 * (mean - 1) * gain_time_u / gain_time) / mean)


def _weights(left: Floats, of_ratios: int, rough: float, unusual: Floats, density: Floats) -> tuple[float, Floats]:
    """Power of the likelihood that is used, and weights of lasers by what each leaves, ratios first."""
    unlikely, free = np.sum(left[:, :of_ratios] ** 2, axis=1), left.shape[1] - of_ratios - 3
    if free > 0:
        # what each beat is known to was stated, and is good for as much as some more beats would tell of it
        chi_square, freedom = np.sum(left[:, of_ratios:] ** 2, axis=1), free + _STATED
        above = (chi_square - chi_square.min()) / max(float(chi_square.min()) / free, 1.0)
        unlikely = unlikely + (freedom + 1) * np.log1p(above / freedom)
    unlikely = unlikely / (1 + rough) + unusual
    unlikely = 0.5 * (unlikely - unlikely.min())
    for power in _POWERS:
        weights = np.exp(-power * unlikely) / density
        if weights.sum() ** 2 > _LEAST_NUMBER * np.sum(weights**2):
            break
    return float(power), weights


def _powers_of(lasers: Floats) -> Floats:
    """What all that lasers (L, 3) change is a sum of, to the fourth order in their difference: (L, 25)."""
    # (a2 e^(i eps/2) - a1 e^(-i eps/2))/(a2 e^(i eps/2) + a1 e^(-i eps/2)); exchanged beams only turn its sign
    x = np.tanh((lasers[:, 1] + 1j * lasers[:, 0]) / 2)
    faster = np.stack([((1 + lasers[:, 2]) / (1 - lasers[:, 2]) / 3) ** k for k in range(3)])
    orders = [(2, 0), (1, 1), (0, 2), (4, 0), (3, 1), (2, 2), (1, 3), (0, 4)]
    powers = [faster * x.real**m * x.imag**n for m, n in orders]
    return np.concatenate([np.ones((1, x.size)), *powers]).T


def ratios_of_lasers(parameters: Floats, lasers: Floats, data: RatioData) -> tuple[Complexes, Floats, Bools]:
    """Ratios of lasers with backscatter of any kind in the place of those of equation (1), for all else the same.

    `lasers` (L, 3) as `BACKSCATTER`. Gives rho and df/f (L, n), and which have a beat.
    """
    z = np.repeat(lock_in_at(parameters, data), len(lasers), axis=0)
    angle, logarithm, saturation = (lasers[:, k, np.newaxis] + np.zeros(z.shape) for k in range(3))
    inequality = np.exp(logarithm)
    coupling = np.exp(-0.5j * angle) + inequality * np.exp(0.5j * angle)
    two_pi_k = float((data.angular / data.beat_rate).flat[0])
    first = two_pi_k * np.abs(z) / np.abs(coupling)
    gain = np.broadcast_to(1 / max(float(parameters[0, 3]), _SHORTEST), z.shape)
    each = np.stack([first, inequality * first, angle / 2, saturation, gain], axis=-1).reshape(-1, 5)
    readout = (np.angle(coupling) - np.angle(z)).reshape(-1, 1)
    rate, angular = (np.broadcast_to(one, z.shape).ravel() for one in (data.rate, data.angular))
    start = np.zeros((rate.size, 2, steps_of_a_turn(data.ratio)))
    if data.reference == "beat":
        values, sagnac, found = periodic_states(each, np.sign(rate) * angular, start, angular)
    else:
        values, sagnac, found = periodic_states(each, two_pi_k * rate, start)
    psi, lines, beat = lines_in_time(each, sagnac, values, 2)
    fringes = np.sqrt(np.exp(values.sum(axis=1))) * np.sin(psi + readout)
    one, two = np.einsum("bk,bmk->mb", fringes, lines)
    free = np.sqrt(np.maximum(sagnac**2 - (two_pi_k * np.abs(z).ravel()) ** 2, 1e-300))
    ratio, push = two * np.abs(one) / one**2, beat / free - 1
    beats = np.all(found.reshape(z.shape), axis=1, keepdims=True)
    return np.asarray(ratio.reshape(z.shape)), np.asarray(push).reshape(z.shape), beats[:, 0]


def beats_of_rates(
    points: Points, mismatch: Floats, lock_in_rate: float, share_u: float
) -> tuple[Floats, Floats, Floats] | None:
    """What the beats at p rates and senses leave of the lock-in equation, in its standard uncertainties, (p + 1,).

    And what the push of each point's beat adds (n, p + 1), and a change of WL^2 (p + 1,), both relative; freed of
    what all beats may have in common. The last: WL is known to `share_u` from the ratios. ``None``: no beats.
    """
    records, sums = points.records, np.zeros((4, len(points.places)))
    for some, every in records.records.blocks():
        rows = np.flatnonzero(records.used[some] & np.isfinite(mismatch[some]))
        block, frequency = every.take(rows), every.beat_frequency[rows]
        square = (lock_in_rate / block.rate) ** 2
        rate_u = records.rate_u[some][rows] / np.abs(block.rate) / (1 - square)
        weight = 1 / ((block.beat_frequency_u / frequency) ** 2 + rate_u**2 + LEAST_U**2)
        each = np.stack([np.ones_like(square), mismatch[some][rows], square / (1 - square), 1 / block.rate])
        sums += points.places.sums(block, *(weight * each))
    place = 2 * points.rate_group + (points.points.rate > 0)
    merge = np.equal.outer(np.unique(place[sums[0] > 0]), place) * sums[0]
    if not merge.size:
        return None
    weight = merge.sum(axis=1)
    merge /= weight[:, np.newaxis]
    seen, pulled, drift = sums[1:] / np.maximum(sums[0], 1e-300) @ merge.T
    columns = np.stack([np.ones_like(drift), drift / np.abs(drift).max(), pulled * share_u])
    root = np.append(np.sqrt(weight), 1.0)
    common = np.column_stack([columns, [0.0, 0.0, 1.0]]) * root
    free = np.diag(root) - root[:, np.newaxis] * (np.linalg.pinv(common, rcond=_ALIKE) @ common)
    return seen @ free[:-1], merge.T @ free[:-1], 0.5 * pulled @ free[:-1]
