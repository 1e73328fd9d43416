"""Fit of the geometric series on the sums of a few harmonics: the fast way, away from lock-in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.geometric_series import LARGEST_RATIO, Series, harmonics_needed
from analysis.periodic_fit import Step, gauss_newton_step, record_sums, two_sided

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]

ITERATIONS = 10

CURVATURE = 0.03
"""A Gauss-Newton step is wrong by about the square of its length. It is the last one when that square is below
this share of the standard uncertainty."""


def fit_by_sums(values: Floats, weights: Floats | None, start: Series) -> tuple[Series, Step, Bools]:
    """Gauss-Newton from a start that is close already.

    Parameters
    ----------
    values : (R, N); weights : (R, N) or None
        Centred, 0 where missing.
    start : Series

    Returns
    -------
    Series, Step, converged (R,) of bool
    """
    n_records, n_samples = values.shape
    n_harmonics = harmonics_needed(start.ratio * 1.1)
    series = start
    step = Step(np.zeros((n_records, 6, 6)), np.zeros((n_records, 6)), np.zeros(n_records))
    active = np.arange(n_records)
    for _ in range(ITERATIONS):
        everything = active.size == n_records
        some = values if everything else values[active]
        some_weights = None if weights is None else weights[active]
        here = series if everything else series.take(active)
        sums = record_sums(some, here.omega, n_harmonics, some_weights)
        now = gauss_newton_step(sums, *_series_tangents(here, n_harmonics))
        change = now.solve()
        moved = here.moved(change, n_samples)
        now = Step(now.normal, now.gradient, now.predicted_residual(change))
        if everything:
            series, step = moved, now
        else:
            series.put(active, moved)
            step.put(active, now)
        active = active[_must_go_on(change, moved, now, n_samples)]
        if active.size == 0:
            break
    converged = np.ones(n_records, dtype=bool)
    converged[active] = False
    converged &= np.abs(series.ratio) < LARGEST_RATIO
    return series, step, converged


def _must_go_on(change: Floats, series: Series, step: Step, n_samples: int) -> Bools:
    size = np.maximum(np.abs(series.first), 1e-300)
    by_first = np.hypot(change[:, 1], change[:, 2]) / size
    by_ratio = np.hypot(change[:, 3], change[:, 4])
    curvature = change[:, 5] ** 2 + by_ratio * (by_ratio + by_first)
    noise = np.sqrt(step.residual_power * 2) / (n_samples * size)
    return np.asarray(curvature > CURVATURE * noise + 1e-22)


def _series_tangents(series: Series, n_harmonics: int) -> tuple[Complexes, Complexes]:
    """Two-sided coefficients (R, 2K+1) and their derivatives by c0, Re H, Im H, Re q, Im q (R, 5, 2K+1)."""
    n_records = series.first.size
    powers = np.ones((n_records, n_harmonics), dtype=np.complex128)
    for k in range(1, n_harmonics):
        np.multiply(powers[:, k - 1], series.ratio, out=powers[:, k])
    by_ratio = np.zeros_like(powers)
    by_ratio[:, 1:] = series.first[:, np.newaxis] * np.arange(1, n_harmonics) * powers[:, :-1]
    coefficients = two_sided(series.offset, series.first[:, np.newaxis] * powers)
    tangents = np.zeros((n_records, 5, 2 * n_harmonics + 1), dtype=np.complex128)
    tangents[:, 0, n_harmonics] = 1.0
    for row, derivative in ((1, powers), (3, by_ratio)):
        tangents[:, row, n_harmonics + 1 :] = derivative / 2
        tangents[:, row, n_harmonics - 1 :: -1] = np.conj(derivative) / 2
        tangents[:, row + 1, n_harmonics + 1 :] = 0.5j * derivative
        tangents[:, row + 1, n_harmonics - 1 :: -1] = np.conj(0.5j * derivative)
    return coefficients, tangents
