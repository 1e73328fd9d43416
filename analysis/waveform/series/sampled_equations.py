"""Exact normal equations of the tied series from the samples: for ratios that would need too many harmonics."""

from __future__ import annotations

import numpy as np

from analysis.arrays import Floats, Samples
from analysis.waveform.series.geometric_series import Series, carrier_of
from analysis.waveform.series.harmonic_sums import phasors, record_grid
from analysis.waveform.series.normal_equations import Step


def equations_by_samples(values: Samples, weights: Samples | None, series: Series) -> Step:
    """Normal equations of (R,) records at the given parameters, in the precision of `values`."""
    tangents, left = _tangents(values, weights, series, drifting=False)
    return _step(tangents, left)


def drift_by_samples(values: Samples, weights: Samples | None, series: Series) -> tuple[Floats, Floats]:
    """By how much the complex ratio of fitted records would change from the middle to the end if it drifted.

    The amplitude may drift beside it, by any share. One step from the minimum of a fit without.
    """
    change, covariance = _step(*_tangents(values, weights, series, drifting=True)).solve_and_invert()
    return change[:, 7:], covariance[:, 7:, 7:]


def _step(tangents: Samples, left: Samples) -> Step:
    normal = np.matmul(tangents, tangents.swapaxes(-1, -2))
    gradient = np.matmul(tangents, left[..., np.newaxis])[..., 0]
    power = np.vecdot(left, left)
    return Step(normal.astype(np.float64), gradient.astype(np.float64), power.astype(np.float64))


def _tangents(
    values: Samples, weights: Samples | None, series: Series, *, drifting: bool
) -> tuple[Samples, Samples]:
    """Derivatives (R, P, N) of the model, and what it leaves of the records; `drifting`: of the amplitude and of
    both parts of the ratio that grow from the middle of the record, too.
    """
    n_records, n_samples = values.shape
    outer, inner = record_grid(n_samples)
    coarse, fine = (phasors(series.omega, index, values.dtype) for index in (outer, inner))
    carrier = carrier_of(coarse, fine, n_samples)
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
