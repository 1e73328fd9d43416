"""The Cramér-Rao bound: the smallest standard deviation that any unbiased estimator can reach.

The derivatives by r and by the phase are numerical, those by amplitude, readout phase and offset are plain; the
one by the frequency is that by the phase times 2 pi n. Rounding counts as white noise of 1/sqrt(12) level.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Complexes, Floats
from benchmarks.estimator.gyros import N_SAMPLES, Gyros, phasor, unit_beat


@dataclass(frozen=True)
class Bound:
    """Smallest standard deviations of (R,) records: cycles per sample, r, deg/s."""

    frequency: Floats
    ratio: Floats
    lock_in_rate: Floats


def cramer_rao_bound(gyros: Gyros) -> Bound:
    """Bound of a record that is its own rate reference: f, r, two phases, amplitude and offset unknown."""
    u = phasor(gyros.frequency, gyros.theta)
    z = unit_beat(gyros.ratio, u)
    by_delta, shape = _rotated(gyros, 1j * z), _rotated(gyros, z)

    step = 1e-5 * (1 - gyros.ratio)
    by_ratio = unit_beat(gyros.ratio + step, u) - unit_beat(gyros.ratio - step, u)
    by_ratio /= 2 * step[:, np.newaxis]
    turn = 1e-5
    by_theta = unit_beat(gyros.ratio, u * np.exp(1j * turn)) - unit_beat(gyros.ratio, u * np.exp(-1j * turn))
    by_theta /= 2 * turn

    amplitude = gyros.amplitude[:, np.newaxis]
    index = 2 * np.pi * (np.arange(N_SAMPLES) - (N_SAMPLES - 1) / 2)
    phase = amplitude * _rotated(gyros, by_theta)
    # Counting samples from the middle changes what theta means, not what is known of f and r.
    columns = [phase * index, amplitude * _rotated(gyros, by_ratio), phase, amplitude * by_delta, shape]
    jacobian = np.stack([*columns, np.ones_like(shape)], axis=1)
    scale = np.sqrt(np.einsum("rpn,rpn->rp", jacobian, jacobian))
    jacobian /= scale[:, :, np.newaxis]
    gram = np.matmul(jacobian, jacobian.swapaxes(1, 2))
    covariance = np.linalg.inv(gram)[:, :2, :2] / (scale[:, :2, np.newaxis] * scale[:, np.newaxis, :2])
    covariance *= (gyros.total_noise**2)[:, np.newaxis, np.newaxis]

    r = gyros.ratio
    slopes = np.stack([2 * r / (1 - r * r), gyros.frequency * 2 * (1 + r * r) / (1 - r * r) ** 2], axis=-1)
    variance = np.einsum("ri,rij,rj->r", slopes, covariance, slopes)
    return Bound(np.sqrt(covariance[:, 0, 0]), np.sqrt(covariance[:, 1, 1]), np.sqrt(variance))


def _rotated(gyros: Gyros, z: Complexes) -> Floats:
    """Im(z exp(i delta)), or of the conjugate of z for the negative sense; linear in the real and imaginary part.

    A multiplication by i before it is a derivative by delta only for the positive sense; for the negative one it
    changes the sign of that column, which the bound does not see.
    """
    sine, cosine = np.sin(gyros.delta), gyros.sense * np.cos(gyros.delta)
    return np.asarray(sine[:, np.newaxis] * z.real + cosine[:, np.newaxis] * z.imag)
