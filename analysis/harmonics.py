"""Frequency and harmonics of periodic records by least squares on the samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.frequency_search import coarse_frequency
from analysis.periodic_fit import Step, gauss_newton_step, record_sums, two_sided
from analysis.records import as_records

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

ITERATIONS = 12
"""Gauss-Newton converges quadratically here: 3 to 5 steps are used, the rest is for hopeless records."""


@dataclass(frozen=True)
class HarmonicFit:
    """Least-squares fit of volts = offset + Re sum c_n exp(2 pi i n f t), t = 0 at the first sample.

    frequency, frequency_u : (...) Hz, and its standard uncertainty for white noise
    amplitudes : (..., harmonics) complex c_n, volts
    amplitudes_u : (..., harmonics) standard uncertainty of the real and of the imaginary part (their rms), volts
    offset, noise_rms : (...) volts; the noise is what the fit leaves, per degree of freedom
    """

    frequency: Floats
    frequency_u: Floats
    amplitudes: Complexes
    amplitudes_u: Floats
    offset: Floats
    noise_rms: Floats


def fit_harmonics(volts: ArrayLike, sample_interval: float, *, harmonics: int = 3) -> HarmonicFit:
    """Fit offset, frequency and harmonics of each record by least squares on its samples.

    The frequency is fitted, not read from a spectrum: an error of 2 % of a bin would already change A2/A1 by
    1 %. Exact for any number of periods, since the normal equations keep every overlap of the harmonics.

    Parameters
    ----------
    volts : (..., n_samples)
        nan marks a missing sample.
    sample_interval : float
        Seconds.
    harmonics : int
        How many harmonics, at least 1.

    Returns
    -------
    HarmonicFit
        Fields of shape (...). A constant record gives nan.

    Raises
    ------
    ValueError
        Fewer than 8 samples, an interval that is not positive, infinite values, harmonics < 1.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(100) * 0.01
    >>> fit = fit_harmonics(1 + np.cos(2 * np.pi * 5.3 * t), 0.01, harmonics=1)
    >>> round(float(fit.frequency), 6), round(float(fit.offset), 6), round(abs(complex(fit.amplitudes[0])), 6)
    (5.3, 1.0, 1.0)
    """
    if harmonics < 1:
        raise ValueError(f"harmonics is {harmonics}: at least 1 is needed")
    records = as_records(volts, sample_interval)
    n_parameters = 2 * harmonics + 2
    size = len(records.values)
    omega, offset = np.full(size, np.nan), np.full(size, np.nan)
    amplitudes = np.full((size, harmonics), np.nan, dtype=np.complex128)
    covariance = np.full((size, n_parameters, n_parameters), np.nan)
    residual = np.full(size, np.nan)
    for part in records.parts(~records.constant):
        values, weights = records.take(part)
        omega[part], offset[part], amplitudes[part], step = fit_free_harmonics(
            values, weights, coarse_frequency(values), harmonics
        )
        covariance[part], residual[part] = step.covariance(), step.residual_power

    degrees = np.maximum(records.count - n_parameters, 1)
    noise = np.sqrt(residual / degrees) * records.scale
    variances = np.diagonal(covariance, axis1=-2, axis2=-1) * (residual / degrees)[:, np.newaxis]
    per_sample = np.sqrt(variances[:, -1]) * (2 / records.n_samples)
    to_hertz = 1 / (2 * np.pi * sample_interval)
    pairs = np.sqrt((variances[:, 1:-1:2] + variances[:, 2:-1:2]) / 2)
    middle = (records.n_samples - 1) / 2
    at_start = np.exp(-1j * np.outer(omega * middle, np.arange(1, harmonics + 1)))
    shape = records.shape
    return HarmonicFit(
        frequency=(omega * to_hertz).reshape(shape),
        frequency_u=(per_sample * to_hertz).reshape(shape),
        amplitudes=(amplitudes * at_start * records.scale[:, np.newaxis]).reshape(*shape, harmonics),
        amplitudes_u=(pairs * records.scale[:, np.newaxis]).reshape(*shape, harmonics),
        offset=(offset * records.scale + records.centre).reshape(shape),
        noise_rms=noise.reshape(shape),
    )


def fit_free_harmonics(
    values: Floats, weights: Floats | None, omega: Floats, harmonics: int, iterations: int = ITERATIONS
) -> tuple[Floats, Floats, Complexes, Step]:
    """Offset, frequency and independent harmonics; phases count from the middle of the record.

    Parameters
    ----------
    values : (R, N); weights : (R, N) or None; omega : (R,) start, rad per sample

    Returns
    -------
    omega (R,), offset (R,), amplitudes (R, harmonics), and the last Step (parameter order: offset,
    Re c_1, Im c_1, ..., frequency)
    """
    n_records, n_samples = values.shape
    tangents = np.broadcast_to(_free_tangents(harmonics), (n_records, 2 * harmonics + 1, 2 * harmonics + 1))
    omega = omega.copy()
    parameters = np.zeros((n_records, 2 * harmonics + 1))
    # With all amplitudes zero the frequency has no influence: the first step solves the linear part alone.
    sums = record_sums(values, omega, harmonics, weights)
    for iteration in range(iterations + 1):
        amplitudes = parameters[:, 1::2] + 1j * parameters[:, 2::2]
        step = gauss_newton_step(sums, two_sided(parameters[:, 0], amplitudes), tangents)
        if iteration == iterations:
            break
        change = step.solve()
        if iteration == 0:
            change[:, -1] = 0.0
        parameters += change[:, :-1]
        # Half a radian at the ends is the most that the linearisation can be trusted for.
        moved = np.clip(change[:, -1], -0.5, 0.5)
        omega = np.clip(omega + moved * (2 / n_samples), 0.5 / n_samples, np.pi)
        if iteration > 0 and np.all(np.abs(moved) < 1e-9):
            iterations = iteration + 1
        if iteration > 0:
            sums = record_sums(values, omega, harmonics, weights)
    return omega, parameters[:, 0], parameters[:, 1::2] + 1j * parameters[:, 2::2], step


def _free_tangents(harmonics: int) -> Complexes:
    """Derivatives of the two-sided coefficients by offset, Re c_1, Im c_1, ...; (2K+1, 2K+1)."""
    size = 2 * harmonics + 1
    tangents = np.zeros((size, size), dtype=np.complex128)
    tangents[0, harmonics] = 1.0
    for k in range(1, harmonics + 1):
        tangents[2 * k - 1, [harmonics + k, harmonics - k]] = 0.5
        tangents[2 * k, harmonics + k], tangents[2 * k, harmonics - k] = 0.5j, -0.5j
    return tangents
