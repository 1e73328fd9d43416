"""The complex harmonic ratio as a function of rate: lock-in, laser and receiver; its least squares.

    rho = L {rho0 + D a [1 - r^2 - 2i rho0 Im rho0] + H a^2 [2i rho0 Im rho0^2 - (1 - r^2) rho0*]}     (1)
    rho0 = q G |c|/c,     q = -r e^(+i b)  W > 0,     q = +r e^(-i b)  W < 0

A mirror that moves by a tenth of a micrometre turns b by radians, and WL drifts as a laser warms up. So
b = b0 + s/2 in the positive sense, b0 - s/2 in the negative one, and with t the place of a record in its run, from
-1/2 to 1/2,

    b0 = b00 + d1 t + d2 (6 t^2 - 1/2),     WL = WL0 (1 + v t)                                          (2)

r harmonic ratio of the lock-in equation, b backscatter phase less readout phase, a amplitude of the record, before
the pole of L, over the mean of all. D and H, second- and third-order distortion of the receiver: the second and
third harmonic that it makes of a pure sine of that mean amplitude, over its fundamental. The brackets are what a
square and a cubic law make of the ratio of the geometric series that fits the distorted signal best, to first
order in D and H (docs/several_rates.md); `beyond_first_order` has the rest.

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

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from analysis.arrays import Bools, Complexes, Floats, Indices, Stacked
from analysis.budget import (
    LOCK_IN_DRIFT_LIMIT,
    PHASE_CHANGE_LIMIT,
    PROBE_HZ,
    SECOND_ORDER_LIMIT,
    THIRD_ORDER_LIMIT,
    BenchKnowledge,
    lowest_bandwidth,
    lowest_gain_corner,
)

Reference = Literal["rate", "beat"]

N_PARAMETERS = 10  # Re z, Im z (deg/s), D, T (s), P (s^2), H, s, d1, d2 (rad), v

SENSES, PHASES, DRIFT = 6, slice(6, 9), 9
"""The phase between the senses, all phases that may change, the drift of WL."""


@dataclass(frozen=True)
class RatioData:
    """Complex ratios of B sets of n points each; all fields broadcast to (B, n)."""

    rate: Floats  # deg/s, signed; with reference "beat" only its sign is used
    beat_rate: Floats  # deg/s, f/K
    angular: Floats  # rad/s, 2 pi f
    ratio: Complexes  # rho
    whitening: Floats  # (B, n, 2, 2) lower factor C with C C^T = inverse covariance; zero leaves a point out
    amplitude: Floats  # of the point, over that to which D and H refer
    when: Floats  # place in the run, from -1/2 to 1/2; 0 of all where nobody knows it
    # third harmonic beyond the waveform in phase with distortion, over the amplitude, and the reciprocal of its
    # standard uncertainty, 0 where it is not known
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

    def take(self, sets: Indices) -> RatioData:
        """Some of the sets."""
        axes = {name: 4 if name == "whitening" else 2 for name in vars(self)}
        own = {name: v[sets] for name, v in vars(self).items() if np.ndim(v) == axes[name] and len(v) > 1}
        return replace(self, **own)


@dataclass(frozen=True)
class Prior:
    """What is known of the parameters beforehand: mean and standard deviation, (N_PARAMETERS,) each."""

    # inf: nothing; 0: the parameter stays where it is.

    mean: Floats
    sd: Floats

    def seen_by(self, data: RatioData) -> Prior:
        """Without what these data cannot see: a phase between senses in one, drifts where no order is known."""
        rate, when = data.rate, data.when
        seen = np.ones(N_PARAMETERS, dtype=bool)
        seen[SENSES] = bool(np.any(rate > 0) and np.any(rate < 0))
        seen[SENSES + 1 :] = bool(np.ptp(when) > 0)
        return Prior(self.mean, np.where(seen, self.sd, 0.0))


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
    lag = data.angular**2 * lag_square
    amplitude = data.amplitude * np.sqrt(1 + np.maximum(lag, 0.0))  # before the pole
    size = third_order * amplitude**2
    cubic = 2j * own * (own**2).imag - (1 - share) * np.conj(own)
    distorted = own + distortion * amplitude * (1 - share - 2j * own * own.imag) + size * cubic
    ratio = distorted * low_pass_factor(share, lag)
    x = 1j * np.sqrt(np.abs(lag))
    passed = (1 + x) ** 3 / ((1 + 3 * x) * np.abs(1 + x) ** 2)
    third = (
        size * third_harmonic_share(share) * np.asarray(np.where(lag < 0, 2 - passed, passed))
        + own**2 * np.sign(lag) * ((1 + 2 * x) ** 2 / ((1 + 3 * x) * (1 + x)) - 1)
    ).real
    return np.asarray(ratio), np.asarray(third)


def ratio_of_light(parameters: Floats, data: RatioData) -> Complexes:
    """rho0 of equation (1), before the receiver, for parameters (B, N_PARAMETERS), shape (B, n)."""
    fast, slowness = _of_fast_gain(parameters, data)
    gain, turn = gain_factors(fast, slowness)
    return np.asarray(fast * gain * turn)


def _of_fast_gain(parameters: Floats, data: RatioData) -> tuple[Complexes, Floats]:
    """q of equation (1), and 2 pi f T, (B, n)."""
    z, gain_time = lock_in_at(parameters, data), parameters[..., 3, np.newaxis]
    square = np.abs(z) ** 2
    if data.reference == "beat":
        per_rate = 1 / (data.beat_rate + np.sqrt(data.beat_rate**2 + square))
    else:
        # Below the threshold there is no beat; r stays 1 there, so that the fit can find its way out.
        rate = np.maximum(np.abs(data.rate), np.sqrt(square))
        per_rate = 1 / (rate + np.sqrt((rate - np.sqrt(square)) * (rate + np.sqrt(square))))
    fast = np.where(data.rate > 0, -z, np.conj(z)) * per_rate
    return np.asarray(fast), np.asarray(data.angular * gain_time)


def lock_in_at(parameters: Floats, data: RatioData) -> Complexes:
    """WL e^(i b) at every point, equation (2), but for the conjugate of the negative sense: (B, n), deg/s."""
    z = (parameters[..., 0] + 1j * parameters[..., 1])[..., np.newaxis]
    between, even, bent, drift = (parameters[..., k, np.newaxis] for k in range(6, N_PARAMETERS))
    turned = between * np.sign(data.rate) / 2 + even * data.when + bent * (6 * data.when**2 - 0.5)
    return np.asarray(z * (1 + drift * data.when) * np.exp(1j * turned))


_LARGEST_SQUARE = 0.99


def gain_factors(fast_ratio: Complexes, slowness: Floats) -> tuple[Complexes, Complexes]:
    """What slow gain makes of the ratio q that a laser with fast gain has: G and |c|/c of equation (1)."""
    # With F = 1/(1 + i w T) and q e^(...) of size r, the lines of the beat stay a geometric series, of ratio p = r
    # G with |p|/(1 + |p|^2) = |F| r/(1 + r^2) and the phase of F. Its image makes the fundamental c = (1 - r^2
    # G)^2 + q^2 (1 - G)^2.
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


def beyond_first_order(parameters: Floats, data: RatioData) -> tuple[Complexes, Floats]:
    """What distortion and pole make of the ratio and of the third harmonic beside what (1) says of it."""
    # (1) is of first order in D, H and P, and takes the light to be as large at every phase of the beat. Slow gain
    # leaves it to wink: with q e^(...) of size r the light of the fringes is (z - r)^2/[(1 - p z)(z - p*)], p = r
    # G, and the cube of what the receiver sees has three times the winking in its fundamental.
    # The lines d_n of the distorted signal come from one period of it. With D(w) = sum d_n w^(n-1), the geometric
    # series nearest to them has the ratio w* where (1 - |w|^2) |D(w)|^2 is largest, D'/D = w*/(1 - |w|^2), and the
    # fundamental (1 - |w|^2) D(w).
    parameters = np.where(np.arange(N_PARAMETERS) == 4, np.maximum(parameters, 0.0), parameters)
    fast, slowness = _of_fast_gain(parameters, data)
    gain, turn = gain_factors(fast, slowness)
    own = fast * gain * turn
    possible = (np.abs(own) > _SMALLEST) & (np.abs(fast) < _LARGEST)
    fast, gain, own = np.where(possible, (fast, gain, own), np.array([0.5, 1.0, 0.5])[:, np.newaxis, np.newaxis])
    x = data.angular * np.sqrt(parameters[..., 4, np.newaxis])
    amplitude = data.amplitude * np.hypot(1.0, x)
    second, third = parameters[..., 2, np.newaxis] * amplitude, parameters[..., 5, np.newaxis] * amplitude**2
    lines = _distorted(fast, gain, own, second, third)
    lines = lines / (1 + 1j * x[..., np.newaxis] * np.arange(1, lines.shape[-1] + 1))
    w, value = nearest_series(lines, np.conj(own))
    turned = np.abs(value) / value
    left = lines[..., 2] - (1 - np.abs(w) ** 2) * value * np.conj(w) ** 2
    ratio, rest = predicted(parameters, data)
    ratio, rest = np.conj(w) * turned - ratio, (left * turned**3).real / np.abs(value) - rest
    return np.where(possible, ratio, 0.0), np.where(possible, rest, 0.0)


def nearest_series(lines: Complexes, start: Complexes, rounds: int = 9) -> tuple[Complexes, Complexes]:
    """Ratio w of the geometric series nearest to lines (..., L), from a start, and the sum of d_n w^(n-1)."""
    w, rest, turned = start, 1 - np.abs(start) ** 2, np.conj(lines)
    for _ in range(rounds):
        value, slope = _polynomial(turned, w)
        step = rest * (np.conj(slope * (1 - np.abs(w) ** 2) / value) - w)
        w = w + step
        if np.all(np.abs(step) < _ROUNDING):
            break
    return w, _polynomial(turned, w)[0]


_SMALLEST, _LARGEST = 1e-8, 0.95  # ratios between which a cubic law is worked out

_PHASES = 512
_ROUNDING = 1e-14  # a step that changes a ratio by less was the last one


def _distorted(
    fast: Complexes, gain: Complexes, own: Complexes, second_order: Floats, third_order: Floats
) -> Complexes:
    """Lines (..., L) of the beat behind a curved law, its amplitude 1 and its fundamental real before it."""
    square, rest = np.abs(fast) ** 2, 1 - np.abs(own) ** 2
    image = (1 - square * gain) ** 2 + (fast * (1 - gain)) ** 2
    constant = (np.conj(fast) * (square * gain + np.conj(gain) - 2)).real * rest / np.abs(image)
    phases = np.exp(2j * np.pi * np.arange(_PHASES) / _PHASES)
    pole = 1 - own[..., np.newaxis] * phases
    signal = constant[..., np.newaxis] + (rest[..., np.newaxis] * phases / pole).real
    cubic = (third_order / (1 - 3 * third_order))[..., np.newaxis]
    signal = (signal + 4 * cubic * signal**3) / (1 + 3 * cubic) + 2 * second_order[..., np.newaxis] * signal**2
    return np.asarray(2 / _PHASES * np.fft.rfft(signal)[..., 1:-1])


def _polynomial(turned: Complexes, w: Complexes) -> tuple[Complexes, Complexes]:
    """Sum of d_n w^(n-1), and its derivative, of conjugate lines."""
    factors = np.empty(turned.shape, np.complex128)
    factors[..., 0], factors[..., 1:] = 1.0, w[..., np.newaxis]
    powers = np.cumprod(factors, axis=-1)
    orders = np.arange(1, turned.shape[-1])
    return np.vecdot(turned, powers), np.vecdot(turned[..., 1:], orders * powers[..., :-1])


def third_harmonic_share(square: Floats) -> Floats:
    """Third harmonic that third-order distortion leaves beyond the nearest geometric series, over H; of r^2."""
    # With Y the beat as a function of its phase, the distortion is H Re Y^3 and what is left of it H (1 - r^2) s
    # Y^2/(1 - q s), whose third coefficient this is.
    rest = 1 - square
    return np.asarray(rest * (rest**2 - 4 * rest * square + square**2))


def third_order_by_third_harmonic(parameters: Floats, data: RatioData) -> tuple[float, float]:
    """H by the third harmonics of the points alone, and its standard uncertainty, inf where they are not known."""
    share = third_harmonic_share(np.abs(ratio_of_light(parameters, data)) ** 2) * data.amplitude**2
    weight = data.third_weight**2
    power = float(np.sum(weight * share**2))
    return (float(np.sum(weight * share * data.third)) / power, power**-0.5) if power > 0 else (0.0, np.inf)


# --------------------
# Weighted least squares of equation (1) of `ratio_model`, with what is known beforehand as further data


ITERATIONS = 80
SETTLED = 1e-10  # a step that changes chi-square by less, relatively, was the last one

SINGULAR = 1e-11
"""A normal matrix (unit diagonal) with a smaller eigenvalue means unknowns that the data cannot tell apart."""

_RATIOS = np.geomspace(0.004, 0.93, 22)
_START_PHASES = np.arange(24) * (2 * np.pi / 24)
_GAIN_TIMES = np.array([-1.0, 0.0, 1.0, 3.0])
"""Sizes of r at the slowest rate, phases, and gain times (over the time of the fastest beat) from which the best
starts are taken."""

_BESIDE = np.array([0.92, 0.97, 1.03, 1.08])
"""Lock-in rates over those found first, from which a second minimum close by is looked for."""

_FIRST_ITERATIONS, _FINISHED = 15, 5  # all starts go a little way, the best of them to the end

_NO_WAY_DOWN = 1e5  # damping with which a step that still does not go down ends the search

_CLOSE = 1e-3
_LARGEST_STEP = 0.999  # the slowest rate with a beat is faster than the lock-in rate by at least this share


@dataclass(frozen=True)
class RatioFit(Stacked):
    """parameters (B, P) and covariance (B, P, P), zero where held; chi_square (B,), what is known beforehand
    included; singular (B,).
    """

    parameters: Floats
    covariance: Floats
    chi_square: Floats
    singular: Bools


def fit_ratios(data: RatioData, prior: Prior, start: Floats) -> RatioFit:
    """Weighted least squares for every set, from a start for each."""
    return _minimised(data, prior, np.array(start, dtype=np.float64), ITERATIONS)


def _minimised(data: RatioData, prior: Prior, point: Floats, iterations: int) -> RatioFit:
    """Damped Gauss-Newton."""
    found = _linearised(point, data, prior)
    live, damping = np.arange(len(point)), np.full(len(point), 1e-4)
    for _ in range(iterations):
        here, some = found.take(live), data.take(live)
        ridge = damping[live, np.newaxis, np.newaxis] * np.eye(here.ways.shape[1])
        step = here.unit * np.linalg.solve(here.normal + ridge, here.gradient[..., np.newaxis])[..., 0]
        moved = here.point + np.einsum("bw,bwp->bp", step, here.ways)
        trial = _linearised(_bounded(moved, some), some, prior)
        better = trial.cost <= here.cost
        settled = np.abs(here.cost - trial.cost) <= SETTLED * (1 + here.cost)
        settled |= ~better & (damping[live] >= _NO_WAY_DOWN)
        found.put(live[better], trial.take(better))
        softer, harder = np.maximum(damping[live] * 0.2, 1e-13), np.minimum(damping[live] * 8, 1e6)
        damping[live] = np.where(better, softer, harder)
        live = live[~settled]
        if not live.size:
            break
    eigenvalues, vectors = np.linalg.eigh(found.normal)
    inverse = np.einsum("bij,bj,bkj->bik", vectors, 1 / np.maximum(eigenvalues, 1e-15), vectors)
    inverse = inverse * found.unit[:, :, np.newaxis] * found.unit[:, np.newaxis, :]
    covariance = np.einsum("bvp,bvw,bwq->bpq", found.ways, inverse, found.ways)
    return RatioFit(found.point, covariance, found.cost, eigenvalues[:, 0] < SINGULAR)


@dataclass(frozen=True)
class _Linearised(Stacked):
    """Chi-square about points (B, N_PARAMETERS): its value and slope, see `_linearised`."""

    point: Floats
    ways: Floats
    cost: Floats
    normal: Floats
    gradient: Floats
    unit: Floats


def all_solutions(data: RatioData, prior: Prior) -> RatioFit:
    """Every minimum that is found from many starts, for one set of data; the best first."""
    # Lock-in rate and phase are tried on a grid, and the gain time where it is free, with the best distortion for
    # each; the lowest points of that map are the starts.
    tried = _minimised(data, prior, _starts(data, prior), _FIRST_ITERATIONS)
    tried = _apart(tried, np.zeros(len(tried.chi_square))).take(slice(_FINISHED))
    starts = np.repeat(tried.parameters, _BESIDE.size, axis=0)
    starts[:, :2] *= np.tile(_BESIDE, len(tried.parameters))[:, np.newaxis]
    near = _minimised(data, prior, _bounded(with_distortion_alone(starts, data, prior), data), _FIRST_ITERATIONS)
    both = RatioFit.joined([tried, near])
    tried = _apart(both, np.zeros(len(both.chi_square))).take(slice(_FINISHED))
    found = fit_ratios(data, prior, tried.parameters)
    return _apart(found, 0.5 * np.sqrt(np.trace(found.covariance[:, :2, :2], axis1=-2, axis2=-1)))


def _apart(found: RatioFit, u: Floats) -> RatioFit:
    """Those that are not one minimum found twice, within `u` (B,) of their lock-in rates; the best first."""
    z = found.parameters[:, 0] + 1j * found.parameters[:, 1]
    kept: list[int] = []
    for row in np.argsort(found.chi_square):
        if not np.any(np.abs(z[kept] - z[row]) < _CLOSE * np.abs(z[row]) + u[row]):
            kept.append(int(row))
    return found.take(np.array(kept))


def whitened(parameters: Floats, data: RatioData) -> tuple[Floats, Floats]:
    """What the model leaves in standard uncertainties: of the ratios (B, n, 2), of the third harmonics (B, n)."""
    ratio, third = predicted(parameters, data)
    return in_standard_uncertainties(data.ratio - ratio, data.third - third, data)


def in_standard_uncertainties(ratio: Complexes, third: Floats, data: RatioData) -> tuple[Floats, Floats]:
    """Differences of ratios and of third harmonics (B, n) in their standard uncertainties, as :func:`whitened`."""
    factor, imaginary = data.whitening, ratio.imag
    along = factor[..., 0, 0] * ratio.real + factor[..., 1, 0] * imaginary
    return np.stack([along, factor[..., 1, 1] * imaginary], axis=-1), third * data.third_weight


def residual(parameters: Floats, data: RatioData, prior: Prior) -> Floats:
    """Whitened residuals of ratios, third harmonics and of what is known beforehand, (B, 3n + known)."""
    ratios, thirds = whitened(parameters, data)
    known = np.isfinite(prior.sd) & (prior.sd > 0)
    before = (prior.mean[known] - parameters[..., known]) / prior.sd[known]
    return np.concatenate([ratios.reshape(*ratios.shape[:-2], -1), thirds, before], axis=-1)


def _bounded(point: Floats, data: RatioData) -> Floats:
    """The same with the lock-in rate below the slowest rate that shows a beat."""
    there = np.abs(data.whitening).sum(axis=(-1, -2)) > 0
    # a beat f belongs to the rate W with (f/K)^2 = W^2 - WL^2
    by_beat = data.reference == "beat"
    rate = data.beat_rate / np.sqrt(1 - _LARGEST_STEP**2) if by_beat else np.abs(data.rate)
    slowest = np.where(there, rate, np.inf).min(axis=-1)
    size = np.maximum(np.hypot(point[:, 0], point[:, 1]), 1e-300)
    bounded = point.copy()
    bounded[:, :2] *= (np.minimum(size, _LARGEST_STEP * slowest) / size)[:, np.newaxis]
    return bounded


def _linearised(point: Floats, data: RatioData, prior: Prior) -> _Linearised:
    """Normal matrix scaled to a unit diagonal, gradient in the same units, and the units (B, ways)."""
    # change of each parameter that changes rho of the slowest point by about one
    slowest, fastest = float(np.min(data.beat_rate)), float(np.max(data.angular))
    scale = np.array([slowest, slowest, 1.0, 1 / fastest, 1 / fastest**2, 1.0, 1.0, 1.0, 1.0, 1.0])
    ways = np.repeat(np.diag(scale)[np.flatnonzero(prior.sd > 0), np.newaxis], len(point), axis=1)
    shift = 1e-5 * ways
    both = residual(np.concatenate([point - shift, point + shift, point[np.newaxis]]), data, prior)
    jacobian = np.moveaxis(both[: len(ways)] - both[len(ways) : -1], 0, -1) / 2e-5
    size = np.linalg.norm(jacobian, axis=1)
    size = np.where(size > 0, size, 1.0)
    jacobian = jacobian / size[:, np.newaxis, :]
    normal = jacobian.swapaxes(-1, -2) @ jacobian
    gradient = np.einsum("bnp,bn->bp", jacobian, both[-1])
    return _Linearised(point, ways.swapaxes(0, 1), np.sum(both[-1] ** 2, axis=-1), normal, gradient, 1 / size)


def _starts(data: RatioData, prior: Prior) -> Floats:
    """The lowest points of a map of chi-square over lock-in rate and phase, (S, N_PARAMETERS)."""
    slowest = float(np.min(np.abs(data.rate) if data.reference == "rate" else data.beat_rate))
    square = _RATIOS**2
    sizes = slowest * 2 * _RATIOS / (1 + square if data.reference == "rate" else 1 - square)
    times = _GAIN_TIMES / np.max(data.angular) if prior.sd[3] > 0 else np.array([prior.mean[3]])
    size, phase, time = np.meshgrid(sizes, _START_PHASES, times, indexing="ij")
    grid = np.tile(np.where(prior.sd > 0, prior.mean, 0.0), (*size.shape, 1))
    grid[..., 0], grid[..., 1], grid[..., 3] = size * np.cos(phase), size * np.sin(phase), time
    flat = grid.reshape(-1, N_PARAMETERS)
    if prior.sd[2] > 0:
        flat[:, 2] = _best_distortion(flat, data, prior)
    cost = np.asarray(np.sum(residual(flat, data, prior) ** 2, axis=-1)).reshape(size.shape)
    best = cost.argmin(axis=-1)
    lowest = np.take_along_axis(cost, best[..., np.newaxis], axis=-1)[..., 0]
    # a valley may be narrower than the steps of the map: the best phase of every size is a start too
    chosen = lowest == lowest.min(axis=1, keepdims=True)
    edged = np.pad(lowest, ((1, 1), (0, 0)), constant_values=np.inf)
    around = [np.roll(edged, (i, j), axis=(0, 1))[1:-1] for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    chosen |= lowest <= np.min(around, axis=0)
    sizes_chosen, phases_chosen = np.nonzero(chosen)
    starts = flat.reshape(*size.shape, -1)[sizes_chosen, phases_chosen, best[chosen]]
    return np.asarray(starts)


def with_distortion_alone(points: Floats, data: RatioData, prior: Prior) -> Floats:
    """The same lock-in rates and phases (B, N_PARAMETERS), with the best distortion for each and nothing else."""
    alone = points.copy()
    alone[:, 2:] = np.where(prior.sd > 0, prior.mean, points)[:, 2:]
    if prior.sd[2] > 0:
        alone[:, 2] = _best_distortion(alone, data, prior)
    return alone


def _best_distortion(points: Floats, data: RatioData, prior: Prior) -> Floats:
    """D for every point of a grid, the other parameters given: the model is linear in it."""
    with_one = points.copy()
    with_one[:, 2] = 1.0
    at_zero = residual(points, data, prior)
    column = at_zero - residual(with_one, data, prior)
    return np.asarray(np.vecdot(column, at_zero) / np.maximum(np.vecdot(column, column), 1e-300))


# --------------------
# What is known of receiver and laser before a fit over several rates: bounds where nobody said anything


_RECTANGLE = math.sqrt(3.0)

WEAK = 3.0
"""Distortion that nobody stated is fitted freely: it is looked for within this many times the usual bound, which
matters only where the records themselves cannot tell it."""


def prior_of(bench: BenchKnowledge, slowest_beat_hz: float) -> Prior:
    """Mean and standard deviation of every parameter of the fit before there are data; nan: the usual bounds."""
    # Limits count as rectangular: half width over the root of three.
    mean, sd = np.zeros(N_PARAMETERS), np.full(N_PARAMETERS, np.inf)
    second = math.nan if "distortion" in bench.separated else bench.distortion_limit
    sd[2] = WEAK * SECOND_ORDER_LIMIT if math.isnan(second) else second / _RECTANGLE
    gain, corner = bench.gain, bench.bandwidth
    # with an uncertainty it is a value, without one it is the lowest that is possible
    longest = _time(lowest_gain_corner(slowest_beat_hz) if math.isnan(gain.hz) else gain.hz)
    sd[3] = longest / _RECTANGLE
    if gain.u_hz > 0 and not math.isnan(gain.hz):
        mean[3], sd[3] = longest, longest * gain.u_hz / gain.hz
    lag_square = _time(lowest_bandwidth(slowest_beat_hz) if math.isnan(corner.hz) else corner.hz) ** 2
    by_pole = lag_square / _RECTANGLE
    if corner.corrected and math.isfinite(corner.hz):
        by_pole = 2 * lag_square * corner.u_hz / corner.hz
    # far below its corner a probe that is off by a share e does what a pole of tau^2 = 2 e tau_probe^2 does
    sd[4] = math.hypot(by_pole, 2 * bench.probe_limit * _time(PROBE_HZ) ** 2 / _RECTANGLE)
    for places, stated, usual in (
        (5, bench.third_order_limit, THIRD_ORDER_LIMIT),
        (PHASES, bench.phase_change_limit, PHASE_CHANGE_LIMIT),
        (DRIFT, bench.lock_in_drift_limit, LOCK_IN_DRIFT_LIMIT),
    ):
        sd[places] = (usual if math.isnan(stated) else stated) / _RECTANGLE
    return Prior(mean, sd)


def _time(corner_hz: float) -> float:
    """Time constant of a corner, s."""
    return 0.0 if corner_hz == math.inf else 1 / (2 * math.pi * corner_hz)
