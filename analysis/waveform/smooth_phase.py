"""Records whose rate moves smoothly, many at a time: the phase of the beat is a spline.

    v = C(t) + A(t) sin(phi),      exp(i phi) = (i rho + exp(i chi)) / (1 - i rho* exp(i chi)),
    rho = (s + i c)/(a + w),       a^2 = w^2 + b^2,    s + i c = b exp(i gamma),    b = 2 pi K WL
    chi = X + E Im(exp(iX) rho*) + (2 w''/(a w (1 - r^2)) - 3 E w'/w)/w Re(exp(iX) rho*),
    E = 2 w'/(a w (1 - r^2)),      w = X'

a is 2 pi K W. The first line is the steady waveform with the ratio r = |rho| of the rate of each instant, which
holds exactly with d(chi)/dt = w - 2 r'/(1 - r^2) sin; the rest is the second adiabatic order of that. So a sample
depends on the phase X at its own time alone. With X a cubic spline on equal intervals and A and C low
polynomials, the normal equations are a band of four beside an arrow of ten parameters, and nothing is integrated
along the record.

How smooth X is, the record says: its differences of an order d from 2 to 4 are independent values of a variance
that has the greatest restricted likelihood. The interval then counts every path that X may take between the
samples, and 2 S(w)/N: the noise of the rate at the frequency of the beat itself, which no fit tells from lock-in.

Not for motions that are fast beside the beat: `Path.fast` says how fast, and who calls takes the exact fit
(`trajectory`) instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.special
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial import legendre
from scipy.linalg import lapack

from analysis.arrays import Bools, Complexes, Floats, Indices, Ints, Samples, Stacked

SLOW = 4  # Legendre polynomials of amplitude and of offset
OTHERS = 2 + 2 * SLOW  # parameters beside the path: s, c, amplitude, offset

KNOTS_PER_PERIOD, FEWEST_KNOTS, MOST_KNOTS = 1.75, 6, 160
KNOT_CLASSES = 1.1  # the numbers of knots that occur are so far apart: records of like numbers are fitted together
ORDERS = (2, 3, 4)  # differences of the path whose size is that of noise
AT_ONCE = 8  # records whose samples are worked on together: they stay in the cache

NOT_AT_CRESTS = 0.02
"""Trust in a phase that was read from the samples where they are at a crest, over that between two."""

FREED, TIED = 4, 1e3  # so many iterations about a step go with a path that is as tight as that
ITERATIONS, ENOUGH = 7, 0.03  # a step that gains less than so many variances of a sample's noise is the last one

RIDGE = 1e-10
LOOSEST, TIGHTEST = 1e-6, 1e14  # weights of the differences


@dataclass(frozen=True)
class Paths(Stacked):
    """Fits of (R,) records; rates in rad per sample."""

    rate: Floats  # (R,) mean of a
    pull: Floats  # (R, 2) s, c
    covariance: Floats  # (R, 3, 3) of the three
    turned: Complexes  # (R,) i exp(i (chi - gamma)) in the middle of the record
    amplitude: Floats  # (R,) means of A and C
    offset: Floats
    variance: Floats  # (R,) of the noise of a sample
    degrees: Floats  # (R,) samples less parameters
    left: Samples  # (R, N)
    moves: Floats  # (R,) what the samples say against an even phase, in variances of their noise
    fast: Floats  # (R,) largest |w'|/w^2
    slowest: Floats  # (R,) lowest a but for a hundredth of the samples
    weakest: Floats  # (R,) smallest over largest amplitude
    # (R,) rms by which s and c change along the record, and the share of records in which noise makes as much
    drift: Floats
    drift_chance: Floats
    # (R,) what b may be off by because the time base may have stepped with the rate, and whether it surely has
    stepped_u: Floats
    stretched: Bools


@dataclass(frozen=True)
class _Basis:
    """Intervals of a record: m of h samples; the last one may reach over its end."""

    n_samples: int
    m: int
    h: int
    tables: Samples  # (3, 4, h) the four splines of an interval, their first and their second derivatives
    place: Samples  # (h,) of a sample in its interval, 0 to 1
    slow: Samples  # (SLOW, m, h)

    @property
    def n_path(self) -> int:
        """Coefficients of the path."""
        return self.m + 3

    def cut(self, samples: Samples) -> Samples:
        """(R, N) as (R, m, h), zeros behind the end."""
        room: Samples = np.zeros((len(samples), self.m * self.h), dtype=np.float32)
        room[:, : self.n_samples] = samples
        return room.reshape(-1, self.m, self.h)


@lru_cache(maxsize=64)
def _basis(n_samples: int, knots: int) -> _Basis:
    h = -(-n_samples // knots)
    m = -(-n_samples // h)
    u = np.arange(h) / h
    values = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]) / 6
    slopes = np.stack([-((1 - u) ** 2), 3 * u**2 - 4 * u, -3 * u**2 + 2 * u + 1, u**2]) / (2 * h)
    curves = np.stack([1 - u, 3 * u - 2, 1 - 3 * u, u]) / h**2
    time = (np.arange(m * h) - (n_samples - 1) / 2) * (2 / n_samples)
    slow = legendre.legvander(time, SLOW - 1).T.reshape(SLOW, m, h)
    tables = np.stack([values, slopes, curves])
    return _Basis(n_samples, m, h, tables.astype(np.float32), u.astype(np.float32), slow.astype(np.float32))


@lru_cache(maxsize=256)
def _roughness(n_path: int, order: int) -> tuple[Floats, float, Floats]:
    """Squared differences of an order as a band (5, n), their log determinant, and what makes them."""
    rows = np.diff(np.eye(n_path), order, axis=0)
    square = rows.T @ rows
    band = np.zeros((5, n_path))
    for k in range(order + 1):
        band[k, : n_path - k] = np.diagonal(square, k)
    return band, float(np.linalg.slogdet(rows @ rows.T)[1]), rows


def knots_of(periods: Floats) -> Ints:
    """Knots for records of so many periods (R,)."""
    wanted = np.clip(KNOTS_PER_PERIOD * periods, FEWEST_KNOTS, MOST_KNOTS)
    steps = np.ceil(np.log(wanted / FEWEST_KNOTS) / np.log(KNOT_CLASSES) - 1e-9)
    return np.asarray(np.ceil(FEWEST_KNOTS * KNOT_CLASSES**steps), dtype=np.int64)


# --------------------
# What a path makes of the samples, and its normal equations


@dataclass(frozen=True)
class _PathEquations:
    """Normal equations of (R,) records, not yet smoothed."""

    band: Floats  # (R, 5, n) of the path, by diagonals
    cross: Floats  # (R, n, P)
    others: Floats  # (R, P, P)
    path_side: Floats  # (R, n)
    other_side: Floats  # (R, P)
    power: Floats  # (R,) of the residuals

    def without(self, places: Indices) -> _PathEquations:
        """Without some of the other parameters."""
        kept = np.delete(np.arange(self.other_side.shape[1]), places)
        parts = self.cross[..., kept], self.others[:, kept][..., kept], self.other_side[:, kept]
        # copies lie alike, however many records there are: the last digits of products depend on it
        cross, others, side = (part.copy() for part in parts)
        return _PathEquations(self.band, cross, others, self.path_side, side, self.power)


def _equations(
    values: Samples,
    mask: Samples,
    path: Floats,
    others: Floats,
    place: Floats,
    basis: _Basis,
    *,
    changing: bool = False,
) -> tuple[_PathEquations, Samples, Samples]:
    """Of cut records (R, m, h); with what is left, and the rates w."""
    # `changing`: what s and c may do besides enters too, first of all behind s and c: they change as Legendre
    # polynomials from the first on, and grow at the place of the step
    n_records, n = len(path), basis.n_path
    p = others.shape[1] + (2 * SLOW - 1 if changing else 0)
    band, cross, side = np.zeros((n_records, 5, n)), np.zeros((n_records, n, p)), np.zeros((n_records, n))
    whole = np.empty((n_records, p + 1, p + 1))
    left, rate = np.empty((2, *values.shape), dtype=np.float32)
    for begin in range(0, n_records, AT_ONCE):
        few = slice(begin, begin + AT_ONCE)
        some = values[few], mask[few], path[few], others[few], place[few]
        sums, left[few], rate[few] = _equations_of_few(*some, basis, changing=changing)
        for i in range(4):
            here = slice(i, i + basis.m)
            for j in range(i, 4):
                band[few, j - i, here] += sums[:, :, j, i]
            cross[few, here] += sums[:, :, i, 4:-1]
            side[few, here] += sums[:, :, i, -1]
        whole[few] = sums[:, :, 4:, 4:].sum(axis=1)
    return _PathEquations(band, cross, whole[:, :-1, :-1], side, whole[:, :-1, -1], whole[:, -1, -1]), left, rate


def _equations_of_few(
    values: Samples, mask: Samples, path: Floats, others: Floats, place: Floats, basis: _Basis, *, changing: bool
) -> tuple[Floats, Samples, Samples]:
    """Products of all derivatives and the residual in each interval, (R, m, K, K); residual; rates."""
    windows = sliding_window_view(path, 4, axis=1)
    base = windows[..., 1:2]
    near = (windows - base).astype(np.float32)  # single precision is enough within an interval
    splines, slopes, curves = basis.tables
    x, w, w1 = near @ splines, near @ slopes, near @ curves
    n_steps = others.shape[1] - OTHERS
    if n_steps or changing:
        behind = np.arange(basis.m * basis.h).reshape(basis.m, basis.h) - place[:, np.newaxis, np.newaxis]
        after = (behind > 0).astype(np.float32)
    if n_steps:
        jump, ramp = others[:, OTHERS, np.newaxis, np.newaxis], np.maximum(behind, 0.0)
        base = base + jump * ramp[..., :1]
        x += (jump * (ramp - ramp[..., :1])).astype(np.float32)
        w += jump.astype(np.float32) * after
        ramp = ramp.astype(np.float32)
    x += (base - 2 * np.pi * np.rint(base / (2 * np.pi))).astype(np.float32)
    np.maximum(w, np.float32(1e-5), out=w)
    # third derivative at the knots, so that its slope is the fourth
    third = np.diff(path, 3, axis=1) / basis.h**3
    third = np.concatenate([third[:, :1], (third[:, 1:] + third[:, :-1]) / 2, third[:, -1:]], axis=1)
    third = third.astype(np.float32)
    w2 = third[:, :-1, np.newaxis] + np.diff(third, axis=1)[..., np.newaxis] * basis.place
    s, c = before = others[:, :2].T.astype(np.float32)[..., np.newaxis, np.newaxis]
    if n_steps > 2:
        grown = 1 + others[:, -1, np.newaxis, np.newaxis].astype(np.float32) * after
        s, c = s * grown, c * grown
    a = np.sqrt(w * w + (s * s + c * c))
    q = 1 / (a + w)
    rho_re, rho_im = s * q, c * q
    cos, sin = np.cos(x), np.sin(x)
    rest = 1 - (s * s + c * c) * q * q
    first = 2 / (a * w * rest)
    turn = first * w1 * (sin * rho_re - cos * rho_im)
    turn += first * (w2 - 3 * w1 * w1 / w) / w * (cos * rho_re + sin * rho_im)
    cos, sin = cos - sin * turn, sin + cos * turn
    # with d = 1 - i rho* exp(i chi), exp(i phi) = exp(i chi) d*/d
    d_re, d_im = 1 - rho_im * cos + rho_re * sin, rho_re * cos + rho_im * sin
    shrink = 1 / (d_re * d_re + d_im * d_im)
    even, odd = 2 * d_re * d_re * shrink - 1, 2 * d_re * d_im * shrink
    sin_phi, cos_phi = sin * even + cos * odd, cos * even - sin * odd
    amplitude, offset = (
        _each(others[:, k : k + SLOW].astype(np.float32), basis.slow.reshape(SLOW, -1)).reshape(values.shape)
        for k in (2, 2 + SLOW)
    )
    left = (values - offset - amplitude * sin_phi) * mask
    by_phi = amplitude * cos_phi * mask
    # exp(-i chi)/d*
    e_re, e_im = (cos * d_re - sin * d_im) * shrink, (sin * d_re + cos * d_im) * shrink
    by_w = by_phi * (-2) * (rho_re * e_re + rho_im * e_im) / a
    by_x = by_phi * rest * shrink
    n_pulls = 2 * SLOW + 1 if changing else 2
    rows: Samples = np.empty((*left.shape[:2], 4 + n_pulls + 2 * SLOW + n_steps + 1, basis.h), dtype=np.float32)
    np.multiply(by_x[:, :, np.newaxis], splines, out=rows[:, :, :4])
    rows[:, :, :4] += by_w[:, :, np.newaxis] * slopes
    along = (rho_re * e_re + rho_im * e_im) / a
    by_phi *= 2 * q
    pulls = rows[:, :, 4:6]
    pulls[:, :, 0], pulls[:, :, 1] = by_phi * (e_re - along * s), by_phi * (e_im - along * c)
    if n_steps or changing:
        growth = (pulls[:, :, 0] * before[0] + pulls[:, :, 1] * before[1]) * after
    if n_steps > 2:
        pulls *= grown[:, :, np.newaxis]
    slow = basis.slow.transpose(1, 0, 2)
    if changing:
        for k in range(1, SLOW):
            np.multiply(pulls, slow[:, k, np.newaxis], out=rows[:, :, 4 + 2 * k : 6 + 2 * k])
        rows[:, :, 3 + n_pulls] = growth
    sin_phi *= mask
    number = 4 + n_pulls
    np.multiply(sin_phi[:, :, np.newaxis], slow, out=rows[:, :, number : number + SLOW])
    np.multiply(mask[:, :, np.newaxis], slow, out=rows[:, :, number + SLOW : number + 2 * SLOW])
    if n_steps:
        number += 2 * SLOW
        rows[:, :, number], rows[:, :, number + 1] = by_x * ramp + by_w * after, by_x * after
    if n_steps > 2:
        rows[:, :, -2] = growth
    rows[:, :, -1] = left
    return (rows @ rows.transpose(0, 1, 3, 2)).astype(np.float64), left, w


# --------------------
# The fit


def fit_smooth_phase(values: Floats, mask: Floats, phase: Floats | None = None) -> Paths:
    """Fit (R, N) records without their means; `mask` is 0 where a sample is missing or clipped."""
    # `phase` (R, N): where it is known roughly from something else than the band of the fundamental
    # Clipped samples keep their values: the first path is read from them too.
    # A record of another number of knots is another problem; each has the same digits whoever is beside it.
    if len(values) == 2 and np.array_equal(values[0], values[1]) and np.array_equal(mask[0], mask[1]):
        return fit_smooth_phase(values[:1], mask[:1], None if phase is None else phase[:1]).take(np.array([0, 0]))
    spectra = np.abs(np.fft.rfft(values)) ** 2
    spectra[:, :2] = 0.0
    line = (spectra[:, :-2] + spectra[:, 1:-1] + spectra[:, 2:]).argmax(axis=1) + 1.0
    knots = knots_of(line)
    fits: list[Paths] = []
    place = np.empty(len(values), dtype=np.intp)
    n_done = 0
    for number in np.unique(knots):
        rows = np.flatnonzero(knots == number)
        place[rows] = n_done + np.arange(rows.size)
        n_done += rows.size
        with np.errstate(all="ignore"):  # a step too far gives nan, and the record goes to the exact fit
            some, basis = None if phase is None else phase[rows], _basis(values.shape[1], int(number))
            fits.append(_fit_alike(values[rows], mask[rows], line[rows], some, basis))
    return Paths.joined(fits).take(place)


def _fit_alike(values: Floats, mask: Floats, line: Floats, phase: Floats | None, basis: _Basis) -> Paths:
    cut, cut_mask, count = basis.cut(values), basis.cut(mask), mask.sum(axis=1)
    phase, trust = _in_band(values, line) if phase is None else (phase, NOT_AT_CRESTS + np.abs(np.cos(phase)))
    path, others = _first(values, mask, phase, trust * mask, basis)
    place = np.zeros(len(values))
    order, weight = _improved(cut, cut_mask, count, path, others, place, basis)
    bent = _without_line(path)
    kink, jump, steps = _step_in(bent)
    place = np.asarray((kink - 1.0) * basis.h)
    paths = _paths(cut, cut_mask, count, path, others, place, weight, order, basis)
    # Where the rate takes two values the path needs a kink; and where b does too, it is the time base that steps.
    rows, at = np.flatnonzero(steps), np.arange(basis.n_path) - 1.0
    line, others = path[rows] - bent[rows], np.concatenate([others[rows], np.zeros((rows.size, 2))], axis=1)
    others[:, OTHERS] = jump[rows] / basis.h
    ramp = others[:, OTHERS, np.newaxis] * np.maximum(at * basis.h - place[rows, np.newaxis], 0.0)
    path = line + _without_line(ramp) - ramp
    place = place[rows]
    for _ in range(2):
        if not rows.size:
            break
        order, weight = _improved(cut[rows], cut_mask[rows], count[rows], path, others, place, basis)
        again = _paths(cut[rows], cut_mask[rows], count[rows], path, others, place, weight, order, basis)
        better = again.variance < WORTH_A_STEP * paths.variance[rows]
        paths.put(rows[better], again.take(better))
        stretched = np.flatnonzero(better & again.stretched)
        rows, path, place = rows[stretched], path[stretched], place[stretched]
        others = np.concatenate([others[stretched], np.zeros((rows.size, 1))], axis=1)
    return paths


def _improved(
    cut: Samples, mask: Samples, count: Floats, path: Floats, others: Floats, place: Floats, basis: _Basis
) -> tuple[Ints, Floats]:
    """Order and weight (R,) of the best fit; path, others and place are moved there."""
    n_records, h, stepping = len(path), basis.h, others.shape[1] > OTHERS
    # what a step is made of must find its place before the path is free
    first = FREED if stepping else 0
    weight, order = (0.1 if first == 0 else TIED) * h * others[:, 2] ** 2, np.full(n_records, 2)
    live, last_cost = np.arange(n_records), np.full(n_records, np.inf)
    for number in range(first + ITERATIONS):
        equations = _equations(cut[live], mask[live], path[live], others[live], place[live], basis)[0]
        if 0 <= number - first < 2:
            orders = ORDERS if number > first else (2,)
            order[live], weight[live] = _likeliest(equations, count[live], path[live], orders)
        step = _solved(equations, path[live], weight[live], order[live])
        degrees = _degrees(count[live], order[live], others)
        variance = np.maximum(step.cost - step.gain, 1e-12 * step.cost) / degrees
        worse = (number > first + 1) & (step.cost > last_cost[live] * (1 + 1e-6)) & (step.gain > 1e-2 * variance)
        # not more than a radian at once, nor than half of what lock-in is
        pull = np.hypot(*others[live, :2].T)
        least = 0.02 * np.abs(np.diff(path[live], axis=1)).mean(axis=1) / h
        share = np.minimum(1.0, 1 / np.maximum(np.abs(step.path).max(axis=1), 1e-12))
        turned = np.hypot(*step.others[:, :2].T)
        share = np.minimum(share, 0.5 * np.maximum(pull, least) / np.maximum(turned, 1e-300))
        share = np.where(worse, 0.25 * share, share)[:, np.newaxis]
        last_cost[live] = step.cost
        path[live] += share * step.path
        others[live] += share * step.others
        if stepping:
            # a phase that jumps by e beside a rate that jumps by d comes from a step e/d samples earlier
            early = others[live, OTHERS + 1] / others[live, OTHERS]
            place[live] -= np.clip(np.where(np.isfinite(early), early, 0.0), -h, h)
            others[live, OTHERS + 1] = 0.0
        if number > first:
            live = live[step.gain >= ENOUGH * variance]
            if not live.size:
                break
    return order, weight


def _without_line(path: Floats) -> Floats:
    places = np.arange(path.shape[1]) - (path.shape[1] - 1) / 2
    bent = path - path.mean(axis=1, keepdims=True)
    return np.asarray(bent - np.vecdot(bent, places)[:, np.newaxis] * places / (places @ places))


def _each(rows: Samples, table: Samples) -> Samples:
    """Products of (R, k) and (k, n), each row by itself: its digits do not depend on how many there are."""
    return np.asarray((rows[:, np.newaxis] @ table)[:, 0])


def _degrees(count: Floats, order: Ints, others: Floats) -> Floats:
    return np.asarray(np.maximum(count - others.shape[1] - order, 1.0))


def _in_band(values: Floats, line: Floats) -> tuple[Floats, Floats]:
    """Phase of the analytic signal of the band about the fundamental, and how far it can be trusted (R, N)."""
    n_records, n_samples = values.shape
    bins = np.arange(n_samples // 2 + 1)
    low, high = np.maximum(0.55 * line, 1.0)[:, np.newaxis], 1.55 * line[:, np.newaxis]
    steep = 8 / np.maximum(0.3 * line, 1.0)[:, np.newaxis]
    band = 1 / (1 + np.exp(np.clip((low - bins) * steep, -40, 40)))
    band /= 1 + np.exp(np.clip((bins - high) * steep, -40, 40))
    spectrum = np.zeros((n_records, n_samples), dtype=np.complex128)
    spectrum[:, : bins.size] = np.fft.rfft(values) * band
    signal = np.fft.ifft(spectrum)
    ends = np.minimum(np.arange(n_samples), np.arange(n_samples)[::-1]) * line[:, np.newaxis] / n_samples
    size = np.abs(signal)
    trust = (size / size.max(axis=1, keepdims=True)) ** 2 * np.clip(ends, 0.002, 1.0)
    return np.unwrap(np.angle(signal)) + np.pi / 2, trust


def _first(values: Floats, mask: Floats, phase: Floats, trust: Floats, basis: _Basis) -> tuple[Floats, Floats]:
    """Path and others by a phase that is known roughly."""
    n_records, n_samples = values.shape
    cut, cut_trust = basis.cut(phase - phase[:, :1]), basis.cut(trust)
    splines = basis.tables[0]
    products = (splines[:, np.newaxis] * splines).reshape(16, -1)
    squares = (cut_trust @ products.T).reshape(n_records, basis.m, 4, 4)
    sums = (cut_trust * cut) @ splines.T
    band_sums, side = np.zeros((n_records, 5, basis.n_path)), np.zeros((n_records, basis.n_path))
    for i in range(4):
        side[:, i : i + basis.m] += sums[:, :, i]
        for j in range(i, 4):
            band_sums[:, j - i, i : i + basis.m] += squares[:, :, i, j]
    band_sums += 0.1 * basis.h * _roughness(basis.n_path, 2)[0]
    path = np.stack(
        [_banded(one, other[:, np.newaxis])[0][:, 0] for one, other in zip(band_sums, side, strict=True)]
    )
    path += phase[:, :1]
    # harmonics on that path
    windows = sliding_window_view(path, 4, axis=1)
    followed = (windows @ splines.astype(np.float64)).reshape(n_records, -1)[:, :n_samples]
    rate = np.diff(path, axis=1).mean(axis=1) / basis.h
    turn = np.exp(1j * followed)
    square = turn * turn
    columns = np.stack([np.ones_like(followed), turn.real, turn.imag, square.real, square.imag], axis=1)
    weighted = columns * mask[:, np.newaxis]
    normal = weighted @ columns.transpose(0, 2, 1) + 1e-9 * n_samples * np.eye(5)
    found = np.linalg.solve(normal, weighted @ values[..., np.newaxis])[..., 0]
    size = np.hypot(found[:, 1], found[:, 2])
    angle = np.arctan2(found[:, 1], found[:, 2])
    cos, sin = np.cos(2 * angle), np.sin(2 * angle)
    rho = np.stack([found[:, 3] * cos - found[:, 4] * sin, found[:, 4] * cos + found[:, 3] * sin]) / size
    rho *= np.minimum(1.0, 0.9 / np.maximum(np.hypot(*rho), 1e-9))
    rest = 1 - np.sum(rho**2, axis=0)
    others = np.zeros((n_records, OTHERS))
    others[:, 0], others[:, 1] = rho * 2 * rate / rest
    others[:, 2] = size / rest
    others[:, 2 + SLOW] = found[:, 0] - others[:, 2] * rho[0]
    return path + angle[:, np.newaxis], others


CHANGES, GROWTH = np.arange(2, 2 * SLOW), 2 * SLOW
"""Places among the other parameters of what s and c may do besides, and of their growth at a step."""

AT_ENDS = 0.01  # share of the samples that may lie lower: a path is hardly known at the very ends of a record

CUT_OFF = 1.25
"""Rate times the length of an interval from which on a path cannot follow the noise of the rate at the beat."""


LEFT_BY_STEP = 0.16
"""Share of the phase's departure from a steady rate that may remain beside a step. Of an even change of the rate,
the smooth motion which is most like a step, a quarter remains."""

SHARP, MOST_OF_IT = 3, 0.7
"""A step bends the path within so many knots, and hardly anywhere else, or explains all but a tenth of that."""

WORTH_A_STEP = 1.002
"""Variance of the samples over that beside a free path which a step may leave: it has fewer parameters."""

SURE, LARGEST = 15.0, 50.0
"""-2 log likelihood by which a step of the time base must be likelier than one of the rate to be called one; and
the largest that is told."""


def _paths(
    cut: Samples,
    mask: Samples,
    count: Floats,
    path: Floats,
    others: Floats,
    place: Floats,
    weight: Floats,
    order: Ints,
    basis: _Basis,
) -> Paths:
    """What the fits say, from one more look at the records."""
    n_records, n_samples, h = len(path), basis.n_samples, basis.h
    n_steps, share = others.shape[1] - OTHERS, place / n_samples
    every, left, rates = _equations(cut, mask, path, others, place, basis, changing=True)
    pull = others[:, :2]
    if n_steps > 2:
        pull = pull * (1 + others[:, -1:] * (1 - share[:, np.newaxis]))
    rate = np.sqrt(rates.astype(np.float64) ** 2 + np.vecdot(pull, pull)[:, np.newaxis, np.newaxis])
    inside = np.arange(basis.m * h).reshape(basis.m, h) < n_samples
    inverse = inside / rate
    by_slope = ((rates * inverse) @ basis.tables[1].T) / n_samples
    by_path = np.zeros((n_records, basis.n_path, 1))
    for i in range(4):
        by_path[:, i : i + basis.m, 0] += by_slope[:, :, i]
    step = _solved(every.without(np.append(CHANGES, GROWTH)), path, weight, order, by_path)
    degrees = _degrees(count, order, others)
    variance = np.maximum(step.cost - step.gain, 1e-12 * step.cost) / degrees
    # the mean rate and s, c as linear in all parameters
    by_others = np.zeros((n_records, 3, others.shape[1]))
    by_others[:, 0, :2] = pull * inverse.sum(axis=(1, 2))[:, np.newaxis] / n_samples
    if n_steps:
        after = np.arange(basis.m * h).reshape(basis.m, h) > place[:, np.newaxis, np.newaxis]
        by_others[:, 0, OTHERS] = np.sum(rates * inverse * after, axis=(1, 2)) / n_samples
    by_others[:, 0] -= (by_path.transpose(0, 2, 1) @ step.by_others)[:, 0]
    by_others[:, 1, 0] = by_others[:, 2, 1] = 1.0
    covariance = by_others @ step.inverse @ by_others.transpose(0, 2, 1)
    covariance[:, 0, 0] += np.vecdot(by_path[..., 0], step.by_more[..., 0])
    covariance *= variance[:, np.newaxis, np.newaxis]
    mean_w = rates.mean(axis=(1, 2), dtype=np.float64)
    noise = variance / weight * h ** (1.0 - 2 * order) * mean_w ** (2.0 - 2 * order)
    noise *= np.where(mean_w * h > CUT_OFF, 2 / n_samples, 0.0)
    noise *= _above_law(path, variance, weight, order, others[:, 2] ** 2 * h / 2)
    covariance[:, 1, 1] += noise
    covariance[:, 2, 2] += noise
    changing = _solved(every.without(np.array([GROWTH])), path, weight, order)
    changes, of_mean = changing.others[:, 2:GROWTH], np.repeat(2 * np.arange(1, SLOW) + 1.0, 2)
    of_changes = changing.inverse[:, 2:GROWTH, 2:GROWTH] * variance[:, np.newaxis, np.newaxis]
    of_changes += noise[:, np.newaxis, np.newaxis] * np.diag(of_mean)
    chi_square = np.vecdot(changes, np.linalg.solve(of_changes, changes[..., np.newaxis])[..., 0])
    growing = _solved(every.without(CHANGES if n_steps < 3 else np.append(CHANGES, -1)), path, weight, order)
    whole = path.copy()
    if n_steps:
        at = (np.arange(basis.n_path) - 1.0) * h
        whole += others[:, OTHERS, np.newaxis] * np.maximum(at - place[:, np.newaxis], 0.0)
    jump = (others[:, OTHERS] if n_steps else np.zeros(n_records)) / np.diff(whole, axis=1).mean(axis=1) * h
    levels = np.stack([1 - jump * (1 - share), 1 + jump * share])
    expected, growth = levels[1] / levels[0] - 1, growing.others[:, 2]
    surer = (growth**2 - (growth - expected) ** 2) / (growing.inverse[:, 2, 2] * variance)
    if n_steps > 2:
        surer[:] = LARGEST
    chance = 1 / (1 + np.exp(-np.clip(surer / 2, -LARGEST, LARGEST)))
    away = np.hypot(*pull.T) * np.abs(levels - 1).max(axis=0)
    middle, u = divmod((n_samples - 1) / 2 / h, 1)
    splines = np.array([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]) / 6
    chi = np.vecdot(path[:, int(middle) : int(middle) + 4], splines)
    if n_steps:
        chi += others[:, OTHERS] * np.maximum((n_samples - 1) / 2 - place, 0.0)
    even = rate.reshape(n_records, -1)[:, :n_samples]
    heights, offsets = (
        _each(others[:, k : k + SLOW], basis.slow.reshape(SLOW, -1))[:, :n_samples] for k in (2, 2 + SLOW)
    )
    bends = np.diff(path, 2, axis=1) / h**2
    slopes = (whole[:, 2:] - whole[:, :-2]) / (2 * h)
    return Paths(
        rate=even.mean(axis=1),
        pull=pull,
        covariance=covariance,
        turned=1j * np.exp(1j * (chi - np.arctan2(pull[:, 1], pull[:, 0]))),
        amplitude=heights.mean(axis=1),
        offset=offsets.mean(axis=1),
        variance=variance,
        degrees=degrees,
        left=left.reshape(n_records, -1)[:, :n_samples],
        moves=_weighted(every.band, _without_line(whole)) / variance,
        fast=(np.abs(bends) / np.maximum(slopes, 1e-5) ** 2).max(axis=1),
        slowest=np.quantile(even, AT_ENDS, axis=1),
        weakest=heights.min(axis=1) / heights.max(axis=1),
        drift=np.sqrt(np.sum(changes**2 / of_mean, axis=1)),
        drift_chance=np.asarray(scipy.special.chdtrc(CHANGES.size, chi_square)),
        stepped_u=away * np.sqrt(chance) if n_steps else np.zeros(n_records),
        stretched=np.asarray((surer > SURE) & (n_steps > 0)),
    )


def _weighted(band: Floats, path: Floats) -> Floats:
    """Square (R,) of paths in the metric of banded matrices."""
    total = np.vecdot(path * band[:, 0], path)
    for k in range(1, 4):
        total += 2 * np.vecdot(path[:, k:] * band[:, k, :-k], path[:, :-k])
    return np.asarray(total)


def _step_in(bent: Floats) -> tuple[Indices, Floats, Bools]:
    """Kinks of paths (R, n) without their lines: place, growth of the slope, and whether they explain the path."""
    n = bent.shape[1]
    places, inner = np.arange(n), np.arange(2, n - 2)
    kinks = np.maximum(places - inner[:, np.newaxis], 0.0)
    middle = places - (n - 1) / 2
    kinks -= kinks.mean(axis=1, keepdims=True)
    kinks -= (kinks @ middle / (middle @ middle))[:, np.newaxis] * middle
    power = np.vecdot(kinks, kinks)
    along = _each(bent, kinks.T)
    best = (along**2 / power).argmax(axis=1)
    found, kink = along[np.arange(len(bent)), best] / power[best], inner[best]
    left = bent - found[:, np.newaxis] * kinks[best]
    # in its course, and in where it bends
    bends = np.diff(bent, 2, axis=1) ** 2
    near = np.abs(places[1:-1] - kink[:, np.newaxis]) <= SHARP
    rest = np.vecdot(left, left) / np.maximum(np.vecdot(bent, bent), 1e-300)
    sharp = (np.vecdot(near, bends) > MOST_OF_IT * bends.sum(axis=1)) | (rest < 0.1 * LEFT_BY_STEP**2)
    return kink, found, np.asarray((rest < LEFT_BY_STEP**2) & sharp)


def _above_law(path: Floats, variance: Floats, weight: Floats, order: Ints, known: Floats) -> Floats:
    """What paths have in the upper half of their band, over what the law of their differences puts there (R,)."""
    found = np.ones(len(path))
    for number in np.unique(order):
        rows = np.flatnonzero(order == number)
        differences = np.diff(path[rows], int(number), axis=1)
        size = differences.shape[1]
        window = np.hanning(size + 2)[1:-1]
        power = np.abs(np.fft.rfft(differences * window)) ** 2 / (window @ window)
        place = np.arange(power.shape[1]) * 2 * np.pi / size
        spline = (2416 + 2382 * np.cos(place) + 240 * np.cos(2 * place) + 2 * np.cos(3 * place)) / 5040
        by_samples = known[rows, np.newaxis] * spline
        by_law = weight[rows, np.newaxis] * (2 * np.sin(place / 2)) ** (2 * number)
        level = (variance[rows] / weight[rows])[:, np.newaxis]
        top = slice(int(np.count_nonzero(place <= np.pi / 2)), None)
        expected = (by_samples / (by_samples + by_law) * level)[:, top].sum(axis=1)
        found[rows] = (power[:, top].sum(axis=1) + level[:, 0]) / (expected + level[:, 0])
    return found


# --------------------
# One step, and how smooth the path is


@dataclass(frozen=True)
class _Step:
    """path, others : changes (R, n), (R, P); gain : what they take from the cost (R,); inverse : (R, P, P)"""

    path: Floats
    others: Floats
    gain: Floats
    cost: Floats
    inverse: Floats
    determinant: Floats  # logarithm
    by_others: Floats  # (R, n, P) what the path takes over from the others
    by_more: Floats  # (R, n, k) the band's inverse times what was asked besides


def _solved(
    equations: _PathEquations, path: Floats, weight: Floats, order: Ints, more: Floats | None = None
) -> _Step:
    """Solve the smoothed equations; `more` (R, n, k): right sides whose solutions by the path alone are wanted."""
    n_records, n, p = equations.cross.shape
    band, side, cost = equations.band.copy(), equations.path_side.copy(), equations.power.copy()
    for number in set(order.tolist()):
        rows, (square, _, differences) = np.flatnonzero(order == number), _roughness(n, number)
        band[rows] += weight[rows, np.newaxis, np.newaxis] * square
        rough = _each(path[rows], differences.T)
        cost[rows] += weight[rows] * np.vecdot(rough, rough)
        side[rows] -= weight[rows, np.newaxis] * _each(rough, differences)
    band[:, 0] += RIDGE * equations.band[:, 0].mean(axis=1)[:, np.newaxis]
    sides = [equations.cross, side[..., np.newaxis], *([] if more is None else [more])]
    right = np.concatenate(sides, axis=2)
    solved, determinant = np.empty_like(right), np.empty(n_records)
    for row in range(n_records):
        solved[row], determinant[row] = _banded(band[row], right[row])
    of_cross, of_side = solved[..., :p], solved[..., p]
    across = equations.cross.transpose(0, 2, 1)
    normal = equations.others - across @ of_cross
    gradient = equations.other_side - (across @ of_side[..., np.newaxis])[..., 0]
    scale = 1 / np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-300))
    scales = scale[:, :, np.newaxis] * scale[:, np.newaxis]
    scaled = normal * scales + 1e-12 * np.eye(p)
    inverse = np.linalg.inv(scaled) * scales
    determinant += np.linalg.slogdet(scaled)[1] - 2 * np.log(scale).sum(axis=1)
    others = (inverse @ gradient[..., np.newaxis])[..., 0]
    change = of_side - (of_cross @ others[..., np.newaxis])[..., 0]
    gain = np.vecdot(side, change) + np.vecdot(equations.other_side, others)
    return _Step(change, others, gain, cost, inverse, determinant, of_cross, solved[..., p + 1 :])


def _banded(band: Floats, right: Floats) -> tuple[Floats, float]:
    """Solution of a positive banded system, and the logarithm of its determinant; nan where it is not positive."""
    factor, failed = lapack.dpbtrf(band, lower=1)
    if failed:
        return np.full_like(right, np.nan), np.nan
    return lapack.dpbtrs(factor, right, lower=1)[0], 2 * float(np.log(factor[0]).sum())


_LEVELS = np.arange(-6.0, 34.0)
"""Logarithms of the power of the path's differences, over that of the samples' noise, that are tried."""


def _likeliest(
    equations: _PathEquations, count: Floats, path: Floats, orders: tuple[int, ...]
) -> tuple[Ints, Floats]:
    """Order and weight (R,) by the path that the samples alone ask for, band by band of frequencies."""
    # Whittle's likelihood finds the weight, the restricted one at that weight the order.
    n_records, n, _ = equations.cross.shape
    band = equations.band
    loose = _solved(equations, path, 1e-4 * band[:, 0].mean(axis=1), np.full(n_records, 2))
    variance = np.maximum(loose.cost - loose.gain, 1e-12 * loose.cost) / _degrees(
        count, np.full(n_records, 2), equations.other_side
    )
    rough = path + loose.path
    means = [band[:, k, : n - k].sum(axis=1)[:, np.newaxis] / (n - k) for k in range(4)]
    known = (means[0] + 2 * (means[1] + means[2] + means[3]))[:, 0]
    power = variance[:, np.newaxis] / (known[:, np.newaxis] * np.exp(-_LEVELS))
    best, best_weight, best_order = np.full(n_records, np.inf), np.ones(n_records), np.full(n_records, 2)
    for order in orders:
        differences = np.diff(rough, order, axis=1)
        size = differences.shape[1]
        if size < 3:
            continue
        window = np.hanning(size + 2)[1:-1] if size > 6 else np.ones(size)
        seen = np.abs(np.fft.rfft(differences * window)) ** 2 / (window @ window)
        place = np.arange(seen.shape[1]) * 2 * np.pi / size
        place[0] = 0.4 * place[1]
        share = np.ones(place.size)
        share[0] = 0.5
        if size % 2 == 0:
            share[-1] = 0.5
        exact = means[0] + 2 * sum(mean * np.cos(k * place) for k, mean in enumerate(means) if k)
        up = (2 * np.sin(place / 2)) ** (2 * order)
        noise = variance[:, np.newaxis] * up / np.maximum(exact, 1e-3 * exact[:, :1])
        noise /= 1 + 1e-4 * means[0] * (2 * np.sin(place / 2)) ** 4 / np.maximum(exact, 1e-9)
        expected = power[:, :, np.newaxis] + noise[:, np.newaxis]
        unlikely = (np.log(expected) + seen[:, np.newaxis] / expected) @ share
        found = power[np.arange(n_records), unlikely.argmin(axis=1)]
        weight = np.clip(variance / found, LOOSEST, TIGHTEST)
        step = _solved(equations, path, weight, np.full(n_records, order))
        degrees = _degrees(count, np.full(n_records, order), equations.other_side)
        left = np.maximum(step.cost - step.gain, 1e-12 * step.cost)
        constant = order * np.log(n) - _roughness(n, order)[1]
        criterion = (
            degrees * (np.log(left / degrees) + 1) + step.determinant - (n - order) * np.log(weight) + constant
        )
        better = criterion < best
        best, best_weight = np.where(better, criterion, best), np.where(better, weight, best_weight)
        best_order = np.where(better, order, best_order)
    return best_order, best_weight
