"""Gauss-Newton steps for a periodic model on samples, by sums instead of by samples.

A periodic signal is written two-sided, v = sum over k = -K..K of g_k exp(i k w m), g_-k = conj g_k: the offset
is g_0 and a harmonic amplitude c_k is 2 g_k. Every inner product of two such signals is then a Hermitian
Toeplitz form of the kernels in `harmonic_sums`, exact for any number of periods, folded harmonics included.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Complexes, Floats
from analysis.waveform.series.harmonic_sums import UNIFORM_PHASES, data_sums, hermitian_toeplitz, uniform_kernels
from analysis.waveform.series.normal_equations import Step


@dataclass(frozen=True)
class RecordSums:
    """What a fit needs to know of the records at one frequency each.

    data : (R, 2, 2K+1) two-sided sums of v and v t;  power : (R,) sum of v^2;  count : (R,) valid samples;
    gram : three (R, 2K+1, 2K+1) Toeplitz matrices of t^0, t^1 and t^2.
    """

    data: Complexes
    power: Floats
    count: Floats
    gram: tuple[Complexes, Complexes, Complexes]


def record_sums(volts: Floats, omega: Floats, n_harmonics: int, weights: Floats | None) -> RecordSums:
    """Sums of each record, k = -K..K."""
    n_samples = volts.shape[-1]
    one_sided = data_sums(volts, omega, n_harmonics, 1)
    data = np.concatenate([np.conj(one_sided[..., :0:-1]), one_sided], axis=-1)
    if weights is None:
        kernels = uniform_kernels(omega, n_samples, 2 * n_harmonics) * UNIFORM_PHASES
        count = np.full(omega.shape, float(n_samples))
    else:
        kernels = data_sums(weights, omega, 2 * n_harmonics, 2)
        count = weights.sum(axis=-1)
    gram = (
        hermitian_toeplitz(kernels[:, 0]),
        hermitian_toeplitz(kernels[:, 1]),
        hermitian_toeplitz(kernels[:, 2]),
    )
    return RecordSums(data, np.vecdot(volts, volts), count, gram)


def two_sided(offset: Floats, amplitudes: Complexes) -> Complexes:
    """(R,), (R, K) -> (R, 2K+1): offset and c_k as coefficients of exp(i k w m), k = -K..K."""
    half = amplitudes / 2
    return np.concatenate([np.conj(half[..., ::-1]), offset[..., np.newaxis] + 0j, half], axis=-1)


def gauss_newton_step(sums: RecordSums, coefficients: Complexes, tangents: Complexes) -> Step:
    """Normal equations of a model with two-sided `coefficients`."""
    t0, t1, t2 = sums.gram
    order = np.arange(coefficients.shape[-1]) - coefficients.shape[-1] // 2
    slope = 1j * order * coefficients
    fitted0 = np.matmul(t0, coefficients[..., np.newaxis])[..., 0]
    fitted1 = np.matmul(t1, coefficients[..., np.newaxis])[..., 0]
    left = sums.data[:, 0] - fitted0
    left1 = sums.data[:, 1] - fitted1

    n_parameters = tangents.shape[1]
    normal = np.empty((coefficients.shape[0], n_parameters + 1, n_parameters + 1))
    conjugate = np.conj(tangents)
    normal[:, :-1, :-1] = np.matmul(np.matmul(conjugate, t0), tangents.swapaxes(-1, -2)).real
    mixed = np.matmul(conjugate, np.matmul(t1, slope[..., np.newaxis]))[..., 0].real
    normal[:, :-1, -1] = normal[:, -1, :-1] = mixed
    normal[:, -1, -1] = np.vecdot(slope, np.matmul(t2, slope[..., np.newaxis])[..., 0]).real
    gradient = np.empty((coefficients.shape[0], n_parameters + 1))
    gradient[:, :-1] = np.matmul(conjugate, left[..., np.newaxis])[..., 0].real
    gradient[:, -1] = np.vecdot(slope, left1).real
    residual = sums.power - np.vecdot(coefficients, sums.data[:, 0] + left).real
    return Step(normal, gradient, np.maximum(residual, 0.0))
