"""Sums of v[n] n^p exp(-i k w n) over a record, for many records, frequencies and harmonics at once.

Every fit in this package rests on these sums and on their counterpart for v = 1, the Gram kernels. The sample
index is counted from the middle of the record, m = n - (N-1)/2, in units of N/2, so that powers stay near 1.

The trick of `data_sums`: with n = L i + j the exponential is an outer product exp(-i k w L i) exp(-i k w j)
of two short vectors, and all sums of a record become one small matrix product.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


def harmonic_powers(turn: Complexes, n_harmonics: int) -> Complexes:
    """turn^k for k = 0..n_harmonics; (R, L) -> (R, n_harmonics + 1, L)."""
    powers = np.empty((turn.shape[0], n_harmonics + 1, turn.shape[1]), dtype=np.complex128)
    powers[:, 0] = 1.0
    for k in range(1, n_harmonics + 1):
        np.multiply(powers[:, k - 1], turn, out=powers[:, k])
    return powers


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


def data_sums(volts: Floats, omega: Floats, n_harmonics: int, highest_power: int = 1) -> Complexes:
    """Sums of v t^p exp(-i k w m), with m the centred sample index and t = 2 m / N.

    Parameters
    ----------
    volts : (R, N)
    omega : (R,)
        Angular frequency of each record, rad per sample.
    n_harmonics, highest_power : int
        k = 0..n_harmonics, p = 0..highest_power.

    Returns
    -------
    (R, highest_power + 1, n_harmonics + 1), complex
    """
    n_records, n_samples = volts.shape
    outer, inner = record_grid(n_samples)
    if outer.size * inner.size != n_samples:
        padded = np.zeros((n_records, outer.size * inner.size))
        padded[:, :n_samples] = volts
        volts = padded
    blocks = volts.reshape(n_records, outer.size, inner.size)
    turns = -1j * omega[:, np.newaxis]
    fine = harmonic_powers(np.exp(turns * inner), n_harmonics)
    coarse = harmonic_powers(np.exp(turns * outer), n_harmonics)

    # (inner + outer)^p is expanded: each power of `outer` costs one product over the samples, those of `inner`
    # only one over the columns. Real and imaginary parts go through it side by side: half a complex product's
    # work.
    n_powers, n_orders = highest_power + 1, n_harmonics + 1
    sides = np.empty((n_records, n_powers, 2, n_orders, outer.size))
    sides[:, 0, 0], sides[:, 0, 1] = coarse.real, coarse.imag
    for q in range(1, n_powers):
        np.multiply(sides[:, q - 1], outer * (2 / n_samples), out=sides[:, q])
    products = np.matmul(sides.reshape(n_records, -1, outer.size), blocks)
    products = products.reshape(n_records, n_powers, 2, n_orders, inner.size)
    partial = np.empty((n_records, n_powers, n_orders, inner.size), dtype=np.complex128)
    partial.real, partial.imag = products[:, :, 0], products[:, :, 1]
    partial *= fine[:, np.newaxis]
    inner_powers = (inner[:, np.newaxis] * (2 / n_samples)) ** np.arange(n_powers)
    mixed = np.matmul(partial, inner_powers.astype(np.complex128))
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
    angle = omega[:, np.newaxis] * np.arange(n_orders + 1)
    # D(angle + 2 pi) = (-1)^(N-1) D(angle): reduce to the principal interval, where series and sign are safe.
    turns = np.rint(angle / (2 * np.pi))
    reduced = angle - 2 * np.pi * turns
    sign = np.where((turns * (n - 1)) % 2 == 0, 1.0, -1.0)

    half_sine, half_cosine = np.sin(reduced / 2), np.cos(reduced / 2)
    sine_n, cosine_n = np.sin(n * reduced / 2), np.cos(n * reduced / 2)
    near = np.abs(reduced) * n < 0.1
    safe = np.where(near, 1.0, half_sine)
    cotangent = half_cosine / safe
    d0 = sine_n / safe
    d1 = (n * cosine_n / safe - d0 * cotangent) / 2
    # The kernel obeys D'' = (1 - N^2)/4 D - cot(angle/2) D'.
    d2 = (1 - n * n) / 4 * d0 - cotangent * d1

    e2 = reduced * reduced
    s2, s4, s6 = _power_sums(n)
    d0 = np.where(near, n - s2 * e2 / 2 + s4 * e2 * e2 / 24, d0)
    d1 = np.where(near, reduced * (-s2 + s4 * e2 / 6 - s6 * e2 * e2 / 120), d1)
    d2 = np.where(near, -s2 + s4 * e2 / 2 - s6 * e2 * e2 / 24, d2)

    kernels = np.empty((omega.size, 3, n_orders + 1), dtype=np.complex128)
    kernels[:, 0] = sign * d0
    kernels[:, 1] = 1j * sign * d1 * (2 / n)
    kernels[:, 2] = -sign * d2 * (2 / n) ** 2
    return kernels


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
