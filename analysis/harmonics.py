"""Frequency and harmonics of periodic records by least squares on the samples."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Complexes, Floats
from analysis.waveform.frequency import NanPolicy, Records, SpectralStart, as_stack, records_at_once
from analysis.waveform.series import Step, carrier_of, step_by_samples

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


def fit_harmonics(
    volts: ArrayLike, sample_interval: float, *, harmonics: int = 3, nan_policy: NanPolicy = "raise"
) -> HarmonicFit:
    """Fit offset, frequency and harmonics of each record by least squares on its samples.

    The frequency is fitted, not read from a spectrum: an error of 2 % of a bin would already change A2/A1 by
    1 %. Exact for any number of periods, since the normal equations keep every overlap of the harmonics.

    Parameters
    ----------
    volts : (..., n_samples)
        Or raw codes, in which -128 marks a missing sample.
    sample_interval : float
        Seconds.
    harmonics : int
        How many harmonics, at least 1.
    nan_policy : {"raise", "omit"}
        Whether nan in `volts` is an error, or a missing sample that is left out.

    Returns
    -------
    HarmonicFit
        Fields of shape (...). A constant record gives nan.

    Raises
    ------
    ValueError
        Fewer than 8 samples, an interval that is not positive, nan or infinite values, harmonics < 1.

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
    stack = as_stack(volts, sample_interval, nan_policy)
    at_once = max(1, records_at_once(stack.n_samples, np.float64) // harmonics)
    parts = [slice(begin, begin + at_once) for begin in range(0, max(len(stack.volts), 1), at_once)]
    fitted = [_fit_part(stack.take(part), harmonics) for part in parts]
    omega, offset, noise, amplitudes, deviations = (np.concatenate(column) for column in zip(*fitted, strict=True))
    to_hertz = 1 / (2 * np.pi * sample_interval)
    at_start = np.exp(-0.5j * (stack.n_samples - 1) * np.outer(omega, np.arange(1, harmonics + 1)))
    shape = stack.shape
    return HarmonicFit(
        frequency=(omega * to_hertz).reshape(shape),
        frequency_u=(deviations[:, -1] * (2 / stack.n_samples) * to_hertz).reshape(shape),
        amplitudes=(amplitudes * at_start).reshape(*shape, harmonics),
        amplitudes_u=np.sqrt((deviations[:, 1:-1:2] ** 2 + deviations[:, 2:-1:2] ** 2) / 2).reshape(
            *shape, harmonics
        ),
        offset=offset.reshape(shape),
        noise_rms=noise.reshape(shape),
    )


def _fit_part(records: Records, harmonics: int) -> tuple[Floats, Floats, Floats, Complexes, Floats]:
    """Frequency, offset, noise (R,), amplitudes (R, harmonics), and standard uncertainty of each parameter."""
    omega, offset, amplitudes, step = fit_free_harmonics(
        records.values, records.weights, SpectralStart.of(records.values).omega, harmonics
    )
    noise = np.sqrt(step.residual_power / np.maximum(records.count - 2 * harmonics - 2, 1))
    deviations = np.sqrt(np.diagonal(step.covariance(), axis1=-2, axis2=-1)) * noise[:, np.newaxis]
    blank = np.where(records.constant, np.nan, 1.0)[:, np.newaxis]
    offset = (offset + records.centre) * blank[:, 0]
    return omega * blank[:, 0], offset, noise, amplitudes * blank, deviations * blank


def fit_free_harmonics(
    values: Floats, weights: Floats | None, omega: Floats, harmonics: int, iterations: int = ITERATIONS
) -> tuple[Floats, Floats, Complexes, Step]:
    """Frequency, offset, amplitudes with their phases in the middle of the record, and the last equations."""
    n_records, n_samples = values.shape
    whole, weights = weights is None, np.ones((n_records, 1)) if weights is None else weights
    index = (np.arange(n_samples) - (n_samples - 1) / 2) * (2 / n_samples)
    offset, amplitudes = np.zeros(n_records), np.zeros((n_records, harmonics), dtype=np.complex128)
    tangents = np.ones((n_records, 2 * harmonics + 2, n_samples))
    # With all amplitudes zero the frequency has no influence: the first step solves the linear part alone.
    going_on = np.ones(n_records, dtype=bool)
    for number in range(iterations + 1):
        carrier = carrier_of(omega, n_samples, values.dtype)
        left, slope, wave = values - offset[:, np.newaxis], np.zeros(values.shape), np.ones_like(carrier)
        for order, amplitude in enumerate(amplitudes.T, 1):
            wave *= carrier
            tangents[:, 2 * order - 1], tangents[:, 2 * order] = wave.real, -wave.imag
            left -= (beat := amplitude[:, np.newaxis] * wave).real
            slope -= order * beat.imag
        tangents[:, -1] = slope * index
        step = step_by_samples(tangents if whole else tangents * weights[:, np.newaxis], left * weights)
        change = step.solve()
        if number == iterations or not going_on.any():
            break
        change[~going_on] = 0.0  # each record stops by itself
        offset, amplitudes = offset + change[:, 0], amplitudes + change[:, 1:-1:2] + 1j * change[:, 2:-1:2]
        # Half a radian at the ends is the most that the linearisation can be trusted for.
        turn = (number > 0) * np.clip(change[:, -1], -0.5, 0.5)
        omega = np.clip(omega + turn * (2 / n_samples), 0.5 / n_samples, np.pi)
        going_on &= (np.abs(turn) >= 1e-10) | (number == 0)
    return omega, offset, amplitudes, step
