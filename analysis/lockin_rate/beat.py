"""Frequency and harmonic ratio of the fitted waveforms, and what speaks against them."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from analysis.arrays import Bools, Complexes, Floats, Indices, Ints
from analysis.flags import Flag
from analysis.lockin_rate.rate import SIGNIFICANT
from analysis.waveform.waveform_fit import WaveformFit

FEWEST_PERIODS = 3.0

FEW_FOR_A_MOTION = 10.0
"""Periods below which a fitted motion can make a beat of any slow curve; the second harmonic must speak for it."""

LOSS = 0.01
"""Share of the amplitude that may be missing; an averaged moving phase that costs it costs the ratio 3 %."""


@dataclass(frozen=True)
class Beat:
    """Frequency and harmonic ratio of (R,) records, with their covariance.

    size is |q| as fitted, ratio the same freed of its bias; covariance (R, 3, 3) is that of frequency, size of
    the ratio, and its part across (phase times size), from noise; misfit is the standard uncertainty of both parts
    of the ratio by what is no noise.
    """

    frequency: Floats
    size: Floats
    ratio: Floats
    covariance: Floats
    misfit: Floats
    rho: Complexes
    rho_covariance: Floats
    amplitude: Floats
    omega: Floats
    periods: Floats

    @property
    def frequency_u(self) -> Floats:
        """Standard uncertainty of the frequency, Hz."""
        return np.sqrt(self.covariance[:, 0, 0])

    @property
    def ratio_u(self) -> Floats:
        """Standard uncertainty of the size of the ratio."""
        return np.hypot(np.sqrt(self.covariance[:, 1, 1]), self.misfit)

    def take(self, rows: Indices) -> Beat:
        """Some of the records."""
        return Beat(**{field.name: getattr(self, field.name)[rows] for field in fields(Beat)})

    def widened(self, rows: Indices, ratio_u: Floats) -> Beat:
        """With one more uncertainty (r,) by what is no noise in the ratio of some records."""
        misfit = self.misfit.copy()
        misfit[rows] = np.hypot(misfit[rows], ratio_u)
        return replace(self, misfit=misfit)

    @staticmethod
    def of(fit: WaveformFit, n_samples: int, sample_interval: float) -> Beat:
        """From fitted waveforms."""
        first, q, omega = fit.series.first, fit.series.ratio, fit.series.omega
        size = np.abs(q)
        jacobian = _jacobian(first, q, 1 / (np.pi * n_samples * sample_interval))
        covariance = jacobian @ fit.covariance @ jacobian.swapaxes(-1, -2)
        strength = np.sqrt(fit.excess)
        covariance = covariance * strength[:, :, np.newaxis] * strength[:, np.newaxis, :]
        rho = q * np.conj(first) / np.abs(first)
        turn = np.exp(1j * np.angle(rho))
        rotation = np.stack([np.stack([turn.real, -turn.imag], -1), np.stack([turn.imag, turn.real], -1)], -2)
        return Beat(
            frequency=omega / (2 * np.pi * sample_interval),
            size=size,
            # |q|^2 is too large by the variance of its two parts; that along q is in the mean already.
            ratio=np.sqrt(np.maximum(size**2 - covariance[:, 2, 2], 0.0)),
            covariance=covariance,
            misfit=fit.misfit,
            rho=rho,
            rho_covariance=rotation @ covariance[:, 1:, 1:] @ rotation.swapaxes(-1, -2),
            amplitude=np.abs(first) / (1 - size**2),
            omega=omega,
            periods=omega * n_samples / (2 * np.pi),
        )


def _jacobian(first: Complexes, q: Complexes, hertz: float) -> Floats:
    """Derivatives (R, 3, 6) of frequency and of the ratio along and across its direction by the fit's parameters.

    The part across is that of rho = q exp(-i arg H), so the phase of H enters it; the size of the ratio does not
    know H.
    """
    size = np.abs(q)
    unit = np.where(size > 0, q / np.where(size > 0, size, 1.0), 1.0)
    jacobian = np.zeros((q.size, 3, 6))
    jacobian[:, 0, 5] = hertz
    jacobian[:, 1, 3], jacobian[:, 1, 4] = unit.real, unit.imag
    jacobian[:, 2, 3], jacobian[:, 2, 4] = -unit.imag, unit.real
    squared = np.abs(first) ** 2
    jacobian[:, 2, 1], jacobian[:, 2, 2] = size * first.imag / squared, -size * first.real / squared
    return jacobian


def beat_flags(beat: Beat, fit_flags: Ints, n_samples: int) -> Ints:
    """What frequency and ratio say against a record, (R,), with the flags of its fit (R,)."""
    flags = np.zeros(beat.size.shape, dtype=np.int64)
    flags[beat.periods < FEWEST_PERIODS] |= Flag.FEW_PERIODS
    flags[2 * beat.omega >= np.pi] |= Flag.SECOND_HARMONIC_ABOVE_NYQUIST
    flags[_folds_onto_another(beat.omega, beat.size, n_samples)] |= Flag.HARMONICS_ALIASED
    flags[~(beat.size > SIGNIFICANT * beat.ratio_u)] |= Flag.RATIO_NOT_SIGNIFICANT
    moved = (fit_flags & int(Flag.RATE_WANDER)) != 0
    silent = (flags & int(Flag.RATIO_NOT_SIGNIFICANT)) != 0
    # A gyro that swings inside lock-in leaves such a curve.
    flags[moved & silent & (beat.periods < FEW_FOR_A_MOTION)] |= Flag.MISFIT
    return flags


def is_weaker(beat: Beat, fit: WaveformFit, full: Floats, n_samples: int) -> Bools:
    """Where the amplitude falls short of `full` by more than noise and the stability of a laser explain."""
    amplitude_u = fit.noise_rms * np.sqrt(2 / n_samples)
    return np.asarray(full - beat.amplitude > np.maximum(LOSS * full, 5 * amplitude_u))


def _folds_onto_another(omega: Floats, ratio: Floats, n_samples: int) -> Bools:
    """Whether a strong harmonic folds to within one bin of the fundamental or of the second harmonic."""
    orders = np.arange(2, 13)
    folded = np.abs((orders * omega[:, np.newaxis] + np.pi) % (2 * np.pi) - np.pi)
    bin_width = 2 * np.pi / n_samples
    strong = ratio[:, np.newaxis] ** (orders - 1) > 0.02 * ratio[:, np.newaxis]
    on_first = np.abs(folded - omega[:, np.newaxis]) < bin_width
    second = np.abs((2 * omega[:, np.newaxis] + np.pi) % (2 * np.pi) - np.pi)
    on_second = (np.abs(folded - second) < bin_width) & (orders > 2)
    at_edge = (np.abs(folded - np.pi) < bin_width) & (orders == 2)
    at_zero = (folded < bin_width) & (orders == 2)
    return np.asarray((strong & (on_first | on_second | at_edge | at_zero)).any(axis=-1))
