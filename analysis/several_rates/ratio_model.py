"""The complex harmonic ratio as a function of rate: lock-in, laser and receiver.

    rho = L rho0 + D a [1 - r^2 - 2i rho0 Im rho0] + H a^2 [2i rho0 Im rho0^2 - (1 - r^2) rho0*]       (1)
    rho0 = q G |c|/c,     q = -r e^(+i b)  W > 0,     q = +r e^(-i b)  W < 0

r harmonic ratio of the lock-in equation, b backscatter phase less readout phase, a amplitude of the record over
the mean of all. D and H, second- and third-order distortion of the receiver: the second and third harmonic that it
makes of a pure sine of that mean amplitude, over its fundamental. The brackets are what a square and a cubic law
make of the ratio of the geometric series that fits the distorted signal best, to first order in D and H
(docs/several_rates.md); `beyond_first_order` has the rest for H.

G and c are what the time T = 1/g_c does that the gain needs to follow the intensity: 1 for fast gain, and F =
1/(1 + 2 pi i f T) and 1 far above lock-in. `gain_factors` has them at any rate: with equal backscatter of both
beams and no phase between them, the equations of a two-mode laser have an exact solution (docs/several_rates.md).

L is a receiver of one pole with the time constant tau: `low_pass_factor`. Its effect goes with P = tau^2, which is
what is fitted; noise may make it negative.

What no geometric series takes up of the third-order distortion stands at the third harmonic; it is data too.

Fitted in the real and imaginary part of z = WL e^(i b), which are without a singular point at WL = 0, in D, T, P
and H.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from analysis.arrays import Complexes, Floats

Reference = Literal["rate", "beat"]

N_PARAMETERS = 6
"""Re z, Im z (deg/s), D, T (s), P (s^2), H."""


@dataclass(frozen=True)
class RatioData:
    """Complex ratios of B sets of n points each; all fields broadcast to (B, n).

    rate : deg/s, signed; with reference "beat" only its sign is used
    beat_rate : deg/s, f/K
    angular : rad/s, 2 pi f
    ratio : rho
    whitening : (B, n, 2, 2) lower factor C with C C^T = inverse covariance; zero leaves a point out
    amplitude : of the point, over that to which D and H refer
    third, third_weight : third harmonic beyond the waveform in phase with distortion, over the amplitude, and the
        reciprocal of its standard uncertainty, 0 where it is not known
    """

    rate: Floats
    beat_rate: Floats
    angular: Floats
    ratio: Complexes
    whitening: Floats
    amplitude: Floats
    third: Floats
    third_weight: Floats
    reference: Reference

    def weighted(self, weights: Floats) -> RatioData:
        """The data with weights (B, n) of 1 or 0: several selections of one set, fitted side by side."""
        return replace(
            self,
            whitening=self.whitening * weights[..., np.newaxis, np.newaxis],
            third_weight=self.third_weight * weights,
        )


@dataclass(frozen=True)
class Prior:
    """What is known of the parameters beforehand: mean and standard deviation, (N_PARAMETERS,) each.

    inf: nothing; 0: the parameter stays where it is.
    """

    mean: Floats
    sd: Floats


def whitening_factor(covariance: Floats) -> Floats:
    """Lower factor of the inverse of each (..., 2, 2) covariance."""
    return np.asarray(np.linalg.cholesky(np.linalg.inv(covariance)))


def predicted_ratio(parameters: Floats, data: RatioData) -> Complexes:
    """Equation (1): rho for parameters (B, N_PARAMETERS), shape (B, n)."""
    return predicted(parameters, data)[0]


def predicted(parameters: Floats, data: RatioData) -> tuple[Complexes, Floats]:
    """Equation (1), and the third harmonic beyond the waveform, for parameters (B, N_PARAMETERS), each (B, n)."""
    distortion, lag_square, third_order = (parameters[..., k, np.newaxis] for k in (2, 4, 5))
    own = ratio_of_light(parameters, data)
    share = np.minimum(np.abs(own) ** 2, _LARGEST_SQUARE)
    ratio = own * low_pass_factor(share, data.angular**2 * lag_square)
    ratio = ratio + distortion * data.amplitude * (1 - share - 2j * own * own.imag)
    size = third_order * data.amplitude**2
    ratio = ratio + size * by_cubic_law(own)
    third = size * third_harmonic_share(share) + (own**2 * _third_by_low_pass(data.angular**2 * lag_square)).real
    return np.asarray(ratio), np.asarray(third)


def ratio_of_light(parameters: Floats, data: RatioData) -> Complexes:
    """rho0 of equation (1), before the receiver, for parameters (B, N_PARAMETERS), shape (B, n)."""
    fast, slowness = _of_fast_gain(parameters, data)
    gain, turn = gain_factors(fast, slowness)
    return np.asarray(fast * gain * turn)


def _of_fast_gain(parameters: Floats, data: RatioData) -> tuple[Complexes, Floats]:
    """q of equation (1), and 2 pi f T, (B, n)."""
    z = (parameters[..., 0] + 1j * parameters[..., 1])[..., np.newaxis]
    gain_time, square = parameters[..., 3, np.newaxis], np.abs(z) ** 2
    if data.reference == "beat":
        per_rate = 1 / (data.beat_rate + np.sqrt(data.beat_rate**2 + square))
    else:
        # Below the threshold there is no beat; r stays 1 there, so that the fit can find its way out.
        rate = np.maximum(np.abs(data.rate), np.sqrt(square))
        per_rate = 1 / (rate + np.sqrt((rate - np.sqrt(square)) * (rate + np.sqrt(square))))
    fast = np.where(data.rate > 0, -z, np.conj(z)) * per_rate
    return np.asarray(fast), np.asarray(data.angular * gain_time)


_LARGEST_SQUARE = 0.99


def gain_factors(fast_ratio: Complexes, slowness: Floats) -> tuple[Complexes, Complexes]:
    """What slow gain makes of the ratio q that a laser with fast gain has: G and |c|/c of equation (1).

    With F = 1/(1 + i w T) and q e^(...) of size r, the lines of the beat stay a geometric series, of ratio p = r G
    with |p|/(1 + |p|^2) = |F| r/(1 + r^2) and the phase of F. Its image makes the fundamental
    c = (1 - r^2 G)^2 + q^2 (1 - G)^2.
    """
    square = np.abs(fast_ratio) ** 2
    follow = 1 / (1 + 1j * slowness)
    steepness = 4 * square * np.abs(follow) ** 2 / (1 + square) ** 2
    gain = follow * 2 / ((1 + square) * (1 + np.sqrt(np.maximum(1 - steepness, 0.0))))
    fundamental = (1 - square * gain) ** 2 + (fast_ratio * (1 - gain)) ** 2
    size = np.abs(fundamental)
    # At the threshold there is no fundamental left to turn.
    turn = np.where(size > 0, size / np.where(size > 0, fundamental, 1.0), 1.0)
    return np.asarray(gain), np.asarray(turn)


def low_pass_factor(square: Floats, lag: Floats) -> Complexes:
    """What one pole makes of rho: H(2f) |H(f)|/H(f)^2, close to lock-in that of the nearest geometric series."""
    size, rest = np.abs(lag), 1 - square
    x = np.sqrt(size)
    weaker = 0.5 * np.log((1 + size) / (1 + 4 * size)) * (3 + square) / (3 * rest)
    moments = (7 + 10 * square + square**2) / rest**2
    of_first = (1 + 4 * square + square**2 - square * (7 + 10 * square + square**2)) / rest**3
    later = (2 * np.arctan(x) - np.arctan(2 * x)) * (moments - of_first) / 6
    return np.asarray(np.exp(np.sign(lag) * (weaker + 1j * later)))


def by_cubic_law(own: Complexes) -> Complexes:
    """What a cubic law adds to rho0, over H, to first order: the last bracket of equation (1)."""
    share = np.minimum(np.abs(own) ** 2, _LARGEST_SQUARE)
    return np.asarray(2j * own * (own**2).imag - (1 - share) * np.conj(own))


def beyond_first_order(parameters: Floats, data: RatioData) -> tuple[Complexes, Floats]:
    """What a cubic law adds to the ratio and to the third harmonic beside what (1) says of it.

    (1) is of first order in H, and takes the light to be as large at every phase of the beat. Slow gain leaves it
    to wink: with q e^(...) of size r, the light of the fringes is (z - r)^2/[(1 - p z)(z - p*)], p = r G, and the
    cube of what the receiver sees of it has three times the winking in its fundamental.

    The lines d_n of the distorted signal come from one period of it. With D(w) = sum d_n w^(n-1), the geometric
    series nearest to them has the ratio w* where (1 - |w|^2) |D(w)|^2 is largest, D'/D = w*/(1 - |w|^2), and the
    fundamental (1 - |w|^2) D(w).
    """
    fast, slowness = _of_fast_gain(parameters, data)
    gain, turn = gain_factors(fast, slowness)
    own = fast * gain * turn
    size = parameters[..., 5, np.newaxis] * data.amplitude**2
    possible = (np.abs(own) > _SMALLEST) & (np.abs(fast) < _LARGEST)
    fast, gain, own = np.where(possible, (fast, gain, own), np.array([0.5, 1.0, 0.5])[:, np.newaxis, np.newaxis])
    distorted = _distorted(fast, gain, own, size)
    w = np.conj(own)
    for _ in range(_ROUNDS):
        value, slope = _polynomial(distorted, w)
        w = w + (1 - np.abs(own) ** 2) * (np.conj(slope * (1 - np.abs(w) ** 2) / value) - w)
    value, _ = _polynomial(distorted, w)
    turned = np.abs(value) / value
    ratio = np.conj(w) * turned - own - size * by_cubic_law(own)
    left = distorted[..., 2] - (1 - np.abs(w) ** 2) * value * np.conj(w) ** 2
    third = (left * turned**3).real / np.abs(value) - size * third_harmonic_share(np.abs(own) ** 2)
    return np.where(possible, ratio, 0.0), np.where(possible, third, 0.0)


_SMALLEST, _LARGEST = 1e-8, 0.95
"""Ratios between which a cubic law is worked out."""

_PHASES, _ROUNDS = 512, 6


def _distorted(fast: Complexes, gain: Complexes, own: Complexes, third_order: Floats) -> Complexes:
    """Lines (..., L) of the beat behind a cubic law, its amplitude 1 and its fundamental real before it."""
    square, rest = np.abs(fast) ** 2, 1 - np.abs(own) ** 2
    image = (1 - square * gain) ** 2 + (fast * (1 - gain)) ** 2
    constant = (np.conj(fast) * (square * gain + np.conj(gain) - 2)).real * rest / np.abs(image)
    phases = np.exp(2j * np.pi * np.arange(_PHASES) / _PHASES)
    pole = 1 - own[..., np.newaxis] * phases
    signal = constant[..., np.newaxis] + (rest[..., np.newaxis] * phases / pole).real
    cubic = (third_order / (1 - 3 * third_order))[..., np.newaxis]
    signal = (signal + 4 * cubic * signal**3) / (1 + 3 * cubic)
    return np.asarray(2 / _PHASES * np.fft.rfft(signal)[..., 1:-1])


def _polynomial(lines: Complexes, w: Complexes) -> tuple[Complexes, Complexes]:
    """Sum of d_n w^(n-1), and its derivative."""
    orders = np.arange(lines.shape[-1])
    powers = w[..., np.newaxis] ** orders
    return np.vecdot(np.conj(lines), powers), np.vecdot(np.conj(lines[..., 1:]), orders[1:] * powers[..., :-1])


def third_harmonic_share(square: Floats) -> Floats:
    """Third harmonic that third-order distortion leaves beyond the nearest geometric series, over H; of r^2.

    With Y the beat as a function of its phase, the distortion is H Re Y^3 and what is left of it H (1 - r^2) s
    Y^2/(1 - q s), whose third coefficient this is.
    """
    rest = 1 - square
    return np.asarray(rest * (rest**2 - 4 * rest * square + square**2))


def third_order_by_third_harmonic(parameters: Floats, data: RatioData) -> tuple[float, float]:
    """H by the third harmonics of the points alone, and its standard uncertainty, inf where they are not known."""
    share = third_harmonic_share(np.abs(ratio_of_light(parameters, data)) ** 2) * data.amplitude**2
    weight = data.third_weight**2
    power = float(np.sum(weight * share**2))
    return (float(np.sum(weight * share * data.third)) / power, power**-0.5) if power > 0 else (0.0, np.inf)


def _third_by_low_pass(lag: Floats) -> Complexes:
    """What one pole leaves at the third harmonic, over rho^2: H(3f) H(f)/H(2f)^2 - 1."""
    x = 1j * np.sqrt(np.abs(lag))
    return np.asarray(np.sign(lag) * ((1 + 2 * x) ** 2 / ((1 + 3 * x) * (1 + x)) - 1))
