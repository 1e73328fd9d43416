"""Lock-in rate from a sine and a cosine photodiode, free of second-order distortion in one record.

The true beat has lines on one side of the spectrum only: with complex amplitudes s_n of the sine and c_n of the
cosine signal, g = s_n/c_n is one number for all harmonics, whatever gain and phase the two channels have. So
s_2 - g c_2 holds nothing but what the receivers made. For square laws, in terms of rho = c2 |c1|/c1^2,

    (rho_s - D_s B_s) exp(i arg g) = rho_c - D_c B_c,    B = 1 - |rho|^2 - 2i rho Im rho               (1)

two real equations for the two distortions D_s, D_c. For equal channels in perfect quadrature this is the
subtraction of the image, c_2 - c_-2 (c_1/|c_1|)^4 of Z = cosine + i sine (docs/several_rates.md).

A square law also mixes the harmonics of the beat, and its mean, back into the fundamental. Summed over all of them
the fundamental becomes 1 - 2 D conj(rho) times what it was: its phase turns by 2 D Im rho, and its size falls by
2 D Re rho, which must be taken out of the ratio of the channels' gains.
"""

from dataclasses import dataclass, replace
from enum import IntFlag

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.arrays import Complexes, Floats, Ints
from analysis.flags import FATAL, Flag
from analysis.lockin_equation import Relation
from analysis.lockin_rate import LockInEstimate, estimate_lock_in, with_ratio
from analysis.waveform.frequency import NanPolicy

HARMONICS = 5  # of the two channels, compared at the frequency found: the phase between them, and the images
SAMPLES_AT_ONCE = 400_000  # bounds the memory of a large batch
POOR_QUADRATURE = 0.35  # rad from a right angle, where a correction costs 6 % in uncertainty
NO_QUADRATURE = 0.1
"""Sine of the angle between the channels below which the sense of rotation and the correction mean nothing."""
LARGE_DISTORTION = 0.02
SIZE_WITH_RATIO = 0.5
"""Share of the fundamental's error that is in rho too; found by simulation between 1.2 and 30 lock-in rates, where
it makes the stated uncertainty of the gain ratio that of its scatter within 15 %."""
IMAGE_LIMIT = 4.0  # in standard uncertainties: images of the third harmonic above this are real


class QuadratureFlag(IntFlag):
    """Bits of `QuadratureEstimate.flags`; the lower-case name is the one used in JSON."""

    NOT_IN_QUADRATURE = 1
    """The channels are so nearly in phase that they hold one signal twice."""
    POOR_QUADRATURE = 2
    """Far from 90 degrees: still corrected, with a larger uncertainty."""
    FREQUENCIES_DIFFER = 4
    """The channels show two beats."""
    SENSE_DISAGREES = 8
    """The sense seen is not that of the input rate given: channels exchanged, one inverted, or the rate."""
    LARGE_DISTORTION = 16
    """Second harmonic of a receiver above -34 dBc: terms of higher order are left."""
    IMAGE_LEFT = 32
    """The third harmonic has an image that neither imbalance nor second-order distortion makes."""


@dataclass(frozen=True)
class QuadratureEstimate:
    """Estimate from two channels; arrays have the leading shape of the records.

    estimate : the corrected one; its complex ratio and backscatter phase are those of the sine channel
    sine, cosine : each channel alone, with its distortion in it
    sense : +1 where the cosine leads the sine by 90 deg (a phase that grows), -1, or 0 where that cannot be told
    gain_ratio, gain_ratio_u : amplitude of the sine over that of the cosine
    phase_error, phase_error_u : rad, by which the readout phases of the channels differ more than 90 deg; what is
        optical in it has one sign for both senses of rotation, a delay between the channels has two
    distortion, distortion_u : (..., 2) second harmonic that the receivers of sine and cosine make, over the
        fundamental
    images : (..., 3) |c_-1/c_1| of Z = cosine + i sine; then, with gain and phase corrected, |c_-2/c_1| and
        |c_-3/c_1|, which an ideal bench does not have
    image_u : (..., 2) standard uncertainty that noise gives to the last two
    flags : bits of `QuadratureFlag`
    """

    estimate: LockInEstimate
    sine: LockInEstimate
    cosine: LockInEstimate
    sense: Ints
    gain_ratio: Floats
    gain_ratio_u: Floats
    phase_error: Floats
    phase_error_u: Floats
    distortion: Floats
    distortion_u: Floats
    images: Floats
    image_u: Floats
    flags: Ints


def estimate_quadratures(
    sine: ArrayLike,
    cosine: ArrayLike,
    sample_interval: float,
    *,
    scale_factor: float,
    input_rate: ArrayLike | None = None,
    relation: Relation = "exact",
    clipped: tuple[ArrayLike, ArrayLike] | None = None,
    nan_policy: NanPolicy = "raise",
) -> QuadratureEstimate:
    """Lock-in rate from two channels of one acquisition.

    Parameters
    ----------
    sine, cosine : (..., n_samples)
        Volts of the two photodiodes, sampled at the same instants.
    sample_interval : float
        Seconds.
    scale_factor : float
        K, pulses per degree.
    input_rate : (...), optional
        deg/s, signed. Without it the record is its own reference and ``estimate.input_rate`` has the sign seen.
    relation : {"exact", "paper-13", "paper-10"}
    clipped : two arrays (..., n_samples) of bool, optional
    nan_policy : {"raise", "omit"}
        Whether nan is an error, or a missing sample that is left out.

    Returns
    -------
    QuadratureEstimate
        nan where either channel shows no beat.

    Raises
    ------
    ValueError
        Channels of different shape, and what `estimate_lock_in` refuses.
    """
    both = (np.asarray(sine), np.asarray(cosine))
    if both[0].shape != both[1].shape:
        raise ValueError(f"sine and cosine must have the same shape, not {both[0].shape} and {both[1].shape}")
    masks = (None, None) if clipped is None else clipped
    channels = [
        estimate_lock_in(
            volts,
            sample_interval,
            scale_factor=scale_factor,
            input_rate=input_rate,
            relation=relation,
            clipped=mask,
            nan_policy=nan_policy,
        )
        for volts, mask in zip(both, masks, strict=True)
    ]
    frequency = _mean_frequency(*channels)[0]
    omega = 2 * np.pi * frequency.ravel() * sample_interval
    lines = [_lines_at(volts, omega) for volts in both]
    with np.errstate(invalid="ignore", divide="ignore"):  # records without a beat are nan throughout
        return _combine(channels[0], channels[1], lines[0], lines[1], both[0].shape[-1])


def _mean_frequency(sine: LockInEstimate, cosine: LockInEstimate) -> tuple[Floats, Floats]:
    """Weighted mean of the channels' beat frequencies and its standard uncertainty."""
    weights = np.stack([1 / np.maximum(e.beat_frequency_u**2, 1e-300) for e in (sine, cosine)])
    values = np.stack([sine.beat_frequency, cosine.beat_frequency])
    total = weights.sum(axis=0)
    return np.asarray((weights * values).sum(axis=0) / total), np.asarray(1 / np.sqrt(total))


def _lines_at(volts: NDArray[np.generic], omega: Floats) -> Complexes:
    """Complex amplitudes (R, HARMONICS) by least squares at a known frequency; phases from the middle."""
    # More harmonics are fitted than are wanted: in a short record those left out would leak into the others.
    values = np.asarray(volts, dtype=np.float64).reshape(-1, volts.shape[-1])
    lines = np.full((len(values), HARMONICS), np.nan, dtype=np.complex128)
    rows = np.flatnonzero(np.isfinite(omega))
    for part in np.array_split(rows, max(1, rows.size * values.shape[1] // SAMPLES_AT_ONCE)):
        lines[part] = _lines_of(values[part], omega[part])
    return lines


def _lines_of(values: Floats, omega: Floats) -> Complexes:
    size = 3 * HARMONICS
    weights = np.isfinite(values).astype(np.float64)
    values = np.where(weights > 0, values, 0.0)
    place = np.arange(values.shape[1]) - (values.shape[1] - 1) / 2
    turn = np.exp(-1j * omega[:, np.newaxis] * place)
    power = np.ones_like(turn)
    kernels = np.empty((len(values), 4 * size + 1), dtype=np.complex128)
    sums = np.empty((len(values), 2 * size + 1), dtype=np.complex128)
    for order in range(2 * size + 1):
        kernel = np.einsum("rn,rn->r", weights, power)
        kernels[:, 2 * size + order], kernels[:, 2 * size - order] = kernel, np.conj(kernel)
        if order <= size:
            product = np.einsum("rn,rn->r", values, power)
            sums[:, size + order], sums[:, size - order] = product, np.conj(product)
        power *= turn
    place_of = np.arange(2 * size + 1)
    gram = kernels[:, 2 * size + place_of[:, np.newaxis] - place_of]
    # Harmonics that fold onto each other share what they cannot divide.
    gram += 1e-9 * values.shape[1] * np.eye(2 * size + 1)
    two_sided = np.linalg.solve(gram, sums[..., np.newaxis])[..., 0]
    return np.asarray(2 * two_sided[:, size + 1 : size + 1 + HARMONICS], dtype=np.complex128)


@dataclass(frozen=True)
class _Pair:
    """(R,) values of the two channels, sine first where there are two."""

    ratio: tuple[Complexes, Complexes]
    covariance: tuple[Floats, Floats]
    lines: tuple[Complexes, Complexes]
    lines_u: tuple[Floats, Floats]

    @property
    def angle(self) -> Floats:
        """Phase of the sine's fundamental less that of the cosine, rad."""
        return np.angle(self.lines[0][:, 0] / self.lines[1][:, 0])

    @property
    def angle_u(self) -> Floats:
        return np.hypot(*(u / np.abs(c[:, 0]) for u, c in zip(self.lines_u, self.lines, strict=True)))


def _combine(
    sine: LockInEstimate, cosine: LockInEstimate, sine_lines: Complexes, cosine_lines: Complexes, n_samples: int
) -> QuadratureEstimate:
    shape, flat = sine.flags.shape, (sine.reshaped(-1), cosine.reshaped(-1))
    pair = _Pair(
        ratio=(flat[0].complex_ratio, flat[1].complex_ratio),
        covariance=(flat[0].complex_ratio_covariance, flat[1].complex_ratio_covariance),
        lines=(sine_lines, cosine_lines),
        lines_u=(flat[0].noise_rms * np.sqrt(2 / n_samples), flat[1].noise_rms * np.sqrt(2 / n_samples)),
    )
    # Equation (1), solved for D_s and D_c.
    angle, inner = pair.angle, pair.ratio
    for _ in range(4):
        turn = np.exp(1j * angle)
        difference = pair.ratio[0] * turn - pair.ratio[1]
        by_sine, by_cosine = _bracket(inner[0]) * turn, -_bracket(inner[1])
        determinant = by_sine.real * by_cosine.imag - by_sine.imag * by_cosine.real
        d_sine = (difference.real * by_cosine.imag - difference.imag * by_cosine.real) / determinant
        d_cosine = (by_sine.real * difference.imag - by_sine.imag * difference.real) / determinant
        inner = (pair.ratio[0] - d_sine * _bracket(inner[0]), pair.ratio[1] - d_cosine * _bracket(inner[1]))
        # The square law mixes first and second harmonic back into the first and turns its phase by 2 D Im rho.
        angle = pair.angle - 2 * (d_sine * inner[0].imag - d_cosine * inner[1].imag)
    rho, distortion = inner[0], np.stack([d_sine, d_cosine], axis=-1)
    covariance, distortion_u, angle_u, gain_u = _propagated(pair)
    across = np.abs(np.sin(pair.angle)) > NO_QUADRATURE
    sense = np.where(across, -np.sign(np.sin(pair.angle)), 0.0)
    sense = np.where(np.isfinite(sense), sense, 0.0)
    other = pair.ratio[1] - distortion[:, 1] * _bracket(pair.ratio[1])
    taken = [1 - 2 * d * np.conj(r) for d, r in zip(distortion.T, (rho, other), strict=True)]
    gain = np.abs(sine_lines[:, 0] / cosine_lines[:, 0] * taken[1] / taken[0])
    # A growing phase puts the sine 90 deg behind the cosine; what is beyond that is the error.
    phase_error = np.angle(-1j * np.exp(-1j * np.where(sense == 0, 1.0, sense) * angle))
    images, image_u = _images(pair, sense, distortion, distortion_u)
    estimate = _corrected(flat, rho, covariance, sense)
    flags = _flags(flat, pair, sense, distortion, images, image_u)
    return QuadratureEstimate(
        estimate=estimate.reshaped(*shape) if shape else estimate[0],
        sine=sine,
        cosine=cosine,
        sense=sense.astype(np.int64).reshape(shape),
        gain_ratio=gain.reshape(shape),
        gain_ratio_u=(gain * gain_u).reshape(shape),
        phase_error=phase_error.reshape(shape),
        phase_error_u=angle_u.reshape(shape),
        distortion=distortion.reshape(*shape, 2),
        distortion_u=distortion_u.reshape(*shape, 2),
        images=images.reshape(*shape, 3),
        image_u=image_u.reshape(*shape, 2),
        flags=flags.reshape(shape),
    )


def _bracket(rho: Complexes) -> Complexes:
    """What a square law of unit second harmonic adds to rho, to first order: 1 far above lock-in."""
    return np.asarray(1 - np.abs(rho) ** 2 - 2j * rho * rho.imag)


def _propagated(pair: _Pair) -> tuple[Floats, Floats, Floats, Floats]:
    """Covariance (R, 2, 2) of the corrected rho; uncertainties of distortions (R, 2), angle, relative gain."""
    sin, cos = np.sin(pair.angle), np.cos(pair.angle)
    zero, one = np.zeros_like(sin), np.ones_like(sin)
    turned = pair.ratio[0] * np.exp(1j * pair.angle)
    by_angle = turned.real / sin - (turned - pair.ratio[1]).imag * cos / sin**2
    # d(D_s), d(D_c) by the two parts of rho_s, of rho_c, and by the angle, with B = 1.
    d_sine = np.stack([one, cos / sin, zero, -1 / sin, by_angle], axis=-1)
    d_cosine = np.stack([zero, 1 / sin, one, -cos / sin, cos * by_angle + turned.imag], axis=-1)
    inputs = np.zeros((*sin.shape, 5, 5))
    inputs[:, :2, :2], inputs[:, 2:4, 2:4] = pair.covariance
    inputs[:, 4, 4] = pair.angle_u**2
    for k, share in enumerate((-2.0, 2.0)):
        # The phase of the fundamental enters rho too: twice what it would alone, since q leans on it in the fit.
        phase_u2 = (pair.lines_u[k] / np.abs(pair.lines[k][:, 0])) ** 2
        common = share * (1 - np.abs(pair.ratio[k]) ** 2) * phase_u2 * 1j * pair.ratio[k]
        for part, place in ((common.real, 2 * k), (common.imag, 2 * k + 1)):
            inputs[:, place, 4] = inputs[:, 4, place] = part
    rho = np.zeros((*sin.shape, 2, 5))
    rho[:, 0, 0], rho[:, 1, 1] = 1.0, 1.0
    rho[:, 0] -= d_sine
    covariance = rho @ inputs @ rho.swapaxes(-1, -2)
    rows = [
        d / (1 - np.abs(ratio) ** 2)[:, np.newaxis]
        for d, ratio in zip((d_sine, d_cosine), pair.ratio, strict=True)
    ]
    turned_back = [2 * ratio.imag[:, np.newaxis] * row for row, ratio in zip(rows, pair.ratio, strict=True)]
    rows.append(np.array([0.0, 0.0, 0.0, 0.0, 1.0]) - turned_back[0] + turned_back[1])
    by_size = [2 * ratio.real[:, np.newaxis] * row for ratio, row in zip(pair.ratio, rows[:2], strict=True)]
    rows.append(by_size[0] - by_size[1])
    us = [np.sqrt(np.einsum("ri,rij,rj->r", row, inputs, row)) for row in rows]
    gain_u = np.sqrt(np.maximum(pair.angle_u**2 + us[3] ** 2 + 2 * _sizes_with(rows[3], pair), 0.0))
    return covariance, np.stack(us[:2], axis=-1), us[2], gain_u


def _sizes_with(row: Floats, pair: _Pair) -> Floats:
    """Covariance (R,) of the ratio of both fundamentals with a function of both rho, of given derivatives."""
    # The size of a fundamental is as uncertain as its phase and enters rho by its inverse.
    total = np.zeros(len(row))
    for k, sign in enumerate((1.0, -1.0)):
        size_u2 = (pair.lines_u[k] / np.abs(pair.lines[k][:, 0])) ** 2
        common = -SIZE_WITH_RATIO * (1 - np.abs(pair.ratio[k]) ** 2) * size_u2 * pair.ratio[k]
        total += sign * (row[:, 2 * k] * common.real + row[:, 2 * k + 1] * common.imag)
    return total


def _images(pair: _Pair, sense: Floats, distortion: Floats, distortion_u: Floats) -> tuple[Floats, Floats]:
    s, c = pair.lines
    first = np.abs(c[:, 0])
    raw = np.abs(c[:, 0] + 1j * np.stack([s[:, 0], -s[:, 0]])) / 2
    g = s[:, 0] / c[:, 0]
    by_sine = -sense / g.imag
    by_cosine = -by_sine * g.real

    def image(sines: Complexes, cosines: Complexes) -> Floats:
        balanced = by_sine * sines + by_cosine * cosines
        return np.asarray(np.abs(cosines - 1j * sense * balanced) / 2 / first)

    # The square law's own part of the third harmonic is no sign of anything else.
    square_law = [
        2 * (1 - np.abs(rho) ** 2) * line[:, 1] for rho, line in zip(pair.ratio, pair.lines, strict=True)
    ]
    s3, c3 = (
        line[:, 2] - distortion[:, k] * square_law[k] * np.exp(1j * np.angle(line[:, 0]))
        for k, line in enumerate(pair.lines)
    )
    noise = np.hypot(by_sine * pair.lines_u[0], np.hypot(1.0, by_cosine) * pair.lines_u[1]) / 2 / first
    noise_3 = np.hypot(noise, np.linalg.norm(distortion_u * np.abs(square_law).T, axis=-1) / 2 / first)
    images = [raw.min(axis=0) / raw.max(axis=0), image(s[:, 1], c[:, 1]), image(s3, c3)]
    return np.stack(images, axis=-1), np.stack([noise, noise_3], axis=-1)


def _corrected(
    flat: tuple[LockInEstimate, LockInEstimate], rho: Complexes, covariance: Floats, sense: Floats
) -> LockInEstimate:
    """The sine channel's estimate with the corrected ratio, and the frequency of both."""
    sine, cosine = flat
    fatal = ((sine.flags | cosine.flags) & int(FATAL)) != 0
    frequency, frequency_u = _mean_frequency(sine, cosine)
    blank = np.where(fatal, np.nan, 1.0)
    both = replace(
        sine,
        beat_frequency=frequency * blank,
        beat_frequency_u=frequency_u * blank,
        periods=sine.periods * blank,
        records=(~fatal).astype(np.int64),
        records_rejected=fatal.astype(np.int64),
        flags=sine.flags | cosine.flags,
    )
    # What a distorted channel leaves the pair has taken out, or its images show it; not what happened to the beat.
    happened = (both.flags & int(Flag.PARTS_DIFFER | Flag.RATE_WANDER)) != 0
    misfit_u = np.where(happened, np.fmax(sine.misfit_u, cosine.misfit_u), 0.0)
    return with_ratio(both, rho, covariance, np.where(sense == 0, 1.0, sense), misfit_u)


def _flags(
    flat: tuple[LockInEstimate, LockInEstimate],
    pair: _Pair,
    sense: Floats,
    distortion: Floats,
    images: Floats,
    image_u: Floats,
) -> Ints:
    sine, cosine = flat
    from_right_angle = np.abs(np.abs(pair.angle) - np.pi / 2)
    apart = np.abs(sine.beat_frequency - cosine.beat_frequency)
    apart_u = np.hypot(sine.beat_frequency_u, cosine.beat_frequency_u)
    conditions = {
        QuadratureFlag.NOT_IN_QUADRATURE: sense == 0,
        QuadratureFlag.POOR_QUADRATURE: from_right_angle > POOR_QUADRATURE,
        # Distortion and rounding of noise-free records shift a frequency by far less than this share of a bin.
        QuadratureFlag.FREQUENCIES_DIFFER: apart > 5 * apart_u + 1e-3 * sine.beat_frequency / sine.periods,
        QuadratureFlag.SENSE_DISAGREES: (sense != 0) & sine.rate_given & (sense * sine.input_rate < 0),
        QuadratureFlag.LARGE_DISTORTION: np.abs(distortion).max(axis=-1) > LARGE_DISTORTION,
        QuadratureFlag.IMAGE_LEFT: images[:, 2] > IMAGE_LIMIT * image_u[:, 1] + 1e-4,
    }
    bits = [np.where(raised, int(bit), 0) for bit, raised in conditions.items()]
    return np.asarray(np.bitwise_or.reduce(bits), dtype=np.int64)
