"""Fit of the geometric series on the samples in closed form: the safe way, up to the edge of lock-in."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.frequency_search import Spectrum, candidate_frequencies
from analysis.geometric_series import Series, carrier_of
from analysis.harmonic_sums import data_sums, record_grid, uniform_kernels
from analysis.periodic_fit import Step

Floats = NDArray[np.float64]
Samples = NDArray[Any]  # of float32 or float64

ITERATIONS = 30
SINGLE_PRECISION_NOISE = 2e-4
"""Residual over signal below which single precision would show; then the last steps are in double."""


def fit_by_samples(values: Floats, weights: Floats | None, spectrum: Spectrum) -> tuple[Series, Step]:
    """Levenberg-Marquardt from a start that needs no first guess.

    Parameters
    ----------
    values : (R, N); weights : (R, N) or None
        Centred, 0 where missing.
    spectrum : (R, N//2 + 1)
        Of `values`.
    """
    series, step = _levenberg_marquardt(values, weights, _start(values, weights, spectrum), np.float32)
    power = np.einsum("rn,rn->r", values, values)
    fine = step.residual_power < SINGLE_PRECISION_NOISE**2 * power
    if fine.any():
        some_weights = None if weights is None else weights[fine]
        better, better_step = _levenberg_marquardt(values[fine], some_weights, series.take(fine), np.float64)
        series.put(fine, better)
        step.put(fine, better_step)
    return series, step


def _levenberg_marquardt(
    values: Floats, weights: Floats | None, series: Series, precision: type[np.float32 | np.float64]
) -> tuple[Series, Step]:
    """Minimise the residual power; each record keeps its own damping and stops by itself."""
    n_samples = values.shape[1]
    data: Samples = values.astype(precision)
    masks: Samples | None = None if weights is None else weights.astype(precision)
    best = _normal_equations(data, masks, series)
    damping = np.zeros(series.offset.shape)
    active = np.arange(damping.size)
    rounding = 1e-6 if precision is np.float32 else 1e-12
    for _ in range(ITERATIONS):
        here, old = series.take(active), best.take(active)
        change = old.solve(damping[active])
        trial_series = here.moved(change, n_samples)
        trial = _normal_equations(data[active], None if masks is None else masks[active], trial_series)
        # At the optimum the residual repeats to rounding; that must count as a step forward.
        better = trial.residual_power <= old.residual_power * (1 + rounding)
        series.put(active, trial_series.where(better, here))
        best.put(active, trial.where(better, old))
        tried = damping[active]
        damping[active] = np.where(better, np.where(tried < 1e-4, 0.0, tried / 10), np.maximum(tried * 10, 1e-3))
        gain = np.abs(np.einsum("rp,rp->r", change, old.gradient))
        small = gain < 1e-3 * old.residual_power / n_samples if precision is np.float32 else gain < 1e-22
        small |= gain < 1e-9 * old.residual_power / n_samples
        active = active[~((small & better) | (damping[active] > 1e9))]
        if active.size == 0:
            break
    return series, best


def _normal_equations(values: Samples, weights: Samples | None, series: Series) -> Step:
    """Exact normal equations of (R,) records from their samples, in the precision of `values`."""
    n_records, n_samples = values.shape
    kind = np.result_type(values.dtype, np.complex64)
    outer, inner = record_grid(n_samples)
    coarse = np.exp(1j * series.omega[:, np.newaxis] * outer).astype(kind)
    fine = np.exp(1j * series.omega[:, np.newaxis] * inner).astype(kind)
    carrier = carrier_of(coarse, fine, n_samples)
    first, ratio = (p.astype(kind)[:, np.newaxis] for p in (series.first, series.ratio))
    below = 1 - ratio * carrier
    wave = carrier * np.conj(below)
    wave *= 1 / (below.real**2 + below.imag**2)
    beat = first * wave
    by_ratio = beat * wave
    index = ((np.arange(n_samples) - (n_samples - 1) / 2) * (2 / n_samples)).astype(values.dtype)
    tangents = np.empty((n_records, 6, n_samples), dtype=values.dtype)
    tangents[:, 0] = 1.0
    tangents[:, 1], tangents[:, 2] = wave.real, -wave.imag
    tangents[:, 3], tangents[:, 4] = by_ratio.real, -by_ratio.imag
    # The derivative by w is m Re[i H e / (1 - q e)^2], and H e / (1 - q e)^2 = beat + q by_ratio.
    tangents[:, 5] = -(beat + ratio * by_ratio).imag * index
    left = values - series.offset.astype(values.dtype)[:, np.newaxis] - beat.real
    if weights is not None:
        left *= weights
        tangents *= weights[:, np.newaxis, :]
    normal = np.matmul(tangents, tangents.swapaxes(-1, -2))
    gradient = np.matmul(tangents, left[..., np.newaxis])[..., 0]
    power = np.einsum("rn,rn->r", left, left)
    return Step(normal.astype(np.float64), gradient.astype(np.float64), power.astype(np.float64))


def _start(values: Floats, weights: Floats | None, spectrum: Spectrum) -> Series:
    """Best of the candidate frequencies, each with the linear fit of `_equation_error_start`."""
    n_records = len(values)
    best = np.full(n_records, np.inf)
    chosen = Series(*(np.zeros(n_records, kind) for kind in (float, complex, complex, float)))
    for candidate in candidate_frequencies(spectrum, values.shape[1]).T:
        series, left = _equation_error_start(values, weights, np.ascontiguousarray(candidate))
        chosen = series.where(left < best, chosen)
        best = np.minimum(left, best)
    return chosen


def _equation_error_start(values: Floats, weights: Floats | None, omega: Floats) -> tuple[Series, Floats]:
    """Start values from a linear fit that needs no harmonics and no first guess of q, and what it leaves.

    Multiplied by |1 - q e|^2 the waveform becomes linear in its unknowns:
    v = a + Re(b e) + v Re(s e), with s = 2q/(1 + |q|^2), whose size is WL/W itself. All inner products are sums
    of 1, v and v^2 times 1, e and e^2.
    """
    n_samples = values.shape[1]
    ones = uniform_kernels(omega, n_samples, 2)[:, 0] if weights is None else data_sums(weights, omega, 2, 0)[:, 0]
    of_v, of_square = data_sums(values, omega, 2, 0)[:, 0], data_sums(values * values, omega, 2, 0)[:, 0]
    normal = np.empty((len(values), 5, 5))
    normal[:, :3, :3] = _products(ones)
    normal[:, :3, 3:] = _products(of_v)[:, :, 1:]
    normal[:, 3:, :3] = normal[:, :3, 3:].swapaxes(-1, -2)
    normal[:, 3:, 3:] = _products(of_square)[:, 1:, 1:]
    gradient = np.concatenate([_columns(of_v), _columns(of_square)[:, 1:]], axis=-1)
    power = of_square[:, 0].real
    step = Step(normal, gradient, power)
    solution = step.solve()
    s = solution[:, 3] + 1j * solution[:, 4]
    size = np.abs(s)
    limited = np.minimum(size, 0.9999)
    s = s * (limited / np.maximum(size, 1e-300))
    q = s / (1 + np.sqrt(1 - limited**2))
    # The linear fit's a and b are c0 - Re(H conj q)/(1+|q|^2) and H/(1+|q|^2) - c0 s: solved for c0 and H.
    square = np.abs(q) ** 2
    b = solution[:, 1] + 1j * solution[:, 2]
    offset = (solution[:, 0] + (b * np.conj(q)).real) * (1 + square) / (1 - square)
    first = (b + offset * s) * (1 + square)
    return Series(offset, first, q, omega), step.predicted_residual(solution) / (1 + limited**2 / 2)


def _products(sums: NDArray[np.complex128]) -> Floats:
    """Inner products of 1, Re e, -Im e under a weight, from its sums times exp(-i k w m), k = 0, 1, 2."""
    zero, one, two = sums[:, 0].real, np.conj(sums[:, 1]), np.conj(sums[:, 2])
    rows = (
        (zero, one.real, -one.imag),
        (one.real, (zero + two.real) / 2, -two.imag / 2),
        (-one.imag, -two.imag / 2, (zero - two.real) / 2),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _columns(sums: NDArray[np.complex128]) -> Floats:
    one = np.conj(sums[:, 1])
    return np.stack([sums[:, 0].real, one.real, -one.imag], axis=-1)
