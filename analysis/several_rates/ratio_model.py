"""The complex harmonic ratio as a function of rate, and its weighted fit to many records at once.

    rho = rho0 + D [1 - r^2 - 2i rho0 Im rho0],    rho0 = q G |c|/c                          (1)
    q = -r e^(+i b)  W > 0,     q = +r e^(-i b)  W < 0

r harmonic ratio of the lock-in equation, b backscatter phase less readout phase, D second-order distortion of the
receiver (its second harmonic over the fundamental of a pure sine of the same amplitude). The bracket is 1 far
above lock-in: it is what a square law makes of the whole series of harmonics, to first order in D.

G and c are what the time T = 1/g_c does that the gain needs to follow the intensity: 1 for fast gain, and F =
1/(1 + 2 pi i f T) and 1 far above lock-in. `gain_factors` has them at any rate: with equal backscatter of both
beams and no phase between them, the equations of a two-mode laser have an exact solution (docs/several_rates.md).

Fitted in the real and imaginary part of z = WL e^(i b), which are without a singular point at WL = 0, in D and T.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from analysis.arrays import Bools, Complexes, Floats, Indices

Reference = Literal["rate", "beat"]

N_PARAMETERS = 4
"""Re z, Im z (deg/s), D, T (s)."""

ITERATIONS = 60
SINGULAR = 1e-11
"""A normal matrix (unit diagonal) with a smaller eigenvalue means unknowns that the data cannot tell apart."""


@dataclass(frozen=True)
class RatioData:
    """Complex ratios of B sets of n records each; all fields broadcast to (B, n).

    rate : deg/s, signed; with reference "beat" only its sign is used
    beat_rate : deg/s, f/K
    angular : rad/s, 2 pi f
    ratio : rho
    whitening : (B, n, 2, 2) lower factor C with C C^T = inverse covariance; zero leaves a record out
    amplitude : of the record, over that to which D refers
    """

    rate: Floats
    beat_rate: Floats
    angular: Floats
    ratio: Complexes
    whitening: Floats
    amplitude: Floats
    reference: Reference

    def weighted(self, weights: Floats) -> RatioData:
        """The data with weights (B, n) of 1 or 0: several selections of one set, fitted side by side."""
        return replace(self, whitening=self.whitening * np.sqrt(weights)[..., np.newaxis, np.newaxis])


@dataclass(frozen=True)
class RatioFit:
    """parameters (B, 4) and covariance (B, 4, 4), zero where held; chi_square (B,); singular (B,)."""

    parameters: Floats
    covariance: Floats
    chi_square: Floats
    singular: Bools


def whitening_factor(covariance: Floats) -> Floats:
    """Lower factor of the inverse of each (..., 2, 2) covariance."""
    return np.asarray(np.linalg.cholesky(np.linalg.inv(covariance)))


def predicted_ratio(parameters: Floats, data: RatioData) -> Complexes:
    """Equation (1): rho for parameters (B, 4), shape (B, n)."""
    z = (parameters[..., 0] + 1j * parameters[..., 1])[..., np.newaxis]
    distortion, gain_time = parameters[..., 2, np.newaxis], parameters[..., 3, np.newaxis]
    square = np.abs(z) ** 2
    if data.reference == "beat":
        per_rate = 1 / (data.beat_rate + np.sqrt(data.beat_rate**2 + square))
    else:
        # Below the threshold there is no beat; r stays 1 there, so that the fit can find its way out.
        rate = np.maximum(np.abs(data.rate), np.sqrt(square))
        per_rate = 1 / (rate + np.sqrt((rate - np.sqrt(square)) * (rate + np.sqrt(square))))
    fast = np.where(data.rate > 0, -z, np.conj(z)) * per_rate
    gain, turn = gain_factors(fast, data.angular * gain_time)
    own = fast * gain * turn
    bracket = 1 - square * per_rate**2 - 2j * own * own.imag
    return np.asarray(own + distortion * data.amplitude * bracket)


def gain_factors(fast_ratio: Complexes, slowness: Floats) -> tuple[Complexes, Complexes]:
    """What slow gain makes of the ratio q that a laser with fast gain has: G and |c|/c of equation (1).

    With F = 1/(1 + i w T) and q e^(...) of size r, the lines of the beat stay a geometric series, of ratio p = r G
    with |p|/(1 + |p|^2) = |F| r/(1 + r^2) and the phase of F. Its image makes the fundamental
    c = (1 - r^2 G)^2 + q^2 (1 - G)^2.

    Parameters
    ----------
    fast_ratio : (...)
        q.
    slowness : (...)
        w T, of the beat's angular frequency w.
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


def fit_ratios(data: RatioData, free: tuple[bool, bool], start: Floats | None = None) -> RatioFit:
    """Weighted least squares for every set.

    Parameters
    ----------
    free : (bool, bool)
        Whether D and T are fitted; otherwise they stay at `start`, or at 0.
    start : (B, 4), optional
        Values to start from. Without it the best of a grid of T with the linear solution of the rest.
    """
    chosen = np.flatnonzero([True, True, *free])
    point = _start(data, free) if start is None else np.array(start, dtype=np.float64)
    cost = _cost(point, data)
    damping = np.full(len(point), 1e-6)
    for _ in range(ITERATIONS):
        normal, gradient, unit = _normal_equations(point, data, chosen)
        ridge = damping[:, np.newaxis, np.newaxis] * np.eye(chosen.size)
        step = np.zeros_like(point)
        step[:, chosen] = unit * np.linalg.solve(normal + ridge, gradient[..., np.newaxis])[..., 0]
        trial = point + step
        trial_cost = _cost(trial, data)
        better = trial_cost <= cost
        settled = np.where(better, cost - trial_cost <= 1e-10 * (1 + cost), damping >= 1e5)
        point, cost = np.where(better[:, np.newaxis], trial, point), np.where(better, trial_cost, cost)
        damping = np.where(better, np.maximum(damping * 0.2, 1e-13), np.minimum(damping * 8, 1e6))
        if np.all(settled):
            break
    return _finished(point, cost, data, chosen)


def _finished(point: Floats, cost: Floats, data: RatioData, chosen: Indices) -> RatioFit:
    normal, _, unit = _normal_equations(point, data, chosen)
    eigenvalues, vectors = np.linalg.eigh(normal)
    inverse = np.einsum("bij,bj,bkj->bik", vectors, 1 / np.maximum(eigenvalues, 1e-15), vectors)
    covariance = np.zeros((len(point), N_PARAMETERS, N_PARAMETERS))
    covariance[:, chosen[:, np.newaxis], chosen] = inverse * unit[:, :, np.newaxis] * unit[:, np.newaxis, :]
    return RatioFit(point, covariance, cost, eigenvalues[:, 0] < SINGULAR)


def _residual(parameters: Floats, data: RatioData) -> Floats:
    """Whitened residuals, (B, 2n)."""
    left = data.ratio - predicted_ratio(parameters, data)
    parts = np.stack([left.real, left.imag], axis=-1)
    white = np.einsum("...ji,...j->...i", data.whitening, parts)
    return np.asarray(white.reshape(*white.shape[:-2], -1))


def _cost(parameters: Floats, data: RatioData) -> Floats:
    return np.asarray(np.sum(_residual(parameters, data) ** 2, axis=-1))


def _normal_equations(point: Floats, data: RatioData, chosen: Indices) -> tuple[Floats, Floats, Floats]:
    """Normal matrix scaled to a unit diagonal, gradient in the same units, and the units (B, P)."""
    scale = _scales(data)
    columns = []
    for place in chosen:
        shift = np.zeros(N_PARAMETERS)
        shift[place] = 1e-5 * scale[place]
        columns.append((_residual(point - shift, data) - _residual(point + shift, data)) / 2e-5)
    jacobian = np.stack(columns, axis=-1)
    size = np.linalg.norm(jacobian, axis=1)
    size = np.where(size > 0, size, 1.0)
    jacobian = jacobian / size[:, np.newaxis, :]
    normal = jacobian.swapaxes(-1, -2) @ jacobian
    gradient = np.einsum("bnp,bn->bp", jacobian, _residual(point, data))
    return normal, gradient, scale[chosen] / size


def _scales(data: RatioData) -> Floats:
    """Change of each parameter that changes rho of the slowest record by about one, (4,)."""
    slowest, fastest = float(np.min(data.beat_rate)), float(np.max(data.angular))
    return np.array([slowest, slowest, 1.0, 1 / fastest])


def _start(data: RatioData, free: tuple[bool, bool]) -> Floats:
    """Linear solution for z and D, with r = WL/2W, at each T of a grid; the best of them for every set."""
    grid = np.array([0.0, 0.1, 0.3, 1.0, 3.0]) if free[1] else np.zeros(1)
    n_sets = len(data.whitening)
    best, best_cost = np.zeros((n_sets, N_PARAMETERS)), np.full(n_sets, np.inf)
    for gain_time in grid / np.max(data.angular):
        trial = _linear_solution(data, free[0], float(gain_time))
        cost = _cost(trial, data)
        lower = cost < best_cost
        best[lower], best_cost[lower] = trial[lower], cost[lower]
    return best


def _linear_solution(data: RatioData, with_distortion: bool, gain_time: float) -> Floats:
    size = data.beat_rate if data.reference == "beat" else np.abs(data.rate)
    own = 0.5 / size / (1 + 1j * data.angular * gain_time)
    positive = data.rate > 0
    columns = [np.where(positive, -own, own), -1j * own]  # of z itself, and of its conjugate
    if with_distortion:
        columns.append(np.broadcast_to(data.amplitude + 0j, own.shape))
    tangents = np.stack(np.broadcast_arrays(*columns), axis=-1)
    parts = np.stack([tangents.real, tangents.imag], axis=-2)
    white = np.einsum("...ji,...jp->...ip", data.whitening, parts)
    design = white.reshape(len(white), -1, tangents.shape[-1])
    zero = np.zeros((len(design), N_PARAMETERS))
    target = _residual(zero, data)
    normal = design.swapaxes(-1, -2) @ design
    largest = np.trace(normal, axis1=-2, axis2=-1)[:, np.newaxis, np.newaxis]
    ridge = 1e-13 * np.where(largest > 0, largest, 1.0) * np.eye(tangents.shape[-1])
    solved = np.linalg.solve(normal + ridge, np.einsum("bnp,bn->bp", design, target)[..., np.newaxis])[..., 0]
    zero[:, : tangents.shape[-1]] = solved
    zero[:, 3] = gain_time
    return zero
