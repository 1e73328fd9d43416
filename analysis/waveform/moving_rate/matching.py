"""First values of the rate's motion from a phase that is known roughly: a linear problem.

Integrated, the lock-in equation is linear in all that is not the phase:

    phi(t) = phi_0 + sum over j of a_j I_j(t) - s S(t) + c C(t)

with I_j, S, C the integrals of the polynomials, of sin(phi) and of cos(phi). Weighted by A cos(phi), which turns
an error of the phase into one of the sample, its least squares are nearly those of the samples themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from analysis.arrays import Floats
from analysis.waveform.moving_rate.polynomials import polynomials

RIDGE = 1e-12


@dataclass(frozen=True)
class Motion:
    """rate (J,): Legendre coefficients of a(t), rad per sample; sine, cosine: s and c."""

    rate: Floats
    sine: float
    cosine: float


def matched_motion(phase: Floats, weights: Floats, terms: int) -> Motion:
    """Motion with as many polynomials as the phase asks for (Bayesian information criterion), at most `terms`."""
    others = [np.ones(phase.size), -_integral(np.sin(phase)), _integral(np.cos(phase))]
    columns = np.concatenate([others, polynomials(phase.size).integrals[:terms]])
    columns *= weights
    target = weights * phase
    normal = columns @ columns.T
    scale = 1 / np.sqrt(np.maximum(np.diagonal(normal), 1e-300))
    normal *= scale
    normal *= scale[:, np.newaxis]
    normal[np.diag_indices_from(normal)] += RIDGE
    factor = scipy.linalg.cholesky(normal, lower=True)
    # The factor is nested: what each further polynomial explains is one square.
    explained = scipy.linalg.solve_triangular(factor, scale * (columns @ target), lower=True)
    left = np.maximum(target @ target - np.cumsum(explained**2)[3:], 1e-300)
    count = np.count_nonzero(weights)
    degree = int(np.argmin(count * np.log(left) + np.log(count) * np.arange(left.size)))
    size = degree + 4
    solution = scale[:size] * scipy.linalg.solve_triangular(factor[:size, :size].T, explained[:size])
    return Motion(solution[3:], float(solution[1]), float(solution[2]))


def _integral(values: Floats) -> Floats:
    return np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2)])
