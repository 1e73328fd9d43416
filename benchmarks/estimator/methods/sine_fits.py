"""Sine fits by Gauss-Newton: the four-parameter fit of IEEE Std 1057 and its extension by a second harmonic."""

from __future__ import annotations

import numpy as np
import scipy.fft

from benchmarks.estimator.methods.reading import Floats, Reading, exact

ITERATIONS = 8


def fit_two_tones(codes: Floats, rate: Floats) -> Reading:
    """A four-parameter fit for the fundamental, then a three-parameter fit of the rest at twice its frequency."""
    omega, left, first = _sine_fit(codes, peak_frequency(codes), 1)
    basis = _basis(2 * omega, codes.shape[1], 1)
    second = _solve(basis, left)
    ratio = np.hypot(second[:, 1], second[:, 2]) / np.hypot(first[:, 1], first[:, 2])
    return Reading(omega / (2 * np.pi), exact(ratio, omega / (2 * np.pi), rate))


def fit_two_harmonics(codes: Floats, rate: Floats) -> Reading:
    """Offset, two harmonics and their one frequency together."""
    omega, _, found = _sine_fit(codes, peak_frequency(codes), 2)
    ratio = np.hypot(found[:, 3], found[:, 4]) / np.hypot(found[:, 1], found[:, 2])
    return Reading(omega / (2 * np.pi), exact(ratio, omega / (2 * np.pi), rate))


def peak_frequency(codes: Floats) -> Floats:
    """The strongest line of the Hann spectrum, its fraction of a bin from the two highest bins; rad per sample."""
    n_samples = codes.shape[1]
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n_samples) / n_samples)
    height = np.abs(scipy.fft.rfft((codes - codes.mean(axis=1, keepdims=True)) * window, axis=1))
    height[:, 0] = 0.0
    rows = np.arange(len(height))
    peak = np.clip(height.argmax(axis=1), 1, height.shape[1] - 2)
    below, here, above = height[rows, peak - 1], height[rows, peak], height[rows, peak + 1]
    ratio = np.maximum(below, above) / here
    fraction = np.where(above >= below, 1, -1) * np.clip((2 * ratio - 1) / (ratio + 1), -0.5, 0.5)
    return np.asarray(2 * np.pi * (peak + fraction) / n_samples)


def _sine_fit(codes: Floats, omega: Floats, n_harmonics: int) -> tuple[Floats, Floats, Floats]:
    """Frequency, residual and coefficients (offset, cosine, sine of each harmonic)."""
    n_samples = codes.shape[1]
    index = np.arange(n_samples) - (n_samples - 1) / 2
    orders = np.arange(1, n_harmonics + 1)
    found = _solve(_basis(omega, n_samples, n_harmonics), codes)
    for _ in range(ITERATIONS):
        basis = _basis(omega, n_samples, n_harmonics)
        cosines, sines = basis[:, 1::2], basis[:, 2::2]
        a, b = found[:, 1::2, np.newaxis], found[:, 2::2, np.newaxis]
        by_omega = (orders[:, np.newaxis] * (b * cosines - a * sines)).sum(axis=1) * index
        solved = _solve(np.concatenate([basis, by_omega[:, np.newaxis]], axis=1), codes)
        found, change = solved[:, :-1], solved[:, -1]
        omega = np.clip(omega + np.clip(change, -1 / n_samples, 1 / n_samples), 1 / n_samples, np.pi)
    basis = _basis(omega, n_samples, n_harmonics)
    found = _solve(basis, codes)
    return omega, codes - np.einsum("rpn,rp->rn", basis, found), found


def _basis(omega: Floats, n_samples: int, n_harmonics: int) -> Floats:
    """1, cos(w n), sin(w n), cos(2 w n), ... with n from the middle of the record: (R, 1 + 2 harmonics, N)."""
    carrier = np.exp(1j * omega[:, np.newaxis] * (np.arange(n_samples) - (n_samples - 1) / 2))
    basis = np.ones((len(omega), 1 + 2 * n_harmonics, n_samples))
    power = np.ones_like(carrier)
    for order in range(n_harmonics):
        power = power * carrier
        basis[:, 1 + 2 * order], basis[:, 2 + 2 * order] = power.real, power.imag
    return basis


def _solve(basis: Floats, codes: Floats) -> Floats:
    """Least-squares coefficients (R, P), by normal equations of columns scaled to one length."""
    scale = np.sqrt(np.einsum("rpn,rpn->rp", basis, basis))
    scaled = basis / scale[:, :, np.newaxis]
    gram = scaled @ scaled.swapaxes(1, 2)
    # The faintest ridge keeps a record whose columns coincide from stopping the whole batch.
    gram += 1e-12 * np.eye(gram.shape[1])
    return np.asarray(np.linalg.solve(gram, scaled @ codes[:, :, np.newaxis])[..., 0] / scale)
