"""Sums of v[n] n^p exp(-i k w n) over a record, for many records, frequencies and harmonics at once.

Every fit in this package rests on these sums and on their counterpart for v = 1, the Gram kernels. The sample
index is counted from the middle of the record, m = n - (N-1)/2, in units of N/2, so that powers stay near 1.

The trick of `data_sums`: with n = L i + j the exponential is an outer product exp(-i k w L i) exp(-i k w j)
of two short vectors, and all sums of a record become one small matrix product.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Samples = NDArray[Any]
"""float32 or float64"""
Complexes = NDArray[Any]
"""complex64 or complex128"""


SUMS_AT_ONCE = 1500
"""Sums computed together, so that what they need stays in the second-level cache."""


def harmonic_powers(turn: Complexes, n_harmonics: int) -> Complexes:
    """turn^k for k = 0..n_harmonics; (R, L) -> (R, n_harmonics + 1, L)."""
    powers = np.empty((turn.shape[0], n_harmonics + 1, turn.shape[1]), dtype=turn.dtype)
    powers[:, 0] = 1.0
    for k in range(1, n_harmonics + 1):
        np.multiply(powers[:, k - 1], turn, out=powers[:, k])
    return powers


def phasors(omega: Floats, index: Floats, precision: np.dtype[Any]) -> Complexes:
    """exp(i w m), (R,) and (L,) -> (R, L), in single or double precision.

    The angle may be thousands of turns: it is reduced in double precision before it is rounded to single.
    """
    angle = omega[:, np.newaxis] * index
    if precision == np.float32:
        angle -= 2 * np.pi * np.rint(angle / (2 * np.pi))
        angle = angle.astype(np.float32)
    turn = np.empty(angle.shape, dtype=np.result_type(precision, np.complex64))
    np.cos(angle, out=turn.real)
    np.sin(angle, out=turn.imag)
    return turn


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


def data_sums(values: Samples, omega: Floats, n_harmonics: int, highest_power: int = 1) -> Complexes:
    """Sums of v t^p exp(-i k w m), with m the centred sample index and t = 2 m / N.

    Parameters
    ----------
    values : (R, N)
        The sums are computed in its precision. Single is twice as fast, and good to about 1e-8 of N times the
        largest value.
    omega : (R,) or (R, C)
        Angular frequency of each record, or C of them, rad per sample.
    n_harmonics, highest_power : int
        k = 0..n_harmonics, p = 0..highest_power.

    Returns
    -------
    (R, highest_power + 1, n_harmonics + 1) or (R, C, highest_power + 1, n_harmonics + 1), complex128
    """
    n_records, n_samples = values.shape
    outer, inner = record_grid(n_samples)
    if outer.size * inner.size != n_samples:
        padded = np.zeros((n_records, outer.size * inner.size), dtype=values.dtype)
        padded[:, :n_samples] = values
        values = padded
    blocks = values.reshape(n_records, outer.size, inner.size)
    n_powers, n_orders = highest_power + 1, n_harmonics + 1
    sums = np.empty((*omega.shape, n_powers, n_orders), dtype=np.complex128)
    per_record = n_powers * n_orders * omega.size // max(n_records, 1)
    at_once = max(1, SUMS_AT_ONCE // per_record)
    for start in range(0, n_records, at_once):
        part = slice(start, start + at_once)
        found = _sums_of_blocks(
            blocks[part], omega[part].ravel(), (outer, inner), 2 / n_samples, (n_powers, n_orders)
        )
        sums[part] = found.reshape(sums[part].shape)
    return sums


def _sums_of_blocks(
    blocks: Samples, omega: Floats, grid: tuple[Floats, Floats], unit: float, shape: tuple[int, int]
) -> Complexes:
    """`data_sums` of samples in rows, (R, rows, length), at R or several times R frequencies."""
    kind, (outer, inner), (n_powers, n_orders) = blocks.dtype, grid, shape
    fine = harmonic_powers(phasors(-omega, inner, kind), n_orders - 1)
    coarse = harmonic_powers(phasors(-omega, outer, kind), n_orders - 1)
    # (inner + outer)^p is expanded: each power of `outer` costs one product over the samples, those of `inner`
    # only one over the columns. Real and imaginary parts go through it side by side: half a complex product's
    # work.
    sides = np.empty((omega.size, n_powers, 2, n_orders, outer.size), dtype=kind)
    sides[:, 0, 0], sides[:, 0, 1] = coarse.real, coarse.imag
    for q in range(1, n_powers):
        np.multiply(sides[:, q - 1], (outer * unit).astype(kind), out=sides[:, q])
    products = np.matmul(sides.reshape(len(blocks), -1, outer.size), blocks)
    products = products.reshape(omega.size, n_powers, 2, n_orders, inner.size)
    partial = np.empty((omega.size, n_powers, n_orders, inner.size), dtype=fine.dtype)
    partial.real, partial.imag = products[:, :, 0], products[:, :, 1]
    partial *= fine[:, np.newaxis]
    near_powers = (inner[:, np.newaxis] * unit) ** np.arange(n_powers)
    mixed = (partial.reshape(-1, inner.size) @ near_powers.astype(fine.dtype)).astype(np.complex128)
    mixed = mixed.reshape(omega.size, n_powers, n_orders, n_powers)
    sums = mixed[:, 0].swapaxes(-1, -2).copy()
    for p in range(1, n_powers):
        for q in range(1, p + 1):
            sums[:, p] += math.comb(p, q) * mixed[:, q, :, p - q]
    return np.asarray(sums)


def uniform_kernels(omega: Floats, n_samples: int, n_orders: int) -> Complexes:
    """`data_sums` of a record of ones, p = 0, 1, 2, in closed form (Dirichlet kernel and its derivatives).

    Parameters
    ----------
    omega : (R,)
        rad per sample.
    n_samples, n_orders : int
        N, and the highest k.

    Returns
    -------
    (R, 3, n_orders + 1), complex
        Sum over n of t^p exp(-i k w m): the entries of every Gram matrix of the harmonic model.
    """
    n = n_samples
    half = harmonic_powers(np.exp(0.5j * omega[:, np.newaxis]), n_orders)[..., 0]
    many = harmonic_powers(np.exp(0.5j * n * omega[:, np.newaxis]), n_orders)[..., 0]
    # A harmonic on a multiple of the sampling rate is a constant; the quotients then need their limits.
    near = np.nonzero((np.abs(half.imag) * n < 0.05) & (half.real * many.real != 0))
    inverse = half.imag.copy()
    inverse[near] = 1.0
    np.divide(1.0, inverse, out=inverse)
    cotangent = half.real * inverse
    d0 = many.imag * inverse
    d1 = (n * many.real * inverse - d0 * cotangent) / 2
    # The kernel obeys D'' = (1 - N^2)/4 D - cot(angle/2) D'.
    d2 = (1 - n * n) / 4 * d0 - cotangent * d1
    d0[near], d1[near], d2[near] = _near_a_constant(half[near], many[near], n)

    kernels = np.zeros((omega.size, 3, n_orders + 1), dtype=np.complex128)
    kernels.real[:, 0] = d0
    kernels.imag[:, 1] = d1 * (2 / n)
    kernels.real[:, 2] = d2 * -((2 / n) ** 2)
    return kernels


def _near_a_constant(half: Complexes, many: Complexes, n: int) -> tuple[Floats, Floats, Floats]:
    """The kernel and its two derivatives by their power series, at angles close to a multiple of 2 pi."""
    # D(angle + 2 pi) = (-1)^(N-1) D(angle)
    sign = np.sign(half.real * many.real)
    e = 2 * half.imag * np.sign(half.real)
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


def hermitian_toeplitz(kernel: Complexes) -> Complexes:
    """Matrix T[k, l] = kernel(k - l), kernel(-m) = conj kernel(m); (R, M) -> (R, M, M)."""
    size = kernel.shape[-1]
    difference = np.arange(size)[:, np.newaxis] - np.arange(size)
    both = np.concatenate([np.conj(kernel[..., :0:-1]), kernel], axis=-1)
    return np.asarray(both[..., difference + size - 1])
