"""What records at several rates or in both senses will say, with distortion fitted beside the lock-in rate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.arrays import Complexes, Floats
from analysis.budget import Reference
from analysis.budget.expected_noise import RecordShape, expected_noise
from analysis.lockin_equation import beat_frequency, harmonic_ratio
from analysis.several_rates.ratio_model import RatioData, fit_ratios, predicted_ratio, whitening_factor

_PHASES = 12


def expected_joint_u(
    shapes: Sequence[RecordShape],
    input_rates: Sequence[float],
    lock_in_rate: float,
    scale_factor: float,
    *,
    reference: Reference = "beat",
    phase: float = np.nan,
    with_distortion: bool = True,
) -> float:
    """Standard uncertainty from noise of the lock-in rate that all rates give together, deg/s.

    Parameters
    ----------
    shapes : (n,) of RecordShape
        Of the records at each rate, their number included.
    input_rates : (n,)
        deg/s, signed.
    lock_in_rate, scale_factor : float
        deg/s, pulses per degree.
    reference : {"beat", "rate"}
    phase : float, optional
        Readout phase less backscatter phase, rad; nan: the rms over all phases.
    with_distortion : bool, optional
        Whether distortion is an unknown too.

    Raises
    ------
    ValueError
        The rates cannot tell distortion from lock-in.
    """
    phases = np.array([phase]) if np.isfinite(phase) else np.arange(_PHASES) * (2 * np.pi / _PHASES)
    rate = np.asarray(input_rates, dtype=np.float64)
    frequency = beat_frequency(scale_factor, np.abs(rate), lock_in_rate)
    noise = [
        expected_noise(shape, r)
        for shape, r in zip(shapes, harmonic_ratio(lock_in_rate / np.abs(rate)), strict=True)
    ]
    along = np.array([float(one.ratio_u) for one in noise])
    across = np.array([float(one.across_u) for one in noise])
    z = lock_in_rate * np.exp(-1j * phases)
    truth = np.stack([z.real, z.imag, np.zeros_like(phases), np.zeros_like(phases)], axis=-1)
    data = RatioData(
        rate=rate,
        beat_rate=frequency / scale_factor,
        angular=2 * np.pi * frequency,
        ratio=np.zeros(rate.size, dtype=np.complex128),
        whitening=np.zeros((phases.size, rate.size, 2, 2)),
        amplitude=np.ones(rate.size),
        reference=reference,
    )
    rho = predicted_ratio(truth, data)
    data = RatioData(**{**vars(data), "ratio": rho, "whitening": whitening_factor(_turned(rho, along, across))})
    fit = fit_ratios(data, (with_distortion, False), truth)
    if np.any(fit.singular):
        raise ValueError(
            "these rates cannot tell distortion from lock-in: take both senses, or rates that differ by a factor "
            "of two or more"
        )
    radial = np.stack([np.cos(phases), -np.sin(phases)], axis=-1)
    variance = np.einsum("bi,bij,bj->b", radial, fit.covariance[:, :2, :2], radial)
    return float(np.sqrt(variance.mean()))


def _turned(rho: Complexes, along: Floats, across: Floats) -> Floats:
    """Covariance (..., 2, 2) with given standard deviations along and across the direction of rho."""
    unit = rho / np.abs(rho)
    turn = np.stack([np.stack([unit.real, -unit.imag], -1), np.stack([unit.imag, unit.real], -1)], -2)
    squares = np.stack([along**2, across**2], axis=-1)
    return np.asarray(np.einsum("...ij,...j,...kj->...ik", turn, squares, turn))
