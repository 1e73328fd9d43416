"""`scipy.optimize.curve_fit` of the complete waveform, as one would write it in an afternoon."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.optimize import OptimizeWarning, curve_fit

from benchmarks.estimator.methods.reading import Floats, Reading, exact
from benchmarks.estimator.methods.sine_fits import peak_frequency


def fit_curve(codes: Floats, rate: Floats) -> Reading:
    """Six parameters, default settings, no Jacobian; started at the peak and with a ratio from the Hann window."""
    omega = peak_frequency(codes)
    index = np.arange(codes.shape[1], dtype=np.float64)
    found = np.array([_fit_one(index, record, start) for record, start in zip(codes, omega, strict=True)])
    return Reading(found[:, 0], exact(found[:, 1], found[:, 0], rate))


def _series(
    index: Floats, offset: float, a: float, b: float, q_real: float, q_imag: float, omega: float
) -> Floats:
    """offset + Re[H e/(1 - q e)], e = exp(i w n)."""
    carrier = np.exp(1j * omega * index)
    return np.asarray(offset + ((a + 1j * b) * carrier / (1 - (q_real + 1j * q_imag) * carrier)).real)


def _fit_one(index: Floats, record: Floats, omega: float) -> tuple[float, float]:
    """Frequency in cycles per sample and ratio; nan where the optimiser gives up."""
    window = np.hanning(record.size)
    first, second = (
        2 * np.sum((record - record.mean()) * window * np.exp(-1j * k * omega * index)) / window.sum()
        for k in (1, 2)
    )
    q = second / first
    q *= min(1.0, 0.9 / abs(q))
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore", OptimizeWarning)
            start = [record.mean(), first.real, first.imag, q.real, q.imag, omega]
            found, _ = curve_fit(_series, index, record, p0=start)
    except (RuntimeError, ValueError):  # no convergence, or the pole crossed the unit circle
        return np.nan, np.nan
    return float(found[5] / (2 * np.pi)), float(np.hypot(found[3], found[4]))
