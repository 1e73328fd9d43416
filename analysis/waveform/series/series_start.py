"""Start values of the tied series where the strongest line of the spectrum may not be the fundamental."""

from __future__ import annotations

import numpy as np

from analysis.arrays import Complexes, Floats, Indices, Samples
from analysis.waveform.records import never_alone
from analysis.waveform.series.frequency_search import Spectra
from analysis.waveform.series.geometric_series import Series
from analysis.waveform.series.harmonic_sums import data_sums, uniform_kernels
from analysis.waveform.series.normal_equations import Step

LINES = 6
BESIDE = (-0.5, -0.25, 0.25, 0.5)
"""Where two harmonics fold almost onto each other their common line stands between them: so many bins away from
the strongest lines the fundamental is looked for too."""

FEW_PERIODS = 8.0
SLOW_GRID = np.arange(1.75, FEW_PERIODS, 0.25)
"""Periods in a record that has so few of them that its lines are not apart."""

REFINEMENTS = (0.12, 0.06)
"""The start is then improved to within about this many bins."""


def start_of_series(values: Samples, weights: Samples | None) -> Series:
    """Best of many candidate frequencies, each with the linear fit of `_equation_error_fit`."""
    n_samples = values.shape[1]
    one_bin = 2 * np.pi / n_samples
    search = _Search(values, weights)
    lines = Spectra.of(values).candidates(LINES)
    beside = lines[:, : LINES // 2, np.newaxis] + np.array(BESIDE) * one_bin
    search.try_at(np.concatenate([lines, beside.reshape(len(lines), -1)], axis=1))
    slow = never_alone(np.flatnonzero(lines[:, 0] < FEW_PERIODS * one_bin))
    if slow.size:
        some = search.take(slow)
        some.try_at(np.broadcast_to(SLOW_GRID * one_bin, (slow.size, SLOW_GRID.size)))
        search.put(slow, some)
    for bins in REFINEMENTS:
        search.try_at(search.best.omega[:, np.newaxis] + np.array([-bins, bins]) * one_bin)
    return search.best


class _Search:
    """The best start found so far for each record, and what it leaves."""

    def __init__(self, values: Samples, weights: Samples | None) -> None:
        n_records = len(values)
        self.values, self.weights, self.squares = values, weights, values * values
        self.best = Series(*(np.zeros(n_records, kind) for kind in (float, complex, complex, float)))
        self.left = np.full(n_records, np.inf)

    def try_at(self, omega: Floats) -> None:
        """Some more frequencies (R, C) for each record."""
        n_samples = self.values.shape[1]
        omega = np.clip(omega, np.pi / n_samples, np.pi)
        of_values, of_squares = (data_sums(v, omega, 2, 0)[:, :, 0] for v in (self.values, self.squares))
        if self.weights is None:
            ones = uniform_kernels(omega.ravel(), n_samples, 2)[:, 0].astype(np.complex128)
        else:
            ones = data_sums(self.weights, omega, 2, 0)[:, :, 0]
        sums = (part.reshape(-1, 3) for part in (ones, of_values, of_squares))
        tried, left = _equation_error_fit(omega.ravel(), *sums)
        rows = np.arange(len(omega))
        chosen = left.reshape(omega.shape).argmin(axis=1)
        best, left = tried.take(rows * omega.shape[1] + chosen), left.reshape(omega.shape)[rows, chosen]
        better = left < self.left
        self.best = best.where(better, self.best)
        self.left = np.where(better, left, self.left)

    def take(self, part: Indices) -> _Search:
        """The search of some of the records."""
        some = _Search(self.values[part], None if self.weights is None else self.weights[part])
        some.best, some.left = self.best.take(part), self.left[part]
        return some

    def put(self, part: Indices, other: _Search) -> None:
        """What a search of some of the records has found."""
        self.best.put(part, other.best)
        self.left[part] = other.left


def _equation_error_fit(
    omega: Floats, ones: Complexes, of_values: Complexes, of_squares: Complexes
) -> tuple[Series, Floats]:
    """Start values from a linear fit that needs no harmonics and no first guess of q, and what it leaves.

    Multiplied by |1 - q e|^2 the waveform becomes linear in its unknowns:
    v = a + Re(b e) + v Re(s e), with s = 2q/(1 + |q|^2), whose size is WL/W itself. All inner products are sums
    of 1, v and v^2 times exp(-i k w m), k = 0, 1, 2: the arguments, (R, 3) each.
    """
    normal = np.empty((omega.size, 5, 5))
    normal[:, :3, :3] = _products(ones)
    normal[:, :3, 3:] = _products(of_values)[:, :, 1:]
    normal[:, 3:, :3] = normal[:, :3, 3:].swapaxes(-1, -2)
    normal[:, 3:, 3:] = _products(of_squares)[:, 1:, 1:]
    gradient = np.concatenate([_columns(of_values), _columns(of_squares)[:, 1:]], axis=-1)
    step = Step(normal, gradient, of_squares[:, 0].real)
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


def _products(sums: Complexes) -> Floats:
    """Inner products of 1, Re e, -Im e under a weight, from its sums times exp(-i k w m), k = 0, 1, 2."""
    zero, one, two = sums[:, 0].real, np.conj(sums[:, 1]), np.conj(sums[:, 2])
    products = np.empty((len(sums), 3, 3))
    products[:, 0, 0] = zero
    products[:, 0, 1] = products[:, 1, 0] = one.real
    products[:, 0, 2] = products[:, 2, 0] = -one.imag
    products[:, 1, 1], products[:, 2, 2] = (zero + two.real) / 2, (zero - two.real) / 2
    products[:, 1, 2] = products[:, 2, 1] = -two.imag / 2
    return products


def _columns(sums: Complexes) -> Floats:
    one = np.conj(sums[:, 1])
    return np.stack([sums[:, 0].real, one.real, -one.imag], axis=-1)
