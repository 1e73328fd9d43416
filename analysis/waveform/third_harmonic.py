"""What the lock-in waveform leaves at three times the beat: third-order distortion shows itself there.

s + k s^3 of the signal s = A sin(psi) is (1 + 3h) s - h A sin(3 psi), h = k A^2/4. The geometric series that fits
it best has another ratio than the beat, which no ratio shows; what no geometric series can take up is, at the
third harmonic, h A times a number that follows from r alone (`analysis.several_rates.ratio_model`).
"""

from __future__ import annotations

import numpy as np

from analysis.arrays import Complexes, Floats, Samples
from analysis.flags import FATAL, Flag
from analysis.waveform.records import Stack
from analysis.waveform.series.geometric_series import Series, orders_needed
from analysis.waveform.series.harmonic_sums import phasors, record_grid
from analysis.waveform.waveform_fit import WaveformFit

ORDER = 3

NOT_KNOWN = int(FATAL | Flag.CLIPPED | Flag.DAMAGED | Flag.RATE_WANDER | Flag.ROUNDING_REPEATS)
"""Records in which other things leave something at the third harmonic."""

SMALLEST = 1e-4
"""Least uncertainty, -80 dBc: rounding to levels leaves that much in quiet records."""

_ORDERS_LEFT_OUT = 1e-9


def third_harmonic(stack: Stack, fit: WaveformFit) -> tuple[Complexes, Floats]:
    """Third harmonic beyond the waveform that was fitted, over the amplitude of the beat, of (R,) records.

    Its phase is referred to three times that of the fundamental, so that the time origin does not enter.

    Returns
    -------
    excess : (R,) complex
        0 where it is not known.
    u : (R,)
        Standard uncertainty of its real and its imaginary part from noise; inf where it is not known.
    """
    series = fit.series
    excess, u = np.zeros(series.omega.size, dtype=np.complex128), np.full(series.omega.size, np.inf)
    whole = np.ones(series.omega.size, dtype=bool)
    for part in stack.parts():
        with np.errstate(over="ignore", invalid="ignore"):  # volts beyond single precision: not known then
            some = stack.take(part, np.float32)
            rows = np.arange(part.start, part.start + len(some.values))
            excess[rows] = _line(some.values, series.omega[rows])
        if some.weights is not None:
            whole[rows] = some.weights.all(axis=-1)
    with np.errstate(all="ignore"):  # records without a beat; they are blanked
        excess -= _line_of_series(series, stack.n_samples)
        unit = series.first / np.abs(series.first)
        amplitude = np.abs(series.first) / (1 - np.abs(series.ratio) ** 2)
        excess *= np.conj(unit) ** ORDER / amplitude
        noise = fit.noise_rms * np.sqrt(2 / stack.n_samples * fit.excess[:, 1]) / amplitude
    known = whole & ((fit.flags & NOT_KNOWN) == 0) & np.isfinite(excess) & np.isfinite(noise)
    known &= ORDER * series.omega < np.pi
    u[known] = np.hypot(noise[known], SMALLEST)
    return np.where(known, excess, 0.0), u


def _line(values: Samples, omega: Floats) -> Complexes:
    """(2/N) times the sum of the values with exp(-3 i w m), m counted from the middle of the record, (R,)."""
    n_samples = values.shape[1]
    outer, inner = record_grid(n_samples)
    coarse = phasors(ORDER * omega, outer, np.dtype(np.float64))
    fine = phasors(ORDER * omega, inner, np.dtype(np.float64))
    padded = np.zeros((len(values), outer.size * inner.size), dtype=np.float64)
    padded[:, :n_samples] = values
    grid = padded.reshape(len(values), outer.size, inner.size)
    sums = np.matmul(grid, np.conj(fine)[:, :, np.newaxis])[..., 0]
    return np.asarray(2 / n_samples * np.einsum("ro,ro->r", np.conj(coarse), sums))


def _line_of_series(series: Series, n_samples: int) -> Complexes:
    """The same of the waveform: its third harmonic, and what the others leak into the line."""
    orders = np.arange(1, orders_needed(series.ratio, _ORDERS_LEFT_OUT, ORDER) + 1)
    lines = series.first[:, np.newaxis] * series.ratio[:, np.newaxis] ** (orders - 1)
    omega = series.omega[:, np.newaxis]
    direct = _kernel((orders - ORDER) * omega, n_samples)
    mirrored = _kernel((orders + ORDER) * omega, n_samples)
    constant = 2 * series.offset * _kernel(ORDER * series.omega, n_samples)
    return np.asarray((lines * direct + np.conj(lines) * mirrored).sum(axis=-1) + constant)


def _kernel(turn: Floats, n_samples: int) -> Floats:
    """Mean of exp(i turn m) over the samples of a record, m counted from its middle."""
    half = np.asarray(turn) / 2
    sine = np.sin(half)
    flat = np.abs(sine) < 1e-9
    return np.asarray(np.where(flat, 1.0, np.sin(n_samples * half) / (n_samples * np.where(flat, 1.0, sine))))
