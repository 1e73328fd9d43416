"""Maximum-likelihood fit of the lock-in waveform: all harmonics tied into one geometric series.

    v = c0 + Re[ H e / (1 - q e) ],    e = exp(i w m),    harmonics c_k = H q^(k-1),    r = |q|

Six real parameters: c0, H, q and w. Every harmonic helps, and those that fold back below half the sampling
rate are part of the model instead of an error. Far from lock-in few harmonics matter and the fit runs on their
sums (`periodic_fit`); close to it the fit runs on the samples with the closed form above.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.frequency_search import coarse_frequency, other_candidates
from analysis.harmonics import fit_free_harmonics
from analysis.periodic_fit import Step, gauss_newton_step, record_sums, two_sided

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

LARGEST_RATIO = 0.995
"""|q| is kept below this: x = 0.99999, where a record of a few periods holds no more information."""

EASY_RATIO = 0.3
EASY_RESIDUAL = 0.12
"""A two-harmonic fit with a ratio and a residual share below these has found the fundamental: a wrong line,
one of the harmonics of a gyro close to lock-in, leaves the odd harmonics and so a third of the power."""

NEGLIGIBLE = 3e-7
"""Harmonics below this share of the fundamental cannot move an estimate from eight-bit samples."""

ITERATIONS = 25


@dataclass(frozen=True)
class Series:
    """Parameters of records, phases counted from the middle of the record.

    offset (R,) real; first (R,) H; ratio (R,) q; omega (R,) rad per sample.
    """

    offset: Floats
    first: Complexes
    ratio: Complexes
    omega: Floats

    def moved(self, change: Floats, n_samples: int) -> Series:
        """The parameters after a Gauss-Newton change (R, 6), kept inside their domain."""
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

    def where(self, chosen: NDArray[np.bool_], other: Series) -> Series:
        """This series where chosen, the other elsewhere."""
        return Series(
            np.where(chosen, self.offset, other.offset),
            np.where(chosen, self.first, other.first),
            np.where(chosen, self.ratio, other.ratio),
            np.where(chosen, self.omega, other.omega),
        )

    def take(self, part: NDArray[np.intp] | NDArray[np.bool_]) -> Series:
        """Some of the records."""
        return Series(self.offset[part], self.first[part], self.ratio[part], self.omega[part])

    def put(self, part: NDArray[np.intp] | NDArray[np.bool_], other: Series) -> None:
        """Write the other's records into the places `part` of this one."""
        self.offset[part], self.first[part] = other.offset, other.first
        self.ratio[part], self.omega[part] = other.ratio, other.omega


def fit_series(values: Floats, weights: Floats | None) -> tuple[Series, Step]:
    """Fit the waveform to each record.

    Parameters
    ----------
    values : (R, N)
        Centred, of unit scale, 0 where missing.
    weights : (R, N) or None
        1 for a valid sample, 0 for a missing one.

    Returns
    -------
    Series, Step
        Parameters, and the normal equations at them in the order c0, Re H, Im H, Re q, Im q, w (w in rad at the
        record's ends).
    """
    n_records = values.shape[0]
    omega, offset, amplitudes, step = fit_free_harmonics(values, weights, coarse_frequency(values), 2, 3)
    ratio = amplitudes[:, 1] / np.where(amplitudes[:, 0] == 0, 1.0, amplitudes[:, 0])
    power = np.einsum("rn,rn->r", values, values)
    easy = (np.abs(ratio) < EASY_RATIO) & (step.residual_power < EASY_RESIDUAL * power)
    series = Series(offset, amplitudes[:, 0].copy(), ratio, omega)
    normal, gradient, residual = np.zeros((n_records, 6, 6)), np.zeros((n_records, 6)), np.zeros(n_records)
    for part, fit in ((easy, _fit_by_sums), (~easy, _fit_by_samples)):
        if part.any():
            chosen = None if weights is None else weights[part]
            fitted, step = fit(values[part], chosen, series.take(part))
            series.put(part, fitted)
            normal[part], gradient[part], residual[part] = step.normal, step.gradient, step.residual_power
    return series, Step(normal, gradient, residual)


def _fit_by_sums(values: Floats, weights: Floats | None, start: Series) -> tuple[Series, Step]:
    largest = min(max(float(np.abs(start.ratio).max()) * 1.3, 1e-3), 0.6)
    n_harmonics = max(3, math.ceil(math.log(NEGLIGIBLE) / math.log(largest)))

    def normal_equations(series: Series) -> Step:
        sums = record_sums(values, series.omega, n_harmonics, weights)
        coefficients, tangents = _series_tangents(series, n_harmonics)
        return gauss_newton_step(sums, coefficients, tangents)

    return _levenberg_marquardt(normal_equations, start, values.shape[1])


def _series_tangents(series: Series, n_harmonics: int) -> tuple[Complexes, Complexes]:
    """Two-sided coefficients (R, 2K+1) and their derivatives by c0, Re H, Im H, Re q, Im q (R, 5, 2K+1)."""
    n_records = series.first.size
    powers = np.ones((n_records, n_harmonics), dtype=np.complex128)
    np.cumprod(
        np.broadcast_to(series.ratio[:, np.newaxis], (n_records, n_harmonics - 1)), axis=1, out=powers[:, 1:]
    )
    by_ratio = np.zeros_like(powers)
    by_ratio[:, 1:] = series.first[:, np.newaxis] * np.arange(1, n_harmonics) * powers[:, :-1]
    coefficients = two_sided(series.offset, series.first[:, np.newaxis] * powers)
    none = np.zeros(n_records)
    tangents = np.empty((n_records, 5, 2 * n_harmonics + 1), dtype=np.complex128)
    tangents[:, 0] = two_sided(none + 1.0, np.zeros_like(powers))
    tangents[:, 1], tangents[:, 2] = two_sided(none, powers), two_sided(none, 1j * powers)
    tangents[:, 3], tangents[:, 4] = two_sided(none, by_ratio), two_sided(none, 1j * by_ratio)
    return coefficients, tangents


def _fit_by_samples(values: Floats, weights: Floats | None, start: Series) -> tuple[Series, Step]:
    start = _start_near_lock_in(values, weights, start.omega)

    def normal_equations(series: Series) -> Step:
        return _sampled_normal_equations(values, weights, series)

    return _levenberg_marquardt(normal_equations, start, values.shape[1])


def _levenberg_marquardt(
    normal_equations: Callable[[Series], Step], series: Series, n_samples: int
) -> tuple[Series, Step]:
    """Minimise the residual power; each record keeps its own damping and its own best parameters."""
    best = normal_equations(series)
    damping = np.zeros(series.offset.shape)
    for _ in range(ITERATIONS):
        change = best.solve(damping)
        trial_series = series.moved(change, n_samples)
        trial = normal_equations(trial_series)
        # At the optimum the residual repeats to rounding; that must count as a step forward.
        better = trial.residual_power <= best.residual_power * (1 + 1e-12)
        series = trial_series.where(better, series)
        gain = np.abs(np.einsum("rp,rp->r", change, best.gradient))
        best = trial.where(better, best)
        damping = np.where(better, np.where(damping < 1e-4, 0.0, damping / 10), np.maximum(damping * 10, 1e-3))
        if np.all((gain < 1e-8 * best.residual_power / n_samples + 1e-13) | (damping > 1e9)):
            break
    return series, best


def beat_carrier(omega: Floats, n_samples: int) -> Complexes:
    """exp(i w m) on the samples, m from the middle of the record; (R,) -> (R, N), as an outer product."""
    length = math.isqrt(n_samples - 1) + 1
    rows = -(-n_samples // length)
    middle = (n_samples - 1) / 2
    coarse = np.exp(1j * omega[:, np.newaxis] * (np.arange(rows) * length - middle))
    fine = np.exp(1j * omega[:, np.newaxis] * np.arange(length))
    grid = coarse[:, :, np.newaxis] * fine[:, np.newaxis, :]
    return np.asarray(grid.reshape(omega.size, -1)[:, :n_samples])


def sampled_series(series: Series, n_samples: int) -> Floats:
    """The model on the samples, (R, N)."""
    carrier = beat_carrier(series.omega, n_samples)
    wave = carrier / (1 - series.ratio[:, np.newaxis] * carrier)
    return np.asarray(series.offset[:, np.newaxis] + (series.first[:, np.newaxis] * wave).real)


def _sampled_normal_equations(values: Floats, weights: Floats | None, series: Series) -> Step:
    n_records, n_samples = values.shape
    first, ratio = series.first[:, np.newaxis], series.ratio[:, np.newaxis]
    carrier = beat_carrier(series.omega, n_samples)
    wave = carrier / (1 - ratio * carrier)
    weighted = first * wave
    by_ratio = weighted * wave
    turned = 1j * weighted * (1 + ratio * wave)
    index = (np.arange(n_samples) - (n_samples - 1) / 2) * (2 / n_samples)
    tangents = np.empty((n_records, 6, n_samples))
    tangents[:, 0] = 1.0
    tangents[:, 1], tangents[:, 2] = wave.real, -wave.imag
    tangents[:, 3], tangents[:, 4] = by_ratio.real, -by_ratio.imag
    tangents[:, 5] = turned.real * index
    left = values - series.offset[:, np.newaxis] - weighted.real
    if weights is not None:
        left *= weights
        tangents *= weights[:, np.newaxis, :]
    normal = np.matmul(tangents, tangents.swapaxes(-1, -2))
    gradient = np.matmul(tangents, left[..., np.newaxis])[..., 0]
    return Step(normal, gradient, np.einsum("rn,rn->r", left, left))


def _start_near_lock_in(values: Floats, weights: Floats | None, omega: Floats) -> Series:
    """Start values from a linear fit that needs no harmonics and no first guess of q.

    Multiplied by |1 - q e|^2 the waveform becomes linear in its unknowns:
    v = a + Re(b e) + v Re(s e), with s = 2q/(1 + |q|^2), whose size is WL/W itself. The candidate frequency
    that leaves least is taken.
    """
    best = np.full(omega.shape, np.inf)
    chosen = Series(
        np.zeros(omega.size), np.zeros(omega.size, complex), np.zeros(omega.size, complex), omega.copy()
    )
    for candidate in other_candidates(values, omega).T:
        series = _equation_error_start(values, weights, np.ascontiguousarray(candidate))
        left = values - sampled_series(series, values.shape[1])
        if weights is not None:
            left *= weights
        cost = np.einsum("rn,rn->r", left, left)
        chosen = series.where(cost < best, chosen)
        best = np.minimum(cost, best)
    return chosen


def _equation_error_start(values: Floats, weights: Floats | None, omega: Floats) -> Series:
    n_records, n_samples = values.shape
    carrier = beat_carrier(omega, n_samples)
    columns = np.empty((n_records, 5, n_samples))
    columns[:, 0] = 1.0 if weights is None else weights
    columns[:, 1], columns[:, 2] = carrier.real, -carrier.imag
    if weights is not None:
        columns[:, 1:3] *= weights[:, np.newaxis]
    columns[:, 3], columns[:, 4] = values * carrier.real, -values * carrier.imag
    s = _linear(columns, values)[:, 3:] @ np.array([1.0, 1j])
    size = np.minimum(np.abs(s), 0.9999)
    s = s * (size / np.maximum(np.abs(s), 1e-300))
    ratio = s / (1 + np.sqrt(1 - size * size))
    # With q and w known the rest is linear on the waveform itself.
    wave = carrier / (1 - ratio[:, np.newaxis] * carrier)
    columns = columns[:, :3]
    columns[:, 1], columns[:, 2] = wave.real, -wave.imag
    if weights is not None:
        columns[:, 1:3] *= weights[:, np.newaxis]
    linear = _linear(columns, values)
    return Series(linear[:, 0], linear[:, 1] + 1j * linear[:, 2], ratio, omega)


def _linear(columns: Floats, values: Floats) -> Floats:
    normal = np.matmul(columns, columns.swapaxes(-1, -2))
    return Step(normal, np.matmul(columns, values[..., np.newaxis])[..., 0], np.zeros(len(values))).solve()
