"""Sums of v[n] n^p exp(-i k w n) over a record, for many records, frequencies and harmonics at once.

Every fit in this package rests on these sums and on their counterpart for v = 1, the Gram kernels. The sample
index is counted from the middle of the record, m = n - (N-1)/2, in units of N/2, so that powers stay near 1.

The trick of `data_sums`: with n = L i + j the exponential is an outer product exp(-i k w L i) exp(-i k w j)
of two short vectors, and all sums of a record become one small matrix product.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from analysis.arrays import Floats, Phasors, Samples

SUMS_AT_ONCE = 4500
"""Sums computed together: so few that a cache holds what they need, so many that the cost of calling NumPy does
not count."""


UNIFORM_PHASES = np.array([1, 1j, 1])[:, np.newaxis]
"""Factors of `uniform_kernels` for p = 0, 1, 2."""


def harmonic_powers(turn: Phasors, highest: int, lowest: int = 0, axis: int = -1) -> Phasors:
    """turn^k for k = lowest..highest, lowest 0 or 1, on a new axis of the result."""
    axis %= turn.ndim + 1
    shape = (*turn.shape[:axis], highest - lowest + 1, *turn.shape[axis:])
    powers = np.empty(shape, dtype=turn.dtype)
    by_order = powers.transpose(axis, *(n for n in range(powers.ndim) if n != axis))
    by_order[0] = turn if lowest else 1.0
    for row in range(1, len(by_order)):
        np.multiply(by_order[row - 1], turn, out=by_order[row])
    return powers


def phasors(omega: Floats, index: Floats, precision: np.dtype[Any]) -> Phasors:
    """exp(i w m), (R,) or (R, C) and (L,) -> (R, L) or (R, L, C), in single or double precision.

    The angle may be thousands of turns: it is reduced in double precision before it is rounded to single.
    """
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
    """Centred sample index as a sum of two short ones, m = outer[i] + inner[j] for sample n = L i + j.

    L times the number of rows is at least n_samples: the surplus lies behind the record's end.
    """
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
    """`data_sums` of a record of ones, p = 0, 1, 2, in closed form (Dirichlet kernel and its derivatives).

    The sums are real for p = 0 and 2, and imaginary for p = 1: the factor i is left out there.
    """
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
    """The kernel and its two derivatives by their power series, at angles close to a multiple of 2 pi.

    `sign` is what the kernel takes on from there to here: D(angle + 2 pi) = (-1)^(N-1) D(angle).
    """
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


def hermitian_toeplitz(kernel: Phasors) -> Phasors:
    """Matrix T[k, l] = kernel(k - l), kernel(-m) = conj kernel(m); (R, M) -> (R, M, M)."""
    size = kernel.shape[-1]
    difference = np.arange(size)[:, np.newaxis] - np.arange(size)
    both = np.concatenate([np.conj(kernel[..., :0:-1]), kernel], axis=-1)
    return np.asarray(both[..., difference + size - 1])
