"""Start values of the tied series where the strongest line of the spectrum may not be the fundamental."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.frequency_search import Spectrum, candidate_frequencies
from analysis.geometric_series import Series
from analysis.harmonic_sums import data_sums, uniform_kernels
from analysis.normal_equations import Step

Floats = NDArray[np.float64]
Samples = NDArray[Any]


LINES = 6
BESIDE = (-0.5, -0.25, 0.25, 0.5)
"""Where two harmonics fold almost onto each other their common line stands between them: so many bins away from
the strongest lines the fundamental is looked for too."""

FEW_PERIODS = 8.0
SLOW_GRID = np.arange(1.75, FEW_PERIODS, 0.25)
"""Periods in a record that has so few of them that its lines are not apart."""

REFINEMENTS = (0.12, 0.06)
"""The start is then improved to within about this many bins."""


def start_of_series(values: Samples, weights: Samples | None, spectrum: Spectrum) -> Series:
    """Best of many candidate frequencies, each with the linear fit of `_equation_error_start`.

    Parameters
    ----------
    values : (R, N); weights : (R, N) or None
        Centred, 0 where missing.
    spectrum : (R, N//2 + 1)
        Of `values`.
    """
    n_samples = values.shape[1]
    one_bin = 2 * np.pi / n_samples
    search = _Search(values, weights)
    lines = candidate_frequencies(spectrum, n_samples, LINES)
    for column in range(LINES):
        search.try_at(lines[:, column])
    for column in range(LINES // 2):
        for bins in BESIDE:
            search.try_at(lines[:, column] + bins * one_bin)
    search.try_slow(np.flatnonzero(lines[:, 0] < FEW_PERIODS * one_bin), SLOW_GRID * one_bin)
    for bins in REFINEMENTS:
        middle = search.best.omega.copy()
        search.try_at(middle - bins * one_bin)
        search.try_at(middle + bins * one_bin)
    return search.best


class _Search:
    """The best start found so far for each record, and what it leaves."""

    def __init__(self, values: Samples, weights: Samples | None) -> None:
        n_records = len(values)
        self.values, self.weights = values, weights
        self.best = Series(*(np.zeros(n_records, kind) for kind in (float, complex, complex, float)))
        self.left = np.full(n_records, np.inf)

    def try_at(self, omega: Floats) -> None:
        """One more frequency for each record."""
        lowest = np.pi / self.values.shape[1]
        series, left = _equation_error_start(self.values, self.weights, np.clip(omega, lowest, np.pi))
        better = left < self.left
        self.best = series.where(better, self.best)
        self.left = np.where(better, left, self.left)

    def try_slow(self, part: NDArray[np.intp], grid: Floats) -> None:
        """Many frequencies for some of the records."""
        if part.size == 0:
            return
        some = _Search(self.values[part], None if self.weights is None else self.weights[part])
        some.left = self.left[part]
        some.best = self.best.take(part)
        for omega in grid:
            some.try_at(np.full(part.size, omega))
        self.best.put(part, some.best)
        self.left[part] = some.left


def _equation_error_start(
    values: Samples, weights: Samples | None, omega: Floats
) -> tuple[Series, Floats]:
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
