"""The lock-in waveform with all its harmonics tied into one geometric series.

    v = c0 + Re[ H e / (1 - q e) ],    e = exp(i w m),    harmonics c_k = H q^(k-1),    r = |q|

Six real parameters: c0, H, q and w. Every harmonic helps to find them, and those that fold back below half the
sampling rate are part of the model instead of an error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scipy.special
from numpy.typing import DTypeLike

from analysis.arrays import Complexes, Floats, Indices, Phasors, Samples, Stacked
from analysis.waveform.frequency import are_all, never_alone, records_at_once

LARGEST_RATIO = 0.995
"""|q| is kept below this: x = 0.99999, where a record of a few periods holds no more information."""

NEGLIGIBLE = {np.dtype(np.float32): 2e-5, np.dtype(np.float64): 1e-12}
"""Harmonics below this share of the fundamental are left out. The first cannot move an estimate from eight-bit
samples, which single precision is for."""

RATIO_CLASSES = (0.01, 0.03, 0.06, 0.1, 0.2, 0.45, 0.7, 0.86)
"""Records are fitted together up to these ratios, each of which says how many harmonics its class needs: a number
that must not depend on what else is in the batch, or the last digits would."""

MANY_HARMONICS = 40  # beyond this many, the closed form on the samples is cheaper than the sum of the harmonics


@dataclass(frozen=True)
class Series(Stacked):
    """Parameters of records, phases counted from the middle of the record."""

    # offset (R,) real; first (R,) H; ratio (R,) q; omega (R,) rad per sample.

    offset: Floats
    first: Complexes
    ratio: Complexes
    omega: Floats

    def moved(self, change: Floats, n_samples: int) -> Series:
        """The parameters after a change (R, 6) in the order c0, Re H, Im H, Re q, Im q, w (rad at the record's
        ends), kept inside their domain.
        """
        ratio = self.ratio + change[:, 3] + 1j * change[:, 4]
        size = np.abs(ratio)
        ratio = np.where(size > LARGEST_RATIO, ratio * (LARGEST_RATIO / np.maximum(size, 1e-300)), ratio)
        turned = np.clip(change[:, 5], -1.0, 1.0) * (2 / n_samples)
        return Series(
            self.offset + change[:, 0],
            self.first + change[:, 1] + 1j * change[:, 2],
            ratio,
            np.clip(self.omega + turned, 0.5 / n_samples, np.pi),
        )


def orders_needed(ratio: float, negligible: float, fewest: int) -> int:
    """How many powers of a ratio are not negligible, at least `fewest`."""
    return max(fewest, math.ceil(math.log(negligible) / math.log(ratio)))


def ratio_classes(ratio: Complexes) -> Iterator[tuple[float, Indices]]:
    """Largest ratio of each class that occurs, and its records; that of the last is `LARGEST_RATIO`."""
    numbers = np.searchsorted(RATIO_CLASSES, np.abs(ratio))
    for number in np.flatnonzero(np.bincount(numbers)):
        yield (*RATIO_CLASSES, LARGEST_RATIO)[number], never_alone(np.flatnonzero(numbers == number))


def sampled_series(series: Series, n_samples: int, precision: DTypeLike = np.float64) -> Samples:
    """The model on the samples, (R, N)."""
    grid: Samples = np.empty((series.omega.size, n_samples), dtype=precision)
    for rows, model in sampled_blocks(series, n_samples, np.dtype(precision)):
        grid[rows] = model
    return grid


def sampled_blocks(
    series: Series, n_samples: int, precision: np.dtype[Any]
) -> Iterator[tuple[slice | Indices, Samples]]:
    """The model on the samples, a few records (r,) at a time, (r, N): they stay in the cache for the next pass."""
    at_once = records_at_once(n_samples, precision)
    for largest, part in ratio_classes(series.ratio):
        some = series.take(part)
        n_harmonics = orders_needed(largest, NEGLIGIBLE[precision], 3)
        closed = n_harmonics > MANY_HARMONICS
        sides = None if closed else _sides(some, n_samples, precision, n_harmonics)
        for start in range(0, part.size, at_once):
            here = slice(start, start + at_once)
            rows = here if are_all(part, series.omega.size) else part[here]
            if sides is None:
                yield rows, _in_closed_form(series.take(part[here]), n_samples, precision)
            else:
                product = np.matmul(sides[0][here], sides[1][here])
                yield rows, product.reshape(len(product), -1)[:, :n_samples]


def _in_closed_form(series: Series, n_samples: int, precision: np.dtype[Any]) -> Samples:
    carrier = carrier_of(series.omega, n_samples, precision)
    first, ratio = (p.astype(carrier.dtype)[:, np.newaxis] for p in (series.first, series.ratio))
    beat = (first * carrier / (1 - ratio * carrier)).real
    return np.asarray(beat + series.offset.astype(precision)[:, np.newaxis])


def _sides(series: Series, n_samples: int, precision: np.dtype[Any], n_harmonics: int) -> tuple[Samples, Samples]:
    """Two real matrices per record, (R, rows, 2K + 2) and (R, 2K + 2, length), whose product is the waveform."""
    # The real parts of K complex products of a coarse and a fine phasor, and the offset.
    outer, inner = record_grid(n_samples)
    coarse, fine = phasors(series.omega, outer, precision), phasors(series.omega, inner, precision)
    first, ratio = (p.astype(coarse.dtype)[:, np.newaxis] for p in (series.first, series.ratio))
    left = np.empty((*coarse.shape, n_harmonics + 1), dtype=coarse.dtype)
    left[..., 0] = first * coarse
    turn = ratio * coarse
    for k in range(1, n_harmonics):
        np.multiply(left[..., k - 1], turn, out=left[..., k])
    left[..., -1] = series.offset[:, np.newaxis]
    powers = harmonic_powers(fine, n_harmonics, 1, axis=1)
    right = np.zeros((len(fine), 2 * n_harmonics + 2, inner.size), dtype=precision)
    right[:, :-2:2] = powers.real
    np.negative(powers.imag, out=right[:, 1:-2:2])
    right[:, -2] = 1.0
    return left.view(precision), right


def carrier_of(omega: Floats, n_samples: int, precision: np.dtype[Any]) -> Phasors:
    """exp(i w m) on the samples, (R, N), from its two short factors."""
    coarse, fine = (phasors(omega, index, precision) for index in record_grid(n_samples))
    product = coarse[:, :, np.newaxis] * fine[:, np.newaxis, :]
    return np.asarray(product.reshape(len(coarse), coarse.shape[1] * fine.shape[1])[:, :n_samples])


# --------------------
# Exact normal equations of the tied series from the sums of a record's harmonics, in closed form.
#
# With g = e / (1 - q e), e = exp(i w m), the waveform is c0 + Re(H g), and its derivatives are made of g and g^2:
#
#     d/dH: g        d/dq: H g^2        d/dw: i m H (g + q g^2)
#
# so every inner product that the normal equations need is a sum over the samples, weighted with t^p, of a product
# of two of 1, g, g^2 and their conjugates. Powers of g are power series in e, sums of which are the kernels:
#
#     g^j = sum over k >= j of C(k-1, j-1) q^(k-j) e^k
#
# and products with conjugates reduce to them by |g|^2 = (1 + 2 Re(q g)) / (1 - |q|^2), since |e| = 1. The cost of
# a
# record is proportional to its number of harmonics, and nothing is left out: few periods, where the harmonics are
# not orthogonal, and folded harmonics, which fall onto each other, are exact


LEFT_OUT_OF_DATA = {np.dtype(np.float32): 1e-6, np.dtype(np.float64): 1e-14}
LEFT_OUT_OF_KERNELS = {np.dtype(np.float32): 1e-9, np.dtype(np.float64): 1e-18}
"""Powers of the ratio below these are left out of the sums. A harmonic that folds onto the fundamental, or onto
zero frequency, has a large sum, and the coefficients hold factors up to its order, or binomials up to thousands:
so they must be small indeed."""


@dataclass(frozen=True)
class SeriesSums(Stacked):
    """Sums over the samples of (R,) records, of which the normal equations are made."""

    counts: Floats  # (R, 3) of t^p
    of_g: Phasors  # (R, 3, 4) of t^p g^j, j = 1..4
    of_data: Phasors  # (R, 2, 2) of v t^p g^j, j = 1, 2

    @staticmethod
    def zeros(n_records: int) -> SeriesSums:
        """Room for those of so many records."""
        of_g, of_data = (np.zeros((n_records, *shape), dtype=np.complex128) for shape in ((3, 4), (2, 2)))
        return SeriesSums(np.zeros((n_records, 3)), of_g, of_data)

    @staticmethod
    def of(values: Samples, weights: Samples | None, series: Series, largest: float) -> SeriesSums:
        """Sums of (R, N) records, 0 where missing, none of whose ratios exceeds `largest`."""
        n_samples, kind = values.shape[1], values.dtype
        n_harmonics = orders_needed(largest, LEFT_OUT_OF_DATA[kind], 3)
        n_orders = orders_needed(largest, LEFT_OUT_OF_KERNELS[kind], 6)
        powers = np.empty((series.ratio.size, n_orders), dtype=np.complex128)
        powers[:, 0] = 1.0
        powers[:, 1:] = series.ratio[:, np.newaxis]
        np.multiply.accumulate(powers, axis=1, out=powers)
        coefficients = np.zeros((series.ratio.size, n_orders, 4), dtype=np.complex128)
        for j, binomials in enumerate(_binomials(n_orders)):
            np.multiply(powers[:, : n_orders - j], binomials, out=coefficients[:, j:, j])
        of_powers = coefficients
        if weights is None:
            kernels = uniform_kernels(series.omega, n_samples, n_orders)
            counts = kernels[:, :, 0]
            # real matrices times complex ones, as two real ones side by side
            of_g = np.matmul(kernels[:, :, 1:], of_powers.view(np.float64)).view(np.complex128)
            of_g *= np.conj(UNIFORM_PHASES)
        else:
            of_weights = np.conj(data_sums(weights, series.omega, n_orders, 2))
            counts = of_weights[:, :, 0].real
            of_g = np.matmul(of_weights[:, :, 1:], of_powers)
        of_data = np.conj(data_sums(values, series.omega, n_harmonics, 1, lowest=1))
        return SeriesSums(counts, of_g, np.matmul(of_data, of_powers[:, :n_harmonics, :2]))


@cache
def _binomials(n_orders: int) -> list[Floats]:
    """C(k-1, j-1), k = j..n_orders, for j = 1..4."""
    return [np.asarray(scipy.special.comb(np.arange(j, n_orders), j)) for j in range(4)]


def equations_of_sums(series: Series, sums: SeriesSums, power: Floats, total: Floats) -> Step:
    """Normal equations of (R,) records at the given parameters."""
    counts, g_sums, v_sums = sums.counts, sums.of_g, sums.of_data
    first, ratio, offset = series.first, series.ratio, series.offset
    column = ratio[:, np.newaxis]
    poisson = 1 / (1 - np.abs(column) ** 2)
    one, two, three, four = (g_sums[..., j] for j in range(4))
    # sums of t^p times |g|^2, g^2 conj(g) and |g|^4
    g_g = poisson * (counts + 2 * (column * one).real)
    gg_g = poisson * (one + column * two + np.conj(column) * g_g)
    gg_gg = poisson * (g_g + 2 * (column * gg_g).real)
    # the slope s = g + q g^2: sums of t^p times s, s g and s conj(g), s g^2 and s conj(g^2), s^2 and |s|^2
    s_, s_g, s_gg = one + column * two, two + column * three, three + column * four
    s_cg, s_cgg = g_g + column * gg_g, np.conj(gg_g) + column * gg_gg
    s_s, s_cs = s_g + column * s_gg, (s_cg + np.conj(column) * s_cgg).real

    normal = empty_matrices(first.size, 6)
    h_gg, turn = first * two[:, 0], 1j * first
    h_squared: Phasors = first * first
    normal[:, 0, 0] = counts[:, 0]
    normal[:, 0, 1], normal[:, 0, 2] = one[:, 0].real, -one[:, 0].imag
    normal[:, 0, 3], normal[:, 0, 4] = h_gg.real, -h_gg.imag
    normal[:, 0, 5] = (turn * s_[:, 1]).real
    _put_block(normal, 1, 1, g_g[:, 0] + 0j, two[:, 0])
    _put_block(normal, 1, 3, np.conj(first * gg_g[:, 0]), first * three[:, 0])
    _put_block(normal, 3, 3, np.abs(first) ** 2 * gg_gg[:, 0] + 0j, h_squared * four[:, 0])
    _put_column(normal, 1, turn * s_cg[:, 1], turn * s_g[:, 1])
    _put_column(normal, 3, turn * np.conj(first) * s_cgg[:, 1], turn * first * s_gg[:, 1])
    normal[:, 5, 5] = np.abs(first) ** 2 * s_cs[:, 2] - (h_squared * s_s[:, 2]).real
    normal[:, 1:, 1:] /= 2
    for row in range(1, 6):
        normal[:, row, :row] = normal[:, :row, row]

    # what the model leaves, times 1, g, g^2 and the slope
    back = np.conj(first)
    left = total - offset * counts[:, 0] - (first * one[:, 0]).real
    left_g = v_sums[:, 0, 0] - offset * one[:, 0] - (first * two[:, 0] + back * g_g[:, 0]) / 2
    left_gg = v_sums[:, 0, 1] - offset * two[:, 0] - (first * three[:, 0] + back * gg_g[:, 0]) / 2
    left_s = v_sums[:, 1, 0] + ratio * v_sums[:, 1, 1] - offset * s_[:, 1]
    left_s -= (first * s_g[:, 1] + back * s_cg[:, 1]) / 2
    by_ratio = first * left_gg
    gradient = np.stack(
        [left, left_g.real, -left_g.imag, by_ratio.real, -by_ratio.imag, (turn * left_s).real], axis=-1
    )
    explained = offset * (total + left) + (first * (v_sums[:, 0, 0] + left_g)).real
    return Step(normal, gradient, np.maximum(power - explained, 0.0))


def _put_block(normal: Floats, row: int, column: int, with_conjugate: Phasors, without: Phasors) -> None:
    """Inner products of Re a, -Im a with Re b, -Im b, twice, from the sums of a conj(b) and of a b."""
    sum_, difference = with_conjugate + without, with_conjugate - without
    normal[:, row, column], normal[:, row, column + 1] = sum_.real, difference.imag
    np.negative(sum_.imag, out=normal[:, row + 1, column])
    normal[:, row + 1, column + 1] = difference.real


def _put_column(normal: Floats, row: int, with_conjugate: Phasors, without: Phasors) -> None:
    """Inner products of Re a, -Im a with Re b, twice, from the sums of b conj(a) and of b a."""
    sum_ = with_conjugate + without
    normal[:, row, 5] = sum_.real
    np.subtract(with_conjugate.imag, without.imag, out=normal[:, row + 1, 5])


# --------------------
# Exact normal equations of the tied series from the samples: for ratios that would need too many harmonics


def equations_by_samples(values: Samples, weights: Samples | None, series: Series) -> Step:
    """Normal equations of (R,) records at the given parameters, in the precision of `values`."""
    tangents, left = _tangents(values, weights, series, drifting=False)
    return step_by_samples(tangents, left)


def drift_by_samples(values: Samples, weights: Samples | None, series: Series) -> tuple[Floats, Floats]:
    """By how much the complex ratio of fitted records would change from the middle to the end if it drifted."""
    # The amplitude may drift beside it, by any share. One step from the minimum of a fit without. Few records at a
    # time: their derivatives stay in the cache.
    found = []
    for few in np.array_split(np.arange(len(values)), -(-len(values) // DRIFTS_AT_ONCE)):
        some = None if weights is None else weights[few]
        step = step_by_samples(*_tangents(values[few], some, series.take(few), drifting=True))
        found.append(step.solve_and_invert())
    change, covariance = (np.concatenate(part) for part in zip(*found, strict=True))
    return change[:, 7:], covariance[:, 7:, 7:]


def step_by_samples(tangents: Samples, left: Samples) -> Step:
    """Normal equations from the derivatives (R, P, N) of a model, frequency last, and what it leaves (R, N)."""
    normal = np.matmul(tangents, tangents.swapaxes(-1, -2))
    gradient = np.matmul(tangents, left[..., np.newaxis])[..., 0]
    power = np.vecdot(left, left)
    return Step(normal.astype(np.float64), gradient.astype(np.float64), power.astype(np.float64))


def _tangents(
    values: Samples, weights: Samples | None, series: Series, *, drifting: bool
) -> tuple[Samples, Samples]:
    """Derivatives (R, P, N), with `drifting` by growth of amplitude and ratio too, and what the model leaves."""
    carrier = carrier_of(series.omega, values.shape[1], values.dtype)
    return tangents_along(carrier, values, weights, series, drifting=drifting)


def tangents_along(
    carrier: Phasors, values: Samples, weights: Samples | None, series: Series, *, drifting: bool = False
) -> tuple[Samples, Samples]:
    """The same for a fundamental (R, N) whose phase need not be even."""
    n_records, n_samples = values.shape
    first, ratio = (p.astype(carrier.dtype)[:, np.newaxis] for p in (series.first, series.ratio))
    below = 1 - ratio * carrier
    wave = carrier * np.conj(below)
    wave *= 1 / (below.real**2 + below.imag**2)
    beat = first * wave
    by_ratio = beat * wave
    index = ((np.arange(n_samples) - (n_samples - 1) / 2) * (2 / n_samples)).astype(values.dtype)
    tangents = np.empty((n_records, 9 if drifting else 6, n_samples), dtype=values.dtype)
    tangents[:, 0] = 1.0
    tangents[:, 1], tangents[:, 2] = wave.real, -wave.imag
    tangents[:, 3], tangents[:, 4] = by_ratio.real, -by_ratio.imag
    # The derivative by w is m Re[i H e / (1 - q e)^2], and H e / (1 - q e)^2 = beat + q by_ratio.
    tangents[:, 5] = -(beat + ratio * by_ratio).imag * index
    if drifting:
        tangents[:, 6] = beat.real * index
        tangents[:, 7:] = tangents[:, 3:5] * index
    left = values - series.offset.astype(values.dtype)[:, np.newaxis] - beat.real
    if weights is not None:
        left *= weights
        tangents *= weights[:, np.newaxis, :]
    return tangents, left


# --------------------
# Normal equations of a batch of least-squares fits, and their solution


RIDGE = 1e-13
"""Added to the scaled diagonal: an exactly singular case (a harmonic on another's alias) stays solvable, and its
variance comes out enormous, as it should."""


ROUNDING = 1e-3  # relative error of an inverse that is still no sign of a singular matrix


def empty_matrices(n_records: int, size: int) -> Floats:
    """Room for (R, P, P) matrices of which each element lies side by side for all records."""
    return np.empty((size, size, n_records)).transpose(2, 0, 1)


@dataclass(frozen=True)
class Step(Stacked):
    """One Gauss-Newton step: normal matrix and gradient, frequency last (its unit: rad at the record's ends)."""

    normal: Floats
    gradient: Floats
    residual_power: Floats

    def solve(self, damping: Floats | None = None) -> Floats:
        """Change of the parameters, (R, P); `damping` (R,) adds that share of each diagonal element."""
        return self.solve_and_invert(damping)[0]

    def covariance(self) -> Floats:
        """Inverse of the normal matrix, (R, P, P): the covariance for unit noise."""
        return self.solve_and_invert()[1]

    def solve_and_invert(self, damping: Floats | None = None) -> tuple[Floats, Floats]:
        """Change of the parameters, (R, P), and inverse of the normal matrix, (R, P, P)."""
        normal = self.normal.transpose(1, 2, 0)
        each = np.arange(normal.shape[0])
        diagonal = normal[each, each]
        scale = 1 / np.sqrt(np.where(diagonal > 1e-100, diagonal, 1.0))  # a constant record has zeros
        inverse = normal * scale
        inverse *= scale[:, np.newaxis]
        inverse[each, each] += RIDGE if damping is None else RIDGE + damping
        smallest = (1 - ROUNDING) / inverse[each, each]
        _invert(inverse)
        # No diagonal element of the inverse is less than the reciprocal; rounding breaks that in singular cases.
        variances = inverse[each, each]
        inverse[each, each] = np.where(variances > smallest, variances, 1 / RIDGE)
        inverse *= scale
        inverse *= scale[:, np.newaxis]
        change = np.zeros((len(inverse), len(self.gradient)))
        for column, slope in enumerate(self.gradient.T):  # in one order, however many records there are
            change += inverse[:, column] * slope
        return np.ascontiguousarray(change.T), inverse.transpose(2, 0, 1)

    def predicted_residual(self, change: Floats) -> Floats:
        """Residual power after a full step, as the linear model predicts it, (R,)."""
        gained = np.vecdot(change, self.gradient)
        return np.asarray(np.maximum(self.residual_power - gained, 0.0))


def _invert(matrix: Floats) -> None:
    """Replace positive definite matrices with a unit diagonal, (P, P, R), by their inverses."""
    # Gauss-Jordan elimination of all records in step: for many small matrices it is several times faster than a
    # call of LAPACK for each, and for few it must give the same digits. Positive definite matrices need no
    # pivoting.
    for row in range(len(matrix)):
        reciprocal = 1 / np.maximum(matrix[row, row], RIDGE / 10)
        column = matrix[:, row].copy()
        matrix[:, row] = 0.0
        column[row] = -1.0
        matrix[row, row] = 1.0
        pivot_row = matrix[row] * reciprocal
        matrix[row] = 0.0
        matrix -= column[:, np.newaxis] * pivot_row


# --------------------
# Sums of v[n] n^p exp(-i k w n) over a record, for many records, frequencies and harmonics at once.
#
# Every fit in this package rests on these sums and on their counterpart for v = 1, the Gram kernels. The sample
# index is counted from the middle of the record, m = n - (N-1)/2, in units of N/2, so that powers stay near 1.
#
# The trick of `data_sums`: with n = L i + j the exponential is an outer product exp(-i k w L i) exp(-i k w j)
# of two short vectors, and all sums of a record become one small matrix product


SUMS_AT_ONCE, DRIFTS_AT_ONCE = 4500, 16
"""Sums computed together: so few that a cache holds what they need, so many that the cost of calling NumPy does
not count."""


ONE_BY_ONE = 16  # powers that are; of more each call makes as many as there are

UNIFORM_PHASES = np.array([1, 1j, 1])[:, np.newaxis]  # factors of `uniform_kernels` for p = 0, 1, 2


def harmonic_powers(turn: Phasors, highest: int, lowest: int = 0, axis: int = -1) -> Phasors:
    """turn^k for k = lowest..highest, lowest 0 or 1, on a new axis of the result."""
    axis %= turn.ndim + 1
    shape = (*turn.shape[:axis], highest - lowest + 1, *turn.shape[axis:])
    powers = np.empty(shape, dtype=turn.dtype)
    by_order = powers.transpose(axis, *(n for n in range(powers.ndim) if n != axis))
    by_order[0] = turn if lowest else 1.0
    done = min(len(by_order), ONE_BY_ONE)
    for row in range(1, done):
        np.multiply(by_order[row - 1], turn, out=by_order[row])
    while done < len(by_order):
        step = by_order[done - 1] if lowest else by_order[done - 1] * turn
        some = by_order[done : 2 * done]
        np.multiply(by_order[: len(some)], step, out=some)
        done += len(some)
    return powers


def phasors(omega: Floats, index: Floats, precision: np.dtype[Any]) -> Phasors:
    """exp(i w m), (R,) or (R, C) and (L,) -> (R, L) or (R, L, C), in single or double precision."""
    # The angle may be thousands of turns: it is reduced in double precision before it is rounded to single.
    turn = np.empty((len(omega), index.size, *omega.shape[1:]), dtype=np.result_type(precision, np.complex64))
    # before the middle of the record stand the conjugates of what stands behind it, to the last bit
    half = index.size // 2 if index[0] == -index[-1] else 0
    behind = index[half:]
    angle = omega[:, np.newaxis] * (behind if omega.ndim == 1 else behind[:, np.newaxis])
    if precision == np.float32:
        turns = angle / (2 * np.pi)
        np.rint(turns, out=turns)
        turns *= 2 * np.pi
        angle -= turns
        angle = angle.astype(np.float32)
    np.cos(angle, out=turn.real[:, half:])
    np.sin(angle, out=turn.imag[:, half:])
    if half:
        np.conjugate(turn[:, : -half - 1 : -1], out=turn[:, :half])
    return turn


@cache
def record_grid(n_samples: int) -> tuple[Floats, Floats]:
    """Centred sample index as a sum of two short ones, m = outer[i] + inner[j] for sample n = L i + j."""
    # L times the number of rows is at least n_samples: the surplus lies behind the record's end.
    length = math.isqrt(n_samples - 1) + 1
    rows = -(-n_samples // length)
    half = (length - 1) / 2
    inner = np.arange(length, dtype=np.float64) - half
    outer = length * np.arange(rows, dtype=np.float64) + half - (n_samples - 1) / 2
    return outer, inner


def data_sums(
    values: Samples, omega: Floats, n_harmonics: int, highest_power: int = 1, lowest: int = 0
) -> Phasors:
    """Sums of v t^p exp(-i k w m), with m the centred sample index and t = 2 m / N."""
    n_records = len(values)
    n_powers, n_orders = highest_power + 1, n_harmonics + 1 - lowest
    columns = omega.reshape(n_records, -1)
    sums = np.empty((*columns.shape, n_powers, n_orders), dtype=np.complex128)
    at_once = max(1, SUMS_AT_ONCE // max(columns.shape[1] * n_powers * n_orders, 1))
    for start in range(0, n_records, at_once):
        part = slice(start, start + at_once)
        found = _some_sums(values[part], columns[part], n_powers, lowest, n_harmonics)
        sums[part] = found.reshape(*found.shape[:2], -1, n_orders).swapaxes(1, 2)
    return sums.reshape(*omega.shape, n_powers, n_orders)


def _some_sums(values: Samples, omega: Floats, n_powers: int, lowest: int, highest: int) -> Phasors:
    """`data_sums` of records (R, N) at (R, C) frequencies, (R, p, C * K)."""
    (n_records, n_samples), kind = values.shape, values.dtype
    outer, inner = record_grid(n_samples)
    if outer.size * inner.size != n_samples:
        values = np.pad(values, ((0, 0), (0, outer.size * inner.size - n_samples)))
    rows = values.reshape(n_records, outer.size, inner.size)
    fine = harmonic_powers(phasors(-omega, inner, kind), highest, lowest).reshape(n_records, inner.size, -1)
    coarse = harmonic_powers(phasors(-omega, outer, kind), highest, lowest).reshape(n_records, outer.size, -1)
    far_powers, near = _grid_powers(n_samples, n_powers, fine.shape[2], kind)
    sums = np.zeros((n_records, n_powers, fine.shape[2]), dtype=np.complex128)
    # (outer + inner)^p is expanded. Each power of `inner` costs one product over the samples, those of `outer`
    # only one over the rows. Real and imaginary parts are columns side by side: half a complex product's work.
    side = fine
    for q in range(n_powers):
        side = side * near if q else fine
        turned = np.matmul(rows, side.view(kind)).view(fine.dtype)
        turned *= coarse
        mixed = np.matmul(far_powers[: n_powers - q], turned.view(kind)).view(fine.dtype)
        for p in range(q, n_powers):
            sums[:, p] += mixed[:, p - q] if q in (0, p) else math.comb(p, q) * mixed[:, p - q]
    return sums


@cache
def _grid_powers(
    n_samples: int, n_powers: int, n_columns: int, precision: np.dtype[Any]
) -> tuple[Samples, Samples]:
    """Powers (p, rows) of the coarse index in units of N/2, and the fine one, (length, columns)."""
    outer, inner = (index * (2 / n_samples) for index in record_grid(n_samples))
    far_powers = (outer ** np.arange(n_powers)[:, np.newaxis]).astype(precision)
    return far_powers, np.broadcast_to(inner.astype(precision)[:, np.newaxis], (inner.size, n_columns)).copy()


def uniform_kernels(omega: Floats, n_samples: int, n_orders: int) -> Floats:
    """`data_sums` of a record of ones, p = 0, 1, 2, in closed form (Dirichlet kernel and its derivatives)."""
    # The sums are real for p = 0 and 2, and imaginary for p = 1: the factor i is left out there.
    n = n_samples
    half = harmonic_powers(np.exp(0.5j * omega), n_orders, 1)
    many = harmonic_powers(np.exp(0.5j * n * omega), n_orders, 1)
    sine, cosine = half.imag, half.real
    # A harmonic on a multiple of the sampling rate is a constant; the quotients then need their limits.
    near = np.abs(sine) * n < 0.05
    inverse = 1 / np.where(near, 1.0, sine)
    cotangent = cosine * inverse
    d0 = many.imag * inverse
    d1 = (n * many.real * inverse - d0 * cotangent) / 2
    # The kernel obeys D'' = (1 - N^2)/4 D - cot(angle/2) D'.
    d2 = (1 - n * n) / 4 * d0 - cotangent * d1
    if near.any():
        sign = np.sign(cosine[near])
        d0[near], d1[near], d2[near] = _near_a_constant(sine[near] * sign, sign * np.sign(many.real[near]), n)

    kernels = np.empty((omega.size, 3, n_orders + 1))
    kernels[:, 0, 1:] = d0
    np.multiply(d1, 2 / n, out=kernels[:, 1, 1:])
    np.multiply(d2, -((2 / n) ** 2), out=kernels[:, 2, 1:])
    kernels[:, :, 0] = n, 0.0, _power_sums(n)[0] * (2 / n) ** 2
    return kernels


def _near_a_constant(half_angle: Floats, sign: Floats, n: int) -> tuple[Floats, Floats, Floats]:
    """The kernel and its two derivatives by their power series, at angles close to a multiple of 2 pi."""
    # `sign` is what the kernel takes on from there to here: D(angle + 2 pi) = (-1)^(N-1) D(angle).
    e = 2 * half_angle
    e2 = e * e
    s2, s4, s6 = _power_sums(n)
    return (
        sign * (n - s2 * e2 / 2 + s4 * e2 * e2 / 24),
        sign * e * (-s2 + s4 * e2 / 6 - s6 * e2 * e2 / 120),
        sign * (-s2 + s4 * e2 / 2 - s6 * e2 * e2 / 24),
    )


def _power_sums(n: int) -> tuple[float, float, float]:
    """Sums of m^2, m^4 and m^6 over the centred index m of n samples."""
    q = float(n) * n
    s2 = n * (q - 1) / 12
    s4 = s2 * (3 * q - 7) / 20
    s6 = s2 * (3 * q * q - 18 * q + 31) / 112
    return s2, s4, s6
