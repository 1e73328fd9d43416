"""The phase of every sample and the few numbers that rule them all, fitted at the same time.

    minimise  sum over samples of (v - C - A sin(phi_n))^2  +  (1/l) sum over steps of (phi_(n+1) - F(phi_n))^2

F is the exact step of the lock-in equation, a(t), A(t) and C(t) are polynomials. l is the variance of what moves
the phase beside them over that of the noise of the samples: large, the phases follow the samples whatever the
motion may be; small, the equation holds exactly. So a fit that starts large and goes small does not get lost, and
one that stays in between is that of a rate with noise of its own: in a linear problem this is the estimate of
generalised least squares, and its covariance.

Each Gauss-Newton step eliminates the phases one after the other, as Kalman's filter does: what every sample says
of the parameters is what the samples before it have left open.

A beat is mostly sampled far more often than its phase needs. The means of a few samples are then fitted in their
place: v_n is C + A (sin(phi) + k d2(sin phi)/dn2) in the middle of them, k = (1 - 1/of^2)/24, and l is of^2 times
as large. A step of C at a sample is a share of its mean.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import lapack

from analysis.arrays import Floats

# --------------------
# The lock-in equation from one sample to the next, exactly, and how the step moves with what it starts from.
#
#     d(phi)/dt = a(t) - s sin(phi) + c cos(phi),     s + i c = b exp(i gamma)
#
# phi is the phase that the detector sees, so v = C + A sin(phi) holds without another angle; a = 2 pi K W,
# b = 2 pi K WL, gamma = readout phase less backscatter phase. With tan(phi/2) = n/d the equation is linear,
#
#     d(n, d)/dt = M (n, d),    M = [[-s, a + c], [c - a, s]] / 2
#
# and a step is one matrix exponential. While a changes by D within the step, the two first terms of Magnus' series
# turn gamma by D/12; what is left out is of fourth order


LOCKED_AT_MOST = 50.0
"""Relaxation times in one step beyond which exponentials are cut off: no beat is sampled so coarsely."""


@dataclass(frozen=True)
class TrajectorySteps:
    """What each of (N - 1,) steps does."""

    advance: Floats  # rad, phase gained
    by_phase: Floats  # derivatives of the phase at its end by that at its start, by a, s and c
    by_rate: Floats
    by_sine: Floats
    by_cosine: Floats
    sine: Floats  # (N,) of the phases
    cosine: Floats


def exact_steps(phase: Floats, mean_rate: Floats, rate: Floats, sine: float, cosine: float) -> TrajectorySteps:
    """Steps from the first N - 1 of N phases."""
    half = phase / 2
    n, d = np.sin(half), np.cos(half)
    sin, cos = 2 * n * d, (d - n) * (d + n)
    n0, d0 = n[:-1], d[:-1]
    turn = (rate[1:] - rate[:-1]) / 12
    s, c = sine - turn * cosine, cosine + turn * sine
    square = (mean_rate**2 - s**2 - c**2) / 4
    root = np.sqrt(np.maximum(np.abs(square), 1e-18))
    even, odd = np.cos(root), np.sin(root) / root
    locked = np.flatnonzero(square < 0)
    if locked.size:
        slow = np.minimum(root[locked], LOCKED_AT_MOST)
        even[locked], odd[locked] = np.cosh(slow), np.sinh(slow) / slow
    odd /= 2
    n1 = even * n0 + odd * ((mean_rate + c) * d0 - s * n0)
    d1 = even * d0 + odd * ((c - mean_rate) * n0 + s * d0)
    # The matrix has determinant 1, so the square of the length says how neighbouring phases spread.
    by_phase = 1 / (n1 * n1 + d1 * d1)

    def slopes(sin: Floats, cos: Floats, rate: Floats) -> tuple[Floats, Floats, Floats]:
        # of what changes of a, s and c add to the phase: 1, -sin and cos, as seen at the end of the step
        pull, speed = sine * cos + cosine * sin, rate - sine * sin + cosine * cos
        return pull, -cos * speed - sin * pull, cos * pull - sin * speed

    sin1, cos1 = 2 * n1 * d1 * by_phase, (d1 - n1) * (d1 + n1) * by_phase
    added = by_phase + 1, -sin[:-1] * by_phase - sin1, cos[:-1] * by_phase + cos1
    pairs = zip(added, slopes(sin[:-1], cos[:-1], rate[:-1]), slopes(sin1, cos1, rate[1:]), strict=True)
    # Hermite's rule: exact for cubics
    by_rate, by_sine, by_cosine = (both / 2 + (first * by_phase - last) / 12 for both, first, last in pairs)
    advance = 2 * np.arctan2(n1 * d0 - d1 * n0, d1 * d0 + n1 * n0)
    return TrajectorySteps(advance, by_phase, by_rate, by_sine, by_cosine, sin, cos)


DERIVATIVES = np.array([[-1, 7, 7, -1], [-1, 15, -15, 1]]) / 12
"""First and second derivative in the middle of four even steps, the last one first, by what each advances."""

LARGEST_TURN = 1.0  # rad by which a phase may change in one step of the fit
PHASES_ALONE = 2  # steps by which the phases of samples are found from those of means
SHORTER, SHORTENED = 4.0, 6  # a step that makes the fit worse is tried again so many times shorter, and so often
ENOUGH = 1e-3  # gain of a last step, in variances of a sample's noise: a thirtieth of a standard uncertainty

RIDGE = 1e-12

SLOW_CHANGES = 3  # polynomials, from the first on, by which s and c may change along the record


def unit_diagonal(normal: Floats) -> tuple[Floats, Floats]:
    """A normal matrix with a diagonal of one and a ridge against rounding, and the scale (P,) that gives it."""
    scale = 1 / np.sqrt(np.maximum(np.diagonal(normal), 1e-300))
    scaled = normal * scale * scale[:, np.newaxis]
    scaled.flat[:: len(scaled) + 1] += RIDGE
    return scaled, scale


@dataclass(frozen=True)
class Terms:
    """How many terms rate, amplitude and offset have, polynomials unless said otherwise."""

    rate: int
    amplitude: int
    offset: int
    step: int | None = None  # first of the samples behind a step of the offset, which is then one term more

    @property
    def count(self) -> int:
        """Number of parameters, s and c included."""
        return self.rate + 2 + self.amplitude + self.offset + (self.step is not None)


@dataclass(frozen=True)
class Trajectory:
    """phase : (N,) rad
    parameters : (P,) rate, s, c, amplitude, offset, step of the offset; `terms` says how many of each.
    N are samples or means of them, and rates are in rad from one to the next.
    """

    phase: Floats
    parameters: Floats
    terms: Terms

    @property
    def parts(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Coefficients of a(t), rad per mean; s and c; coefficients of A(t), and of C(t) with its step last."""
        pull, amplitude, every = self.terms.rate, self.terms.rate + 2, self.parameters
        offset = amplitude + self.terms.amplitude
        return every[:pull], every[pull:amplitude], every[amplitude:offset], every[offset:]


@dataclass(frozen=True)
class TrajectoryModel:
    """What a trajectory makes of a record: residuals of samples and steps, and their derivatives."""

    left: Floats  # (N,) residuals of the samples
    moved: Floats  # (N - 1,) rad, residuals of the steps: what moves the phase beside the equation
    steps: TrajectorySteps
    by_phase: Floats
    by_sample: Floats

    def cost(self, looseness: float) -> float:
        """The sum that is minimised."""
        return float(self.left @ self.left + self.moved @ self.moved / looseness)

    def phases(self, looseness: float) -> tuple[Floats, Floats]:
        """D and L of the matrix L D L' of the phases, which is tridiagonal."""
        tight, along = 1 / looseness, self.steps.by_phase
        diagonal = self.by_phase**2
        diagonal += RIDGE * np.mean(diagonal)
        diagonal[1:] += tight
        diagonal[:-1] += along**2 * tight
        factor, ratios, failed = lapack.dpttrf(diagonal, -along * tight)
        if failed:
            raise np.linalg.LinAlgError("the phases are not determined")
        return factor, ratios

    def gradient(self, looseness: float, left: Floats, moved: Floats) -> Floats:
        """Slope of the sum by the phases, with other residuals of samples and steps."""
        gradient, pull = self.by_phase * left, moved / looseness
        gradient[1:] -= pull
        gradient[:-1] += self.steps.by_phase * pull
        return gradient


@dataclass(frozen=True)
class Fitted:
    """A trajectory with what is known of it at the minimum."""

    trajectory: Trajectory
    looseness: float
    cost: float  # the sum that was minimised, in squared units of the samples
    degrees: float  # means of samples less parameters
    normal: Floats  # (P, P) normal matrix of the parameters, phases eliminated
    evidence: float  # -2 log of the restricted likelihood, without a constant, its noise at its best
    model: TrajectoryModel
    converged: bool  # whether the last step gained next to nothing

    @property
    def variance(self) -> float:
        """Of the noise of a mean of samples."""
        return self.cost / self.degrees

    @property
    def covariance(self) -> Floats:
        """Of the parameters, (P, P)."""
        scaled, scale = unit_diagonal(self.normal)
        return np.asarray(np.linalg.inv(scaled) * scale * scale[:, np.newaxis] * self.variance)


class SampledRecord:
    """One record, `mask` 0 where a sample is missing, as the (N,) means of `of` samples each that are fitted."""

    def __init__(self, samples: Floats, mask: Floats, of: int = 1) -> None:
        self.samples, self.valid, self.count, self.of = samples, mask, float(mask.sum()), of
        self.values, self.mask = samples.reshape(-1, of).mean(axis=1), mask.reshape(-1, of).min(axis=1)
        self._bend = (1 - of**-2.0) / 24  # a mean is off by so much of the second derivative
        self._around = np.clip(np.arange(-2, self.values.size + 1), 0, self.values.size - 2)  # with two more

    def fit(self, start: Trajectory | Fitted, looseness: float, iterations: int, enough: float = ENOUGH) -> Fitted:
        """Gauss-Newton from a start; `looseness` is l above, in 1 over squared units of the samples."""
        now = start.trajectory if isinstance(start, Fitted) else start
        model = start.model if isinstance(start, Fitted) else self._model(now)
        cost, converged, n_means = model.cost(looseness), False, float(self.mask.sum())
        for _ in range(iterations):
            normal, slope, phases, volume = _without_phases(self, now, model, looseness)
            scaled, scale = unit_diagonal(normal)
            by_parameters = scale * np.linalg.solve(scaled, scale * slope)
            by_phase, gain = _phases_with(by_parameters, now, model, looseness, phases)
            gain += float(slope @ by_parameters)
            share = min(1.0, LARGEST_TURN / max(float(np.abs(by_phase).max()), 1e-300))
            # At the minimum the cost repeats to rounding.
            little = gain < enough * cost / n_means
            for _ in range(1 if little else SHORTENED):
                trial = replace(
                    now, phase=now.phase + share * by_phase, parameters=now.parameters + share * by_parameters
                )
                trial_model = self._model(trial)
                trial_cost = trial_model.cost(looseness)
                if trial_cost <= cost:
                    break
                share /= SHORTER
            converged = share == 1.0 and little
            if not trial_cost <= cost:
                converged = little
                break
            now, model, cost = trial, trial_model, trial_cost
            if converged:
                break
        # one more phase than parameters is free: that of the start
        degrees = max(n_means - now.terms.count - 1, 1.0)
        evidence = degrees * np.log(max(cost, 1e-300)) + (self.values.size - 1) * np.log(looseness)
        evidence += volume + np.linalg.slogdet(scaled)[1] - 2 * np.log(scale).sum()
        return Fitted(now, looseness, cost, degrees, normal, float(evidence), model, converged)

    def changes_of_pull(self, fitted: Fitted) -> tuple[Floats, Floats]:
        """What s and c would be times the polynomials from the first to the third, (6,), and its covariance."""
        # One step from the minimum of a fit without such changes.
        at = fitted.trajectory
        normal, slope, _, _ = _without_phases(self, at, fitted.model, fitted.looseness, changing=True)
        scaled, scale = unit_diagonal(normal)
        places = at.terms.rate + 2 + np.arange(2 * SLOW_CHANGES)
        inverse = (np.linalg.inv(scaled) * scale * scale[:, np.newaxis])[places]
        return inverse @ slope, inverse[:, places] * fitted.variance

    def columns(self, terms: Terms) -> tuple[Floats, Floats]:
        """What A and C are made of, (terms, N) each."""
        low = polynomials(self.values.size).values
        of_offset = low[: terms.offset]
        if terms.step is not None:
            behind = (np.arange(self.samples.size) >= terms.step).reshape(-1, self.of).mean(axis=1)
            of_offset = np.concatenate([of_offset, behind[np.newaxis]])
        return low[: terms.amplitude], of_offset

    def residual(self, trajectory: Trajectory, looseness: float = 0.0) -> Floats:
        """What a trajectory leaves of each sample; with a looseness its phase goes its way between means."""
        from scipy.interpolate import CubicSpline  # takes longer to import than most records need it

        by_mean = np.arange(trajectory.terms.count) < trajectory.terms.rate + 2
        whole, parameters = SampledRecord(self.samples, self.valid), trajectory.parameters / self.of**by_mean
        places = (np.arange(self.values.size) + 0.5) * self.of - 0.5
        phase = CubicSpline(places, trajectory.phase)(np.arange(self.samples.size))
        now = Trajectory(phase, parameters, trajectory.terms)
        for _ in range(PHASES_ALONE if looseness else 0):
            model, loose = whole._model(now), looseness / self.of**2
            step = lapack.dpttrs(*model.phases(loose), model.gradient(loose, model.left, model.moved))[0]
            now = replace(now, phase=now.phase + step)
        return whole._model(now).left

    def _model(self, trajectory: Trajectory) -> TrajectoryModel:
        of_amplitude, of_offset = self.columns(trajectory.terms)
        rate, (s, c), amplitude, offset = trajectory.parts
        height, low = amplitude @ of_amplitude, polynomials(self.values.size)
        steps = exact_steps(trajectory.phase, rate @ low.means[: rate.size], rate @ low.values[: rate.size], s, c)
        sine, cosine = steps.sine, steps.cosine
        by_phase = height * cosine * self.mask
        if self._bend:
            advance = steps.advance[self._around]
            slope, curve = (np.convolve(advance, weights, mode="valid") for weights in DERIVATIVES)
            sine = sine + self._bend * (cosine * curve - sine * slope**2)
        left = (self.values - offset @ of_offset - height * sine) * self.mask
        return TrajectoryModel(
            left,
            np.diff(trajectory.phase) - steps.advance,
            steps,
            by_phase,
            np.concatenate([of_amplitude * sine, of_offset]) * self.mask,
        )


def _without_phases(
    record: SampledRecord, at: Trajectory, model: TrajectoryModel, looseness: float, *, changing: bool = False
) -> tuple[Floats, Floats, tuple[Floats, Floats], float]:
    """Normal matrix and slope of the parameters without the phases; D and L of K = L D L' of these; log det K."""
    # `changing`: behind s and c what they are times each of the next polynomials.
    steps, low, n_rate = model.steps, polynomials(record.values.size).means, at.terms.rate
    n_moved = n_rate + 2 + 2 * SLOW_CHANGES * changing
    n_all, (factor, ratios) = n_moved + len(model.by_sample), model.phases(looseness)
    # the reciprocal variance of each phase by the samples up to its own, and by those before
    ridge, passing = RIDGE * np.mean(model.by_phase**2), np.append(steps.by_phase**2 / looseness, 0.0)
    known = np.maximum(factor - passing, model.by_phase**2 + ridge)
    volume = float(np.log(known + passing).sum())
    before = np.append(0.0, known[:-1] / factor[:-1] / looseness) + ridge
    kept, passed_on = np.minimum(before / known, 1.0), steps.by_phase * (model.by_phase / known)[:-1]
    # how the phase expected from those before goes with each parameter, and, in the last row, what is left of it
    rows = np.empty((n_all + 1, record.values.size))
    of_steps, of_samples, last = rows[:n_moved, 1:], rows[n_moved:n_all], rows[n_all]
    np.multiply(low[:n_rate], steps.by_rate, out=of_steps[:n_rate])
    of_steps[n_rate : n_rate + 2] = steps.by_sine, steps.by_cosine
    for k in range(1, SLOW_CHANGES * changing + 1):
        of_steps[n_rate + 2 * k : n_rate + 2 * k + 2] = of_steps[n_rate : n_rate + 2] * low[k]
    np.multiply(model.by_sample[:, :-1], -passed_on, out=of_samples[:, 1:])
    last[1:] = passed_on * model.left[:-1] - model.moved
    rows[:, 0] = 0.0
    lower = np.ones((2, factor.size))
    lower[1, :-1] = -steps.by_phase * kept[:-1]
    lapack.dtbtrs(lower, rows.T, uplo="L", diag="U", overwrite_b=True)
    rows *= model.by_phase
    of_samples += model.by_sample
    last -= model.left
    rows *= np.sqrt(kept)
    both = rows @ rows.T
    return both[:n_all, :n_all], -both[:n_all, n_all], (factor, ratios), volume


def _phases_with(
    by_parameters: Floats, at: Trajectory, model: TrajectoryModel, looseness: float, phases: tuple[Floats, Floats]
) -> tuple[Floats, float]:
    """Change of the phases that goes with one of the parameters, and what phases alone would gain."""
    steps, n_rate = model.steps, at.terms.rate
    of_rate, (sine, cosine), rest = np.split(by_parameters, [n_rate, n_rate + 2])
    expected = of_rate @ polynomials(model.left.size).means[:n_rate] * steps.by_rate
    expected += sine * steps.by_sine + cosine * steps.by_cosine
    alone = model.gradient(looseness, model.left, model.moved)
    both = model.gradient(looseness, model.left - rest @ model.by_sample, model.moved - expected)
    changes = lapack.dpttrs(*phases, np.stack([both, alone], axis=1))[0]
    return changes[:, 0], float(alone @ changes[:, 1])


# --------------------
# Legendre polynomials over a record: slow motions of rate, amplitude and offset are sums of them


HIGHEST = 260  # degree: enough for a motion of eighty cycles in the record


@dataclass(frozen=True)
class Polynomials:
    """P_0 .. P_HIGHEST on the samples; time runs from -1 to 1 over the record."""

    values: Floats  # (HIGHEST + 1, N) P_j, and its integral over the samples
    integrals: Floats
    means: Floats  # (HIGHEST + 1, N - 1) mean of P_j between neighbouring samples


@lru_cache(maxsize=4)
def polynomials(n_samples: int) -> Polynomials:
    """All polynomials that are used."""
    time = (np.arange(n_samples) - (n_samples - 1) / 2) * (2 / n_samples)
    values = legendre.legvander(time, HIGHEST + 1).T.copy()
    # (2j + 1) P_j is the derivative of P_(j+1) - P_(j-1)
    integrals = np.empty((HIGHEST + 1, n_samples))
    integrals[0] = time
    integrals[1:] = (values[2:] - values[:-2]) / (2 * np.arange(1, HIGHEST + 1)[:, np.newaxis] + 1)
    integrals *= n_samples / 2
    return Polynomials(values[:-1], integrals, np.diff(integrals, axis=1))
