"""The lock-in waveform on a phase that wanders: a rate that moves during the record.

    v = dc + Re[ B (e - conj q(t)) / (1 - q(t) e) ],    e = exp(i theta(t)),
    theta = w m + sum over j = 2..J of a_j P_j(t)

P_j are Legendre polynomials over the record, so the straight part of the phase stays the mean frequency. Since WL
is constant while the rate moves, the ratio moves too: q(t) is q times what the momentary frequency makes of it,
and the mean of the signal moves with it, which is why the waveform is written here with its constant term.

A wander of a few tenths of a radian already spoils a fit at constant frequency, because the second harmonic
wanders twice as far as the fundamental. How many polynomials are needed the data decide (Bayesian information
criterion), and each of them costs its degree of freedom: the covariance is that of all parameters together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import legendre

from analysis.arrays import Complexes, Floats
from analysis.waveform.series.geometric_series import LARGEST_RATIO
from analysis.waveform.series.normal_equations import Step

DEGREES = (2, 3, 4, 6, 8, 11, 15, 20, 27, 36, 48)
"""Numbers of polynomials tried in turn."""

ITERATIONS = 20
NEAR, CLOSE = 1e-4, 1e-7
"""Share of the residual power that a last step may gain: enough to compare numbers of polynomials, and enough for
the result."""


def looks_like_wander(left: Floats, omega: float, ratio: float) -> bool:
    """Whether what a straight phase leaves stands about the fundamental, as the sidebands of a wander do.

    Distortion leaves harmonics, a slow drift the lowest frequencies: no moving phase would mend those. A wander of
    s rad wanders by k s at the k-th harmonic, so its sidebands there have k^2 r^(2k-2) of the power of those about
    the fundamental. The ratio found on a straight phase is too small, which the power 1.5 allows for.
    """
    power = np.abs(np.fft.rfft(left)[1:]) ** 2
    floor = float(np.median(power)) / np.log(2)
    line = omega * left.size / (2 * np.pi)
    bins = np.arange(1, power.size + 1)
    beside = (bins > 0.5 * line) & (bins < 1.5 * line)
    of_fundamental = (1 - ratio**2) ** 3 / (1 + ratio**2)
    surplus, of_all = float((power[beside] - floor).sum()), float((power - floor).sum())
    return bool(surplus > 0.5 * of_fundamental**1.5 * of_all)


@dataclass(frozen=True)
class TrackedFit:
    """Fit of one record with a wandering phase.

    first, ratio : H and q, phases from the middle of the record; offset : c0
    omega : rad per sample, the mean
    covariance : (6, 6) for unit noise, order c0, Re H, Im H, Re q, Im q, w (rad at the record's ends)
    degree : number of polynomials, the frequency included; 1 means that none was needed
    left : (N,) residual
    """

    offset: float
    first: complex
    ratio: complex
    omega: float
    covariance: Floats
    degree: int
    left: Floats


def track_phase(values: Floats, weights: Floats | None, omega: float) -> TrackedFit | None:
    """Fit one record with as many phase polynomials as it needs.

    Parameters
    ----------
    values : (N,); weights : (N,) or None
        Centred, 0 where missing.
    omega : float
        Rough beat frequency, rad per sample.

    Returns
    -------
    TrackedFit or None
        None if no polynomial makes the fit better than a straight phase does.
    """
    n_samples = values.size
    mask = np.ones(n_samples) if weights is None else weights
    highest = min(DEGREES[-1], n_samples // 20)
    basis, slopes = _polynomials(n_samples, highest)
    seen = _fundamental_phase(values, omega)
    centred = seen - seen.mean()
    # The filter rings where the record's ends meet: one period at either end says nothing.
    edge = int(2 * np.pi / omega)
    trusted = mask.copy()
    trusted[:edge] = trusted[n_samples - edge :] = 0.0
    problem = _Problem(values, mask, basis, slopes)
    best, best_criterion, worse = None, np.inf, 0
    parameters, count = None, float(mask.sum())
    for degree in (1, *(d for d in DEGREES if d <= highest)):
        columns = np.concatenate([np.ones((1, n_samples)), basis[:degree]]) * trusted
        starts = [problem.start(np.linalg.lstsq(columns.T, centred * trusted, rcond=None)[0][1:])]
        if parameters is not None:
            starts.append(np.concatenate([parameters, np.zeros(5 + degree - parameters.size)]))
        parameters, step, _ = problem.fit(min(starts, key=problem.residual_power), NEAR)
        criterion = count * np.log(max(step.residual_power[0], 1e-300)) + (degree + 5) * np.log(count)
        if criterion < best_criterion:
            best, best_criterion, worse = parameters, criterion, 0
        else:
            worse += 1
            # A ripple of several turns may need ten polynomials before the first of them helps.
            if worse == 3 and best is not None and best.size > 6:
                break
    return None if best is None or best.size == 6 else _tracked(*problem.fit(best, CLOSE))


@cache
def _polynomials(n_samples: int, highest: int) -> tuple[Floats, Floats]:
    """Legendre polynomials of degree 1 to `highest` over a record, and their derivatives; (highest, N) each."""
    time = (np.arange(n_samples) - (n_samples - 1) / 2) * (2 / n_samples)
    derivatives = [legendre.legval(time, legendre.legder(row)) for row in np.eye(highest + 1)[1:]]
    return legendre.legvander(time, highest).T[1:], np.stack(derivatives)


def _tracked(parameters: Floats, step: Step, left: Floats) -> TrackedFit:
    ratio = complex(parameters[3], parameters[4])
    to_first = 1 - abs(ratio) ** 2
    # Only the phase of H matters to those who use the covariance; its size follows from B and q.
    scale = np.array([1.0, to_first, to_first, 1.0, 1.0, 1.0])
    return TrackedFit(
        offset=float(parameters[0]),
        first=complex(parameters[1], parameters[2]) * to_first,
        ratio=ratio,
        omega=float(parameters[5]) * 2 / left.size,
        covariance=step.covariance()[0][:6, :6] * np.outer(scale, scale),
        degree=parameters.size - 5,
        left=left,
    )


def _fundamental_phase(values: Floats, omega: float) -> Floats:
    """Unwrapped phase of what lies within half its frequency about the fundamental, (N,)."""
    n_samples = values.size
    spectrum = np.fft.fft(values)
    line = omega * n_samples / (2 * np.pi)
    bins = np.arange(n_samples)
    spectrum[(bins < 0.5 * line) | (bins > min(1.5 * line, n_samples / 2))] = 0.0
    return np.asarray(np.unwrap(np.angle(np.fft.ifft(spectrum))))


class _Problem:
    """Least squares of one record; parameters dc, Re B, Im B, Re q, Im q, a_1..a_J (a_1 is the frequency)."""

    def __init__(self, values: Floats, mask: Floats, basis: Floats, slopes: Floats) -> None:
        self.values, self.mask, self.basis, self.slopes = values, mask, basis, slopes

    def start(self, phase_coefficients: Floats) -> Floats:
        """Parameters from a linear fit of two harmonics on a given phase."""
        phase = phase_coefficients @ self.basis[: phase_coefficients.size]
        harmonics = [np.cos(phase), -np.sin(phase), np.cos(2 * phase), -np.sin(2 * phase)]
        columns = np.stack([np.ones_like(phase), *harmonics])
        solution = np.linalg.lstsq((columns * self.mask).T, self.values * self.mask, rcond=None)[0]
        first, second = complex(solution[1], solution[2]), complex(solution[3], solution[4])
        ratio = second / first if first != 0 else 0j
        ratio *= min(1.0, 0.9 / max(abs(ratio), 1e-12))
        whole = first / (1 - abs(ratio) ** 2)
        dc = solution[0] + (whole * np.conj(ratio)).real
        return np.array([dc, whole.real, whole.imag, ratio.real, ratio.imag, *phase_coefficients])

    def residual_power(self, parameters: Floats) -> float:
        """Sum of squares that these parameters leave."""
        left = self._model(parameters)[0]
        return float(left @ left)

    def fit(self, parameters: Floats, tolerance: float) -> tuple[Floats, Step, Floats]:
        """Levenberg-Marquardt: parameters, normal equations and residual at the minimum."""
        damping = 0.0
        step, left = self._normal_equations(parameters)
        for _ in range(ITERATIONS):
            trial = parameters + step.solve(np.array([damping]))[0]
            size = np.hypot(trial[3], trial[4])
            if size > LARGEST_RATIO:
                trial[3:5] *= LARGEST_RATIO / size
            trial_step, trial_left = self._normal_equations(trial)
            gain = float(step.residual_power[0] - trial_step.residual_power[0])
            if gain >= 0:
                parameters, step, left, damping = trial, trial_step, trial_left, damping / 10
                if gain < tolerance * step.residual_power[0]:
                    break
            else:
                damping = max(10 * damping, 1e-3)
                if damping > 1e6:
                    break
        return parameters, step, left

    def _model(self, parameters: Floats) -> tuple[Floats, Complexes, Complexes, Floats]:
        """Residual, carrier, 1 - q(t) e, and the factor of q(t)."""
        coefficients = parameters[5:]
        carrier: Complexes = np.asarray(
            np.exp(1j * (coefficients @ self.basis[: coefficients.size])), np.complex128
        )
        ratio = complex(parameters[3], parameters[4])
        factor = self._ratio_factor(abs(ratio), coefficients)
        below = np.asarray(1 - ratio * factor * carrier, dtype=np.complex128)
        wave = complex(parameters[1], parameters[2]) * (carrier - np.conj(ratio) * factor) / below
        residual: Floats = (self.values - parameters[0] - wave.real) * self.mask
        return residual, carrier, below, factor

    def _ratio_factor(self, size: float, coefficients: Floats) -> Floats:
        """r(t)/r for a constant WL: 2r/(1 - r^2) goes as one over the momentary frequency."""
        frequency = coefficients @ self.slopes[: coefficients.size]
        mean = float(coefficients[0])
        relative = np.clip(frequency / mean, 0.2, 5.0) if mean != 0 else np.ones_like(frequency)
        if size < 1e-9:
            return np.asarray(1 / relative)
        tangent = 2 * size / (1 - size * size) / relative
        return np.asarray(tangent / (1 + np.sqrt(1 + tangent * tangent)) / size)

    def _normal_equations(self, parameters: Floats) -> tuple[Step, Floats]:
        left, carrier, below, factor = self._model(parameters)
        whole, ratio = complex(parameters[1], parameters[2]), complex(parameters[3], parameters[4])
        moebius = (carrier - np.conj(ratio) * factor) / below
        # q(t) stands in the denominator, its conjugate in the numerator. How the phase coefficients move the
        # factor of q(t) is left out: it slows the convergence a little and does not move the minimum much.
        by_q, by_conjugate = whole * factor * moebius * carrier / below, whole * factor / below
        by_phase = -(whole * carrier * (1 - (np.abs(ratio) * factor) ** 2) / below**2).imag
        tangents = np.concatenate(
            [
                np.stack([np.ones_like(left), moebius.real, -moebius.imag]),
                np.stack([(by_q - by_conjugate).real, -(by_q + by_conjugate).imag]),
                by_phase * self.basis[: parameters.size - 5],
            ]
        )
        tangents *= self.mask
        step = Step((tangents @ tangents.T)[np.newaxis], (tangents @ left)[np.newaxis], np.array([left @ left]))
        return step, left
