"""What records at several rates or in both senses will say, with all that is unknown fitted too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from analysis.arrays import Complexes, Floats
from analysis.budget import Reference
from analysis.budget.expected_noise import RecordShape, expected_noise
from analysis.lockin_equation import beat_frequency, harmonic_ratio
from analysis.several_rates import RatioData, ReceiverKnowledge, predicted_ratio
from analysis.several_rates.least_squares import all_solutions, fit_ratios
from analysis.several_rates.ratio_model import N_PARAMETERS, whitening_factor
from analysis.several_rates.solutions import answer

_PHASES = 12

FEW_RATES = 4
"""So many rates in one sense have no second solution; fewer may have one."""


def expected_joint_u(
    shapes: Sequence[RecordShape],
    input_rates: Sequence[float],
    lock_in_rate: float,
    scale_factor: float,
    *,
    reference: Reference = "beat",
    phase: float = np.nan,
    receiver: ReceiverKnowledge | None = None,
    all_else_known: bool = False,
) -> float:
    """Standard uncertainty of the lock-in rate that all rates give together, deg/s: that of `fit_rates`.

    It counts the noise of the records, and what they do not tell of distortion, bandwidth and gain corner. Few
    rates in one sense may have a second solution; then it is that of both together.
    """
    phases = np.array([phase]) if np.isfinite(phase) else np.arange(_PHASES) * (2 * np.pi / _PHASES)
    rate = np.asarray(input_rates, dtype=np.float64)
    if np.unique(rate).size < 2:
        raise ValueError(
            "these rates cannot tell distortion from lock-in: take both senses, or rates that differ by a factor "
            "of two or more"
        )
    frequency = beat_frequency(scale_factor, np.abs(rate), lock_in_rate)
    noise = [
        expected_noise(shape, r)
        for shape, r in zip(shapes, harmonic_ratio(lock_in_rate / np.abs(rate)), strict=True)
    ]
    along = np.array([float(one.ratio_u) for one in noise])
    across = np.array([float(one.across_u) for one in noise])
    z = lock_in_rate * np.exp(-1j * phases)
    truth = np.zeros((phases.size, N_PARAMETERS))
    truth[:, 0], truth[:, 1] = z.real, z.imag
    data = RatioData(
        rate=rate,
        beat_rate=frequency / scale_factor,
        angular=2 * np.pi * frequency,
        ratio=np.zeros(rate.size, dtype=np.complex128),
        whitening=np.zeros((phases.size, rate.size, 2, 2)),
        amplitude=np.ones(rate.size),
        third=np.zeros(rate.size),
        third_weight=1 / along,
        reference=reference,
    )
    rho = predicted_ratio(truth, data)
    data = replace(data, ratio=rho, whitening=whitening_factor(_turned(rho, along, across)))
    prior = (receiver or ReceiverKnowledge()).prior(float(frequency.min()))
    if all_else_known:
        prior = replace(prior, sd=np.where(np.isinf(prior.sd), np.inf, 0.0))
    elif len(set(np.sign(rate))) == 1 and rate.size < FEW_RATES:
        rows = range(0, phases.size, 2) if phases.size > 1 else range(1)
        each = [replace(data, ratio=rho[row], whitening=data.whitening[row : row + 1]) for row in rows]
        us = [answer(all_solutions(one, prior), 1.0, 0).u for one in each]
        return float(np.sqrt(np.mean(np.square(us))))
    fit = fit_ratios(data, prior, truth)
    radial = np.stack([np.cos(phases), -np.sin(phases)], axis=-1)
    variance = np.einsum("bi,bij,bj->b", radial, fit.covariance[:, :2, :2], radial)
    return float(np.sqrt(variance.mean()))


def _turned(rho: Complexes, along: Floats, across: Floats) -> Floats:
    """Covariance (..., 2, 2) with given standard deviations along and across the direction of rho."""
    unit = rho / np.abs(rho)
    turn = np.stack([np.stack([unit.real, -unit.imag], -1), np.stack([unit.imag, unit.real], -1)], -2)
    squares = np.stack([along**2, across**2], axis=-1)
    return np.asarray(np.einsum("...ij,...j,...kj->...ik", turn, squares, turn))
